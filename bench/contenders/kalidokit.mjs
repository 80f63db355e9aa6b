// BlazePose landmarks to rotations by kalidokit, in its own process: `node kalidokit.mjs kalidokit.umd.js IN OUT`.
// IN holds float64: the number of frames, then for each 33 world landmarks (x, y, z) and 33 of the image (x, y).
// OUT gets float64: for each frame ten Euler angles (x, y, z), in the order of BONES, then how long it took (us).
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";

const BONES = [
  "LeftUpperArm", "LeftLowerArm", "RightUpperArm", "RightLowerArm",
  "LeftUpperLeg", "LeftLowerLeg", "RightUpperLeg", "RightLowerLeg",
];
const [library, from, to] = process.argv.slice(2);
const Kalidokit = createRequire(import.meta.url)(library);
const bytes = readFileSync(from);
const given = new Float64Array(bytes.buffer, bytes.byteOffset, bytes.byteLength / 8);
const frames = given[0];
const made = new Float64Array(frames * 31);
for (let i = 0; i < frames; i++) {
  const row = given.subarray(1 + i * 165, 1 + (i + 1) * 165);
  const world = [], image = [];
  for (let k = 0; k < 33; k++) {
    world.push({ x: row[3 * k], y: row[3 * k + 1], z: row[3 * k + 2], visibility: 1 });
    image.push({ x: row[99 + 2 * k], y: row[100 + 2 * k], z: 0, visibility: 1 });
  }
  const began = performance.now();
  const pose = Kalidokit.Pose.solve(world, image, { runtime: "mediapipe", enableLegs: true });
  const took = 1000 * (performance.now() - began);
  const turns = [pose.Hips.rotation, pose.Spine, ...BONES.map((name) => pose[name])];
  turns.forEach((turn, j) => made.set([turn.x, turn.y, turn.z], i * 31 + 3 * j));
  made[i * 31 + 30] = took;
}
writeFileSync(to, new Uint8Array(made.buffer));
