// Pieces that several pages use.

import { html, useCallback, useEffect, useRef, useState } from "./vendor/preact.js";
import { get, mayOperate, postFirst, update } from "./store.js";
import { marked } from "./words.js";

// A button that does something which may fail. It shows what the console answers: `done`, or the sentence of a refusal.
export function Action({ run, children, kind = "", disabled = false, needsRole = true, label }) {
  const [state, set] = useState({});
  const isForbidden = needsRole && !mayOperate();
  const act = async () => {
    set({ isBusy: true });
    try {
      const answer = await run();
      set({ said: answer?.done });
    } catch (error) {
      set({ trouble: error.message });
    }
  };
  return html`<span class="action">
    <button type="button" class=${kind} aria-label=${label} disabled=${disabled || isForbidden || state.isBusy}
      onClick=${act}
      title=${isForbidden ? "You may look, but not operate." : undefined}>${children}</button>
    ${state.trouble && html`<span role="alert" class="trouble">${marked(state.trouble)}</span>`}
    ${state.said && html`<span role="status" class="said">${marked(state.said)}</span>`}
  </span>`;
}

// Releases all servos, or lets them move again.
export const release = (on) => postFirst("servos/release", { on });
const letMove = () => release(false).then(() => update({ stopTrouble: undefined }));
export const LetMove = () => html`<${Action} kind="primary" run=${letMove}>Let servos move again<//>`;

// Returns the answer to a GET, the sentence of a refusal, and a function that asks again.
export function useAnswer(path) {
  const [state, set] = useState({});
  const load = useCallback(
    () =>
      get(path).then(
        (answer) => set({ answer }),
        (error) => set((old) => ({ ...old, trouble: error.message })),
      ),
    [path],
  );
  useEffect(() => void load(), [load]);
  return [state.answer, state.trouble, load];
}

// Calls a function again and again while the page is visible and the component is shown, but not before the last call is done.
export function useEvery(period, call) {
  const latest = useRef(call);
  latest.current = call;
  useEffect(() => {
    let isBusy = false;
    const timer = setInterval(async () => {
      if (isBusy || document.visibilityState !== "visible") return;
      isBusy = true;
      try {
        await latest.current();
      } finally {
        isBusy = false;
      }
    }, period);
    return () => clearInterval(timer);
  }, [period]);
}

const marks = (children) => [children].flat().map((part) => (typeof part === "string" ? marked(part) : part));
export const Trouble = ({ children }) => html`<p role="alert" class="notice bad">${marks(children)}</p>`;

export function bytes(count) {
  const unit = count >= 1e9 ? ["GB", 1e9] : count >= 1e6 ? ["MB", 1e6] : ["kB", 1e3];
  return `${(count / unit[1]).toFixed(unit[1] === 1e3 ? 0 : 1)} ${unit[0]}`;
}

export const duration = (seconds) =>
  `${Math.floor(seconds / 60)}:${String(Math.floor(seconds % 60)).padStart(2, "0")} min`;
export const time = (seconds) =>
  new Date(seconds * 1000).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
