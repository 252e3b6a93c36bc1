// The first time: five steps from a camera to a receiver that moves. Each can be left and come back to.

import { Action, Trouble, useAnswer } from "./common.js";
import { change, draft, isBoard, isChanged, useDraft } from "./draft.js";
import { Choice, Refusal, useHand } from "./hand.js";
import { impairments, present } from "./impaired.js";
import { Picture } from "./picture.js";
import { onFace, post, store, useStore } from "./store.js";
import { html, useEffect, useState } from "./vendor/preact.js";
import { KINDS, LinkState, LinkTrouble, marked, titleOfLink } from "./words.js";

const STEPS = [
  ["Camera", Camera],
  ["Face", FaceFound],
  ["Receiver", Receiver],
  ["Try it", TryIt],
  ["Done", Done],
];
const BOARD_NAMES = { maestro: "Pololu Maestro", serial: "Microcontroller" };
// Cameras have dozens of modes.
const MOST_MODES = 4;
// The clockwise turn that makes the picture upright.
const MOUNTS = [
  [0, "Upright"],
  [90, "On its side (90° clockwise)"],
  [180, "Upside down"],
  [270, "On its side (90° counterclockwise)"],
];
// The step that was open when the page was left.
const left = { step: 0 };

export function Start() {
  const [step, set] = useState(left.step);
  const go = (next) => set((left.step = next));
  const [, Step] = STEPS[step];
  useStore();
  useDraft();
  return html`
    <h2>Start</h2>
    <ol class="steps">${STEPS.map(
      ([title], index) => html`<li key=${title}>
      <button type="button" aria-current=${index === step ? "step" : undefined}
        onClick=${() => go(index)}><b>${index + 1}</b> ${title}</button></li>`,
    )}</ol>
    <${Step} />
    ${isChanged() && html`<p class="notice">Changes wait below: keep them so that they take effect.</p>`}
    <div class="row spread">
      <button type="button" disabled=${step === 0} onClick=${() => go(step - 1)}>Back</button>
      <button type="button" class="primary" hidden=${step === STEPS.length - 1}
        onClick=${() => go(step + 1)}>Next</button>
    </div>`;
}

