// The newest packet: a head, bars, plots and facts, a recording in the browser, and the camera's picture.

import { Bars } from "./bars.js";
import { Face } from "./face/face.js";
import { Picture } from "./picture.js";
import { Plot } from "./plot.js";
import { MOST_ROWS, Recorder } from "./recorder.js";
import { factsOf, noticeOf, showFacts, showHelp, showState, stateOf } from "./status.js";
import { hasService, onFace, stayWhile, store } from "./store.js";
import { html, useEffect, useState } from "./vendor/preact.js";

const FIRST_CHOSEN = ["jawOpen", "mouthSmileLeft", "eyeBlinkLeft"];
// Numbers change 5 times a second, so that people can read them.
const TEXT_PERIOD_MS = 200;
// How fast the face returns to neutral in silence: the share of the expression that is left after a second.
const LEFT_AFTER_A_SECOND = 0.001;

const element = (id) => document.getElementById(id);
const now = () => performance.now();

const page = {
  hello: undefined,
  snapshot: undefined,
  arrived: 0,
  clock: undefined,
  isPaused: false,
  isMirrored: false,
  recorder: undefined,
};
const parts = { face: undefined, bars: undefined, plot: undefined };
const shown = { pose: undefined, text: 0, drawn: 0, fade: 1 };

// The page stays when another one is shown, so that a recording goes on.
export function Live({ isShown }) {
  const [watches, setWatches] = useState(false);
  useEffect(start, []);
  return html`
  <section id="stage" aria-label="Face" hidden=${!isShown}>
    <div id="picture">
      <canvas id="face" role="img"
        aria-label="A head that moves with the coefficients and the pose of the newest packet"></canvas>
      <p id="no-face" hidden>This browser cannot draw the face: it has no WebGL 2. Bars and plots work without it.</p>
      <div id="help" hidden></div>
    </div>
    <div id="controls">
      <button id="pause" type="button" aria-pressed="false" onClick=${togglePause}
        title="Freeze what is shown. A recording goes on.">Pause</button>
      <button id="record" type="button" aria-pressed="false" onClick=${toggleRecording}
        title="Record what arrives to a CSV file with the columns of facewire track">Record</button>
      <button id="mirror" type="button" aria-pressed="false" onClick=${toggleMirror}
        title="Show the face as in a mirror">Mirror</button>
      ${hasService() && html`<button id="camera" type="button" aria-pressed=${String(watches)}
        onClick=${() => setWatches(!watches)}>Camera</button>`}
      <output id="recorded"></output>
    </div>
    ${watches && isShown && html`<${Picture} />`}
    <p id="notice" role="alert" hidden></p>
    <dl id="facts"></dl>
    <figure>
      <figcaption>Last 10 seconds. Choose coefficients in the list.</figcaption>
      <canvas id="plot" role="img" aria-label="Plot of the chosen coefficients over the last 10 seconds"></canvas>
      <ul id="legend"></ul>
    </figure>
  </section>
  <section id="coefficients" aria-label="Coefficients. Each is a button that adds it to the plot."
    hidden=${!isShown}></section>`;
}

// The head takes a second to compute on a small machine, so that it waits until somebody looks.
function makeFace() {
  try {
    parts.face = new Face(element("face"));
  } catch (error) {
    parts.face = null;
    element("no-face").hidden = false;
    console.warn(`The face cannot be drawn: ${error.message}`);
  }
}

function start() {
  parts.face = undefined;
  // The log-in takes the place of the page when a session has ended. The page that comes after it is built anew.
  Object.assign(page, { hello: undefined, snapshot: undefined });
  shown.last = undefined;
  const ends = [onFace(snapshot), stayWhile(() => page.recorder !== undefined)];
  let next = requestAnimationFrame(function draw() {
    next = requestAnimationFrame(draw);
    frame();
  });
  return () => {
    cancelAnimationFrame(next);
    ends.forEach((end) => end());
  };
}

function hello(message) {
  // The program may have started again: its times and numbers then begin anew.
  page.clock = undefined;
  page.snapshot = undefined;
  parts.plot?.clear();
  if (message.hint) showHelp(element("help"), message.hint);
  const isFirst = page.hello === undefined;
  page.hello = message;
  if (!isFirst) return;
  parts.plot = new Plot(element("plot"), element("legend"), message.names);
  parts.bars = new Bars(element("coefficients"), message.names, choose);
  FIRST_CHOSEN.forEach((name) => choose(message.names.indexOf(name)));
  page.index = new Map(message.names.map((name, index) => [name, index]));
}

function choose(index) {
  parts.plot.toggle(index);
  parts.bars.mark(parts.plot.colours);
}

