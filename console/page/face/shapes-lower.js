// The shapes of jaw, mouth and tongue: where each moves a point of the skin, in millimetres at full strength.
//
// A point has `x`, `y`, `z`, its `part`, and `above`: its distance above the line between the lips. In shapes of one
// side, x points outwards and is negative on the other side.

import { MOUTH } from "./form.js";
import { gauss, hill, mix, smoothstep } from "./maths.js";
import { PART } from "./head.js";

// The jaw turns about the axis through both of its joints.
export const JAW = { y: -14, z: 8, turn: 0.4, forward: 7, side: 9 };
// How far the corners of the mouth follow the jaw.
const CORNER = 0.36;

const isLower = ({ part }) => part === PART.lowerLip;
const isMouth = ({ part }) => part === PART.lowerLip || part === PART.upperLip;

// 1 in the middle of the mouth, 0 at its corners: the form of a mouth that opens.
const oval = ({ x }) => Math.sqrt(Math.max(0, 1 - (x / MOUTH.halfWidth) ** 2));

// How far a point follows the jaw.
function jawFollow(point) {
  if (!isMouth(point)) return 0;
  const lateral = 1 - smoothstep(48, 72, Math.abs(point.x));
  const front = smoothstep(-20, 26, point.z);
  const round = oval(point);
  if (isLower(point)) {
    const edge = mix(CORNER * mix(0.7, 1, lateral), 1, round);
    return front * mix(edge, mix(0.9, 1, lateral), smoothstep(0, 24, -point.above));
  }
  return front * CORNER * (1 - round) * (1 - smoothstep(0, 34, point.above)) * mix(0.7, 1, lateral);
}

function jawDrop(point) {
  const [y, z] = [point.y - JAW.y, point.z - JAW.z];
  const [sin, cos] = [Math.sin(JAW.turn), Math.cos(JAW.turn)];
  return [0, y * cos - z * sin - y, y * sin + z * cos - z];
}

function jawOpen(point) {
  const follow = jawFollow(point);
  const narrow = -0.08 * point.x * hill(point.x, point.y, 0, MOUTH.y, 26, 18);
  const [, dy, dz] = jawDrop(point);
  return [narrow, follow * dy, follow * dz];
}

const jawShift = (dx, dz) => (point) => {
  const follow = jawFollow({ ...point, z: point.z + 8 }) * (isLower(point) ? 1 : 0.8);
  return [dx * follow, 0, dz * follow];
};

// With an open jaw, the lips meet between the teeth.
function mouthClose(point) {
  if (!isMouth(point)) return undefined;
  const [, dy, dz] = jawDrop({ y: MOUTH.y, z: 80 });
  const round = oval(point) * (1 - CORNER);
  if (isLower(point)) {
    const near = gauss(Math.max(0, -point.above - 4) / 15) * round;
    return [0, -0.66 * dy * near, -0.75 * dz * near];
  }
  const near = gauss(Math.max(0, point.above - 4) / 9) * round;
  return [0, 0.34 * dy * near, 0.25 * dz * near];
}

// The lips as a whole, and each of them. They fade out towards nose and chin.
const bothLips = (point, width, height) => (isMouth(point) ? hill(point.x, point.y, 0, MOUTH.y, width, height) : 0);
const near = (point) => gauss(Math.max(0, Math.abs(point.above) - 5) / 7);
const lowerLip = (point) => (isLower(point) ? near(point) * gauss(point.x / 22) : 0);
const upperLip = (point) => (point.part === PART.upperLip ? near(point) * gauss(point.x / 22) : 0);

function mouthFunnel(point) {
  const lips = bothLips(point, 30, 17);
  const apart = oval(point) * near(point);
  return [-0.3 * point.x * lips, (isLower(point) ? -5.5 : 4.5) * apart, 9 * lips];
}

function mouthPucker(point) {
  const lips = bothLips(point, 32, 17);
  const thicker = 0.22 * point.above * near(point) * gauss(point.x / 16);
  return [-0.46 * point.x * lips, isMouth(point) ? thicker : 0, 10 * lips];
}

