// Events: a time line with a lane for each kind of thing that happened, and a table of the last ones.

import { colour, make, type Page, Panel, shade, Sheet, type Span } from "./panel";
import type { Stream } from "./store";
import type { Cell, PanelInfo } from "./wire";

/** The first of these fields that an event has says what kind of thing happened. */
const KINDS = ["state", "activity", "cluster", "what", "name", "text", "rejected", "reason", "channel", "number"];
const LABEL = 118;
const [LANE, LANE_MOST] = [22, 40];
const AXIS = 26;
/** A state without an end lasts until the next one of the same sleeper or subject, unless it says that something has passed. */
const [OWNER, PASSED] = [["sleeper", "subject"], new Set(["out", "over", ""])];
const MOST_LANES = 24;
/** Shades that are not taken for an alarm. */
const CALM = [0, 2, 3, 6, 7, 4, 8, 9, 11];
const MOST_ROWS = 60;

interface Lane { stream: Stream; label: string; kind: Cell; shade: number }

const field = (stream: Stream, name: string): number => stream.info.fields.findIndex(([f]) => f === name) + 1;

/** Where the kind of an event stands in its row; 0: nowhere. */
function kindOf(stream: Stream): number {
  for (const name of KINDS) if (name !== "number" && field(stream, name)) return field(stream, name);
  return 0;
}

const lastOf = (stream: Stream): string => stream.info.name.split(".").at(-1) as string;

export class EventsPanel extends Panel {
  private readonly sheet = new Sheet(this.body, this.height);
  private readonly kinds = new Map<string, number>();

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.sheet.canvas.setAttribute("role", "img");
    this.sheet.canvas.setAttribute("aria-label", "no event yet");
  }

  draw(span: Span): void {
    const lanes = this.lanes(span);
    const tall = Math.max(LANE, Math.min(LANE_MOST, Math.floor((this.body.clientHeight - AXIS) / Math.max(1, lanes.length))));
    this.sheet.canvas.style.height = `${Math.max(60, lanes.length * tall + AXIS)}px`;
    const pen = this.sheet.clear();
    const scale = (this.sheet.width - LABEL) / (span.end - span.begin);
    const x = (t: number) => LABEL + (t - span.begin) * scale;
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "middle";
    let drawn = 0;
    lanes.forEach((lane, i) => {
      const top = 2 + i * tall;
      pen.fillStyle = colour("dim");
      pen.fillText(lane.label, 4, top + tall / 2, LABEL - 8);
      pen.fillStyle = colour("rule");
      pen.fillRect(LABEL, top + tall - 1, this.sheet.width - LABEL, 0.5);
      drawn += this.drawLane(pen, lane, top, tall, span, x);
    });
    this.axis(pen, span, x, 2 + lanes.length * tall);
    this.element.dataset["events"] = String(drawn);
    this.sheet.canvas.setAttribute("aria-label", `${drawn} events in ${lanes.length} lanes`);
  }

  private lanes(span: Span): Lane[] {
    const lanes = new Map<string, Lane>();
    for (const stream of this.streams) {
      const kind = kindOf(stream);
      for (const row of recent(stream.rows, span)) {
        const value = kind ? (row[kind] ?? null) : null;
        const own = value === null || value === "" ? "" : String(value);
        const key = `${stream.number} ${own}`;
        const word = typeof value === "number" ? `${stream.info.fields[kind - 1]?.[0]} ${own}` : own;
        const label = own === "" ? this.nameOf(stream) : this.streams.length === 1 ? word : `${lastOf(stream)} ${own}`;
        if (!lanes.has(key) && lanes.size < MOST_LANES) lanes.set(key, { stream, label, kind: value, shade: this.shadeOf(own || stream.info.name) });
      }
    }
    return [...lanes.values()].sort((a, b) => a.stream.number - b.stream.number || (a.label < b.label ? -1 : 1));
  }

  /** The last part of a stream's name, or all of it where another stream ends alike. */
  private nameOf(stream: Stream): string {
    return this.streams.some((other) => other !== stream && lastOf(other) === lastOf(stream)) ? stream.info.name : lastOf(stream);
  }

  private shadeOf(kind: string): number {
    if (!this.kinds.has(kind)) this.kinds.set(kind, this.kinds.size);
    return this.kinds.get(kind) as number;
  }

  private drawLane(pen: CanvasRenderingContext2D, lane: Lane, top: number, tall: number, span: Span, x: (t: number) => number): number {
    const [onset, end, kind, final] = [field(lane.stream, "onset"), field(lane.stream, "end"), kindOf(lane.stream), field(lane.stream, "final")];
    const owner = end || PASSED.has(String(lane.kind)) ? 0 : (OWNER.map((name) => field(lane.stream, name)).find((i) => i > 0) ?? 0);
    const rows = recent(lane.stream.rows, span);
    let drawn = 0;
    const alarm = ["state", "what", "advice"].every((name) => field(lane.stream, name));
    pen.fillStyle = pen.strokeStyle = alarm ? colour(lane.kind === "on" ? "bad" : "dim") : shade(CALM[lane.shade % CALM.length] as number);
    for (const [i, row] of rows.entries()) {
      if (kind && (row[kind] ?? null) !== lane.kind) continue;
      const from = (onset ? row[onset] : row[0]) as number;
      const next = owner ? rows.slice(i + 1).find((later) => later[owner] === row[owner]) : null;
      const to = end ? (row[end] as number) : owner ? ((next ? next[onset || 0] : span.at) as number) : from;
      if (to < span.begin || from > span.end) continue;
      const left = Math.max(x(from), LABEL);
      const wide = Math.max(2, Math.min(x(to), this.sheet.width) - left);
      const open = final > 0 && row[final] === false;
      if (open) pen.strokeRect(left + 0.5, top + 4.5, Math.max(1, wide - 1), tall - 9);
      else pen.fillRect(left, top + 4, Math.max(2, wide - (wide > 6 ? 1 : 0)), tall - 8);
      drawn++;
    }
    return drawn;
  }

  private axis(pen: CanvasRenderingContext2D, span: Span, x: (t: number) => number, top: number): void {
    pen.fillStyle = colour("dim");
    const count = Math.max(2, Math.floor((this.sheet.width - LABEL) / 110));
    for (let i = 0; i < count; i++) {
      const t = span.begin + ((i + 0.5) / count) * (span.end - span.begin);
      pen.fillText(this.page.clock(t), x(t) - 22, top + 12);
    }
  }
}

