// The time line of a recording: all its streams, their gaps, the annotations, and the cursor that moves all panels.

import { colour, make, type Page, Sheet, type Span } from "./panel";
import type { Stream } from "./store";
import type { Hello, PaceMessage } from "./wire";

const LABEL = 118;
const LANE = 13;
const HEAD = 16;
const STEP = 0.1;
/** How far apart labels of the axis may stand (s), and at least how far that is on the screen (px). */
const STEPS_S = [1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400, 21600, 43200, 86400];
const APART = 84;
/** What the cursor's own label takes to its right, in pixels. */
const CURSOR = 90;
/** Streams that hold what people marked: while the session ran, and afterwards. */
export const MARKS = new Set(["annotations", "marks"]);

interface Lane { name: string; number: number; span: [number, number, number] }

export class Timeline {
  private readonly sheet: Sheet;
  private readonly gaps = new Map<number, [number, number][]>();
  private readonly events = new Map<number, number[]>();
  private readonly lanes: Lane[];
  private readonly length: number;
  private dragging = false;

  constructor(private readonly host: HTMLElement, hello: Hello, private readonly streams: Stream[], private readonly page: Page) {
    this.length = Math.max(hello.length_s ?? 0, 1e-9);
    const spans = hello.spans ?? [];
    this.lanes = hello.streams.map((s, number) => ({ name: s.name, number, span: spans[number] ?? [0, this.length, 0] as [number, number, number] }))
      .filter(({ name }) => name !== "marks");
    (hello.gaps ?? []).forEach((gaps, s) => this.take(s, gaps));
    (hello.moments ?? []).forEach((at, s) => { if (at) this.takeEvents(s, at); });
    host.replaceChildren();
    host.hidden = false;
    this.sheet = new Sheet(host, this.lanes.length * LANE + HEAD);
    const canvas = this.sheet.canvas;
    for (const [name, value] of Object.entries({ role: "slider", tabindex: "0", "aria-label": "time", "aria-valuemin": "0", "aria-valuemax": String(this.length) })) canvas.setAttribute(name, value);
    canvas.onpointerdown = (event) => { this.dragging = true; canvas.setPointerCapture(event.pointerId); this.move(event); };
    canvas.onpointermove = (event) => { if (this.dragging) this.move(event); };
    canvas.onpointerup = () => { this.dragging = false; };
  }

  take(stream: number, gaps: [number, number][]): void {
    this.gaps.set(stream, gaps);
    this.host.dataset["gaps"] = String([...this.gaps.values()].reduce((n, g) => n + g.length, 0));
  }

  /** The moments of a stream's events. */
  takeEvents(stream: number, at: number[]): void {
    this.events.set(stream, at);
    this.host.dataset["events"] = String([...this.events.values()].reduce((n, e) => n + e.length, 0));
  }

  /** Times at which something is missing, of any stream, as few as there are: what was lost of a signal is missing from what is made of it. */
  get missing(): [number, number][] {
    const joined: [number, number][] = [];
    for (const [from, to] of [...this.gaps.values()].flat().sort(([a], [b]) => a - b)) {
      const last = joined.at(-1);
      if (last && from <= last[1]) last[1] = Math.max(last[1], to);
      else joined.push([from, to]);
    }
    return joined;
  }

  /** The next gap behind a moment, of any stream; the first one where no other follows. */
  nextGap(at: number): number | null {
    const all = this.missing.map(([from]) => from);
    return all.find((t) => t > at + 1e-6) ?? all[0] ?? null;
  }

  /** Where a key leads. */
  key(key: string, span: Span): number | null {
    const step = (span.end - span.begin) * STEP;
    const steps: Record<string, number> = { ArrowLeft: span.at - step, ArrowRight: span.at + step, Home: 0, End: this.length };
    return key === "g" ? this.nextGap(span.at) : (steps[key] ?? null);
  }

  draw(span: Span): void {
    const pen = this.sheet.clear();
    const scale = (this.sheet.width - LABEL - 8) / this.length;
    const x = (t: number) => LABEL + t * scale;
    pen.font = "11px system-ui, sans-serif";
    pen.textBaseline = "middle";
    pen.fillStyle = colour("rule");
    pen.fillRect(x(Math.max(0, span.begin)), 0, Math.max(2, (Math.min(this.length, span.end) - Math.max(0, span.begin)) * scale), this.sheet.height);
    this.axis(pen, x, x(span.at));
    this.lanes.forEach((lane, i) => this.lane(pen, lane, HEAD + i * LANE, x));
    const marks = this.streams.filter((s) => MARKS.has(s.info.name)).flatMap((s) => s.rows);
    this.host.dataset["marks"] = String(marks.length);
    pen.fillStyle = colour("warn");
    for (const row of marks) pen.fillRect(x((row[1] ?? row[0]) as number) - 1, HEAD, 2, this.sheet.height);
    pen.fillStyle = colour("ink");
    pen.fillRect(x(span.at) - 1, 0, 2, this.sheet.height);
    pen.fillText(this.page.clock(span.at, true), Math.min(x(span.at) + 4, this.sheet.width - CURSOR), HEAD / 2);
    this.sheet.canvas.setAttribute("aria-valuenow", span.at.toFixed(3));
    this.sheet.canvas.setAttribute("aria-valuetext", this.page.clock(span.at, true));
  }

