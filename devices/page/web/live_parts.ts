// What an avatar shows beside its bones' pose: fingers that bend, and a face that moves (stream/domain/fingers.py, operators/body/camera/face.py).

import type { VRM, VRMHumanBoneName } from "@pixiv/three-vrm";
import { Quaternion, Vector3 } from "three";

import type { Stream } from "./store";

const FINGERS = ["Thumb", "Index", "Middle", "Ring", "Little"] as const;
const JOINTS = ["Proximal", "Intermediate", "Distal"] as const;
/** VRM 1.0 names the thumb's bones by the hand's anatomy, one joint further in. */
const THUMB = ["Metacarpal", "Proximal", "Distal"] as const;
/** By how much each finger's spread turns it away from the middle one, towards the thumb. */
const AWAY = [1, 1, 0, -1, -1];
const [X, Y, Z] = [new Vector3(1, 0, 0), new Vector3(0, 1, 0), new Vector3(0, 0, 1)];
/** Expressions of VRM 1.0 by the names of VRM 0 and VMC. */
const SHOWN: Record<string, string> = { Blink_L: "blinkLeft", Blink_R: "blinkRight", A: "aa", I: "ih", U: "ou", E: "ee", O: "oh" };

/** The value of each channel at a time (s): a recording's page holds later ones, too. */
function valuesAt({ signal }: Stream, at: number): number[] {
  let last = signal.time.length - 1;
  while (last >= 0 && (signal.time[last] as number) > at + 1e-6) last--;
  return signal.low.map((values) => values[last] ?? NaN);
}

export const isFingers = ({ info }: Stream): boolean => info.kind === "signal" && info.channels[0] === "LeftThumb.bend";
export const isFace = ({ info }: Stream): boolean => info.kind === "signal" && info.channels.includes("Blink_L");

const about = (axis: Vector3, degrees: number): Quaternion => new Quaternion().setFromAxisAngle(axis, (degrees * Math.PI) / 180);

/** Turn the fingers' bones; `old`: the avatar faces the other way, as those of VRM 0.x do. */
export function bendFingers(vrm: VRM, stream: Stream, at: number, old: boolean): void {
  const bends = valuesAt(stream, at);
  if (bends.length !== 40 || !bends.every(Number.isFinite)) return;
  (["left", "right"] as const).forEach((hand, h) => {
    const side = h ? -1 : 1;
    FINGERS.forEach((finger, f) => {
      const [bend, spread, second, third] = bends.slice(20 * h + 4 * f, 20 * h + 4 * f + 4) as [number, number, number, number];
      const aside = about(Y, -side * (AWAY[f] as number) * spread);
      const turns = f
        ? [aside.multiply(about(Z, -side * bend)), about(Z, -side * second), about(Z, -side * third)]
        : [aside.multiply(about(X, bend)), about(Y, side * second), about(Y, side * third)];
      turns.forEach((q, j) => {
        const node = vrm.humanoid.getNormalizedBoneNode(`${hand}${finger}${(f ? JOINTS : THUMB)[j] as string}` as VRMHumanBoneName);
        if (old) q.set(-q.x, q.y, -q.z, q.w);
        node?.quaternion.copy(q);
      });
    });
  });
}

/** Set the weights of the avatar's expressions: its own of that name, or VRM's preset. */
export function moveFace(vrm: VRM, stream: Stream, at: number): void {
  const weights = valuesAt(stream, at);
  stream.info.channels.forEach((name, k) => {
    const weight = weights[k] as number;
    if (!Number.isFinite(weight)) return;
    const shown = SHOWN[name] ?? name;
    if (vrm.expressionManager?.getExpression(shown)) vrm.expressionManager.setValue(shown, weight);
  });
}
