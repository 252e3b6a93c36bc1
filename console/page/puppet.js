// The puppet: sliders and plays that take the place of the face for all links, within the limits that are set.

import { GROUPS } from "./bars.js";
import { wait } from "./drive.js";
import { Slider } from "./hand.js";
import { store } from "./store.js";
import { html, useEffect, useRef, useState } from "./vendor/preact.js";

const TURNS = [
  ["Head left and right", 40],
  ["Head up and down", 30],
  ["Head to the shoulders", 30],
];
const STEP_MS = 50;
const hill = (part) => Math.sin(Math.PI * part);
const both = (name, value) => ({ [`${name}Left`]: value, [`${name}Right`]: value });
// A play: its title, how long it takes in milliseconds, and the coefficients at a part of it from 0 to 1.
const PLAYS = [
  ["Blink", 400, (part) => both("eyeBlink", hill(part))],
  ["Smile", 2500, (part) => both("mouthSmile", Math.min(1, 2 * hill(part)))],
];
// A servo without a limit of its own is moved by hand at no more than half of its range a second, and follows this all the way.
const SWEEP_MS = 6500;

export function Puppet({ drive, boards }) {
  const [weights, setWeights] = useState({});
  const [turn, setTurn] = useState([0, 0, 0]);
  const [playing, setPlaying] = useState();
  const [asks, setAsks] = useState(false);
  const shown = useRef();
  shown.current = { weights, turn, isOver: false };
  useEffect(() => () => (shown.current.isOver = true), []);
  const pose = (coefficients, head) => drive.move({ coefficients, head_deg: head });
  const put = (name, value) => {
    const next = { ...weights, [name]: value };
    setWeights(next);
    pose(next, turn);
  };
  const rotate = (axis, value) => {
    const next = turn.map((angle, k) => (k === axis ? value : angle));
    setTurn(next);
    pose(weights, next);
  };
  const rest = () => {
    setWeights({});
    setTurn([0, 0, 0]);
    pose({}, [0, 0, 0]);
  };
  const play = async (title, steps) => {
    setPlaying(title);
    for (const { line, ms } of steps()) {
      if (!drive.isArmed || shown.current.isOver) break;
      drive.move(line);
      await wait(ms);
    }
    setPlaying(undefined);
  };
  const expression = (length, at) => () =>
    Array.from({ length: Math.ceil(length / STEP_MS) + 1 }, (_, k) => ({
      line: { coefficients: { ...weights, ...at(Math.min(1, (k * STEP_MS) / length)) }, head_deg: turn },
      ms: STEP_MS,
    }));
  const sweep = () =>
    boards.flatMap(({ link, place }) =>
      (link.channel ?? []).flatMap(({ channel = 0 }) =>
        Array.from({ length: SWEEP_MS / STEP_MS + 1 }, (_, k) => ({
          line: { link: place, channel, position: hill((k * STEP_MS) / SWEEP_MS) },
          ms: STEP_MS,
        })),
      ),
    );
  // Nobody starts it by mistake: it moves every servo all the way.
  const begin = () => {
    setAsks(false);
    play("Sweep", sweep);
  };
  const isOff = !drive.isArmed || playing !== undefined;
  const names = store.hello?.names ?? [];
  const slider = (
    label,
    value,
    most,
    least,
    set,
  ) => html`<label key=${label} class="slider">${label} <output>${value.toFixed(most > 1 ? 0 : 2)}</output>
    <${Slider} min=${least} max=${most} step=${most > 1 ? 1 : 0.01} value=${value} disabled=${isOff} move=${set} /></label>`;
  return html`<section class="panel" id="puppet" aria-label="Puppet">
    <h3>Puppet</h3>
    <p class="dim">${drive.isArmed ? "The puppet takes the face's place for all receivers until you disarm." : "Arm to move the whole face by hand."}</p>
    <div class="row">
      ${PLAYS.map(([title, length, at]) => html`<button type="button" key=${title} disabled=${isOff}
        onClick=${() => play(title, expression(length, at))}>${title}</button>`)}
      <button type="button" disabled=${isOff || boards.length === 0} aria-expanded=${String(asks)}
        onClick=${() => setAsks(!asks)}>Sweep each channel</button>
      <button type="button" disabled=${isOff} onClick=${rest}>Rest</button>
    </div>
    ${
      asks &&
      !isOff &&
      html`<div class="notice warn row spread" role="alertdialog" aria-label="Sweep each channel">
      <span>Each servo goes to both of its ends, one after the other. Are all ends set, and all hands away?</span>
      <span class="row"><button type="button" class="primary" onClick=${begin}>Sweep now</button>
      <button type="button" onClick=${() => setAsks(false)}>Leave it</button></span></div>`
    }
    <p role="status">${playing ? `${playing} …` : ""}</p>
    ${TURNS.map(([label, most], axis) => slider(label, turn[axis], most, -most, (value) => rotate(axis, value)))}
    ${GROUPS.map(
      ([title, pattern]) => html`<details key=${title}><summary>${title}</summary>
      <div class="sliders">${names.filter((name) => pattern.test(name)).map((name) => slider(name, weights[name] ?? 0, 1, 0, (value) => put(name, value)))}</div>
    </details>`,
    )}
  </section>`;
}
