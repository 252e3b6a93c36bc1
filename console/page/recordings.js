// Recordings of landmarks and outcomes on the board: begin, end, play through the links, download, delete.

import { Action, bytes, duration, time, Trouble, useAnswer } from "./common.js";
import { post, useStore } from "./store.js";
import { html, useEffect, useState } from "./vendor/preact.js";

// Below this, the space may not last for the recording that is made.
const LITTLE_BYTES = 500e6;

export function Recordings() {
  const { recording: state, status } = useStore();
  const [answer, trouble, reload] = useAnswer("recordings");
  const [removes, setRemoves] = useState();
  const { recording, playing, trouble: ended } = state ?? {};
  useEffect(() => void reload(), [recording?.name, playing?.name]);
  const act = (path, body) => async () => {
    const done = await post(path, body);
    if (path === "recordings/delete") setRemoves(undefined);
    await reload();
    return done;
  };
  const free = answer?.free_bytes;
  // The one that is being made can neither be played nor deleted.
  const list = answer?.list.filter(({ name }) => name !== recording?.name);
  return html`
    <h2>Recordings</h2>
    ${trouble && html`<${Trouble}>${trouble}<//>`}
    ${ended && html`<${Trouble}>${ended}<//>`}
    <div class="panel">
      <p>A recording holds landmarks and coefficients of each frame, and no picture.</p>
      ${
        recording
          ? html`<p role="status"><b
            class="state-bad">Recording</b> ${duration(recording.seconds)}, ${bytes(recording.bytes)}</p>
        <${Action} kind="primary" run=${act("recordings/end")}>End<//>`
          : html`<${Action} kind="primary" disabled=${!status?.running}
            run=${act("recordings/begin")}>Begin a recording<//>`
      }
      ${playing && html`<p role="status">${playing.name} is played to the links.</p><${Action}
        run=${act("recordings/end")}>Stop playing<//>`}
      ${free !== undefined && html`<p
        class=${free < LITTLE_BYTES ? "trouble" : "dim"}>${bytes(free)} are free.${free < LITTLE_BYTES ? " Delete recordings, or end this one soon." : ""}</p>`}
    </div>
    ${list?.length === 0 && !recording && html`<p class="panel">There is no recording yet.</p>`}
    ${list?.map(
      ({ name, bytes: size, time_s: at }) => html`<article class="panel" key=${name} aria-label=${name}>
      <h3>${time(at)}</h3>
      <p class="dim">${name}, ${bytes(size)}</p>
      <div class="row">
        <${Action} disabled=${Boolean(playing)} run=${act("recordings/play", { name })} label=${`Play ${name}`}>Play<//>
        <a class="button" href=${`api/1/recordings/${encodeURIComponent(name)}`} download=${name}
          aria-label=${`Download ${name}`}>Download</a>
        ${
          removes === name
            ? html`<${Action} kind="danger" run=${act("recordings/delete", { name })}>Delete for ever<//>
          <button type="button" onClick=${() => setRemoves(undefined)}>Leave it</button>`
            : html`<button type="button" aria-label=${`Delete ${name}`}
              onClick=${() => setRemoves(name)}>Delete</button>`
        }
      </div>
    </article>`,
    )}`;
}
