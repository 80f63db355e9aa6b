// Weeks of nights: every evening a line from noon to noon with its times in bed, and every week a line of numbers.

import { colour, make, type Page, Panel, Sheet } from "./panel";
import type { Stream } from "./store";
import type { Cell, PanelInfo } from "./wire";

const LEFT = 92;
const HEAD = 18;
const LINE = 14;
const BAR = 9;
const MOST_EVENINGS = 56;
const DAY_MS = 86_400_000;
const HOURS = [12, 18, 0, 6, 12];
/** The colour of each letter of a night: asleep, awake, in bed and not known. */
const COLOURS: Record<string, string> = { s: "accent", w: "warn", "?": "stale" };
const HEADS = ["week", "nights", "missing", "naps", "asleep", "efficiency", "into bed", "out of bed", "social jet lag", "regularity"];

interface Night { evening: string; kind: string; day: string }

export class WeeksPanel extends Panel {
  private readonly sheet = new Sheet(this.body, this.height);
  private readonly table = make("table");
  private nights: Night[] = [];
  private known = -1;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.sheet.canvas.setAttribute("role", "img");
    this.sheet.canvas.setAttribute("aria-label", "nothing yet");
    this.body.append(make("div", { class: "scroll" }, this.table));
  }

  /** The note says that there is no night yet. */
  protected override get waits(): boolean {
    return false;
  }

  draw(): void {
    const count = this.streams.reduce((sum, stream) => sum + stream.count, 0);
    if (count !== this.known) {
      this.known = count;
      this.read();
      this.weeks();
    }
    const evenings = this.evenings();
    this.sheet.canvas.style.height = `${HEAD + LINE * Math.max(1, evenings.length) + 4}px`;
    const pen = this.sheet.clear();
    const wide = this.sheet.width - LEFT - 8;
    pen.font = "12px system-ui, sans-serif";
    pen.textBaseline = "middle";
    HOURS.forEach((hour, i) => {
      const x = LEFT + (wide * i) / (HOURS.length - 1);
      pen.fillStyle = colour("rule");
      pen.fillRect(x, HEAD, 0.5, LINE * evenings.length);
      pen.fillStyle = colour("dim");
      pen.textAlign = i === HOURS.length - 1 ? "right" : "left";
      pen.fillText(`${String(hour).padStart(2, "0")}:00`, x, HEAD / 2);
    });
    pen.textAlign = "left";
    evenings.forEach((evening, i) => this.line(pen, evening, HEAD + LINE * i, wide));
    this.tell(evenings);
  }

  private line(pen: CanvasRenderingContext2D, evening: string, top: number, wide: number): void {
    pen.fillStyle = colour("dim");
    pen.fillText(named(evening), 4, top + LINE / 2, LEFT - 8);
    const here = this.nights.filter((night) => night.evening === evening);
    if (!here.some((night) => night.kind === "night")) pen.fillText(here.some((n) => n.kind === "unfinished") ? "no numbers" : "no night", LEFT + 4, top + LINE / 2);
    for (const { day } of here) {
      for (let from = 0, to = 0; from < day.length; from = to) {
        while (to < day.length && day[to] === day[from]) to++;
        const name = COLOURS[day[from] as string];
        if (!name) continue;
        pen.fillStyle = colour(name);
        pen.fillRect(LEFT + (wide * from) / day.length, top + (LINE - BAR) / 2, Math.max(1, (wide * (to - from)) / day.length), BAR);
      }
    }
  }

  /** Every evening from the first night's to the last one's, of the newest. */
  private evenings(): string[] {
    const days = this.nights.map((night) => Date.parse(night.evening)).filter((day) => day === day);
    const [first, last] = [Math.min(...days), Math.max(...days)];
    const found = [];
    for (let day = Math.max(first, last - (MOST_EVENINGS - 1) * DAY_MS); day <= last; day += DAY_MS) found.push(new Date(day).toISOString().slice(0, 10));
    return found;
  }

  /** The newest word on every night. */
  private read(): void {
    const found = new Map<string, Night>();
    for (const stream of this.streams) {
      const [name, evening, kind, day] = ["night", "evening", "kind", "day"].map((field) => column(stream, field));
      if (!name || !evening || !kind || !day) continue;
      for (const cells of stream.rows) found.set(text(cells[name]), { evening: text(cells[evening]), kind: text(cells[kind]), day: text(cells[day]) });
    }
    this.nights = [...found.values()].filter((night) => night.kind !== "deleted");
  }

  /** The newest word on every week, the last one first. */
  private weeks(): void {
    const found = new Map<string, Cell[]>();
    for (const stream of this.streams) {
      const at = (field: string) => column(stream, field);
      const key = at("week");
      if (!key) continue;
      for (const cells of stream.rows) {
        const value = (field: string) => cells[at(field)];
        found.set(text(cells[key]), [
          cells[key] ?? null, value("nights") ?? null, value("missing") ?? null, value("naps") ?? null, minutes(value("asleep")),
          worded(value("efficiency"), (v) => `${v.toFixed(0)} %`), clock(value("bed")), clock(value("rise")),
          worded(value("jet_lag"), (v) => `${v < 0 ? "" : "+"}${(60 * v).toFixed(0)} min`), worded(value("regularity"), (v) => v.toFixed(0)),
        ]);
      }
    }
    const rows = [...found].sort(([a], [b]) => (a < b ? 1 : -1)).map(([, cells]) => make("tr", {}, ...cells.map((cell) => make("td", {}, text(cell)))));
    this.table.replaceChildren(...(rows.length ? [make("tr", {}, ...HEADS.map((head) => make("th", {}, head))), ...rows] : []));
  }

  private tell(evenings: string[]): void {
    const nights = new Set(this.nights.filter((night) => night.kind === "night").map((night) => night.evening));
    const shown = evenings.filter((evening) => nights.has(evening)).length;
    const without = evenings.length - shown;
    this.note.textContent = evenings.length ? `${shown} ${shown === 1 ? "night" : "nights"}, ${without} ${without === 1 ? "evening" : "evenings"} without; blue: asleep` : "no night yet";
    this.element.dataset["nights"] = String(shown);
    this.element.dataset["without"] = String(without);
    this.sheet.canvas.setAttribute("aria-label", `from noon to noon: ${this.note.textContent}`);
  }
}

const column = (stream: Stream, name: string): number => stream.info.fields.findIndex(([field]) => field === name) + 1;
const text = (cell: Cell | undefined): string => (cell === undefined || cell === null ? "" : String(cell));
const worded = (cell: Cell | undefined, of: (value: number) => string): string => (typeof cell === "number" && cell === cell ? of(cell) : "–");
const minutes = (cell: Cell | undefined): string => worded(cell, (v) => `${Math.floor(Math.round(v) / 60)} h ${String(Math.round(v) % 60).padStart(2, "0")} min`);
const clock = (cell: Cell | undefined): string => worded(cell, (v) => {
  const whole = Math.round(60 * v);
  return `${String((Math.floor(whole / 60) + 12) % 24).padStart(2, "0")}:${String(whole % 60).padStart(2, "0")}`;
});
const named = (evening: string): string => new Date(Date.parse(evening)).toLocaleDateString("en-GB", { weekday: "short", day: "2-digit", month: "2-digit", timeZone: "UTC" });
