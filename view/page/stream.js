// The connection to facewire-view: one stream of events, which the browser opens again after it has broken.

// Calls `on.hello` with what does not change, `on.snapshot` with each snapshot, and `on.lost` when the connection breaks or
// is refused.
// A page that nobody sees gives its place up, unless `mustStay` says otherwise.
export function connect(on, mustStay) {
  let source;
  const open = () => {
    source = new EventSource("events");
    source.addEventListener("hello", (event) => on.hello(JSON.parse(event.data)));
    source.addEventListener("message", (event) => on.snapshot(JSON.parse(event.data)));
    source.addEventListener("error", () => {
      // The browser tries again by itself, but not after a refusal, which is that of one page too many.
      const isRefused = source.readyState === EventSource.CLOSED;
      on.lost(isRefused);
      if (isRefused) setTimeout(reopen, 2000);
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