function snapshot(message) {
  if (store.hello !== page.hello) hello(store.hello);
  const isNew = message.packet && message.packet.number !== page.snapshot?.packet?.number;
  page.snapshot = message;
  if (message.packet) setClock(message.packet);
  if (!isNew) return;
  record(message.packet);
  if (!page.isPaused) {
    parts.plot.add(message.packet.time_s, message.packet.coefficients);
    if (!shown.pose || !areSame(shown.pose, message.packet)) shown.pose = message.packet;
  }
}

// Whether two packets show the same face. It is not drawn again then.
function areSame(one, other) {
  const numbers = ["rotation", "position_mm", "coefficients"];
  return one.state === other.state && numbers.every((key) => one[key].every((value, k) => value === other[key][k]));
}

// Times come from the clock of the console. The message that arrived fastest tells best how far that clock is ahead.
function setClock({ time_s: time, since_ms: since }) {
  page.clock = Math.max(page.clock ?? -Infinity, time * 1000 + since - now());
  page.arrived = time * 1000 - page.clock;
}

function record(packet) {
  page.recorder?.add(packet);
  if (page.recorder?.isFull) toggleRecording();
}

// Time since the newest packet, if receivers go neutral after it.
function silence() {
  const since = now() - page.arrived;
  return page.snapshot?.packet && since > page.hello.silence_ms ? since : undefined;
}

// The coefficients to show: those of the newest packet, which fade to neutral in silence.
function faded(coefficients, elapsed) {
  const isSilent = silence() !== undefined && !page.isPaused;
  shown.fade = isSilent ? shown.fade * Math.pow(LEFT_AFTER_A_SECOND, elapsed) : 1;
  return shown.fade === 1 ? coefficients : coefficients.map((value) => value * shown.fade);
}

function drawFace(pose, coefficients) {
  const quaternion = pose.rotation.map((value, k) => (k === 3 ? 1 + (value - 1) * shown.fade : value * shown.fade));
  const length = Math.hypot(...quaternion);
  parts.face?.draw({
    weight: (name) => coefficients[page.index.get(name)] ?? 0,
    rotation: quaternion.map((value) => value / length),
    position: pose.position_mm.map((value) => value * shown.fade),
    isLive: pose.state === "live" && shown.fade === 1,
    isMirrored: page.isMirrored,
  });
}

const AT_REST = { rotation: [0, 0, 0, 1], position_mm: [0, 0, 0], state: "neutral" };

function frame() {
  const time = now();
  if (store.hello && store.hello !== page.hello) hello(store.hello);
  if (time - shown.text > TEXT_PERIOD_MS) showText(time);
  if (!page.hello || element("stage").hidden) return;
  if (parts.face === undefined) makeFace();
  const elapsed = (time - shown.drawn) / 1000;
  shown.drawn = time;
  const pose = shown.pose ?? AT_REST;
  const coefficients = faded(pose.coefficients ?? page.hello.names.map(() => 0), elapsed);
  // A face that does not move costs nothing.
  const { canvas } = parts.face ?? {};
  const drawn = [pose, shown.fade > 0.001 ? shown.fade : 0, page.isMirrored, canvas?.clientWidth, canvas?.clientHeight];
  if (drawn.some((value, k) => value !== shown.last?.[k])) {
    shown.last = drawn;
    drawFace(pose, coefficients);
    parts.bars.show(coefficients, pose.state === "live" && shown.fade === 1);
  }
  if (!page.isPaused) parts.plot.draw((time + (page.clock ?? 0)) / 1000);
}

function showText(time) {
  shown.text = time;
  const message = page.snapshot;
  element("help").hidden = !page.hello?.hint || Boolean(message?.packet) || store.connection !== "open";
  const state = stateOf(message, silence(), store);
  if (element("state"))
    showState(element("state"), page.isPaused && store.connection === "open" ? ["waiting", "paused"] : state);
  if (!message || page.isPaused) return;
  const notice = noticeOf(message);
  element("notice").hidden = notice === "";
  element("notice").textContent = notice;
  if (message.packet) showFacts(element("facts"), factsOf(message, time - page.arrived));
  if (page.recorder) element("recorded").textContent = `${page.recorder.count} rows`;
}

function toggle(id, isOn) {
  element(id).setAttribute("aria-pressed", String(isOn));
  return isOn;
}

function togglePause() {
  page.isPaused = toggle("pause", !page.isPaused);
}

function toggleMirror() {
  page.isMirrored = toggle("mirror", !page.isMirrored);
}

function toggleRecording() {
  if (!page.hello) return;
  const recorder = page.recorder;
  page.recorder = recorder ? undefined : new Recorder(page.hello.names);
  toggle("record", !recorder);
  element("record").textContent = recorder ? "Record" : "Stop and save";
  if (!recorder) return;
  recorder.save();
  element("recorded").textContent = recorder.isFull
    ? `saved ${MOST_ROWS} rows, the most there can be`
    : `saved ${recorder.count} rows`;
}
