// What every page knows: who may do what, the newest events, and requests to the console.

import { useLayoutEffect, useState } from "./vendor/preact.js";
import { connect } from "./stream.js";

// `connection` is "open", or says why there is none. `status`, `calibration` and `recording` are the newest events.
// `couldOperate` says whether this page has ever been an operator's, and `stopTrouble` why its last STOP has failed.
export const store = {
  connection: "open",
  session: undefined,
  couldOperate: false,
  stopTrouble: undefined,
  hello: undefined,
  status: undefined,
  calibration: undefined,
  recording: undefined,
};
const listeners = new Set();
const faces = new Set();
// While one of these holds, a page that nobody sees keeps its stream.
const stayers = new Set();

export function update(changes) {
  Object.assign(store, changes);
  listeners.forEach((listener) => listener());
}

// Draws a component again whenever the store changes. A layout effect listens before anything can change.
export function useStore() {
  const [, redraw] = useState(0);
  useLayoutEffect(() => listen(listeners, () => redraw((count) => count + 1)), []);
  return store;
}

// Calls the listener with every packet's snapshot, up to 60 times a second. Returns a function that ends this.
export const onFace = (listener) => listen(faces, listener);
export const stayWhile = (condition) => listen(stayers, condition);

function listen(set, listener) {
  set.add(listener);
  return () => set.delete(listener);
}

export const mayOperate = () => store.session?.role === "operate";
// Whether there is a service. Otherwise the console shows packets that arrive by UDP or a serial line.
export const hasService = () => !store.hello?.hint;

// Returns why STOP does not work on a page that is or was an operator's, or undefined if it works.
export function whyNoStop() {
  const { connection, session, status, couldOperate } = store;
  if (!couldOperate || !hasService()) return undefined;
  if (!session.role) return "this page is logged out";
  if (!mayOperate()) return "this browser may only look now";
  if (connection !== "open") return connection;
  // A banner says why.
  return status && !status.running ? "no service answers" : undefined;
}

// Opens the stream of events again, as for another session.
export let reopen = () => undefined;

export function open() {
  const lost = (reason = "no connection to the console") => {
    update({ connection: reason });
    // The session may have ended.
    loadSession().catch(() => undefined);
  };
  const face = (message) => {
    store.face = message;
    if (store.connection !== "open") update({ connection: "open" });
    faces.forEach((listener) => listener(message));
  };
  reopen = connect(
    {
      hello: (hello) => update({ connection: "open", hello }),
      face,
      status: (status) =>
        update({ connection: "open", status, recording: { ...store.recording, ...status.recording } }),
      calibration: (calibration) => update({ calibration }),
      recording: (recording) => update({ recording }),
      lost,
    },
    () => [...stayers].some((condition) => condition()),
  );
}

// Ends the GET requests that are under way. A browser sends at most six requests at a time, and a seventh waits for them.
let pendingGets = new AbortController();

// How long a POST that comes first waits for its answer. A network that has gone would let it wait for minutes.
const FIRST_PATIENCE_MS = 2000;

// Sends a POST at once: all GET requests end, and `ask` sends them again after it.
export function postFirst(path, body) {
  pendingGets.abort();
  pendingGets = new AbortController();
  const signal = AbortSignal.timeout(FIRST_PATIENCE_MS);
  return post(path, body, { priority: "high", keepalive: true, signal });
}

// Sends a request. Throws an error with a sentence for the person at the page. With a body it is a POST.
export async function ask(path, body, options = {}) {
  const post =
    body === undefined
      ? {}
      : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const { signal } = body === undefined ? pendingGets : {};
  const answer = await fetch(`api/1/${path}`, { ...post, signal, ...options }).catch(() => {
    if (signal?.aborted) return undefined;
    throw new Error("The console does not answer. Check that it runs, and that this device is in its network.");
  });
  if (!answer) return ask(path);
  if (answer.ok) return answer;
  if (answer.status === 401 && path !== "login") update({ session: { ...store.session, role: null } });
  throw Object.assign(new Error(await sentence(answer)), { status: answer.status });
}

async function sentence(answer) {
  const text = (await answer.text().catch(() => "")).trim();
  try {
    const { error, refused } = JSON.parse(text);
    return error ?? refused ?? text;
  } catch {
    return text || `The console answered with an error (${answer.status}).`;
  }
}

export async function get(path) {
  const answer = await ask(path);
  return answer.json().catch((error) => {
    if (error.name === "AbortError") return get(path);
    throw error;
  });
}
export const post = async (path, body = {}, options) => (await ask(path, body, options)).json().catch(() => ({}));

export async function loadSession() {
  const before = store.session?.role;
  const session = await get("session");
  update({ session, couldOperate: store.couldOperate || session.role === "operate" });
  if (session.role && session.role !== before) reopen();
}
