// What the server of a map of motion tells, as arrays: see docs/method/motion-map.md.

export interface SequenceInfo {
  name: string; first: number; last: number; start_s: number; rate_hz: number;
  facts: Record<string, string>; missing: string[]; variation: (number | null)[];
}
export interface MapHello {
  t: "hello"; mode: "map"; name: string; markers: string[]; bones: [number, number][]; used: number[]; unit: string; rate_hz: number;
  poses: number; step: number; columns: number; rows: number; explained: number[]; quantisation: number; topographic: number;
  placeless: number; sequences: SequenceInfo[];
}
export interface NearMessage { t: "near"; first: number; last: number; ms: number; found: [number, number, number, number][] }
export type MapMessage =
  | MapHello | NearMessage
  | { t: "points"; n: number; bins: number; low: [number, number]; high: [number, number] }
  | { t: "cells"; cells: number; sequences: number; bundle: number }
  | { t: "frames"; ask: number; numbers: number[]; cell: number[] }
  | { t: "curve"; s: number; n: number }
  | { t: "search"; state: "ready" | "failed" };

/** The poses that are drawn. */
export interface PointSet {
  n: number; frames: Int32Array; pca: Float32Array; som: Float32Array; rank: Uint16Array;
  bins: number; density: Float32Array; low: [number, number]; high: [number, number];
}
export interface CellSet { held: Uint32Array; spread: Float32Array; mean: Float32Array; bundle: Float32Array; many: number; sequences: number }
/** Poses that were asked for: their markers, one after the other, and where they lie. */
export interface PoseSet { numbers: number[]; poses: Float32Array; pca: Float32Array; som: Float32Array; rank: Uint16Array; cell: number[] }
export interface Curve { frames: Int32Array; poses: Float32Array; rank: Uint16Array }

/** Arrays, one after the other, out of the numbers behind a header. */
export class Taker {
  constructor(private readonly buffer: ArrayBuffer, private at: number) {}
  f4(n: number): Float32Array { this.at += 4 * n; return new Float32Array(this.buffer, this.at - 4 * n, n); }
  i4(n: number): Int32Array { this.at += 4 * n; return new Int32Array(this.buffer, this.at - 4 * n, n); }
  u4(n: number): Uint32Array { this.at += 4 * n; return new Uint32Array(this.buffer, this.at - 4 * n, n); }
  u2(n: number): Uint16Array { this.at += 2 * n; return new Uint16Array(this.buffer, this.at - 2 * n, n); }
}
