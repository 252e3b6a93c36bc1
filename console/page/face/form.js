// The form of the head at rest: where its surface lies. All lengths are millimetres. The axes are those of the packet:
// x to the person's left, y up, z out of the face. The eyes are at y = 0.

import { curve, gauss, hill, mix, smoothstep, softMax } from "./maths.js";

export const EYE = { x: 32, y: 0, z: 56, radius: 17, halfWidth: 16.5, upper: 8.8, lower: 6.6, lid: 1.4 };
export const MOUTH = { y: -68, halfWidth: 25 };
export const CROWN_Y = 116;
export const CHIN_Y = -110;

// Height, half width, depth of the front and of the back. Above DOME_Y, `dome` narrows all but the height.
const outline = curve([
  [CHIN_Y, 29, 62, 14], [-104, 38, 72, 28], [-92, 48, 79, 46], [-72, 57, 80, 62], [-45, 66, 80, 78], [-15, 71, 80, 90],
  [10, 74, 83, 97], [35, 77, 88, 102], [60, 80, 92, 108], [82, 81, 92, 109], [100, 80, 88, 106], [CROWN_Y, 79, 84, 102],
]);
const DOME_Y = 10;

// The share of width and depth that is left at this height: an ellipse towards the crown.
const dome = (y) => (y > DOME_Y ? Math.sqrt(Math.max(0, 1 - ((y - DOME_Y) / (CROWN_Y - DOME_Y)) ** 2)) : 1);

function outlineAt(y) {
  const share = dome(y);
  return outline(y).map((value) => value * share);
}

// Below the chin the surface runs back to the throat: part of the way, height, half width, front, back.
const throat = curve([
  [0, CHIN_Y, 29, 62, 14], [0.15, -112.5, 26, 54, 16], [0.5, -111, 27, 38, 22], [1, -99, 38, 20, 40],
]);

// Height of the nose above the face, and its width, from its root to the lip.
const nose = curve([
  [-56, 0, 10], [-52.5, 2, 10.5], [-49, 12, 10.8], [-45, 18.5, 10.8], [-40, 21, 10.4], [-32, 16.5, 9.4], [-20, 10.5, 8.5],
  [-6, 6, 8], [8, 3, 9], [22, 0, 12],
]);

export const upperLid = (x) => lidHeight(x, EYE.upper, 0.14);
export const lowerLid = (x) => -lidHeight(x, EYE.lower, -0.12);

// The lids meet at the corners of the eye; `lean` moves the highest point towards the nose.
function lidHeight(x, height, lean) {
  const along = (Math.abs(x) - EYE.x) / EYE.halfWidth;
  const round = 1 - Math.pow(Math.abs(along), 2.2);
  return round <= 0 ? 0 : height * Math.pow(round, 0.8) * (1 - lean * along);
}

// The line between the lips rises slightly to its corners: a friendly face at rest.
export const lipLine = (x) => MOUTH.y + 2.8 * Math.min(1.6, (x / MOUTH.halfWidth) ** 2) - 0.6 * gauss(x / 6);

// Distance from the middle of an eye, 1 at the opening of the lids.
export function eyeDistance(x, y) {
  const height = mix(EYE.lower, EYE.upper, smoothstep(-4, 4, y));
  return Math.hypot((Math.abs(x) - EYE.x) / EYE.halfWidth, y / height);
}

// The depth at which skin lies on the eyeball, or undefined beside it.
export function onEyeball(x, y, gap) {
  const rest = (EYE.radius + gap) ** 2 - (Math.abs(x) - EYE.x) ** 2 - (y - EYE.y) ** 2;
  return rest > 0 ? EYE.z + Math.sqrt(rest) : undefined;
}

// Returns a point of the skin at this angle around the vertical axis (0 is the front) and height.
export function skin(angle, y) {
  const [width, front, back] = outlineAt(y);
  return finish(ring(angle, width, front, back), y);
}

// Returns half the width of the head at this height.
export const halfWidth = (y) => outlineAt(y)[0];

// Returns a point below the chin; `part` runs from 0 at the chin to 1 at the throat.
export function underChin(angle, part) {
  const [y, width, front, back] = throat(part);
  const [x, z] = ring(angle, width, front, back);
  return [x, y, z];
}

function ring(angle, width, front, back) {
  const [side, ahead] = [Math.sin(angle), Math.cos(angle)];
  const squarish = (value) => Math.sign(value) * Math.pow(Math.abs(value), 0.92);
  return [width * side, (ahead > 0 ? front : back) * squarish(ahead)];
}

function finish([x, base], y) {
  if (base <= 0) return [x, y, base];
  const isFront = smoothstep(0, 30, base);
  let z = base + isFront * features(x, y);
  // Close to their opening, the lids lie on the eyeball.
  const ball = onEyeball(x, y, EYE.lid) ?? EYE.z + 3;
  z = mix(z, Math.max(ball, EYE.z + 7.5), 1 - smoothstep(1, 1.85, eyeDistance(x, y)));
  const touch = onEyeball(x, y, EYE.lid);
  return [x, y, touch === undefined ? z : softMax(z, touch, 1.2)];
}

// How far the features of the face stand out.
function features(x, y) {
  const side = Math.abs(x);
  const [height, width] = nose(y);
  const ridge = y > -56 && y < 22 ? height / (1 + Math.pow(side / width, 3.2)) : 0;
  const wings = 6.2 * hill(side, y, 11.5, -45, 5.2, 5) - 2.5 * hill(side, y, 19.5, -45, 4, 8);
  const sockets = -9 * hill(side, y, EYE.x, 1, 18, 14) - 3 * hill(side, y, 14, 4, 7, 9);
  const brows = 3.5 * hill(side, y, 28, 20, 24, 8);
  const cheeks = 5 * hill(side, y, 38, -34, 19, 18) - 2.5 * hill(side, y, 46, -72, 14, 16);
  const muzzle = 4 * hill(x, y, 0, -68, 30, 18);
  const chin = 7 * hill(x, y, 0, -101, 16, 9) - 3 * hill(x, y, 0, -87, 17, 5);
  return ridge + wings + sockets + brows + cheeks + muzzle + chin + lips(x, y);
}

function lips(x, y) {
  const along = Math.abs(x) / (MOUTH.halfWidth + 3);
  if (along >= 1) return -1.6 * hill(Math.abs(x), y, MOUTH.halfWidth + 2, lipLine(MOUTH.halfWidth), 5, 5);
  const full = Math.sqrt(1 - along * along);
  const above = y - lipLine(x);
  const upper = 5.2 * gauss((above - 4.2) / 4) - 1.2 * gauss(x / 2.6) * gauss((above - 9) / 4);
  const lower = 6 * gauss((above + 5) / 4.4);
  return full * (above > 0 ? upper : lower) - 1.2 * gauss(above / 1.6) * full - 1.6 * (1 - full) * gauss(above / 5);
}
