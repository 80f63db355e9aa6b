// A night as it grows: its states over time, final ones as a solid line, those that may still be rescored as outlines.

import { colour, type Page, Panel, Sheet, type Span } from "./panel";
import type { Stream } from "./store";
import type { Cell, PanelInfo } from "./wire";

const LEFT = 74;
const FOOT = 22;
const LEAST_S = 600;
/** Waking at the top, as sleep laboratories draw it; states without a place here follow. */
const ORDER = ["unknown", "away", "out", "awake", "wake", "W", "REM", "R", "N1", "light", "N2", "asleep", "sleep", "deep", "N3"];

interface Epoch { onset: number; end: number; state: string; final: boolean }

export class HypnogramPanel extends Panel {
  private readonly sheet = new Sheet(this.body, this.height);
  private epochs: Epoch[] = [];
  private known = -1;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.sheet.canvas.setAttribute("role", "img");
    this.sheet.canvas.setAttribute("aria-label", "nothing yet");
  }

  draw(span: Span): void {
    this.read();
    const pen = this.sheet.clear();
    const shown = this.page.recording ? this.epochs.filter((e) => e.end > span.begin && e.onset < span.end) : this.epochs;
    const states = [...new Set(shown.map((e) => e.state))].sort((a, b) => place(a) - place(b) || (a < b ? -1 : 1));
    const [begin, end] = this.page.recording ? [span.begin, span.end] : [shown[0]?.onset ?? 0, Math.max(shown.at(-1)?.end ?? 0, (shown[0]?.onset ?? 0) + LEAST_S)];
    const row = (this.sheet.height - FOOT) / Math.max(1, states.length);
    const x = (t: number) => LEFT + ((this.sheet.width - LEFT - 8) * (Math.max(begin, Math.min(end, t)) - begin)) / (end - begin || 1);
    const y = (state: string) => row * (states.indexOf(state) + 0.5);
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "middle";
    for (const state of states) {
      pen.fillStyle = colour("dim");
      pen.fillText(state, 4, y(state), LEFT - 8);
      pen.fillStyle = colour("rule");
      pen.fillRect(LEFT, y(state), this.sheet.width - LEFT - 8, 0.5);
    }
    shown.forEach((epoch, i) => this.epoch(pen, epoch, shown[i - 1], x, y));
    pen.fillStyle = colour("dim");
    for (const share of [0, 0.25, 0.5, 0.75]) pen.fillText(this.page.clock(begin + share * (end - begin)), LEFT + share * (this.sheet.width - LEFT - 8), this.sheet.height - 9);
    this.tell(shown);
  }

  private epoch(pen: CanvasRenderingContext2D, { onset, end, state, final }: Epoch, before: Epoch | undefined, x: (t: number) => number, y: (s: string) => number): void {
    const [left, wide, at] = [x(onset), Math.max(1, x(end) - x(onset)), y(state)];
    pen.fillStyle = pen.strokeStyle = final ? colour("accent") : colour("warn");
    if (final) pen.fillRect(left, at - 2, wide, 4);
    else pen.strokeRect(left + 0.5, at - 5.5, wide, 11);
    if (before && before.state !== state && onset - before.end < 1) pen.fillRect(left, Math.min(at, y(before.state)), 1, Math.abs(at - y(before.state)));
  }

  /** The newest word on every epoch; a final one is not taken back. */
  private read(): void {
    const [stream] = this.streams;
    if (!stream || stream.count === this.known) return;
    this.known = stream.count;
    const column = (name: string) => stream.info.fields.findIndex(([field]) => field === name) + 1;
    const [onset, end, state, final] = [column("onset"), column("end"), column("state"), column("final")];
    const found = new Map<number, Epoch>();
    for (const cells of stream.rows) {
      const epoch = { onset: number(cells[onset]), end: number(cells[end]), state: String(cells[state] ?? ""), final: !final || cells[final] === true };
      if (epoch.final || !found.get(epoch.onset)?.final) found.set(epoch.onset, epoch);
    }
    this.epochs = [...found.values()].sort((a, b) => a.onset - b.onset);
  }

  private tell(shown: Epoch[]): void {
    const final = shown.filter((e) => e.final);
    const until = final.at(-1)?.end;
    this.note.textContent = until === undefined ? "nothing is final yet" : `final until ${this.page.clock(until)}; outlined: provisional`;
    this.element.dataset["final"] = String(final.length);
    this.element.dataset["provisional"] = String(shown.length - final.length);
    this.sheet.canvas.setAttribute("aria-label", `${final.length} final and ${shown.length - final.length} provisional epochs`);
  }
}

const number = (cell: Cell | undefined): number => (typeof cell === "number" ? cell : NaN);
const place = (state: string): number => (ORDER.includes(state) ? ORDER.indexOf(state) : ORDER.length);
