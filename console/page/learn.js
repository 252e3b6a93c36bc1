// Finds the coefficient that a wearer means: the one that moves most against the second before.

import { onFace, store } from "./store.js";
import { wait } from "./drive.js";

const BEFORE_S = 1;
const MOVEMENT_MS = 3000;
const LEAST = 0.1;
const MOST_OFFERED = 3;
// Angles count as a coefficient does: a full movement is 40 degrees.
const FULL_TURN_DEG = 40;

const samples = [];
onFace(({ packet }) => {
  if (packet?.state !== "live") return;
  samples.push({
    time: packet.time_s,
    values: [...packet.coefficients, ...packet.angles_deg.map((angle) => angle / FULL_TURN_DEG)],
  });
  while (packet.time_s - samples[0].time > BEFORE_S) samples.shift();
});

export async function learn() {
  const names = [...store.hello.names, "headYaw", "headPitch", "headRoll"];
  const before = names.map(
    (_, index) => samples.reduce((sum, { values }) => sum + values[index], 0) / Math.max(1, samples.length),
  );
  const moved = names.map(() => 0);
  const end = onFace(() => {
    const newest = samples.at(-1);
    newest?.values.forEach((value, index) => (moved[index] = Math.max(moved[index], Math.abs(value - before[index]))));
  });
  await wait(MOVEMENT_MS);
  end();
  return names
    .map((name, index) => ({ name, moved: moved[index] }))
    .filter(({ moved: by }) => by >= LEAST)
    .sort((a, b) => b.moved - a.moved)
    .slice(0, MOST_OFFERED);
}
