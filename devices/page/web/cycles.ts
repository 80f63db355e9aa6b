// Cycles as they close: per channel the mean with its band, and the last cycle over it; the modes of its activation peaks, and target bands.

import { colour, make, type Page, Panel, shade, Sheet, type Span } from "./panel";
import type { Newest, Stream } from "./store";
import type { Cell, PanelInfo } from "./wire";

/** A cell is at least so wide; wider where names are long, but there are two in a row on a phone. */
const [CELL_WIDTH, CELL_WIDEST] = [150, 220];
const [CELL_LEAST, CELL_MOST, CELL_SHAPE] = [92, 190, 0.62];
const ROOM = 420;
const PAD = 6;
const FONT = "12px system-ui, sans-serif";
/** A channel that changes by less than this part of what the largest one does shows the noise of arithmetic, and is drawn flat. */
const NOISE = 1e-6;
const HEAD = 18;

const field = (stream: Stream, name: string): number => stream.info.fields.findIndex(([f]) => f === name) + 1;
const has = (stream: Stream, ...names: string[]): boolean => names.every((name) => field(stream, name) > 0);

/** Panels' streams: the mean, its standard deviation, the cycles themselves, the low and high end of normative bands; then events: modes, targets. */
export class CyclesPanel extends Panel {
  private readonly sheet = new Sheet(this.body, this.height);
  private drawn = -1;
  /** Modes of the peaks, and whether somebody wants to see them. */
  private readonly modes: Stream | undefined;
  private wanted = false;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.sheet.canvas.setAttribute("role", "img");
    this.sheet.canvas.setAttribute("aria-label", "nothing yet");
    this.modes = streams.find((s) => has(s, "name", "number", "place_pct", "height", "sd_pct", "sd_height", "correlation"));
    if (!this.modes) return;
    const button = make("button", { type: "button", "aria-pressed": "false" }, "modes");
    button.onclick = () => {
      this.wanted = !this.wanted;
      button.setAttribute("aria-pressed", String(this.wanted));
    };
    this.tools.append(button);
  }

  override restyle(): void {
    this.drawn = -1;
  }

  draw(span: Span): void {
    const [mean, sd, last, low, high] = this.streams.filter((s) => s.info.kind !== "events");
    const offered = this.modes;
    const targets = this.streams.find((s) => has(s, "name", "number", "from_pct", "to_pct", "low", "high", "state"));
    const closed = this.streams.find((s) => has(s, "number", "stance_pct", "rejected"));
    const modes = this.wanted ? offered : undefined;
    let [ellipses, bands, norms] = [0, 0, 0];
    const names = mean?.info.channels ?? [];
    const order = sideBySide(names);
    const until = this.page.recording ? span.at : Infinity;
    const seen = [modes, targets].map((s) => (s ? newestOf(s, until).reduce((n, row) => Math.max(n, row[0] as number), 0) : 0));
    const stance = closed ? stanceOf(closed, until) : new Map<string, number>();
    const state = this.streams.reduce((n, s) => n * 31 + s.count, Number(this.wanted) + this.body.clientWidth + seen.reduce((a, b) => a * 3 + b, 0));
    if (state === this.drawn) return;
    this.drawn = state;
    const ranges = levelled(names.map((_, c) => this.range(c, mean?.newest ?? null, sd?.newest ?? null, last?.newest ?? null)));
    const [columns, tall] = this.grid(names.length, order !== null, this.widest(names, ranges));
    this.sheet.canvas.style.height = `${Math.ceil(names.length / columns) * tall}px`;
    this.element.dataset["cell"] = String(tall);
    this.element.dataset["columns"] = String(columns);
    const pen = this.sheet.clear();
    const cell = this.sheet.width / columns;
    const scales: Range[] = [];
    (order ?? names.map((_, c) => c)).forEach((c, place) => {
      const name = names[c] as string;
      const [x, y] = [(place % columns) * cell, Math.floor(place / columns) * tall];
      const box = { left: x + PAD, top: y + HEAD, width: cell - 2 * PAD, height: tall - HEAD - PAD, least: 0, most: 1 };
      const other = order ? otherOf(name, names) : -1;
      [box.least, box.most] = scales[c] = (other < 0 ? ranges[c] : joined(ranges[c] as Range, ranges[other] as Range)) as Range;
      if (stance.size) drawStance(pen, stance.get(SIDES.find(([side]) => side.test(name))?.[1] ?? "") ?? stance.get(""), box);
      this.drawChannel(pen, c, name, box, mean?.newest ?? null, sd?.newest ?? null, last?.newest ?? null);
      if (low?.newest && high?.newest) norms += drawNorm(pen, column(low.newest, c), column(high.newest, c), box);
      if (targets) bands += drawTargets(pen, targets, newestOf(targets, until, name), box);
      if (modes) ellipses += drawModes(pen, modes, newestOf(modes, until, name), box);
    });
    this.element.dataset["scales"] = JSON.stringify(scales);
    if (high) this.element.dataset["norms"] = String(norms);
    if (offered) this.element.dataset["ellipses"] = String(ellipses);
    if (targets) this.element.dataset["targets"] = String(bands);
    this.note.textContent = last?.newest ? `${last.newest.count ? `${last.newest.count} cycles; ` : ""}line: last, band: mean ± SD${modes ? ", ellipses: modes of its peaks" : ""}${targets ? ", boxes: targets" : ""}${norms ? ", dashed: norms" : ""}; 0 to 100 % of the cycle${stance.size ? ", shaded: stance" : ""}` : "no cycle yet";
    this.stamp();
    this.element.dataset["cycles"] = String((last ?? mean)?.newest?.count ?? 0);
    this.sheet.canvas.setAttribute("aria-label", `${names.length} channels, ${this.note.textContent}`);
  }

  /** How many cells in a row, and how tall they are: as large as leaves all of them within the panel's room; in pairs, an even number. */
  private grid(cells: number, pairs: boolean, widest: number): [number, number] {
    const wide = this.body.clientWidth;
    const fit = Math.max(1, Math.min(cells, Math.floor(wide / Math.max(CELL_WIDTH, Math.min(widest, CELL_WIDEST, wide / 2)))));
    const most = pairs && fit > 1 ? fit - (fit % 2) : fit;
    const tall = (columns: number) => Math.round(Math.max(CELL_LEAST, Math.min(CELL_MOST, HEAD + (CELL_SHAPE * wide) / columns)));
    let columns = most;
    for (let fewer = most - (pairs ? 2 : 1); fewer > 0; fewer -= pairs ? 2 : 1)
      if (Math.ceil(cells / fewer) * tall(fewer) <= ROOM * (this.info.tall ?? 1)) columns = fewer;
    return [columns, tall(columns)];
  }

  /** How wide a cell must be for a name and its scale beside each other. */
  private widest(names: string[], ranges: Range[]): number {
    const pen = this.sheet.context;
    pen.font = FONT;
    return 4 * PAD + Math.max(0, ...names.map((name, c) => pen.measureText(name).width + pen.measureText(this.scale(ranges[c] as Range)).width));
  }

  private scale([least, most]: Range): string {
    const unit = this.streams[0]?.info.units[0] ?? "";
    return `${least < 0 ? `${rounded(least)} to ` : ""}${rounded(most)}${unit.startsWith("°") ? "" : " "}${unit}`;
  }

  /** From where to where a channel's curves reach; from 0, unless they go below it as an angle or a moment does. */
  private range(c: number, mean: Newest | null, sd: Newest | null, last: Newest | null): Range {
    const [middle, band, newest] = [mean, sd, last].map((n) => (n ? column(n, c) : []));
    const known = (values: number[]) => values.filter((v) => v === v);
    const tops = known([...(middle ?? []).map((m, i) => m + (band?.[i] ?? 0)), ...(newest ?? [])]);
    const most = this.info.most ?? Math.max(0, ...tops);
    const least = Math.min(0, ...known([...(middle ?? []), ...(newest ?? [])]));
    return [least < -0.05 * Math.max(most, 0) ? Math.min(least, ...known((middle ?? []).map((m, i) => m - (band?.[i] ?? 0)))) : 0, most];
  }

  private drawChannel(pen: CanvasRenderingContext2D, c: number, name: string, box: Box, mean: Newest | null, sd: Newest | null, last: Newest | null): void {
    const { left, width, height, least, most } = box;
    const top = box.top - HEAD;
    const [middle, band, newest] = [mean && column(mean, c), sd && column(sd, c), last && column(last, c)];
    const y = (v: number) => Math.max(box.top, Math.min(box.top + height, level(v, box)));
    const x = (i: number, n: number) => left + (width * i) / Math.max(1, n - 1);
    pen.font = FONT;
    const scale = this.scale([least, most]);
    pen.fillStyle = colour("ink");
    pen.fillText(cut(pen, name, width - pen.measureText(scale).width - PAD), left, top + 12);
    pen.fillStyle = colour("dim");
    pen.textAlign = "right";
    pen.fillText(scale, left + width, top + 12);
    pen.textAlign = "left";
    pen.strokeStyle = colour("rule");
    pen.strokeRect(left + 0.5, box.top + 0.5, width, height);
    if (least < 0) pen.strokeRect(left + 0.5, y(0), width, 0);
    if (middle && band) {
      pen.beginPath();
      middle.forEach((m, i) => pen.lineTo(x(i, middle.length), y(m + (band[i] ?? 0))));
      for (let i = middle.length - 1; i >= 0; i--) pen.lineTo(x(i, middle.length), y((middle[i] as number) - (band[i] ?? 0)));
      pen.fillStyle = colour("rule");
      pen.fill();
    }
    this.line(pen, middle ?? null, x, y, colour("dim"), 1);
    this.line(pen, newest ?? null, x, y, shade(c), 1.8);
  }

  private line(
    pen: CanvasRenderingContext2D, values: number[] | null, x: (i: number, n: number) => number, y: (v: number) => number, stroke: string, wide: number
  ): void {
    if (!values) return;
    pen.beginPath();
    let down = false;
    values.forEach((v, i) => {
      if (v !== v) down = false;
      else if (down) pen.lineTo(x(i, values.length), y(v));
      else {
        pen.moveTo(x(i, values.length), y(v));
        down = true;
      }
    });
    pen.strokeStyle = stroke;
    pen.lineWidth = wide;
    pen.stroke();
    pen.lineWidth = 1;
  }
}

