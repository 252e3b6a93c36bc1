// How the service and its board are: the last hour as plots, what is wrong now, the check, and a report to send in.

import { Chart } from "./chart.js";
import { Action, bytes, time, Trouble, useAnswer, useEvery } from "./common.js";
import { impairments, present } from "./impaired.js";
import { ask, post, useStore } from "./store.js";
import { marked } from "./words.js";
import { html, useState } from "./vendor/preact.js";

const HISTORY_PERIOD_MS = 5000;

export function Health() {
  const { status } = useStore();
  const [history, trouble, reload] = useAnswer("history");
  useEvery(HISTORY_PERIOD_MS, reload);
  return html`
    <h2>Health</h2>
    <${Now} status=${status} />
    ${trouble && html`<${Trouble}>${trouble}<//>`}
    ${history && html`<${Plots} history=${history} />`}
    <${Check} />
    <${Log} />
    <div class="panel"><h3>Report</h3>
      <p>Versions, board, settings without addresses, state and log. It holds no name, no address and no picture. Read it before you send it.</p>
      <${Action} needsRole=${false} run=${save}>Save the report<//></div>`;
}

function Now({ status }) {
  const { metrics, version } = status?.service ?? {};
  const { load, temperature_c: temperature, undervoltage } = status?.board ?? {};
  const facts = [
    ["service", status?.running ? "runs" : "stopped"],
    ["version", version ?? "–"],
    ["load (1: one core)", load === undefined || load === null ? "–" : load.toFixed(2)],
    ["temperature", temperature && `${temperature.toFixed(0)} °C`],
    ["supply voltage", undervoltage === true ? "too low" : undervoltage === false && "enough"],
    ["adaptation", present(metrics, "facewire_step").join(", ") || "–"],
    ["free space", status?.free_bytes ? bytes(status.free_bytes) : "–"],
  ];
  return html`<dl class="facts">${facts.filter(([, value]) => value).map(([name, value]) => html`<div
    key=${name}><dt>${name}</dt><dd>${value}</dd></div>`)}</dl>
    ${impairments(status).map((sentence) => html`<p class="notice warn" role="status"
      key=${sentence}>${sentence}</p>`)}`;
}

// Words for the stages of a frame. The age is that of a face when its packet is sent.
const STAGES = { age: "from camera to packet" };
const SHARES = [
  ["p50", "median"],
  ["p95", "95 %"],
  ["max", "maximum"],
];

// The columns are named STAGE_p50_ms, STAGE_p95_ms and STAGE_max_ms. Without a sensor there is no plot of the temperature.
function Plots({ history: { columns, rows } }) {
  const [chosen, choose] = useState("age");
  const column = (name) => rows.map((row) => row[columns.indexOf(name)] ?? null);
  const times = column("time_s");
  const stages = columns.filter((name) => name.endsWith("_p50_ms")).map((name) => name.slice(0, -"_p50_ms".length));
  const stage = stages.includes(chosen) ? chosen : stages[0];
  const line = (name, title) => ({ title, values: column(name) });
  const temperature = line("temperature_c", "processor");
  const isMeasured = temperature.values.some((value) => value !== null);
  if (rows.length === 0) return html`<p class="panel">The plots begin now.</p>`;
  return html`<div class="charts">
    <${Chart} title="Frames" unit="1/s" times=${times} lines=${[line("rate_hz", "rate")]} />
    ${
      stage !== undefined &&
      html`<${Chart} title="Latency" unit="ms" times=${times}
      lines=${SHARES.map(([share, title]) => line(`${stage}_${share}_ms`, title))}>
      <label class="check">Stage<select value=${stage} onInput=${({ target }) => choose(target.value)}>${stages.map(
        (name) => html`<option key=${name} value=${name}>${STAGES[name] ?? name}</option>`,
      )}</select></label><//>`
    }
    <${Chart} title="Load, 1 is one busy core" times=${times} lines=${[line("load", "load")]} />
    ${isMeasured && html`<${Chart} title="Temperature" unit="°C" times=${times} lines=${[temperature]} />`}
  </div>`;
}

const SIGNS = { ok: "✓", warning: "!", failure: "✗" };

function Check() {
  const [lines, setLines] = useState();
  const run = async () => setLines((await post("check")).lines);
  return html`<div class="panel"><h3>Check</h3>
    <p>Tries camera, networks, model and links, and names a remedy for what does not work.</p>
    <${Action} run=${run}>Check now<//>
    ${
      lines &&
      html`<ul class="check-lines" aria-label="What the check says">${lines.map(
        ({ level, text }, index) => html`<li key=${index} class=${level}>
      <span aria-hidden="true">${SIGNS[level] ?? ""}</span> ${marked(text)}</li>`,
      )}</ul>`
    }
  </div>`;
}

const LEVELS = ["debug", "info", "warning", "error"];

function Log() {
  const [isOpen, setOpen] = useState(false);
  return html`<details class="panel" onToggle=${(event) => setOpen(event.target.open)}><summary>Log of the service</summary>
    ${isOpen && html`<${LogLines} />`}</details>`;
}

function LogLines() {
  const [answer, trouble, reload] = useAnswer("log");
  const [least, setLeast] = useState("info");
  useEvery(HISTORY_PERIOD_MS, reload);
  if (trouble) return html`<${Trouble}>${trouble}<//>`;
  const lines = answer?.lines.filter(({ level }) => LEVELS.indexOf(level) >= LEVELS.indexOf(least));
  return html`<label>Show<select value=${least} onInput=${(event) => setLeast(event.target.value)}>
      <option value="debug">everything</option><option value="info">all but details</option>
      <option value="warning">warnings and errors</option><option value="error">errors</option></select></label>
    ${lines?.length === 0 && html`<p>The log has no such line.</p>`}
    <ul class="check-lines" aria-label="The log, the newest line first">${lines?.map(
      ({ time_s: at, level, text }, index) => html`<li key=${index}
        class=${level === "error" ? "failure" : level}><small class="dim">${time(at)} ${level}</small> ${marked(text)}</li>`,
    )}</ul>`;
}

async function save() {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await (await ask("report")).blob());
  link.download = "facewire-report.txt";
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
