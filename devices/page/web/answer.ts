// The answer of a use, in large type: the newest of what its graph says is worth showing, and the alarms that there are now.

import { make, type Page, Panel, type Span } from "./panel";
import type { Stream } from "./store";
import type { Cell, PanelInfo, ShownInfo } from "./wire";

const ALARM = ["subject", "state", "what", "advice"];
const NOTHING = "–";

const field = (stream: Stream, name: string): number => stream.info.fields.findIndex(([f]) => f === name) + 1;
const isAlarm = (stream: Stream): boolean => ALARM.every((name) => field(stream, name) > 0);

export class AnswerPanel extends Panel {
  private readonly tiles: { item: ShownInfo; value: HTMLElement; unit: HTMLElement; since: HTMLElement }[];
  private readonly alarms = make("ul", { class: "alarms", role: "alert" });
  private readonly verdict = make("p", { class: "verdict", hidden: "" });
  private shown = "";

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super({ ...info, title: info.title || "answer" }, streams, page);
    this.tiles = (info.show ?? []).map((item) => ({ item, value: make("strong"), unit: make("span", { class: "unit" }), since: make("small") }));
    const tiles = this.tiles.map(({ item, value, unit, since }, i) => {
      const label = make("span", { class: "label" }, item.label ?? "");
      return make("div", { class: i ? "tile" : "tile first" }, make("p", {}, value, unit), label, since);
    });
    this.body.append(make("div", { class: "tiles" }, ...tiles, this.verdict), this.alarms);
  }

  protected override get waits(): boolean {
    return false;
  }

  draw(span: Span): void {
    const until = this.page.recording ? span.at : Infinity;
    const texts = this.tiles.map(({ item }) => this.text(item, until));
    const alarms = this.streams.filter(isAlarm).flatMap((stream) => ringing(stream, until));
    const state = JSON.stringify([texts, alarms]);
    if (state === this.shown) return;
    this.shown = state;
    this.tiles.forEach((tile, i) => {
      const [value, unit, since] = texts[i] as string[];
      tile.value.textContent = value || NOTHING;
      tile.value.classList.toggle("long", (value ?? "").length > 9);
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
  private text(item: ShownInfo, until: number): [string, string, string] {
    const stream = this.streams.find((one) => one.info.name === item.of);
    if (!stream) return ["", "", ""];
    const rows = stream.rows.filter((row) => (row[0] as number) <= until && fits(stream, row, item.where ?? {}));
    if (item.count) return [String(rows.length), item.unit ?? "", ""];
    const place = field(stream, item.field ?? "");
    const value = place ? rows.at(-1)?.[place] : undefined;
    if (value === undefined || value === null) return ["", "", ""];
    const unit = item.unit ?? stream.info.fields[place - 1]?.[2] ?? "";
    const word = item.values?.[String(value)];
    const shown = word !== undefined ? word : typeof value === "number" ? (value * (item.factor ?? 1)).toFixed(item.decimals ?? 0) : String(value);
    return [shown, word === undefined && typeof value === "number" ? unit : (item.unit ?? ""), item.since ? this.since(stream, rows, place) : ""];
  }

  private since(stream: Stream, rows: Cell[][], place: number): string {
    let first = rows.length - 1;
    while (first > 0 && rows[first - 1]?.[place] === rows[first]?.[place]) first--;
    const row = rows[first];
    return row ? `since ${this.page.clock(row[field(stream, "onset")] as number).slice(0, 5)}` : "";
  }
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
