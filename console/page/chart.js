// A plot of numbers over the last hour.

import { html, useEffect, useRef } from "./vendor/preact.js";

export const COLOURS = ["#2a9bb0", "#d0632a", "#7a5cc9", "#3f9a4c", "#d0488c", "#9a8a1f", "#5b7083", "#b3261e"];
const HOUR_S = 3600;
const LEFT = 44;
const BOTTOM = 18;

// `lines` are { title, values }, with a value or null for each of `times`.
export function Chart({ title, unit, times, lines, children }) {
  const canvas = useRef();
  const most = scale(Math.max(0, ...lines.flatMap(({ values }) => values.filter((value) => value !== null))));
  const draw = () => canvas.current?.clientWidth && paint(canvas.current, times, lines, most);
  useEffect(() => {
    draw();
    addEventListener("resize", draw);
    return () => removeEventListener("resize", draw);
  });
  const newest = (values) => values.findLast((value) => value !== null);
  const said = lines.map(({ title: name, values }) => `${name} ${newest(values)?.toFixed(1) ?? "unknown"}`).join(", ");
  return html`<figure class="panel">
    <figcaption>${title}${unit ? ` in ${unit}` : ""}, last hour</figcaption>
    ${children}
    <canvas class="chart" ref=${canvas} role="img" aria-label=${`${title}, now: ${said}`}></canvas>
    <ul class="legend">${lines.map(
      (
        { title: name, values },
        index,
      ) => html`<li key=${name} style=${{ "--colour": COLOURS[index] }}>
      ${name} <b>${newest(values)?.toFixed(1) ?? "–"}</b></li>`,
    )}</ul>
  </figure>`;
}

// The next round number: 1, 2 or 5 times a power of ten.
function scale(most) {
  const power = 10 ** Math.floor(Math.log10(most || 1));
  return [1, 2, 5, 10].map((factor) => factor * power).find((round) => round >= most);
}

function paint(canvas, times, lines, most) {
  const ratio = Math.min(2, devicePixelRatio || 1);
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  [canvas.width, canvas.height] = [width * ratio, height * ratio];
  const context = canvas.getContext("2d");
  const style = getComputedStyle(canvas);
  context.scale(ratio, ratio);
  context.font = "12px system-ui, sans-serif";
  context.fillStyle = style.getPropertyValue("--dim");
  context.strokeStyle = style.getPropertyValue("--line");
  const now = times.at(-1) ?? 0;
  const x = (time) => LEFT + (width - LEFT - 4) * (1 - (now - time) / HOUR_S);
  const y = (value) => 6 + (height - BOTTOM - 6) * (1 - value / most);
  context.textAlign = "right";
  for (const level of [0, most / 2, most]) {
    stroke(context, [
      [LEFT, y(level)],
      [width - 4, y(level)],
    ]);
    context.fillText(String(Number(level.toPrecision(3))), LEFT - 6, y(level) + 4);
  }
  context.textAlign = "center";
  for (const minutes of [60, 40, 20])
    context.fillText(`−${minutes} min`, Math.max(LEFT + 14, x(now - 60 * minutes)), height - 4);
  context.lineWidth = 1.5;
  lines.forEach(({ values }, index) => {
    context.strokeStyle = COLOURS[index];
    let points = [];
    values.forEach((value, k) => {
      // A gap in the numbers is a gap in the line.
      const isGap = value === null || (k > 0 && times[k] - times[k - 1] > 30);
      if (isGap) points = void stroke(context, points) ?? [];
      if (value !== null) points.push([x(times[k]), y(value)]);
    });
    stroke(context, points);
  });
}

function stroke(context, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(x, y);
  context.stroke();
}
