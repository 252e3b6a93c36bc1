// The shapes of eyes, brows, cheeks and nose: where each moves a point of the skin, in millimetres at full strength.
//
// A point has `x`, `y`, `z`, its `part`, and `above`: its distance above the edge of the lid that it belongs to. In
// shapes of one side, x points outwards and is negative on the other side.

import { EYE, eyeDistance, lowerLid, upperLid } from "./form.js";
import { gauss, hill, mix, smoothstep } from "./maths.js";
import { PART } from "./head.js";

// Where the lids meet, as part of the way from the lower to the upper one.
const MEETING = 0.16;

// How far the eyes turn: 35 degrees, as those of ARKit.
export const EYE_TURN = 0.61;

const opening = (x) => upperLid(x) - lowerLid(x);

// The skin of a lid follows its edge: all of it at the edge, none of it at the crease.
function lidFollow({ part, above }) {
  if (part === PART.upperLid) return 1 - smoothstep(0, 15, above);
  return part === PART.lowerLid ? 1 - smoothstep(0, 13, -above) : 0;
}

// Moves the lids by these parts of their opening. Only the front of the head has lids.
function lids(point, upper, lower) {
  if (point.x < 0 || point.z < EYE.z - 20) return undefined;
  const share = point.part === PART.upperLid ? upper : point.part === PART.lowerLid ? lower : 0;
  return [0, share * opening(point.x) * lidFollow(point), 0];
}

const blink = (point) => lids(point, -(1 - MEETING) - 0.03, MEETING - 0.02);

function lookUp(point) {
  return lids(point, 0.22, 0.1);
}

function lookDown(point) {
  return lids(point, -0.42, -0.12);
}

function squint(point) {
  const cheek = 2 * hill(point.x, point.y, 34, -18, 15, 9);
  const [, dy] = lids(point, -0.14, 0.27) ?? [0, 0];
  return [0, dy + cheek, cheek * 0.6];
}

function wide(point) {
  const [, dy] = lids(point, 0.3, -0.12) ?? [0, 0];
  return [0, dy + 1.5 * hill(point.x, point.y, EYE.x, 20, 18, 9), 0];
}

// Brows do not pull at the edge of the lid.
const clearOfLid = ({ x, y }) => smoothstep(1, 2.4, eyeDistance(x, y));

function browDown(point) {
  const strength = hill(point.x, point.y, 25, 21, 17, 12) * clearOfLid(point);
  const inner = hill(point.x, point.y, 14, 20, 10, 11) * clearOfLid(point);
  return [-3 * inner, -6 * strength - 2.5 * inner, 1.5 * strength];
}

function browOuterUp(point) {
  const strength = hill(point.x, point.y, 44, 22, 18, 15) * clearOfLid(point);
  return [0, 8.5 * strength, 0.5 * strength];
}

function browInnerUp(point) {
  const strength = hill(Math.abs(point.x), point.y, 13, 23, 15, 15) * clearOfLid(point);
  return [0, 9 * strength, 1 * strength];
}

function cheekSquint(point) {
  const strength = hill(point.x, point.y, 38, -24, 19, 13);
  const [, dy] = lids(point, 0, 0.2) ?? [0, 0];
  return [strength, 5 * strength + dy, 4.5 * strength];
}

function noseSneer(point) {
  const wing = hill(point.x, point.y, 12, -42, 8, 11);
  const lip = hill(point.x, point.y, 14, -60, 10, 8) * (point.part === PART.upperLip ? 1 : 0);
  const brow = hill(point.x, point.y, 11, 14, 9, 11) * clearOfLid(point);
  return [1.5 * wing - brow, 4.5 * wing + 3.5 * lip - 2.5 * brow, 2.5 * wing];
}

function cheekPuff(point) {
  const side = Math.abs(point.x);
  const strength = hill(side, point.y, 41, -62, 20, 21) * smoothstep(8, 28, side);
  const lips = hill(point.x, point.y, 0, -68, 22, 10);
  return [Math.sign(point.x) * (9 * strength - 2 * gauss((side - 18) / 10) * lips), 0, 11 * strength + 1.5 * lips];
}

export const UPPER_SHAPES = {
  one: { browInnerUp, cheekPuff },
  sided: {
    eyeBlink: blink, eyeSquint: squint, eyeWide: wide, eyeLookUp: lookUp, eyeLookDown: lookDown, browDown, browOuterUp,
    cheekSquint, noseSneer,
  },
};

// Returns how far the upper lid of a side hangs into the eye, for its shadow: its height over the middle of the eye.
export function upperLidHeight(weight, side) {
  const shut = weight(`eyeBlink${side}`) * (1 - MEETING) + weight(`eyeLookDown${side}`) * 0.42
    - weight(`eyeLookUp${side}`) * 0.22 - weight(`eyeWide${side}`) * 0.3 + weight(`eyeSquint${side}`) * 0.14;
  return mix(upperLid(EYE.x), lowerLid(EYE.x), shut);
}
