// Forms from the JSON Schema of the settings: a field for each setting, with its bounds, its unit and its comment.

import { Action } from "./common.js";
import { change } from "./draft.js";
import { Check, Choice, Entry } from "./hand.js";
import { html } from "./vendor/preact.js";
import { marked, nameOf } from "./words.js";

// The fields of a table at this path, such as "link.0", whose settings are called as for links of this kind. What `values`
// lacks has its default.
export function Fields({ schema, values, path, faults, kind, hidden = [] }) {
  const entries = ordered(schema).filter(([key, field]) => !hidden.includes(key) && isField(field));
  return html`<div class="fields">${entries.map(
    ([key, field]) => html`
    <${Field} key=${key} name=${key} path=${path ? `${path}.${key}` : key} kind=${kind} schema=${field} value=${values?.[key]}
      faults=${faults} />`,
  )}</div>`;
}

// The properties of a schema in the order of the settings.
export const ordered = ({ properties = {} }) =>
  Object.entries(properties).sort(([, a], [, b]) => (a.order ?? 0) - (b.order ?? 0));

// Tables and lists of tables have forms of their own, or are written as text.
export const isField = ({ type, enum: choices }) =>
  choices !== undefined || ["string", "integer", "number", "boolean"].includes(type);

function Field({ name, path, kind, schema, value, faults }) {
  const id = `field-${path}`;
  const isSet = value !== undefined;
  const faulty = faults.filter(({ key }) => key === path);
  const put = (next) => change({ [path]: next });
  const usual = `Default${schema.default === undefined ? "" : `: ${schema.default === "" ? "empty" : schema.default}`}`;
  return html`<div class=${`field ${isSet ? "modified" : ""}`}>
    <label for=${id}>${nameOf(kind ? `link.${kind}.${name}` : path)}${schema.unit ? html` <span class="dim">(${schema.unit})</span>` : ""} <code>${name}</code></label>
    <${Input} id=${id} schema=${schema} value=${value ?? schema.default} keep=${put} isBad=${faulty.length > 0} />
    ${
      isSet &&
      html`<span class="row"><small class="badge">changed</small>
      <${Action} kind="small" label=${`${usual}, for ${path}`} run=${() => put(null)}>${usual}<//></span>`
    }
    ${faulty.map(({ text }) => html`<p class="trouble" role="alert">${marked(text)}</p>`)}
    ${schema.description && html`<details class="help"><summary>What it does</summary><p
      id=${`${id}-help`}>${marked(schema.description)}</p></details>`}
  </div>`;
}

function Input({ schema, ...rest }) {
  if (schema.enum) return html`<${Choice} ...${rest} choices=${schema.enum.map((choice) => [choice, String(choice)])} />`;
  if (schema.type === "boolean") return html`<${Check} ...${rest} />`;
  if (schema.type === "string")
    return html`<${Entry} type="text" autocomplete="off" autocapitalize="none" spellcheck=${false} ...${rest} />`;
  return html`<${Entry} type="number" inputmode="decimal" ...${rest} min=${schema.minimum} max=${schema.maximum}
    step=${schema.type === "integer" ? 1 : "any"} />`;
}