/** How names of left and of right channels begin: "L_TA", "left TA", "LHip.flexion". */
const SIDES: [RegExp, string, string][] = [[/^(L(?=[ _A-Z])|left(?=[ _]))/, "left", "R"], [/^(R(?=[ _A-Z])|right(?=[ _]))/, "right", "L"]];

/** The number of the channel of the other side; -1 where there is no such channel. */
function otherOf(name: string, names: string[]): number {
  const [side, , letter] = SIDES.find(([begins]) => begins.test(name)) ?? [];
  return side ? names.indexOf(name.replace(side, (begin) => (begin.length === 1 ? (letter as string) : begin === "left" ? "right" : "left"))) : -1;
}

/** Each left channel with its right one behind it, by their numbers, then those of no side; null where no channel has another one. */
function sideBySide(names: string[]): number[] | null {
  const pairs = names.flatMap((name, c) => (SIDES[0]?.[0].test(name) && otherOf(name, names) >= 0 ? [c, otherOf(name, names)] : []));
  return pairs.length ? [...pairs, ...names.map((_, c) => c).filter((c) => !pairs.includes(c))] : null;
}

const rounded = (value: number): string => String(Number(value.toPrecision(2))).replace("-", "\u2212");

/** A text, cut so that it is at most so wide. */
function cut(pen: CanvasRenderingContext2D, text: string, wide: number): string {
  let shown = text;
  while (shown.length > 1 && pen.measureText(shown).width > wide) shown = `${shown.replace(/…$/, "").slice(0, -1)}…`;
  return shown;
}

