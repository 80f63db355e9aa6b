// What the page holds of each stream.

import type { Cell, EventsMessage, NewestMessage, SignalMessage, StreamInfo } from "./wire";

const MOST_EVENTS = 20_000;
const MOST_CURVES = 40;
/** Points of a signal are forgotten once they are so many seconds older than any panel shows. */
const SPARE_S = 5;

/** A signal as it is drawn: per point its time, and per channel the least and the greatest value (NaN: a gap). */
export class Signal {
  time: number[] = [];
  low: number[][];
  high: number[][];
  thin = false;
  width = 0;

  constructor(channels: number) {
    this.low = Array.from({ length: channels }, () => []);
    this.high = Array.from({ length: channels }, () => []);
  }

  add(message: SignalMessage, buffer: ArrayBuffer, at: number): void {
    const { n } = message;
    if (message.fresh || message.thin !== this.thin || message.w !== this.width) this.clear();
    this.thin = message.thin;
    this.width = message.w;
    this.time.push(...new Float64Array(buffer, at, n));
    let place = at + 8 * n;
    for (const side of message.thin ? [this.low, this.high] : [this.low]) {
      for (const channel of side) {
        channel.push(...new Float32Array(buffer, place, n));
        place += 4 * n;
      }
    }
  }

  clear(): void {
    this.time = [];
    for (const side of [this.low, this.high]) for (let c = 0; c < side.length; c++) side[c] = [];
  }

  forget(before: number): void {
    let n = 0;
    while (n < this.time.length && (this.time[n] as number) < before) n++;
    if (n < 500) return;
    this.time.splice(0, n);
    for (const side of [this.low, this.high]) for (const channel of side) channel.splice(0, n);
  }
}

export interface Newest { at: number; count: number; shape: number[]; data: Uint16Array | Float32Array; low: number[]; high: number[]; turns: Float32Array }

/** One stream: its newest samples, when they came, and how far they reach. */
export class Stream {
  signal: Signal;
  rows: Cell[][] = [];
  newest: Newest | null = null;
  curves: Newest[] = [];
  arrived = NaN;
  last = NaN;
  count = 0;
  /** For so long a panel wants to keep it, however little is shown (s). */
  keep_s = SPARE_S;

  constructor(readonly info: StreamInfo, readonly number: number) {
    this.signal = new Signal(info.kind === "signal" ? Math.max(1, info.shape[0] ?? 1) : 0);
  }

  addSignal(message: SignalMessage, buffer: ArrayBuffer, at: number, now: number): void {
    this.signal.add(message, buffer, at);
    this.note(this.signal.time.at(-1) ?? NaN, message.n, now);
  }

  addEvents(message: EventsMessage, now: number): void {
    if (message.fresh) this.rows = [];
    this.rows.push(...message.rows);
    if (this.rows.length > MOST_EVENTS) this.rows.splice(0, this.rows.length - MOST_EVENTS);
    const newest = message.rows.at(-1);
    if (newest) this.note(newest[0] as number, message.rows.length, now);
  }

  addNewest(message: NewestMessage, buffer: ArrayBuffer, at: number, now: number): void {
    const size = message.shape.reduce((a, b) => a * b, 1);
    const data = message.type === "u2" ? new Uint16Array(buffer, at, size) : new Float32Array(buffer, at, size);
    const turns = this.info.avatar ? new Float32Array(buffer, at + data.byteLength, 4 * this.info.avatar.parents.length) : new Float32Array(0);
    this.newest = { turns, at: message.at, count: message.count, shape: message.shape, data, low: message.low ?? [], high: message.high ?? [] };
    if (message.t === "curves") this.curves = [...this.curves.slice(1 - MOST_CURVES), this.newest];
    this.note(message.at, 1, now);
  }

  /** Seconds since anything came, where something should have come by now; 0 while all is well. */
  stale(now: number): number {
    const { kind, rate_hz } = this.info;
    if (kind === "events" || kind === "curves" || (kind === "signal" && !rate_hz) || Number.isNaN(this.arrived)) return 0;
    const silent = (now - this.arrived) / 1000;
    return silent > Math.max(2, rate_hz ? 4 / rate_hz : 10) ? silent : 0;
  }

  forget(before: number): void {
    this.signal.forget(before - this.keep_s);
  }

  private note(last: number, count: number, now: number): void {
    this.last = last;
    this.count += count;
    this.arrived = now;
  }
}
