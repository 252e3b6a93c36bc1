// Ready-made servos of a head: what each is called and what it follows. They begin with ends close to their middle, as every
// new servo does.

const eye = (side) => `eyeLook${side}`;
const pair = (positive, negative) =>
  Object.fromEntries([...positive.map((name) => [eye(name), 0.25]), ...negative.map((name) => [eye(name), -0.25])]);

const EYES = [
  { name: "eyes sideways", sources: pair(["OutLeft", "InRight"], ["InLeft", "OutRight"]), offset: 0.5 },
  { name: "eyes up and down", sources: pair(["UpLeft", "UpRight"], ["DownLeft", "DownRight"]), offset: 0.5 },
];
const upperLid = (side) => ({
  name: `${side.toLowerCase()} upper lid`,
  sources: { [`eyeBlink${side}`]: -0.75, [`eyeWide${side}`]: 0.25, [`eyeLookDown${side}`]: -0.25 },
  offset: 0.75,
});
const lowerLid = (side) => ({
  name: `${side.toLowerCase()} lower lid`,
  sources: { [`eyeBlink${side}`]: 0.6, [`eyeSquint${side}`]: 0.4 },
});
const LIDS = ["Left", "Right"].map(upperLid);
const JAW = [{ name: "jaw", sources: { jawOpen: 1, mouthClose: -0.5 } }];
const NECK = [
  { name: "neck turn", sources: { headYaw: 0.0125 }, offset: 0.5 },
  { name: "neck left", sources: { headPitch: 0.015, headRoll: 0.01 }, offset: 0.5 },
  { name: "neck right", sources: { headPitch: 0.015, headRoll: -0.01 }, offset: 0.5 },
];

export const SETS = [
  ["Eyes", EYES],
  ["Upper lids", LIDS],
  ["Lower lids", ["Left", "Right"].map(lowerLid)],
  ["Jaw", JAW],
  ["Neck", NECK],
  ["Whole head", [...EYES, ...LIDS, ...JAW, ...NECK]],
];
