// The mesh of the head: rows of points around the vertical axis, from the throat to the crown.
//
// Rows follow the edges of the lips and of the lids, so that mouth and eyes are openings in the mesh: beyond their
// corners, the rows above and below share their points. Each edge has an inside, which gives it thickness.

import { CHIN_Y, CROWN_Y, EYE, MOUTH, eyeDistance, halfWidth, lipLine, lowerLid, skin, underChin, upperLid } from "./form.js";
import { gauss, hill, mix, smoothstep } from "./maths.js";

// The rows of each band. They lie densest at the edges of lips and lids, and at the crown.
const UNDER_CHIN_ROWS = 7;
const JAW_ROWS = 20;
const MIDDLE_ROWS = 40;
const TOP_ROWS = 38;
// Columns across the face, and around its back.
const FACE_COLUMNS = 92;
const BACK_COLUMNS = 22;
const FACE_ANGLE = 1.16;

// What a point of the mesh belongs to. The shapes move lips and lids by it.
export const PART = { skin: 0, upperLip: 1, lowerLip: 2, upperLid: 3, lowerLid: 4 };

// Returns { positions, tints, parts, edges, indices }. `edges` holds the heights of the edge of lips or lids at each
// point, from which shapes count distances. A tint is 0, lash, 0 and shade.
export function buildHead() {
  const mesh = { positions: [], tints: [], parts: [], edges: [], indices: [] };
  const angles = columnAngles();
  const rows = bands().map((row) => angles.map((angle) => addPoint(mesh, row, angle)));
  share(rows, angles);
  rows.slice(1).forEach((row, k) => {
    if (!row.isOpening) stitch(mesh, rows[k], row, angles.length);
  });
  addInsides(mesh, rows);
  return {
    positions: new Float32Array(mesh.positions),
    tints: new Float32Array(mesh.tints),
    parts: mesh.parts,
    edges: mesh.edges,
    indices: new Uint16Array(mesh.indices),
  };

  function share(all, columns) {
    for (const [lower, upper, isOpen] of [
      [JAW_END, JAW_END + 1, (angle) => Math.abs(mouthX(angle)) < MOUTH.halfWidth && Math.cos(angle) > 0],
      [MIDDLE_END, MIDDLE_END + 1, (angle) => upperLid(eyeX(angle)) > 0 && Math.cos(angle) > 0],
    ]) {
      all[upper].isOpening = true;
      columns.forEach((angle, j) => {
        if (!isOpen(angle)) all[upper][j] = all[lower][j];
      });
    }
  }
}

const JAW_END = UNDER_CHIN_ROWS + JAW_ROWS;
const MIDDLE_END = JAW_END + 1 + MIDDLE_ROWS;

const mouthX = (angle) => halfWidth(MOUTH.y) * Math.sin(angle);
const eyeX = (angle) => halfWidth(EYE.y) * Math.sin(angle);

function columnAngles() {
  const angles = [];
  for (let j = 0; j <= FACE_COLUMNS; j += 1) {
    angles.push(Math.asin(mix(-1, 1, j / FACE_COLUMNS) * Math.sin(FACE_ANGLE)));
  }
  for (let j = 1; j <= BACK_COLUMNS; j += 1) {
    angles.push(mix(FACE_ANGLE, 2 * Math.PI - FACE_ANGLE, j / (BACK_COLUMNS + 1)));
  }
  return angles;
}

// Returns a function for each row, from the angle to the point, its part and the edge that it belongs to.
function bands() {
  const lip = (angle) => lipLine(mouthX(angle));
  const lids = { below: (angle) => EYE.y + lowerLid(eyeX(angle)), above: (angle) => EYE.y + upperLid(eyeX(angle)) };
  const on = (angle, y, part, edge) => ({ at: skin(angle, y), part, edge });
  const rows = [];
  for (let k = 0; k < UNDER_CHIN_ROWS; k += 1) {
    rows.push((angle) => ({ at: underChin(angle, 1 - k / UNDER_CHIN_ROWS), part: PART.lowerLip, edge: lip(angle) }));
  }
  for (let k = 0; k <= JAW_ROWS; k += 1) {
    const part = Math.pow(1 - k / JAW_ROWS, 1.35);
    rows.push((angle) => on(angle, mix(lip(angle), CHIN_Y, part), PART.lowerLip, lip(angle)));
  }
  for (let k = 0; k <= MIDDLE_ROWS; k += 1) {
    const even = k / MIDDLE_ROWS;
    const part = even - 0.11 * Math.sin(2 * Math.PI * even);
    const isLip = part < 0.5;
    rows.push((angle) =>
      on(angle, mix(lip(angle), lids.below(angle), part), isLip ? PART.upperLip : PART.lowerLid,
        isLip ? lip(angle) : lids.below(angle)));
  }
  for (let k = 0; k <= TOP_ROWS; k += 1) {
    const even = k / TOP_ROWS;
    const part = mix(Math.pow(even, 1.45), 1 - (1 - even) ** 2, even * even);
    rows.push((angle) => on(angle, mix(lids.above(angle), CROWN_Y, part), PART.upperLid, lids.above(angle)));
  }
  return rows;
}

