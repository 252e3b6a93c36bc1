// Links to receivers with their state, and all settings: as forms, as text, and their earlier versions.

import { Action, time, Trouble } from "./common.js";
import { change, Difference, draft, isBoard, isDmx, restore, setText, useDraft } from "./draft.js";
import { Fields, isField, ordered } from "./fields.js";
import { Refusal, useHand } from "./hand.js";
import { DIFFER, PasswordField } from "./login.js";
import { get, loadSession, mayOperate, post, reopen, useStore } from "./store.js";
import { KINDS, LinkState, LinkTrouble, marked, nameOf, titleOfLink } from "./words.js";
import { html, useRef, useState } from "./vendor/preact.js";

// How long nobody types before a text is judged.
const PAUSE_MS = 400;
const VIEWS = [
  ["form", "Form"],
  ["text", "Text"],
  ["versions", "Versions"],
];

export function Links() {
  const { status } = useStore();
  const { trouble, text } = useDraft();
  const [view, setView] = useState("form");
  return html`
    <h2>Links</h2>
    <${LinkStates} links=${status?.service?.links ?? []} />
    <h2>Settings</h2>
    ${trouble && html`<${Trouble}>${trouble}<//>`}
    ${
      text !== undefined &&
      html`
      <p class="dim">${draft.path}</p>
      <div class="row" role="group" aria-label="Show the settings as">${VIEWS.map(
        ([key, title]) => html`
        <button type="button" key=${key} aria-pressed=${String(view === key)}
          onClick=${() => setView(key)}>${title}</button>`,
      )}</div>
      ${view === "form" && html`<${Form} />`}
      ${view === "text" && html`<${Text} />`}
      ${view === "versions" && html`<${Versions} />`}`
    }
    <${Access} />`;
}

// Who may come in.
function Access() {
  const [token, setToken] = useState();
  const [password, setPassword] = useState("");
  const [again, setAgain] = useState("");
  const [old, setOld] = useState("");
  const { session } = useStore();
  const replace = async () => {
    if (again !== password) throw new Error(DIFFER);
    await post("password", { new: password, ...(!session.local && { old }) });
    setPassword("");
    setAgain("");
    setOld("");
    reopen();
    return { done: "The password is changed." };
  };
  const share = async () => setToken((await post("tokens/look", {})).token);
  const leave = async () => {
    await post("logout");
    await loadSession();
  };
  return html`<h2>Access</h2><div class="panel">
    ${!session.local && html`<${PasswordField} label="Old password" autocomplete="current-password" value=${old}
      onInput=${(event) => setOld(event.target.value)} />`}
    <${PasswordField} label="New password" autocomplete="new-password" minlength="8" value=${password}
      onInput=${(event) => setPassword(event.target.value)} />
    <${PasswordField} label="The same again" autocomplete="new-password" value=${again}
      onInput=${(event) => setAgain(event.target.value)} />
    <div class="row"><${Action} disabled=${password.length < 8 || again === "" || !(session.local || old)} run=${replace}>Change the password<//></div>
    <p class="dim">Whoever opens a link to look sees all pages, and changes nothing. A new link ends the former one.</p>
    <div class="row"><${Action} run=${share}>Make a link to look<//><${Action} needsRole=${false}
      run=${leave}>Log out<//></div>
    ${token && html`<pre tabindex="0">${`${location.origin}${location.pathname}#token=${token}`}</pre>`}
  </div>`;
}

// The rate of a link is counted from two states.
function LinkStates({ links }) {
  const before = useRef({ time: 0, sent: [], rates: [] });
  const now = performance.now();
  if (now - before.current.time > 900) {
    const seconds = (now - before.current.time) / 1000;
    const rates = links.map(({ sent }, index) =>
      index in before.current.sent ? (sent - before.current.sent[index]) / seconds : undefined,
    );
    before.current = { time: now, sent: links.map(({ sent }) => sent), rates };
  }
  if (links.length === 0) return html`<p class="panel">No link is open. The settings below name the receivers.</p>`;
  return html`${links.map(
    (link, index) => html`<article class="panel" key=${index} aria-label=${link.name}>
    <h3>${titleOfLink(link)} <${LinkState} link=${link} /></h3>
    <p class="numbers"><span>rate <b>${rate(before.current.rates[index])}</b></span>
      <span>sent <b>${link.sent}</b></span> <span>dropped <b>${link.dropped}</b></span></p>
    <${LinkTrouble} link=${link} />
  </article>`,
  )}`;
}

const rate = (value) => (value === undefined ? "–" : `${Math.max(0, value).toFixed(0)} / s`);

// The schema of a link of this kind.
export const schemaOf = (schema, kind = "udp") =>
  (schema?.properties?.link?.items?.oneOf ?? []).find(({ properties }) => properties.kind.const === kind) ?? {
    properties: {},
  };
export const kindsOf = (schema) =>
  (schema?.properties?.link?.items?.oneOf ?? []).map(({ properties }) => properties.kind.const);

function Form() {
  const { schema, values, faults } = draft;
  const [kind, setKind] = useState("udp");
  const links = values.link ?? [];
  // The link that was added here last stands open.
  const added = useRef();
  const add = () => {
    added.current = links.length;
    return change({ [`link.${links.length}.kind`]: kind });
  };
  const elsewhere = faults.filter(({ key }) => !key);
  const top = { properties: Object.fromEntries(ordered(schema ?? {}).filter(([, field]) => isField(field))) };
  const sections = ordered(schema ?? {})
    .map(([name, section]) => [name, section.$ref ? schema.$defs[section.$ref.split("/").pop()] : section])
    .filter(([, { properties }]) => properties !== undefined);
  const count = (table) => Object.values(table ?? {}).filter((value) => typeof value !== "object").length;
  return html`
    ${elsewhere.map(({ line, text }) => html`<${Trouble}>${line ? `Line ${line}: ` : ""}${marked(text)}<//>`)}
    ${links.map(
      (link, index) => html`<details class="panel link" key=${index} open=${index === added.current}><summary>Link ${index + 1}: ${KINDS[link.kind ?? "udp"] ?? link.kind} <code>${link.kind ?? "udp"}</code></summary>
      ${isBoard(link) && html`<${ToServos} link=${link} />`}
      <${Fields} schema=${schemaOf(schema, link.kind)} values=${link} path=${`link.${index}`} faults=${faults}
        kind=${link.kind ?? "udp"} hidden=${["kind"]} />
      <${Action} run=${() => change({ [`link.${index}`]: null })}>Remove this link<//>
    </details>`,
    )}
    <div class="panel row">
      <label class="grow">A new link<select value=${kind} disabled=${!mayOperate()}
        onInput=${(event) => setKind(event.target.value)}>
        ${kindsOf(schema).map((name) => html`<option key=${name} value=${name}>${KINDS[name] ?? name}</option>`)}</select></label>
      <${Action} run=${add}>Add<//>
    </div>
    <details class="panel"><summary>General</summary><${Fields} schema=${top} values=${values} path=""
      faults=${faults} /></details>
    ${sections.map(
      ([name, section]) => html`<details class="panel" key=${name}>
      <summary>${nameOf(name)} <code>${name}</code>${count(values[name]) > 0 ? html` <small
        class="badge">${count(values[name])} changed</small>` : ""}</summary>
      ${section.description && html`<p class="dim">${marked(section.description)}</p>`}
      <${Fields} schema=${section} values=${values[name]} path=${name} faults=${faults} />
      ${name === "adjust" && html`<p
        class="dim">Single coefficients are adjusted in the text: jawOpen = { gain = 1.2, max = 0.8 }</p>`}
    </details>`,
    )}`;
}

// Leads to the channels of a servo board.
function ToServos({ link }) {
  const count = link.channel?.length ?? 0;
  if (count > 0) return html`<p>Its channels are on the page <a href="#servos">Servos</a>.</p>`;
  const lack = isDmx(link) ? "Without a channel, it sends the whole face." : "This board has no servo yet.";
  return html`<div class="notice row spread"><span>${lack}</span><a class="button" href="#servos">Set up its servos</a></div>`;
}

// The file's own text. A fault stands beside its line.
function Text() {
  const hand = useHand(setText);
  const area = useRef();
  const gutter = useRef();
  const timer = useRef();
  const text = hand.held ?? draft.text;
  const finish = () => {
    clearTimeout(timer.current);
    if (hand.held !== undefined && hand.held !== hand.sent) hand.keep(hand.held);
  };
  const type = ({ target }) => {
    hand.hold(target.value);
    clearTimeout(timer.current);
    timer.current = setTimeout(finish, PAUSE_MS);
  };
  const lines = text.split("\n");
  const faulty = new Map(draft.faults.filter(({ line }) => line).map(({ line, text: why }) => [line, why]));
  const goTo = (line) => {
    const start = lines.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    area.current.focus();
    area.current.setSelectionRange(start, start + lines[line - 1].length);
    area.current.scrollTop = (line - 4) * (area.current.scrollHeight / lines.length);
  };
  return html`
    ${
      draft.faults.length > 0 &&
      html`<ul class="faults" aria-label="Faults">${draft.faults.map(
        ({ line, text: why }) => html`<li>
      ${line ? html`<button type="button" class="small"
        onClick=${() => goTo(line)}>Line ${line}</button> ` : ""}${marked(why)}</li>`,
      )}</ul>`
    }
    <div class="editor">
      <pre ref=${gutter} aria-hidden="true">${lines.map((_, index) => html`<span key=${index}
        class=${faulty.has(index + 1) ? "bad" : ""}>${index + 1}${"\n"}</span>`)}</pre>
      <textarea ref=${area} aria-label="Text of the settings" wrap="off" spellcheck="false" autocapitalize="none"
        readonly=${!mayOperate()} value=${text}
        onInput=${type} onBlur=${finish}
          onScroll=${(event) => (gutter.current.scrollTop = event.target.scrollTop)}></textarea>
    </div>
    <${Refusal} hand=${hand} />`;
}

function Versions() {
  const [shown, setShown] = useState();
  const show = async (id) =>
    setShown(
      shown?.id === id ? undefined : { id, text: (await get(`settings?version=${encodeURIComponent(id)}`)).text },
    );
  if (!draft.versions?.length)
    return html`<p class="panel">No earlier version is kept yet. The last ten are kept from now on.</p>`;
  return html`<ul class="list">${draft.versions.map(
    ({ id, time_s: at, summary, refused }) => html`<li class="panel" key=${id}>
    <p><b>${time(at)}</b> ${summary} ${refused && html`<span class="state-bad">Refused by the service.</span>`}</p>
    <div class="row">
      <${Action} needsRole=${false} run=${() => show(id)}>${shown?.id === id ? "Hide" : "Difference to now"}<//>
      <${Action} run=${() => restore(id)}>Go back to it<//>
    </div>
    ${shown?.id === id && html`<${Difference} from=${draft.kept} to=${shown.text} />`}
  </li>`,
  )}</ul>`;
}
