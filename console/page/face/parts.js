// What the head has besides its skin: eyeballs, teeth, tongue, mouth, ears, neck. Each is { positions, normals, tints, indices }.

import { EYE } from "./form.js";
import { curve, gauss, mix, smoothstep } from "./maths.js";

// A grid of points from a function of two numbers from 0 to 1, with normals from its triangles.
function grid(columns, rows, at, tint = () => [0, 0, 0, 0]) {
  const [positions, tints, indices] = [[], [], []];
  for (let k = 0; k <= rows; k += 1) {
    for (let j = 0; j <= columns; j += 1) {
      positions.push(...at(j / columns, k / rows));
      tints.push(...tint(j / columns, k / rows));
      if (j === columns || k === rows) continue;
      const first = k * (columns + 1) + j;
      const above = first + columns + 1;
      indices.push(first, first + 1, above + 1, first, above + 1, above);
    }
  }
  const part = { positions: new Float32Array(positions), tints: new Float32Array(tints), indices: new Uint16Array(indices) };
  return { ...part, normals: normalsOf(part) };
}

function normalsOf({ positions: p, indices }) {
  const normals = new Float32Array(p.length);
  for (let t = 0; t < indices.length; t += 3) {
    const [a, b, c] = [...indices.subarray(t, t + 3)].map((i) => 3 * i);
    const [u, v] = [[0, 1, 2].map((k) => p[b + k] - p[a + k]), [0, 1, 2].map((k) => p[c + k] - p[a + k])];
    const cross = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const corner of [a, b, c]) cross.forEach((value, k) => (normals[corner + k] += value));
  }
  return normals;
}

// A ball whose columns run around the vertical axis, as seen from outside.
function ball(columns, rows, place) {
  return (u, v) => {
    const [around, up] = [(u - 0.5) * 2 * Math.PI, (v - 0.5) * Math.PI];
    return place(Math.sin(around) * Math.cos(up), Math.sin(up), Math.cos(around) * Math.cos(up));
  };
}

// An eyeball around its own centre; its pupil is on the z axis. The cornea bulges.
export function eyeball() {
  const bulge = (z) => 1 + 0.03 * smoothstep(0.86, 0.97, z);
  const radius = (z) => EYE.radius * bulge(z);
  return grid(32, 24, ball(32, 24, (x, y, z) => [x * radius(z), y * radius(z), z * radius(z)]));
}

// The arch of the teeth. `up` is 1 for the upper row, whose edge is below.
export function teeth(up) {
  const height = 9;
  const edgeY = up > 0 ? -71.4 : -72;
  return grid(56, 4, (u, v) => {
    const along = (u - 0.5) * 2 * 1.35;
    const tooth = Math.abs(Math.sin(along * 8.2));
    const root = up > 0 ? v : 1 - v;
    const y = edgeY + up * height * root + up * 0.5 * (1 - tooth) * (1 - root);
    const inward = 0.6 * (1 - tooth) * (1 - root) + 1.5 * root * root;
    return [(22 - inward) * Math.sin(along), y, 47 + (29 - inward - (up > 0 ? 0 : 2)) * Math.cos(along)];
  }, (u, v) => {
    const root = up > 0 ? v : 1 - v;
    return [smoothstep(0.62, 0.8, root), Math.abs(Math.sin((u - 0.5) * 2 * 1.35 * 8.2)), 0, 0];
  });
}

export function tongue() {
  return grid(28, 20, ball(28, 20, (x, y, z) => {
    const groove = -1.6 * gauss(x / 0.25) * smoothstep(-0.2, 0.5, y);
    return [16 * x, -80 + 5.5 * y + groove - 2 * smoothstep(0.4, 1, z), 48 + 22 * z];
  }));
}

// The wall of the mouth, of which the inside is drawn: once for the upper and once for the lower jaw.
export function cavity() {
  return grid(24, 16, ball(24, 16, (x, y, z) => [43 * x, -71 + 28 * y, 36 + 27 * z]));
}

// An ear: a flat bowl beside the head.
export function ear(side) {
  const rim = curve([[0, 0.2], [0.35, 0.1], [0.72, 0.55], [0.88, 1], [1, 0.55]]);
  return grid(40, 14, (u, v) => {
    const around = side * u * 2 * Math.PI;
    const [ahead, up] = [Math.sin(around), Math.cos(around)];
    const lobe = 1 - 0.32 * smoothstep(0.1, -1, up);
    const bowl = rim(1 - v)[0];
    const reach = 1 - v;
    const [z, y] = [-5 + 15 * reach * ahead * lobe - 4 * reach * up, -7 + 27 * reach * up];
    return [side * (71 + 10 * bowl * reach - 6 * reach * ahead), y, z];
  }, (u, v) => [0, 0, 0, 0.55 * gauss((1 - v) / 0.4)]);
}

// Neck and shoulders. The upper end follows the head.
export function neck() {
  const form = curve([
    [0, -240, 170, 66], [0.2, -186, 148, 58], [0.36, -158, 84, 48], [0.5, -136, 52, 44], [0.75, -100, 46, 43], [1, -60, 44, 42],
  ]);
  return grid(56, 26, (u, v) => {
    const [y, width, depth] = form(v);
    const around = (u - 0.5) * 2 * Math.PI;
    return [width * Math.sin(around), y, mix(-14, -26, smoothstep(-100, -180, y)) + depth * Math.cos(around)];
  }, (u, v) => {
    const [y] = form(v);
    return [0, 0, 0, 0.45 * smoothstep(-140, -95, y)];
  });
}
