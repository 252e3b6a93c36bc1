// The settings as they are being edited. Every page that changes settings changes this draft, and nothing is kept before
// its difference was shown.

import { html, useState } from "./vendor/preact.js";
import { Action } from "./common.js";
import { get, mayOperate, post, update, useStore } from "./store.js";
import { KINDS, marked, nameOf, sentence } from "./words.js";

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

// Links of servo boards have channels. Those of DMX send the whole face without any.
export const isBoard = ({ kind }) => ["maestro", "pca9685", "bus-servo", "sacn", "artnet"].includes(kind);
export const isDmx = ({ kind }) => ["sacn", "artnet"].includes(kind);
const lacksChannels = (link) => isBoard(link) && !isDmx(link) && !link.channel?.length;

// Where facewire sends as long as the settings have no link.
const USUAL_LINKS = [
  ["this machine (127.0.0.1:5252)", { kind: "udp", address: "127.0.0.1:5252" }],
  ["a microcontroller on USB", { kind: "serial", device: "auto", pace: "change" }],
];

// Returns the usual links that the draft ends, because the settings get their first link.
function endedLinks() {
  const links = draft.values.link ?? [];
  if (draft.used.link?.length || links.length === 0) return [];
  const place = ({ kind = "udp", address = USUAL_LINKS[0][1].address }) => (kind === "udp" ? address : kind);
  return USUAL_LINKS.filter(([, usual]) => !links.some((link) => place(link) === place(usual)));
}

const keepUsualLinks = () => {
  const next = draft.values.link.length;
  const settings = endedLinks().flatMap(([, link], index) =>
    Object.entries(link).map(([key, value]) => [`link.${next + index}.${key}`, value]),
  );
  return change(Object.fromEntries(settings));
};

// Returns what has become of a setting, a link or a channel, as words.
function deed(path) {
  const keys = path.split(".");
  const at = (values) => keys.reduce((value, key) => value?.[key], values);
  const listOf = (values) => keys.slice(0, -1).reduce((value, key) => value?.[key], values) ?? [];
  const [was, is] = [at(draft.used), at(draft.values)];
  if (!/^\d+$/.test(keys.at(-1))) return is === undefined ? "back to the default" : typeof is === "object" ? "" : String(is);
  const isIn = (one, values) => listOf(values).some((other) => JSON.stringify(other) === JSON.stringify(one));
  const [isGone, isNew] = [was !== undefined && !isIn(was, draft.values), is !== undefined && !isIn(is, draft.used)];
  return isGone && isNew ? "replaced" : isGone ? "removed" : "added";
}

// One change of the settings, with its name for people and its key.
function Change({ path }) {
  const link = /^link\.(\d+)/.exec(path)?.[1];
  const what = deed(path);
  const values = what === "removed" ? draft.used : draft.values;
  const kind = link === undefined ? undefined : (values.link?.[link]?.kind ?? "udp");
  const place = kind ? `Link ${Number(link) + 1}, ${KINDS[kind] ?? kind}` : "";
  const rest = kind ? path.split(".").slice(2) : [];
  const isChannel = rest[0] === "channel";
  const channel = isChannel && (values.link?.[link]?.channel?.[rest[1]]?.channel ?? 0);
  const name = !kind || rest.length > (isChannel ? 2 : 0) ? nameOf(kind && !isChannel ? `link.${kind}.${rest.at(-1)}` : path) : "";
  const words = [place, isChannel ? `channel ${channel}` : "", name].filter(Boolean).join(", ");
  return html`<li>${words}${what && `: ${what}`} <code>${path}</code></li>`;
}

function Changes() {
  return html`<div class="changes">
    <ul aria-label="List of differences">
      ${draft.changed.map((path) => html`<${Change} key=${path} path=${path} />`)}
      ${endedLinks().map(([to, { kind }]) => html`<li key=${kind}>The usual link to ${to}: removed</li>`)}
    </ul>
    <${Difference} from=${draft.kept} to=${draft.text} />
  </div>`;
}

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
  const ended = endedLinks();
  const count = changed.length === 1 ? "1 setting is" : `${changed.length || "Some"} settings are`;
  return html`<aside id="draft" aria-label="Changed settings">
    ${isOpen && html`<${Changes} />`}
    ${
      faults.length > 0
        ? html`<p
          class="trouble"><b>${faults.length === 1 ? "A fault" : `${faults.length} faults`}:</b> ${faults[0].line ? `line ${faults[0].line}: ` : ""}${marked(faults[0].text)}</p>`
        : html`<p>${count} changed and not kept yet.</p>`
    }
    ${draft.values.link?.some(lacksChannels) && location.hash !== "#servos" && html`<p>A servo board has no channel yet: <a
      href="#servos">set up its servos</a>.</p>`}
    ${
      ended.length > 0 &&
      html`<p>With a link of your own, facewire no longer sends to ${ended.map(([to]) => to).join(" or ")}. <${Action} kind="small" run=${keepUsualLinks}>Keep sending there too<//></p>`
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
