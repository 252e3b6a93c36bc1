// Wearers: those who have a profile, and the guided calibration that makes one.

import { Action, time, Trouble, useAnswer } from "./common.js";
import { change, useDraft } from "./draft.js";
import { Face } from "./face/face.js";
import { Picture } from "./picture.js";
import { REFUSALS, TAKES } from "./poses.js";
import { post, update, useStore } from "./store.js";
import { html, useEffect, useRef, useState } from "./vendor/preact.js";

export function Wearer() {
  const { calibration, status } = useStore();
  const { used } = useDraft();
  const [list, trouble, reload] = useAnswer("wearers");
  const [name, setName] = useState("");
  const [removes, setRemoves] = useState();
  const isRunning = calibration?.progress !== undefined;
  const ended = calibration?.calibrated ?? calibration?.refused;
  useEffect(() => void (ended && reload()), [ended]);
  const begin = async () => {
    update({ calibration: undefined });
    await post("calibration/begin", { wearer: name.trim() });
  };
  const act = (path, body) => async () => {
    const answer = await post(path, body);
    if (path === "wearers/delete") setRemoves(undefined);
    await reload();
    return answer;
  };
  return html`
    <h2>Wearers</h2>
    ${trouble && html`<${Trouble}>${trouble}<//>`}
    ${isRunning ? html`<${Guide} progress=${calibration.progress} />` : html`<${Outcome} calibration=${calibration} />`}
    ${
      !isRunning &&
      html`<div class="panel">
      <h3>Calibrate</h3>
      <p>${POSES[used.wearer?.wears] ?? POSES.nothing} Sit as you will sit later, with light from the front. A head shows each pose, beside your own picture or landmarks.</p>
      <div class="row">
        <label class="grow">Name of the wearer<input value=${name} onInput=${(event) => setName(event.target.value)}
          autocomplete="off" autocapitalize="none" /></label>
        <${Action} kind="primary" disabled=${name.trim() === "" || !status?.running} run=${begin}>Begin<//>
      </div>
    </div>`
    }
    ${
      list &&
      html`<section aria-label="Wearers with a profile">
      ${list.wearers.length === 0 && html`<p
        class="panel">Nobody has a profile yet. facewire then estimates the face at rest while it watches.</p>`}
      ${list.wearers.map(
        ({ wearer, profile }) => html`<article class="panel" key=${wearer} aria-label=${wearer}>
        <h3>${wearer} ${wearer === list.in_use && html`<small class="state-good">in use</small>`} ${
          wearer === used.wearer?.name && html`<small class="badge">at every start</small>`
        }</h3>
        ${profile.Ok ? html`<p
          class="dim">${time(profile.Ok[0])}, ${count(profile.Ok[1])}</p>` : html`<p
          class="trouble">${profile.Err}</p>`}
        <div class="row">
          ${
            wearer === list.in_use
              ? html`<${Action} run=${act("wearers/use", { name: null })}>Use nobody's<//>`
              : html`<${Action} disabled=${!profile.Ok} run=${act("wearers/use", { name: wearer })}
                label=${`Use ${wearer}`}>Use<//>`
          }
          ${
            profile.Ok &&
            wearer !== used.wearer?.name &&
            html`<${Action} run=${() => change({ "wearer.name": wearer })}
              label=${`Use at every start: ${wearer}`}>Use at every start<//>`
          }
          ${
            removes === wearer
              ? html`<${Action} kind="danger"
                run=${act("wearers/delete", { name: wearer })}>Delete ${wearer} for ever<//>
            <button type="button" onClick=${() => setRemoves(undefined)}>Leave it</button>`
              : html`<button type="button" aria-label=${`Delete ${wearer}`}
                onClick=${() => setRemoves(wearer)}>Delete</button>`
          }
        </div>
      </article>`,
      )}
    </section>`
    }`;
}

const count = (poses) => (poses === 1 ? "one pose" : `${poses} poses`);

const POSES = {
  nothing: "Eleven poses of some seconds each teach facewire a face.",
  headset: "Put the headset on, and keep your mouth closed and at rest for a few seconds.",
  mask: "Put the mask on. Eight poses of a few seconds each teach facewire your eyes and brows.",
};

function Guide({ progress }) {
  const { take, done, of, phase, measured, seen, waits_for: waits, refused, last_refusal: last } = progress;
  const [instruction, raised] = TAKES[take] ?? [take, []];
  const what = {
    "get-ready": "Get ready.",
    wait: waits ? REFUSALS[waits] : "Take the pose.",
    measure: "Hold it.",
    ended: waits ? "Ended without a profile." : "Measured.",
  }[phase];
  return html`<section class="panel guide" aria-label="Calibration">
    <div class="pictures"><${Picture} hidesControls /><${Head} raised=${raised} /></div>
    <div>
      <p class="dim">Pose ${Math.min(done + 1, of)} of ${of}</p>
      <h3 aria-live="polite">${instruction}</h3>
      <p role="status" class=${phase === "wait" || (phase === "ended" && waits) ? "state-warn" : "state-good"}>${what}</p>
      ${raised.length > 0 && html`<${Meter} label="How strongly the pose is seen" value=${seen} />`}
      <${Meter} label="How much is measured" value=${measured} />
      ${last && html`<p
        class="notice warn">Refused ${refused === 1 ? "once" : `${refused} times`}, last because: ${REFUSALS[last] ?? last}</p>`}
      <${Action} run=${() => post("calibration/cancel")}>Cancel<//>
    </div>
  </section>`;
}

const Meter = ({ label, value }) =>
  html`<label class="meter">${label}<progress max="1" value=${Math.min(1, value)}></progress></label>`;

function Outcome({ calibration }) {
  if (calibration?.refused) return html`<${Trouble}>The calibration has ended: ${calibration.refused}<//>`;
  const kept = calibration?.calibrated;
  if (!kept) return null;
  return html`<div class="notice good" role="status">
    <p>The profile of ${kept.wearer} is made and in use, from ${count(kept.taken.length)}.${kept.warning ? ` ${kept.warning}` : ""}</p>
    ${
      kept.left_out.length > 0 &&
      html`<p>These poses were left out and keep general values:</p>
      <ul>${kept.left_out.map(([take, why]) => html`<li
        key=${take}>${TAKES[take]?.[0] ?? take} ${REFUSALS[why] ?? why}</li>`)}</ul>`
    }
  </div>`;
}

// The head in a pose.
export function Head({ raised }) {
  const canvas = useRef();
  const face = useRef();
  useEffect(() => {
    try {
      face.current ??= new Face(canvas.current);
    } catch {
      return;
    }
    face.current.draw({
      weight: (name) => (raised.includes(name) ? 1 : 0),
      rotation: [0, 0, 0, 1],
      position: [0, 0, 0],
      isLive: true,
      isMirrored: true,
    });
  }, [raised]);
  return html`<canvas class="head" ref=${canvas} role="img"
    aria-label=${raised.length > 0 ? `The pose to take: ${raised.join(", ")}` : "The pose to take: a face at rest"}></canvas>`;
}