function Camera() {
  const [devices, trouble, reload] = useAnswer("devices");
  const kept = draft.values.camera?.device ?? "auto";
  const hand = useHand((path) => change({ "camera.device": path }));
  const chosen = hand.held ?? kept;
  // A stable path means the same camera after the next start, too.
  const cameras = (devices?.cameras ?? []).map(({ path, stable_paths: [stable], name, modes }) => ({
    path: stable ?? path,
    name,
    modes,
  }));
  const choices = [{ path: "auto", name: "The first camera that works" }, ...cameras];
  const isClip = kept === "demo" || kept.startsWith("rehearsal");
  if (!choices.some(({ path }) => path === kept))
    choices.push({ path: kept, name: isClip ? "The built-in clip" : "As the settings say" });
  return html`<div class="panel">
    <h3>Which camera?</h3>
    ${trouble && html`<${Trouble}>${trouble}<//>`}
    ${devices?.not_examined?.map((sentence) => html`<p class="notice warn" key=${sentence}>${marked(sentence)}</p>`)}
    ${devices && cameras.length === 0 && !isClip && html`<p
      class="notice warn">No camera is plugged in. Plug one in, and look again.</p>`}
    <fieldset class="choices"><legend>Camera</legend>
      ${choices.map(
        ({ path, name, modes }) => html`<label class="choice" key=${path}>
        <input type="radio" name="camera" checked=${chosen === path}
          onInput=${() => hand.keep(path)} />
        <span>${name}${path !== "auto" ? html`<small class="dim">${path}</small>` : ""}${modes ? html`<small
          class="dim">${modes.slice(0, MOST_MODES).join(", ")}${modes.length > MOST_MODES ? " …" : ""}</small>` : ""}</span></label>`,
      )}
    </fieldset>
    <${Refusal} hand=${hand} />
    <${Action} needsRole=${false} run=${reload}>Look again<//>
    <h3>What it sees</h3>
    <${Picture} />
    <${Mount} />
    <${Poor} />
  </div>`;
}

// How the camera is mounted, and the turn that the service proposes.
function Mount() {
  const kept = draft.values.camera?.rotation ?? 0;
  const [proposed] = present(store.status?.service?.metrics, "facewire_proposed_rotation");
  const turn = (degrees) => change({ "camera.rotation": degrees });
  return html`
    <div class="field"><label for="rotation">How the camera is mounted</label>
      <${Choice} id="rotation" value=${kept} keep=${turn} choices=${MOUNTS} /></div>
    ${
      proposed !== undefined &&
      Number(proposed) !== kept &&
      html`<div class="notice warn row spread" role="status"><span>The face stands upright if the picture is turned by
      ${proposed}° clockwise.</span><${Action} run=${() => turn(Number(proposed))}>Turn the picture<//></div>`
    }`;
}

function Poor() {
  const sentences = impairments(store.status);
  return sentences.map((sentence) => html`<p class="notice warn" role="status" key=${sentence}>${sentence}</p>`);
}

function FaceFound() {
  const [state, setState] = useState(store.face?.packet);
  useEffect(
    () =>
      onFace(({ packet }) =>
        setState((old) => (old?.state === packet?.state && old?.reason === packet?.reason ? old : packet)),
      ),
    [],
  );
  const isLive = state?.state === "live";
  return html`<div class="panel">
    <h3>Is your face found?</h3>
    <p role="status"
      class=${`notice ${isLive ? "good" : "warn"}`}>${isLive ? "Yes: the face is followed." : `Not yet: ${state ? (state.reason === "none" ? state.state : state.reason) : "no packet has come"}.`}</p>
    ${isLive && impairments(store.status).length === 0 && html`<p>Nothing makes tracking poor. Sit about an arm's length from the camera, with light from the front.</p>`}
    <${Poor} />
    <${Picture} />
    <p class="dim">Later, a <a href="#wearer">calibration</a> fits facewire to your face.</p>
  </div>`;
}

const PROGRAMS = [
  {
    kind: "live-link",
    title: "Unreal (Live Link)",
    port: 11111,
    other: [
      "Enable the plugins Live Link, Apple ARKit and Apple ARKit Face Support, and restart Unreal.",
      "The subject appears in Window > Virtual Production > Live Link by itself.",
      "Choose it as ARKit Face Subj of the MetaHuman, and tick Use ARKit.",
      "The firewall there must accept UDP at port 11111.",
    ],
  },
  {
    kind: "vrchat",
    title: "VRChat",
    port: 9000,
    other: [
      "The avatar must have the parameters of VRCFaceTracking v2.",
      "Open the action menu and turn on Options > OSC > Enabled.",
      "VRCFaceTracking itself must not run at the same time.",
      "The firewall there must accept UDP at port 9000.",
    ],
  },
  {
    kind: "vmc",
    title: "VMC (VSeeFace, Warudo and others)",
    port: 39540,
    other: [
      "Turn on the receiver of the VMC protocol, at port 39540 (Warudo and EVMC4U: 39539).",
      "The firewall there must accept UDP at this port.",
    ],
  },
  {
    kind: "udp",
    title: "Another facewire receiver",
    port: 5252,
    other: [
      "It receives UDP at port 5252. A facewire-console there shows what arrives.",
      "The firewall there must accept UDP at port 5252.",
    ],
  },
];

function Receiver() {
  const [devices, trouble, reload] = useAnswer("devices");
  const links = draft.values.link ?? [];
  const add = (settings) => () =>
    change(Object.fromEntries(Object.entries(settings).map(([key, value]) => [`link.${links.length}.${key}`, value])));
  const offers = [
    ...(devices?.serial_ports ?? [])
      .filter(({ kind }) => kind)
      .map(({ path, stable_paths: [stable], name, kind }) => ({
        title: BOARD_NAMES[kind] ?? kind,
        place: `${name}, ${stable ?? path}`,
        settings: { kind, device: stable ?? path },
      })),
    ...(devices?.i2c_buses ?? []).map((bus) => ({
      title: "PCA9685, if one is connected",
      place: `I2C bus ${bus}`,
      settings: { kind: "pca9685", bus },
    })),
  ];
  const isThere = (settings) =>
    links.some((link) => Object.entries(settings).every(([key, value]) => link[key] === value));
  return html`<div class="panel">
    <h3>Who receives the face?</h3>
    ${links.length === 0 && html`<p
      class="dim">Without a choice here, facewire sends to this machine, and to a microcontroller on USB.</p>`}
    ${links.length > 0 && html`<p>Already set up: ${links.map(({ kind = "udp", address, device }) => [KINDS[kind] ?? kind, address ?? device].filter((part) => typeof part === "string").join(" ")).join("; ")}.</p>`}
    ${trouble && html`<${Trouble}>${trouble}<//>`}
    <h4>Plugged in here</h4>
    ${devices && offers.length === 0 && html`<p>No servo board and no microcontroller is seen. Plug one in, and look again.</p>`}
    ${offers.map(
      ({
        title,
        place,
        settings,
      }) => html`<div class="row spread offer" key=${place}><span><b>${title}</b> <small
        class="dim">${place}</small></span>
      ${isThere(settings) ? html`<span class="state-good">set up</span>` : html`<${Action} run=${add(settings)}
        label=${`Use it: ${title} at ${place}`}>Use it<//>`}</div>`,
    )}
    <${Action} needsRole=${false} run=${reload}>Look again<//>
    <h4>A program on another machine</h4>
    ${PROGRAMS.map((program) => html`<${Program} key=${program.kind} ...${program} add=${add} />`)}
  </div>`;
}

function Program({ kind, title, port, other, add }) {
  const [host, setHost] = useState("");
  const address = host.trim().includes(":") ? host.trim() : `${host.trim()}:${port}`;
  return html`<details><summary>${title}</summary>
    <ol>${other.map((line) => html`<li key=${line}>${line}</li>`)}</ol>
    <div class="row">
      <label class="grow">Its address<input value=${host} placeholder="192.168.1.20" autocomplete="off"
        autocapitalize="none" onInput=${(event) => setHost(event.target.value)} /></label>
      <${Action} disabled=${host.trim() === ""} run=${add({ kind, address })}
        label=${`Send there, to ${title}`}>Send there<//>
    </div>
  </details>`;
}

function TryIt() {
  const links = store.status?.service?.links ?? [];
  const hasServos = (draft.values.link ?? []).some(isBoard);
  return html`<div class="panel">
    <h3>Does it arrive?</h3>
    <p>Open and close your mouth: the receiver must follow.</p>
    ${links.length === 0 && html`<p
      class="notice warn">No link is open. Choose a receiver in step 3, and keep the change.</p>`}
    <ul class="list">${links.map(
      (link, index) => html`<li key=${index}><b>${titleOfLink(link)}</b> <${LinkState} link=${link} /> <small
      class="dim">${link.sent} sent</small><${LinkTrouble} link=${link} /></li>`,
    )}</ul>
    ${hasServos && html`<p>Set the ends and the source of each servo on the page <a
      href="#servos">Servos</a>, one after the other, and come back here.</p>`}
  </div>`;
}

function Done() {
  const { status } = store;
  return html`<div class="panel">
    <h3>Done</h3>
    <p class=${`notice ${status?.running ? "good" : "warn"}`}>${status?.running ? "The service runs." : "The service does not run yet."}</p>
    <p>Switch the service on once, so that it starts with the board.</p>
    <${Action} run=${() => post("service", { do: "start" })}>Start now and with the board<//>
    <ul><li><a href="#wearer">Calibrate</a> the face in front of the camera.</li><li><a
      href="#servos">Tune</a> each servo.</li>
      <li><a href="#health">Look</a> how the board copes.</li></ul>
  </div>`;
}
