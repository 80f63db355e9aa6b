// The answer of a use, in large type: the newest of what its graph says is worth showing, and the alarms that there are now.

import { make, type Page, Panel, type Span } from "./panel";
import type { Stream } from "./store";
import type { Cell, PanelInfo, ShownInfo } from "./wire";

const ALARM = ["subject", "state", "what", "advice"];
const NOTHING = "–";
/** A signal's newest value is the mean of so much of it (s): a number that changes 60 times a second cannot be read. */
const STEADY_S = 0.25;

const field = (stream: Stream, name: string): number => stream.info.fields.findIndex(([f]) => f === name) + 1;
const isAlarm = (stream: Stream): boolean => ALARM.every((name) => field(stream, name) > 0);

export class AnswerPanel extends Panel {
  private readonly tiles: { item: ShownInfo; box: HTMLElement; value: HTMLElement; unit: HTMLElement; since: HTMLElement }[];
  private readonly alarms = make("ul", { class: "alarms", role: "alert" });
  private readonly verdict = make("p", { class: "verdict", hidden: "" });
  private shown = "";

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super({ ...info, title: info.title || "answer" }, streams, page);
    this.tiles = (info.show ?? []).map((item) => ({ item, box: make("div"), value: make("strong"), unit: make("span", { class: "unit" }), since: make("small") }));
    const tiles = this.tiles.map(({ item, box, value, unit, since }, i) => {
      const label = make("span", { class: "label" }, item.label ?? "");
      box.className = i ? "tile" : "tile first";
      box.append(make("p", {}, value, unit), label, since);
      return box;
    });
    this.body.append(make("div", { class: "tiles" }, ...tiles, this.verdict), this.alarms);
  }

  protected override get waits(): boolean {
    return false;
  }

  override widths(_span_s: number, _pixels: number): Map<number, number> {
    return new Map(this.streams.map((s) => [s.number, s.info.kind === "signal" && (s.info.rate_hz ?? 0) > 4 / STEADY_S ? (STEADY_S * 1e9) / 2 : 0]));
  }

  draw(span: Span): void {
    const until = this.page.recording ? span.at : Infinity;
    const texts = this.tiles.map(({ item }) => this.text(item, until, span.at));
    const alarms = this.streams.filter(isAlarm).flatMap((stream) => ringing(stream, until));
    const state = JSON.stringify([texts, alarms]);
    if (state === this.shown) return;
    this.shown = state;
    this.tiles.forEach((tile, i) => {
      const [value, unit, since] = texts[i] as string[];
      tile.value.textContent = value || NOTHING;
      tile.value.classList.toggle("waits", !value);
      tile.value.classList.toggle("long", (value ?? "").length > 9);
      tile.value.classList.toggle("sentence", (value ?? "").length > 26);
      if (tile.item.down_s) tile.box.hidden = !value;
      tile.unit.textContent = value ? (unit ?? "") : "";
      tile.since.textContent = since ?? "";
    });
    const watched = this.streams.some(isAlarm);
    this.verdict.hidden = !watched || alarms.length > 0 || !this.streams.some((stream) => stream.count);
    this.verdict.textContent = "no alarm";
    this.alarms.replaceChildren(...alarms.map(([who, what, advice]) => make("li", {}, make("strong", {}, `${who}: ${what}`), make("span", {}, advice))));
    this.element.dataset["answer"] = texts.map(([value, unit]) => [value, unit].filter(Boolean).join(" ")).join(" | ");
    this.element.dataset["alarms"] = String(alarms.length);
  }

  /** What one thing shows: the value, its unit, and since when. */
  private text(item: ShownInfo, until: number, now: number): [string, string, string] {
    const stream = this.streams.find((one) => one.info.name === item.of);
    if (!stream) return ["", "", ""];
    if (stream.info.kind === "signal") return ofSignal(stream, item, until);
    if (item.down_s) {
      const row = stream.rows.findLast((one) => (one[0] as number) <= until);
      const left = row && fits(stream, row, item.where ?? {}) ? Math.ceil((row[0] as number) + item.down_s - now) : 0;
      return left > 0 ? [String(left), item.unit ?? "s", ""] : ["", "", ""];
    }
    const rows = stream.rows.filter((row) => (row[0] as number) <= until && fits(stream, row, item.where ?? {}));
    if (item.count) return [String(rows.length), item.unit ?? "", ""];
    const place = field(stream, item.field ?? "");
    const value = place ? rows.at(-1)?.[place] : undefined;
    if (value === undefined || value === null) return ["", "", ""];
    const unit = item.unit ?? stream.info.fields[place - 1]?.[2] ?? "";
    const word = item.values?.[String(value)];
    const shown = word !== undefined ? word : typeof value === "number" ? (value * (item.factor ?? 1)).toFixed(item.decimals ?? 0) : String(value);
    return [shown, word === undefined && typeof value === "number" ? unit : (item.unit ?? ""), item.since ? this.since(stream, rows, place) : limits(stream, rows.at(-1), item)];
  }

  private since(stream: Stream, rows: Cell[][], place: number): string {
    let first = rows.length - 1;
    while (first > 0 && rows[first - 1]?.[place] === rows[first]?.[place]) first--;
    const row = rows[first];
    return row ? `since ${this.page.clock(row[field(stream, "onset")] as number).slice(0, 5)}` : "";
  }
}

