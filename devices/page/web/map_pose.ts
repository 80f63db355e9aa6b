// Poses as glyphs: lines between markers, chosen markers in their colours, turned about the vertical and tipped towards the viewer.

import { colour, shade } from "./panel";

/** How poses are seen: turned and tipped (rad). */
export interface Eye { turn: number; tip: number }
export interface Body { markers: string[]; bones: [number, number][]; chosen: Set<number> }
interface Box { x: number; y: number; width: number; height: number }

/** Where a marker of a pose lies on the picture, in its unit; NaN where it is not known. */
export function project(poses: Float32Array, at: number, eye: Eye): [number, number] {
  const [x, y, z] = [poses[at] as number, poses[at + 1] as number, poses[at + 2] as number];
  const ahead = x * Math.cos(eye.turn) + z * Math.sin(eye.turn);
  const towards = z * Math.cos(eye.turn) - x * Math.sin(eye.turn);
  return [-ahead, -(y * Math.cos(eye.tip) - towards * Math.sin(eye.tip))];
}

/** How far poses reach from the origin, and where their middle is, so that all glyphs have one scale. */
export function extent(poses: Float32Array, eye: Eye): { x: number; y: number; size: number } {
  let [left, right, top, bottom] = [Infinity, -Infinity, Infinity, -Infinity];
  for (let at = 0; at < poses.length; at += 3) {
    const [x, y] = project(poses, at, eye);
    if (!(Math.abs(x) + Math.abs(y) < Infinity)) continue;
    [left, right, top, bottom] = [Math.min(left, x), Math.max(right, x), Math.min(top, y), Math.max(bottom, y)];
  }
  return left <= right ? { x: (left + right) / 2, y: (top + bottom) / 2, size: Math.max(right - left, bottom - top, 1e-6) } : { x: 0, y: 0, size: 1 };
}

/** Draw pose number `k` of many into a box. */
export function drawPose(
  pen: CanvasRenderingContext2D, poses: Float32Array, k: number, body: Body, eye: Eye, box: Box, view: { x: number; y: number; size: number },
  line: string, dots: number,
): void {
  const many = body.markers.length, scale = (0.86 * Math.min(box.width, box.height)) / view.size;
  const place = (m: number): [number, number] => {
    const [x, y] = project(poses, 3 * (k * many + m), eye);
    return [box.x + box.width / 2 + scale * (x - view.x), box.y + box.height / 2 + scale * (y - view.y)];
  };
  pen.strokeStyle = line;
  pen.beginPath();
  for (const [a, b] of body.bones) {
    const [from, to] = [place(a), place(b)];
    if (Number.isNaN(from[0] + to[0])) continue;
    pen.moveTo(...from);
    pen.lineTo(...to);
  }
  pen.stroke();
  for (let m = 0; m < many; m++) {
    const chosen = body.chosen.has(m);
    if (!dots || (!chosen && body.bones.length && dots < 3)) continue;
    const [x, y] = place(m);
    if (Number.isNaN(x)) continue;
    pen.fillStyle = chosen ? shade(m) : colour("dim");
    pen.beginPath();
    pen.arc(x, y, chosen ? dots : dots / 2, 0, 7);
    pen.fill();
  }
}