function addPoint(mesh, row, angle) {
  const { at, part, edge } = row(angle);
  const [x, y, z] = at;
  const isHair = hair(x, y, z);
  const lift = 3.5 * isHair;
  const length = Math.hypot(x, y - 20, z) || 1;
  mesh.positions.push(x + (lift * x) / length, y + (lift * (y - 20)) / length, z + (lift * z) / length);
  mesh.tints.push(0, lash(x, y, z, part), 0, shade(x, y, z));
  mesh.parts.push(part);
  mesh.edges.push(edge);
  return mesh.parts.length - 1;
}

// How much hair covers a point: above the forehead, in front of the ears and on the back of the head.
function hair(x, y, z) {
  const side = Math.abs(x);
  const line = 66 - 16 * smoothstep(30, 62, side) + 3 * gauss((side - 26) / 14);
  const front = smoothstep(line - 1.5, line + 4, y);
  const behind = smoothstep(-10, -18, z) * smoothstep(-62, -52, y);
  const temples = smoothstep(58, 66, side) * smoothstep(34, 12, z) * smoothstep(-14, -2, y);
  return Math.max(front, behind, temples);
}

// Lashes grow on the edge of the upper lid. A point beside the opening has none.
function lash(x, y, z, part) {
  if (z <= 0 || upperLid(x) <= 0) return 0;
  const above = part === PART.upperLid ? y - EYE.y - upperLid(x) : EYE.y + lowerLid(x) - y;
  const strength = part === PART.upperLid ? 1 : part === PART.lowerLid ? 0.35 : 0;
  return strength * (1 - smoothstep(0, 1.3, above)) * Math.min(1, upperLid(x) / 3);
}

// Where little light comes in: beside the nose, under the brows, between the lips, in the nostrils.
function shade(x, y, z) {
  if (z <= 0) return 0;
  const side = Math.abs(x);
  return Math.min(1, 0.22 * hill(side, y, 19, 3, 8, 9) + 0.25 * hill(side, y, 20, -50, 5, 6)
    + 0.2 * hill(x, y, 0, -84, 18, 5) + 0.12 * (eyeDistance(x, y) < 1.8 ? 1 : 0) * gauss((y - 9) / 4));
}

// Joins two rows by triangles. Points that both rows share make no triangle.
function stitch(mesh, lower, upper, columns) {
  for (let j = 0; j < columns; j += 1) {
    const next = (j + 1) % columns;
    const [a, b, c, d] = [lower[j], lower[next], upper[next], upper[j]];
    if (a !== b && b !== c && a !== c) mesh.indices.push(a, b, c);
    if (a !== c && c !== d && a !== d) mesh.indices.push(a, c, d);
  }
}

// Adds the insides of lips and lids: rows that run from the edge into the head. They move with the edge.
function addInsides(mesh, rows) {
  const insides = [
    { row: JAW_END, up: -1, steps: [[0.6, -2.5, 0.1], [-1, -6, 0.6], [-4, -9, 1]] },
    { row: JAW_END + 1, up: 1, steps: [[-0.6, -2.5, 0.1], [1, -6, 0.6], [4, -9, 1]] },
    { row: MIDDLE_END, up: -1, steps: [[0.2, -1.3, 0.2], [0, -3.2, 0.9]] },
    { row: MIDDLE_END + 1, up: 1, steps: [[-0.2, -1.3, 0.2], [0, -3.2, 0.9]] },
  ];
  for (const { row, up, steps } of insides) {
    const opening = rows[row];
    let last = opening;
    const isEdge = opening.map((point, j) => rows[up > 0 ? row - 1 : row + 1][j] !== point);
    for (const [dy, dz, dark] of steps) {
      const next = opening.map((point, j) => (isEdge[j] ? addInside(mesh, point, dy, dz, dark) : point));
      if (up > 0) stitch(mesh, next, last, opening.length);
      else stitch(mesh, last, next, opening.length);
      last = next;
    }
  }
}

function addInside(mesh, point, dy, dz, dark) {
  const [x, y, z] = mesh.positions.slice(3 * point, 3 * point + 3);
  mesh.positions.push(x, y + dy, z + dz);
  mesh.tints.push(0, 0, 0, dark);
  mesh.parts.push(mesh.parts[point]);
  mesh.edges.push(mesh.edges[point]);
  return mesh.parts.length - 1;
}
