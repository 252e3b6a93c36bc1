// Controls that keep showing what somebody has put into them until it is kept. Every status redraws the pages, and what a page
// knows must not replace what somebody is typing, choosing or dragging.

import { mayOperate } from "./store.js";
import { html, useEffect, useRef, useState } from "./vendor/preact.js";
import { marked } from "./words.js";

// How far a thumb moves along a slider before it counts as dragging it. Until then it may be about to scroll the page.
const SLOP_PX = 10;

// Returns the state of a control in use: `held` is what was put into it and is not kept yet, `trouble` why it could not be kept.
export function useHand(keep) {
  const [, redraw] = useState(0);
  const { current: hand } = useRef({});
  const set = (changes) => {
    Object.assign(hand, changes);
    redraw((count) => count + 1);
  };
  hand.hold = (held) => set({ held });
  hand.letGo = () => set({ held: undefined, trouble: undefined });
  hand.refuse = (trouble) => set({ trouble });
  // Keeps a value, and lets go of it once it is kept, unless somebody has changed it meanwhile. A value that is refused stays.
  hand.keep = async (held, value = held) => {
    set({ held, sent: held });
    let trouble;
    try {
      await keep(value);
    } catch (error) {
      trouble = error.message;
    }
    if (hand.sent === held) hand.sent = undefined;
    if (hand.held !== held) return;
    if (trouble) hand.refuse(trouble);
    else hand.letGo();
  };
  return hand;
}

export const Refusal = ({ hand }) =>
  hand.trouble && html`<span class="trouble" role="alert">${marked(hand.trouble)}</span>`;

const common = (hand, isBad) => ({
  "disabled": !mayOperate(),
  "aria-invalid": isBad || hand.trouble ? "true" : undefined,
});

// A field for a text or a number. Enter, or leaving the field, keeps what was typed, and Escape discards it.
export function Entry({ value, keep, isBad, ...attributes }) {
  const hand = useHand(keep);
  const kept = String(value ?? "");
  // A value that was refused is dropped when somebody changes the setting elsewhere.
  useEffect(() => {
    if (hand.trouble) hand.letGo();
  }, [kept]);
  const finish = ({ target }) => {
    const { held, sent } = hand;
    if (held === undefined || held === sent) return;
    const isNumber = target.type === "number";
    const fault = isNumber && faultOf(target);
    if (held === kept && sent === undefined && !target.validity.badInput) hand.letGo();
    else if (fault) hand.refuse(fault);
    else hand.keep(held, isNumber ? Number(held) : held);
  };
  const press = (event) => {
    if (event.key === "Enter") finish(event);
    if (event.key !== "Escape") return;
    // Browsers report a text that is no number as empty. If an empty one is kept, drawing alone would not remove the text.
    event.target.value = kept;
    hand.letGo();
  };
  return html`<input ...${attributes} ...${common(hand, isBad)} value=${hand.held ?? kept} onKeyDown=${press}
    onInput=${({ target }) => hand.hold(target.value)} onChange=${finish} onBlur=${finish} /><${Refusal} hand=${hand} />`;
}

// Returns what is wrong with a number as it is typed. Only whole numbers must match the step. For others, it is that of the arrows.
function faultOf({ value, min, max, step, validity: { rangeUnderflow, rangeOverflow, stepMismatch } }) {
  const isWhole = step === "1";
  if (value !== "" && !rangeUnderflow && !rangeOverflow && !(isWhole && stepMismatch)) return undefined;
  const most = max === "" ? "" : min === "" ? ` of at most ${max}` : ` to ${max}`;
  const least = min === "" ? "" : max === "" ? ` of at least ${min}` : ` from ${min}`;
  return `Give a ${isWhole ? "whole " : ""}number${least}${most}.`;
}

// A list to choose from. `choices` are pairs of a value and its words.
export function Choice({ value, keep, isBad, choices, ...attributes }) {
  const hand = useHand(keep);
  const choose = ({ target }) =>
    hand.keep(target.value, choices.find(([choice]) => String(choice) === target.value)?.[0]);
  return html`<select ...${attributes} ...${common(hand, isBad)} value=${hand.held ?? String(value)} onInput=${choose}>
    ${choices.map(([choice, words]) => html`<option key=${choice} value=${choice}>${words}</option>`)}</select><${Refusal} hand=${hand} />`;
}

export function Check({ value, keep, isBad, ...attributes }) {
  const hand = useHand(keep);
  return html`<input type="checkbox" ...${attributes} ...${common(hand, isBad)} checked=${hand.held ?? value}
    onInput=${({ target }) => hand.keep(target.checked)} /><${Refusal} hand=${hand} />`;
}

// A slider that moves something at once. A thumb that scrolls the page over it moves nothing.
export function Slider({ value, move, disabled, ...attributes }) {
  const hand = useHand();
  // Where a thumb came down, until it drags.
  const { current: thumb } = useRef({});
  const begin = ({ target, pointerType, clientX }) => {
    // Some browsers report that a pointer comes down on a disabled control, but not that it leaves.
    if (disabled) return;
    thumb.from = pointerType === "touch" ? clientX : undefined;
    hand.hold(target.value);
  };
  const drag = ({ clientX }) => {
    if (Math.abs(clientX - thumb.from) > SLOP_PX) thumb.from = undefined;
  };
  const slide = ({ target }) => {
    if (hand.held !== undefined) hand.hold(target.value);
    if (thumb.from === undefined) move(Number(target.value));
  };
  const tap = ({ target }) => {
    if (thumb.from !== undefined) move(Number(target.value));
  };
  const end = () => {
    thumb.from = undefined;
    hand.letGo();
  };
  return html`<input type="range" ...${attributes} disabled=${disabled} value=${hand.held ?? String(value)} onInput=${slide}
    onPointerDown=${begin} onPointerMove=${drag} onPointerUp=${tap} onLostPointerCapture=${end} />`;
}
