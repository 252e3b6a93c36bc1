// Forms from the JSON Schema of the settings: a field for each setting, with its bounds, its unit and its comment.

import { change } from "./draft.js";
import { mayOperate } from "./store.js";
import { html, useState } from "./vendor/preact.js";

// The fields of a table at this path, such as "link.0". What `values` lacks has its default.
export function Fields({ schema, values, path, faults, hidden = [] }) {
  const entries = ordered(schema).filter(([key, field]) => !hidden.includes(key) && isField(field));
  return html`<div class="fields">${entries.map(
    ([key, field]) => html`
    <${Field} key=${key} name=${key} path=${path ? `${path}.${key}` : key} schema=${field} value=${values?.[key]}
      faults=${faults} />`,
  )}</div>`;
}

// The properties of a schema in the order of the settings.
export const ordered = ({ properties = {} }) =>
  Object.entries(properties).sort(([, a], [, b]) => (a.order ?? 0) - (b.order ?? 0));

// Tables and lists of tables have forms of their own, or are written as text.
export const isField = ({ type, enum: choices }) =>
  choices !== undefined || ["string", "integer", "number", "boolean"].includes(type);

function Field({ name, path, schema, value, faults }) {
  const [trouble, setTrouble] = useState();
  const id = `field-${path}`;
  const isSet = value !== undefined;
  const faulty = faults.filter(({ key }) => key === path);
  const put = (next) =>
    change({ [path]: next }).then(
      () => setTrouble(),
      (error) => setTrouble(error.message),
    );
  return html`<div class=${`field ${isSet ? "modified" : ""}`}>
    <label for=${id}>${name}${schema.unit ? html` <span class="dim">(${schema.unit})</span>` : ""}</label>
    <${Input} id=${id} schema=${schema} value=${value ?? schema.default} put=${put} isBad=${faulty.length > 0} />
    ${
      isSet &&
      html`<span class="row"><small class="badge">changed</small>
      <button type="button" class="small" disabled=${!mayOperate()} title=${`Reset ${path} to its default`}
        onClick=${() => put(null)}>
        Default${schema.default === undefined ? "" : `: ${schema.default === "" ? "empty" : schema.default}`}</button></span>`
    }
    ${faulty.map(({ text }) => html`<p class="trouble" role="alert">${text}</p>`)}
    ${trouble && html`<p class="trouble" role="alert">${trouble}</p>`}
    ${schema.description && html`<details class="help"><summary>What it does</summary><p
      id=${`${id}-help`}>${schema.description}</p></details>`}
  </div>`;
}

function Input({ id, schema, value, put, isBad }) {
  const common = { id, disabled: !mayOperate(), "aria-invalid": isBad ? "true" : undefined };
  if (schema.enum) {
    return html`<select ...${common} value=${value}
      onChange=${(event) => put(schema.enum.find((choice) => String(choice) === event.target.value))}>
      ${schema.enum.map((choice) => html`<option key=${choice} value=${choice}>${choice}</option>`)}</select>`;
  }
  if (schema.type === "boolean") {
    return html`<input type="checkbox" ...${common} checked=${value}
      onChange=${(event) => put(event.target.checked)} />`;
  }
  if (schema.type === "string")
    return html`<input type="text" ...${common} value=${value ?? ""} onChange=${(event) => put(event.target.value)} />`;
  const step = schema.type === "integer" ? 1 : "any";
  return html`<input type="number" inputmode="decimal" ...${common} value=${value} min=${schema.minimum}
    max=${schema.maximum} step=${step}
    onChange=${(event) => event.target.value !== "" && put(Number(event.target.value))} />`;
}