const column = (newest: Newest, c: number): number[] => {
  const [points, channels] = newest.shape as [number, number];
  return Array.from({ length: points }, (_, i) => newest.data[i * channels + c] as number);
};

type Range = [number, number];

interface Box { left: number; top: number; width: number; height: number; least: number; most: number }

const level = (v: number, box: Box): number => box.top + box.height * (1 - (v - box.least) / (box.most - box.least));

/** The range of a left channel and its right one together, so that they can be compared. */
const joined = (one: Range, other: Range): Range => [Math.min(one[0], other[0]), Math.max(one[1], other[1])];

/** The ranges, from 0 to 1 where a channel shows nothing but noise. */
function levelled(ranges: Range[]): Range[] {
  const largest = Math.max(0, ...ranges.map(([least, most]) => Math.max(most, -least)));
  return ranges.map(([least, most]) => (Math.max(most, -least) <= NOISE * largest ? [0, 1] : [least, most]));
}

/** Of the latest accepted cycle, how much is stance (%), by limb; "" where limbs are not separated. */
function stanceOf(stream: Stream, until: number): Map<string, number> {
  const [place, limb, rejected] = ["stance_pct", "limb", "rejected"].map((name) => field(stream, name)) as [number, number, number];
  const found = new Map<string, number>();
  for (let i = stream.rows.length - 1; i >= 0 && found.size < 2; i--) {
    const row = stream.rows[i] as Cell[];
    const who = limb ? String(row[limb]) : "";
    if ((row[0] as number) > until || row[rejected] || found.has(who) || typeof row[place] !== "number") continue;
    found.set(who, row[place] as number);
    if (!limb) break;
  }
  return found;
}

