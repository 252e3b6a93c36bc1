// Where each servo of the animatronic head goes by a row of `facewire track`: the channels of docs/animatronic.md.

import { SETS } from "/console/page/sets.js";

const [, WHOLE_HEAD] = SETS.find(([title]) => title === "Whole head");
const brow = (side) => ({
  name: `${side.toLowerCase()} brow`,
  sources: { browInnerUp: 0.5, [`browDown${side}`]: -0.5 },
  offset: 0.5,
});
const corner = (side) => ({
  name: `${side.toLowerCase()} corner of the mouth`,
  sources: { [`mouthSmile${side}`]: 0.7, [`mouthFrown${side}`]: -0.3 },
  offset: 0.3,
});
const CHANNELS = [...WHOLE_HEAD, ...["Left", "Right"].flatMap((side) => [brow(side), corner(side)])];
const ANGLES = { headYaw: "head_yaw_deg", headPitch: "head_pitch_deg", headRoll: "head_roll_deg" };

// Returns the position from 0 to 1 of each channel, by its name.
export function positionsOf(row) {
  return Object.fromEntries(CHANNELS.map(({ name, sources, offset = 0 }) => {
    const parts = Object.entries(sources).map(([source, factor]) => factor * Number(row[ANGLES[source] ?? source]));
    const sum = parts.reduce((total, part) => total + part, offset);
    return [name, Math.min(1, Math.max(0, sum))];
  }));
}