const mouthShift = (dx) => (point) => [dx * bothLips(point, 34, 24), 0, -0.03 * Math.abs(point.x) * bothLips(point, 34, 24)];

const roll = (lip, dy) => (point) => [0, dy * lip(point) * Math.min(1, Math.abs(point.above) / 7), -6.5 * lip(point)];

function mouthShrugLower(point) {
  const chin = hill(point.x, point.y, 0, -94, 20, 14);
  const push = lowerLip(point) + 0.85 * upperLip(point);
  return [0, 4 * push + 4 * chin * (isLower(point) ? 1 : 0), 3.5 * lowerLip(point) + 1.5 * upperLip(point)];
}

function mouthShrugUpper(point) {
  const push = upperLip(point) + 0.7 * lowerLip(point);
  return [0, 3.5 * push, 3 * upperLip(point) + lowerLip(point)];
}

const half = (point) => smoothstep(-9, 9, point.x);
const corner = (point, width, height) => (isMouth(point) ? hill(point.x, point.y, MOUTH.halfWidth, MOUTH.y, width, height) : 0);

function mouthSmile(point) {
  const end = MOUTH.halfWidth + 1;
  const along = point.x < end ? Math.max(0, point.x / end) ** 2.3 : gauss((point.x - end) / 13);
  const pull = isMouth(point) ? along * gauss((point.y - MOUTH.y) / 17) : 0;
  const cheek = hill(point.x, point.y, 40, -36, 18, 17) * half(point);
  const thinner = isMouth(point) ? -0.16 * point.above * near(point) * half(point) : 0;
  return [8 * pull + 1.5 * cheek, 8.5 * pull + 4 * cheek + thinner, -4 * pull + 5 * cheek];
}

function mouthFrown(point) {
  const pull = corner(point, 15, 14);
  return [0.5 * pull, -9 * pull, -1.5 * pull];
}

function mouthDimple(point) {
  const pull = corner(point, 12, 11);
  return [4.5 * pull, 1.5 * pull, -6 * pull];
}

function mouthStretch(point) {
  const pull = corner(point, 20, 15);
  return [9 * pull, -4.5 * pull, -5 * pull];
}

function mouthPress(point) {
  const strength = isMouth(point) ? near(point) * half(point) * gauss((point.x - 12) / 16) : 0;
  return [0.5 * strength, -0.42 * point.above * strength, -2.8 * strength];
}

function mouthLowerDown(point) {
  const strength = isLower(point) ? near(point) * gauss((point.x - 11) / 11) * Math.sqrt(oval(point)) : 0;
  return [strength, -8 * strength, 1.2 * strength];
}

function mouthUpperUp(point) {
  const strength = point.part === PART.upperLip ? near(point) * gauss((point.x - 11) / 11) * Math.sqrt(oval(point)) : 0;
  const fold = hill(point.x, point.y, 24, -50, 10, 10) * half(point);
  return [strength, 7 * strength + 2 * fold, 1.5 * strength + 1.5 * fold];
}

// The tongue itself is a part of its own; the lower lip makes room for it.
function tongueOut(point) {
  return [0, -4.5 * lowerLip(point) * oval(point), lowerLip(point)];
}

export const LOWER_SHAPES = {
  one: {
    jawOpen, jawForward: jawShift(0, JAW.forward), jawLeft: jawShift(JAW.side, 0), jawRight: jawShift(-JAW.side, 0),
    mouthClose, mouthFunnel, mouthPucker, mouthLeft: mouthShift(9), mouthRight: mouthShift(-9),
    mouthRollLower: roll(lowerLip, 3), mouthRollUpper: roll(upperLip, -3), mouthShrugLower, mouthShrugUpper, tongueOut,
  },
  sided: {
    mouthSmile, mouthFrown, mouthDimple, mouthStretch, mouthPress, mouthLowerDown, mouthUpperUp,
  },
};