/** The share of the cycle in which the foot is on the ground, and its end in numbers. */
function drawStance(pen: CanvasRenderingContext2D, pct: number | undefined, box: Box): void {
  if (pct === undefined || pct !== pct) return;
  const wide = (box.width * pct) / 100;
  pen.fillStyle = colour("back");
  pen.fillRect(box.left, box.top, wide, box.height);
  pen.fillStyle = colour("dim");
  pen.font = "10px system-ui, sans-serif";
  pen.fillText(`${pct.toFixed(0)} %`, box.left + wide + 3, box.top + 11);
}

/** The rows of a channel's latest cycle, until a time; without a channel, of each. A joint mixture ("GM+GL") is each of its channels'. */
function newestOf(stream: Stream, until: number, channel = ""): Cell[][] {
  const [name, number] = [field(stream, "name"), field(stream, "number")];
  const mine = (row: Cell[]) => !channel || String(row[name]) === channel.slice(0, 16) || String(row[name]).split("+").includes(channel);
  const rows: Cell[][] = [];
  for (let i = stream.rows.length - 1; i >= 0; i--) {
    const row = stream.rows[i] as Cell[];
    if ((row[0] as number) > until || !mine(row)) continue;
    if (rows.length && (row[number] !== rows[0]?.[number] || row[name] !== rows[0]?.[name])) break;
    rows.push(row);
  }
  return rows;
}

/** Ellipses of two standard deviations; one that reaches over the touch-down goes on at the other end. */
function drawModes(pen: CanvasRenderingContext2D, stream: Stream, rows: Cell[][], box: Box): number {
  const of = (row: Cell[], name: string) => row[field(stream, name)] as number;
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top, box.width, box.height);
  pen.clip();
  pen.strokeStyle = colour("ink");
  pen.globalAlpha = 0.75;
  for (const row of rows) {
    const [along, up, rho] = [2 * of(row, "sd_pct"), 2 * of(row, "sd_height"), of(row, "correlation")];
    for (const turn of [-100, 0, 100]) {
      pen.beginPath();
      for (let k = 0; k <= 48; k++) {
        const [a, b] = [Math.cos((k * Math.PI) / 24), Math.sin((k * Math.PI) / 24)];
        const place = of(row, "place_pct") + turn + along * a;
        const height = of(row, "height") + up * (rho * a + Math.sqrt(Math.max(0, 1 - rho * rho)) * b);
        pen.lineTo(box.left + (box.width * place) / 99, level(height, box));
      }
      pen.stroke();
    }
  }
  pen.restore();
  return rows.length;
}

/** The two ends of a laboratory's band, dashed; 1 where the channel has one. */
function drawNorm(pen: CanvasRenderingContext2D, low: number[], high: number[], box: Box): number {
  if (low.some((v) => v !== v)) return 0;
  pen.save();
  pen.setLineDash([4, 3]);
  pen.strokeStyle = "#12924a";
  for (const edge of [low, high]) {
    pen.beginPath();
    edge.forEach((v, i) => pen.lineTo(box.left + (box.width * i) / Math.max(1, edge.length - 1), Math.max(box.top, Math.min(box.top + box.height, level(v, box)))));
    pen.stroke();
  }
  pen.restore();
  return 1;
}

/** The band that each target asks for, over its phase: green where the last cycle was within, else red; one over the touch-down is two boxes. */
function drawTargets(pen: CanvasRenderingContext2D, stream: Stream, rows: Cell[][], box: Box): number {
  const of = (row: Cell[], name: string) => row[field(stream, name)] as number;
  pen.save();
  pen.beginPath();
  pen.rect(box.left, box.top, box.width, box.height);
  pen.clip();
  pen.lineWidth = 1.6;
  for (const row of rows) {
    const [from, to] = [of(row, "from_pct"), of(row, "to_pct")];
    const y = (v: number) => level(v, box);
    pen.strokeStyle = String(row[field(stream, "state")]) === "within" ? "#12924a" : "#d6202e";
    for (const [a, b] of from <= to ? [[from, to]] : [[from, 100], [0, to]])
      pen.strokeRect(box.left + (box.width * (a as number)) / 100, y(of(row, "high")), (box.width * ((b as number) - (a as number))) / 100, y(of(row, "low")) - y(of(row, "high")));
  }
  pen.restore();
  return rows.length;
}
