// The settings as they are being edited. Every page that changes settings changes this draft, and nothing is kept before
// its difference was shown.

import { html, useState } from "./vendor/preact.js";
import { Action, sentence } from "./common.js";
import { get, mayOperate, post, update, useStore } from "./store.js";

// `kept` is the text of the file, `base` its hash, `text` the draft, and `values` what the draft sets. `used` is what the file
// sets, and so what the service uses.
export const draft = {
  kept: undefined,
  text: undefined,
  values: {},
  used: {},
  schema: undefined,
  faults: [],
  changed: [],
  versions: [],
};
let loading;
let forgetting;
const SAID_MS = 15_000;
const RETRY_MS = 2000;
// Edits follow each other, so that each begins with the text that the one before it gave.
let last = Promise.resolve();

const set = (changes) => {
  Object.assign(draft, changes);
  update({});
};

export function loadDraft() {
  loading ??= reload();
  return loading;
}

async function reload() {
  try {
    const { path, text, hash, schema, values, faults, versions } = await get("settings");
    set({
      path,
      base: hash,
      kept: text,
      text,
      schema,
      values: values ?? {},
      used: values ?? {},
      faults: faults ?? [],
      versions,
      changed: [],
      trouble: undefined,
    });
  } catch (error) {
    loading = undefined;
    // Whoever logs in again loads the draft again.
    if (error.status === 401) return;
    // A console on a busy board may answer too late once.
    set({ trouble: error.message });
    setTimeout(loadDraft, RETRY_MS);
  }
}

// Returns the draft, and loads it if no page has.
export function useDraft() {
  useStore();
  if (draft.text === undefined && !draft.trouble) loadDraft();
  return draft;
}

const after = (step) => (last = last.catch(() => undefined).then(step));

// Changes settings: { "camera.fps": 60, "link.0.channel.2.neutral": null to remove the line }.
export const change = (changes) =>
  after(async () => {
    await loadDraft();
    const { text, values } = await post("settings/edit", { text: draft.text, changes });
    await check(text, values);
  });

export const setText = (text) => after(() => check(text));

async function check(text, edited = draft.values) {
  set({ text, values: edited });
  const { faults, changed, values } = await post("settings/check", { text });
  set({ faults: faults ?? [], changed: changed ?? [], values: values ?? draft.values });
}

export const isChanged = () => draft.text !== draft.kept;

export const keep = () => after(() => replace("settings/keep", { text: draft.text, base: draft.base }));
export const restore = (id) => after(() => replace("settings/restore", { id }));

// What the service says is shown for a while, since what was pressed is gone then.
async function replace(path, body) {
  const answer = await post(path, body);
  await reload();
  set({ said: answer.done });
  clearTimeout(forgetting);
  forgetting = setTimeout(() => set({ said: undefined }), SAID_MS);
  return answer;
}

// The versions begin with the newest. Those that the service has refused, or that have faults, are passed over.
export async function restoreLast() {
  await reload();
  for (const { id, refused } of draft.versions ?? []) {
    if (refused) continue;
    try {
      return await restore(id);
    } catch (error) {
      if (error.status !== 422) throw error;
    }
  }
  throw new Error("No earlier settings without a fault were kept. Mend the faults beside their lines instead.");
}

export const discard = () =>
  after(() => {
    set({ text: draft.kept, faults: [], changed: [] });
    return reload();
  });

// Shows that there are changes which are not kept, on every page.
export function DraftBar() {
  useStore();
  const [isOpen, setOpen] = useState(false);
  if (draft.text === undefined) return null;
  if (!isChanged())
    return (
      draft.said &&
      html`<aside id="kept" class="row spread" role="status"><span>${sentence(draft.said)}</span>
      <button type="button" class="small" onClick=${() => set({ said: undefined })}>Close</button></aside>`
    );
  const { faults, changed } = draft;
  const count = changed.length === 1 ? "1 setting is" : `${changed.length || "Some"} settings are`;
  return html`<aside id="draft" aria-label="Changed settings">
    ${isOpen && html`<${Difference} from=${draft.kept} to=${draft.text} />`}
    ${
      faults.length > 0
        ? html`<p
          class="trouble"><b>${faults.length === 1 ? "A fault" : `${faults.length} faults`}:</b> ${faults[0].line ? `line ${faults[0].line}: ` : ""}${faults[0].text}</p>`
        : html`<p>${count} changed and not kept yet.</p>`
    }
    <div class="row">
      <button type="button" aria-expanded=${isOpen} onClick=${() => setOpen(!isOpen)}>Difference</button>
      <${Action} run=${discard} needsRole=${false}>Discard<//>
      <${Action} kind="primary" disabled=${faults.length > 0 || !mayOperate()} run=${keep}>Keep<//>
    </div>
  </aside>`;
}

export function Difference({ from, to }) {
  const lines = difference(from.split("\n"), to.split("\n"));
  return html`<pre class="difference" tabindex="0" aria-label="Difference to the kept settings">${lines.map(
    ([sign, text], index) => {
      const kind = sign === "+" ? "added" : sign === "-" ? "removed" : "";
      return html`<span key=${index} class=${kind}>${sign} ${text}${"\n"}</span>`;
    },
  )}</pre>`;
}

// The lines that were added and removed, each with two lines of what is around it.
export function difference(before, after) {
  let start = 0;
  while (start < before.length && start < after.length && before[start] === after[start]) start += 1;
  let end = 0;
  const most = Math.min(before.length, after.length) - start;
  while (end < most && before[before.length - 1 - end] === after[after.length - 1 - end]) end += 1;
  const [a, b] = [before.slice(start, before.length - end), after.slice(start, after.length - end)];
  const all = [
    ...before.slice(Math.max(0, start - 2), start).map((line) => [" ", line]),
    ...longest(a, b),
    ...before
      .slice(before.length - end)
      .slice(0, 2)
      .map((line) => [" ", line]),
  ];
  const isNear = (index) => all.slice(Math.max(0, index - 2), index + 3).some(([sign]) => sign !== " ");
  return all.flatMap((line, index) => (isNear(index) ? [line] : isNear(index - 1) ? [["…", ""]] : []));
}

// Compares lines by their longest common subsequence.
function longest(a, b) {
  const table = Array.from({ length: a.length + 1 }, () => new Uint32Array(b.length + 1));
  for (let i = a.length - 1; i >= 0; i -= 1) {
    for (let j = b.length - 1; j >= 0; j -= 1) {
      table[i][j] = a[i] === b[j] ? table[i + 1][j + 1] + 1 : Math.max(table[i + 1][j], table[i][j + 1]);
    }
  }
  const lines = [];
  let [i, j] = [0, 0];
  while (i < a.length || j < b.length) {
    if (i < a.length && j < b.length && a[i] === b[j]) {
      lines.push([" ", a[i]]);
      [i, j] = [i + 1, j + 1];
    } else if (j >= b.length || (i < a.length && table[i + 1][j] >= table[i][j + 1])) {
      lines.push(["-", a[i]]);
      i += 1;
    } else {
      lines.push(["+", b[j]]);
      j += 1;
    }
  }
  return lines;
}
