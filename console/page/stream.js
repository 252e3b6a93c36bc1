// The connection to facewire-console: one stream of events, which the browser opens again after it has broken.

const KINDS = ["hello", "face", "status", "calibration", "recording"];

// Calls `on.KIND` with each event, and `on.lost` when the connection breaks, with the server's reason if it was refused.
// A page that nobody sees gives its place up, unless `mustStay` says otherwise.
export function connect(on, mustStay) {
  let source;
  const open = () => {
    source = new EventSource("api/1/events");
    for (const kind of KINDS) source.addEventListener(kind, (event) => on[kind](JSON.parse(event.data)));
    source.addEventListener("error", () => {
      on.lost();
      // The browser tries again by itself, but not after a refusal.
      if (source?.readyState !== EventSource.CLOSED) return;
      setTimeout(reopen, 2000);
      refusal().then((reason) => reason && source?.readyState === EventSource.CLOSED && on.lost(reason));
    });
  };
  const close = () => {
    source?.close();
    source = undefined;
  };
  const reopen = () => {
    close();
    if (document.visibilityState === "visible" || mustStay()) open();
  };
  document.addEventListener("visibilitychange", () => {
    if (document.visibilityState === "visible" && !source) open();
    else if (document.visibilityState === "hidden" && !mustStay()) close();
  });
  open();
}

// Asks why the stream is refused, which an EventSource does not tell. Nothing if it is not refused any more.
async function refusal() {
  const answer = await fetch("api/1/events").catch(() => undefined);
  if (answer && !answer.ok) return (await answer.text()).trim();
  await answer?.body?.cancel();
}
