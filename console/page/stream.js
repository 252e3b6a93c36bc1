// The connection to facewire-console: one stream of events, which the browser opens again after it has broken.

const KINDS = ["hello", "face", "status", "calibration", "recording"];
// The console sends an event every half second at least. A network that has gone does not break a connection for minutes.
const MOST_SILENT_S = 3;

// Calls `on.KIND` with each event, and `on.lost` when the connection breaks or falls silent, with the server's reason if it was
// refused. A page that nobody sees gives its place up, unless `mustStay` says otherwise. Returns a function that connects again.
export function connect(on, mustStay) {
  let source;
  let silent = 0;
  const open = () => {
    source = new EventSource("api/1/events");
    for (const kind of KINDS)
      source.addEventListener(kind, (event) => {
        silent = 0;
        on[kind](JSON.parse(event.data));
      });
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
  // A page that was busy itself for a while counts one second at most.
  setInterval(() => {
    silent = source ? silent + 1 : 0;
    if (silent <= MOST_SILENT_S) return;
    silent = 0;
    on.lost("the console is silent");
    reopen();
  }, 1000);
  open();
  return reopen;
}

// Asks why the stream is refused, which an EventSource does not tell. Nothing if it is not refused any more.
async function refusal() {
  const answer = await fetch("api/1/events").catch(() => undefined);
  if (answer && !answer.ok) return (await answer.text()).trim();
  await answer?.body?.cancel();
}