/** The newest value of a channel; or how many channels are above a value. */
function ofSignal(stream: Stream, item: ShownInfo, until: number): [string, string, string] {
  const { time, low, high, thin } = stream.signal;
  const last = Number.isFinite(until) ? time.findLastIndex((t) => t <= until) : time.length - 1;
  if (last < 0) return ["", "", ""];
  const from = thin ? last : Math.max(0, time.findIndex((t) => t > (time[last] as number) - STEADY_S));
  const mean = (c: number): number => {
    const part = [low[c], thin ? high[c] : low[c]].flatMap((values) => (values ?? []).slice(from, last + 1)).filter((v) => v === v);
    return part.length ? part.reduce((a, b) => a + b, 0) / part.length : NaN;
  };
  if (item.count) return [String(low.filter((_, c) => mean(c) > (item.above ?? 0)).length), item.unit ?? "", ""];
  const c = stream.info.channels.indexOf(item.field ?? "");
  const value = mean(Math.max(0, c));
  if (value !== value) return ["", "", ""];
  const word = item.values?.[String(Math.round(value))];
  if (word !== undefined) return [word, "", ""];
  const { units } = stream.info;
  const shown = (value * (item.factor ?? 1)).toFixed(item.decimals ?? 0);
  return [/^-0(\.0*)?$/.test(shown) ? shown.slice(1) : shown, item.unit ?? units[units.length === 1 ? 0 : Math.max(0, c)] ?? "", ""];
}

/** Between what the value may be. */
function limits(stream: Stream, row: Cell[] | undefined, item: ShownInfo): string {
  const found = (item.between ?? []).map((name) => row?.[field(stream, name)]).filter((v) => typeof v === "number");
  return found.map((v) => (v * (item.factor ?? 1)).toFixed(item.decimals ?? 0)).join(" to ");
}

const fits = (stream: Stream, row: Cell[], where: Record<string, Cell | Cell[]>): boolean =>
  Object.entries(where).every(([name, wanted]) => (Array.isArray(wanted) ? wanted : [wanted]).includes(row[field(stream, name)] ?? null));

/** The alarms of a stream that are not over: who, what, and what to do. */
function ringing(stream: Stream, until: number): [string, string, string][] {
  const [who, state, what, advice] = ALARM.map((name) => field(stream, name)) as [number, number, number, number];
  const now = new Map<string, Cell[]>();
  for (const row of stream.rows) {
    if ((row[0] as number) > until) break;
    const key = String(row[who]);
    if (row[state] === "on") now.set(key, row);
    else now.delete(key);
  }
  return [...now.values()].map((row) => [String(row[who]), String(row[what]), String(row[advice])]);
}