function recent(rows: Cell[][], span: Span): Cell[][] {
  let first = rows.length;
  while (first > 0 && (rows[first - 1] as Cell[])[0] as number >= span.begin - 1) first--;
  return rows.slice(Math.max(0, first - 50)).filter((row) => (row[0] as number) <= span.end + 3600);
}

/** The columns of a table: the stamp, then what happened, then from when until when, which is seldom what is looked for. */
function inOrder(stream: Stream): number[] {
  const times = ["onset", "end"].map((name) => field(stream, name)).filter((i) => i > 0);
  return [0, ...stream.info.fields.map((_, i) => i + 1).filter((i) => !times.includes(i)), ...times];
}

export class TablePanel extends Panel {
  private readonly choice = make("select", { "aria-label": "stream" });
  private readonly table = make("table");
  private shown = "";

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    for (const stream of streams) this.choice.append(make("option", { value: String(stream.number) }, stream.info.name));
    if (streams.length > 1) this.tools.append(this.choice);
    this.body.append(make("div", { class: "scroll", tabindex: "0" }, this.table));
  }

  draw(span: Span): void {
    const stream = this.streams.find((s) => String(s.number) === this.choice.value) ?? this.streams[0];
    if (!stream) return;
    const rows = (this.page.recording ? stream.rows.filter((row) => (row[0] as number) <= span.at) : stream.rows).slice(-MOST_ROWS).reverse();
    const state = `${stream.number} ${stream.count} ${rows.length}`;
    if (state === this.shown) return;
    this.shown = state;
    const heads = ["time", ...stream.info.fields.map(([name, , unit]) => (unit && unit !== "ns" ? `${name} [${unit}]` : name))];
    const order = inOrder(stream);
    const head = make("thead", {}, make("tr", {}, ...order.map((i) => make("th", { scope: "col" }, heads[i] as string))));
    const body = make("tbody", {}, ...rows.map((row) => make("tr", {}, ...order.map((i) => this.cell(stream, row[i] ?? null, i)))));
    this.table.replaceChildren(head, body);
    this.element.dataset["rows"] = String(rows.length);
  }

  private cell(stream: Stream, value: Cell, i: number): HTMLElement {
    const [name, , unit] = i ? (stream.info.fields[i - 1] as [string, string, string]) : ["time", "i", "ns"];
    if (typeof value !== "number") return make("td", {}, value === null ? "" : String(value));
    const isTime = i === 0 || (unit === "ns" && (name === "onset" || name.endsWith("end") || name.endsWith("onset")));
    const shown = isTime ? this.page.clock(value, true) : Number.isInteger(value) ? String(value) : value.toPrecision(4);
    return make("td", { class: "number" }, shown);
  }
}