  /** Whole times of day, where the cursor's own does not stand. */
  private axis(pen: CanvasRenderingContext2D, x: (t: number) => number, cursor: number): void {
    const scale = x(1) - x(0);
    const step = STEPS_S.find((s) => s * scale >= APART) ?? 86400 * Math.ceil(APART / (86400 * scale));
    const begin = this.page.t0_ms / 1000;
    pen.fillStyle = colour("dim");
    for (let t = Math.ceil(begin / step) * step - begin; t <= this.length; t += step) {
      pen.fillRect(x(t), HEAD - 4, 1, 4);
      const left = Math.max(LABEL, Math.min(x(t) - 22, this.sheet.width - 52));
      if (left + 52 < cursor - 2 || left > Math.min(cursor + 4, this.sheet.width - CURSOR) + CURSOR) pen.fillText(this.page.clock(t), left, HEAD / 2);
    }
  }

  /** A stream: from when until when there is anything of it, its gaps, and, of events, each. */
  private lane(pen: CanvasRenderingContext2D, { name, number, span: [from, to] }: Lane, y: number, x: (t: number) => number): void {
    const events = this.events.get(number);
    pen.fillStyle = colour("dim");
    pen.fillText(name, 2, y + LANE / 2, LABEL - 8);
    pen.globalAlpha = events ? 0.15 : 0.55;
    pen.fillStyle = colour("accent");
    pen.fillRect(x(from), y + 3, Math.max(1, x(to) - x(from)), LANE - 6);
    pen.globalAlpha = 1;
    for (const at of events ?? []) pen.fillRect(x(at), y + 2, 1, LANE - 4);
    pen.fillStyle = colour("bad");
    for (const [begin, end] of this.gaps.get(number) ?? []) pen.fillRect(x(begin), y + 1, Math.max(2, x(end) - x(begin)), LANE - 2);
  }

  private move(event: PointerEvent): void {
    const box = this.sheet.canvas.getBoundingClientRect();
    const share = (event.clientX - box.x - LABEL) / (box.width - LABEL - 8);
    this.page.seek(Math.max(0, Math.min(1, share)) * this.length);
  }
}

/** Playing a recording: the button, and how fast. */
export class Player {
  readonly button = make("button", { type: "button", "aria-pressed": "false", title: "space" }, "play");
  readonly speed = make("select", { "aria-label": "speed" }, ...["0.1", "0.5", "1", "2", "10", "60"].map((s) => make("option", { value: s }, `${s} ×`)));
  private playing = false;

  constructor() {
    this.speed.value = "1";
    this.button.onclick = () => this.toggle();
  }

  toggle(): void {
    this.playing = !this.playing;
    this.button.setAttribute("aria-pressed", String(this.playing));
  }

  /** How far the cursor goes in so many seconds. */
  step(seconds: number): number {
    return this.playing ? seconds * Number(this.speed.value) : 0;
  }
}

/** Steering a replay: how fast, a step, and a slider over its whole length. */
export class Replayer {
  readonly button = make("button", { type: "button", "aria-pressed": "false", title: "space" }, "pause");
  readonly step = make("button", { type: "button", title: "arrow to the right" }, "step");
  readonly speed = make("select", { "aria-label": "speed" }, ...["0.1", "0.5", "1", "2", "10", "100"].map((s) => make("option", { value: s }, `${s} ×`)));
  readonly slider = make("input", { type: "range", min: "0", max: "1", step: "any", value: "0", "aria-label": "moment of the replay" });
  private readonly shown = make("output");
  readonly whole = make("span", { class: "replay" }, this.slider, this.shown);
  private pace: PaceMessage = { t: "pace", at: 0, length: 0, speed: 1 };
  private sliding = false;

  constructor(private readonly ask: (what: object) => void) {
    this.speed.value = "1";
    this.button.onclick = () => this.toggle();
    this.step.onclick = () => this.ask({ do: "step", seconds: STEP });
    this.speed.onchange = () => this.ask({ do: "pace", speed: Number(this.speed.value) });
    this.slider.oninput = () => { this.sliding = true; };
    this.slider.onchange = () => {
      this.sliding = false;
      this.ask({ do: "seek", to: Number(this.slider.value) });
    };
  }

  take(pace: PaceMessage): void {
    this.pace = pace;
    this.button.setAttribute("aria-pressed", String(pace.speed === 0));
    this.slider.max = String(pace.length);
    if (!this.sliding) this.slider.value = String(pace.at);
    this.shown.textContent = `${pace.at.toFixed(1)} of ${pace.length.toFixed(1)} s`;
    if (pace.speed && [...this.speed.options].some((o) => Number(o.value) === pace.speed)) this.speed.value = String(pace.speed);
    document.body.dataset["replayed"] = String(pace.at);
    document.body.dataset["pace"] = String(pace.speed);
  }

  /** Whether the replay stands still: what is shown then is where it stands. */
  get stands(): boolean {
    return this.pace.speed === 0;
  }

  toggle(): void {
    this.ask({ do: "pace", speed: this.stands ? Number(this.speed.value) : 0 });
  }

  /** What a key asks for; whether it was one of ours. */
  key(key: string): boolean {
    const { at, length } = this.pace;
    if (key === " ") this.toggle();
    else if (key === "ArrowRight") this.ask({ do: "step", seconds: STEP });
    else if (key === "ArrowLeft") this.ask({ do: "seek", to: Math.max(0, at - 10 * STEP) });
    else if (key === "Home") this.ask({ do: "seek", to: 0 });
    else if (key === "End") this.ask({ do: "seek", to: length });
    else return false;
    return true;
  }
}
