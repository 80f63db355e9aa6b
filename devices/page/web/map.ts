// The page of a map of motion: its views are linked by the sequences that are chosen, the pose that is picked, and one time.

import { type CurveRow, CurveView, type Pace } from "./map_curves";
import { bars } from "./map_facts";
import { drawPose, extent } from "./map_pose";
import { GridView, held, PlaneView, type Shown } from "./map_views";
import { type CellSet, type Curve, type MapHello, type MapMessage, type NearMessage, type PoseSet, Taker } from "./map_wire";
import { colour, make, shade } from "./panel";
import { Connection, type Message } from "./wire";

const VIEW = 560, DETAIL = 360, CURVE_POINTS = 600, MOST_CHOSEN = 12;
const MOVING = 1, PICKED = 2, NEAR = 3, COMPARED = 4;

const panel = (name: string, title: string, wide: number, ...inside: (Node | string)[]): HTMLElement =>
  make("section", { class: `panel wide${wide}`, id: name, "aria-label": title }, make("header", {}, make("h2", {}, title)), ...inside);
const slider = (name: string, least: number, most: number, step: number, value: number): HTMLInputElement =>
  make("input", { type: "range", "aria-label": name, min: String(least), max: String(most), step: String(step), value: String(value) });

class MapPage {
  private shown: Shown | null = null;
  private readonly curves = new Map<number, Curve>();
  private readonly paces = new Map<number, Pace>();
  private readonly rows = new Map<string, CurveView>();
  private compared: PoseSet | null = null;
  private waiting = false;
  private wants = false;
  private playing = 0;
  private asked = 0;
  private readonly grid = new GridView(VIEW);
  private readonly plane = new PlaneView(VIEW);
  private readonly detail = make("canvas", { width: String(DETAIL), height: String(DETAIL) });
  private readonly about = make("output", { id: "about" });
  private readonly list = make("div", { class: "scroll", id: "sequences" });
  private readonly markers = make("div", { class: "legend", id: "markers" });
  private readonly found = make("div", { class: "scroll", id: "found" });
  private readonly details = make("div", { id: "curves" });
  private readonly facts = make("select", { "aria-label": "colour by" });
  private readonly barHost = make("div", { id: "bars" });
  private readonly from = make("select", { "aria-label": "seen from" }, make("option", { value: "1" }, "the side"), make("option", { value: "2" }, "above"));
  private readonly over = make("button", { type: "button", "aria-pressed": "false", id: "over" }, "over one another");
  private readonly difference = make("output", { id: "difference" });
  private readonly outliers = slider("outliers", 0.9, 1, 0.001, 0.99);
  private readonly outlierNote = make("output");
  private readonly time = slider("time", 0, 1, 0.01, 0);
  private readonly clock = make("output", { id: "clock" });
  private readonly play = make("button", { type: "button", id: "play", "aria-pressed": "false" }, "play");
  private readonly stretch = make("input", { type: "number", "aria-label": "stretch (s)", min: "0", max: "20", step: "0.1", value: "0" });
  private readonly band = make("input", { type: "number", "aria-label": "band (s)", min: "0", step: "0.1", value: "0.5" });
  private readonly nearest = make("button", { type: "button", id: "nearest", disabled: "" }, "nearest to it");
  private readonly status = document.getElementById("status") as HTMLOutputElement;
  private readonly connection: Connection;

  constructor() {
    this.build();
    this.listen();
    document.documentElement.dataset["theme"] = matchMedia("(prefers-color-scheme: dark)").matches ? "dark" : "light";
    this.connection = new Connection((message, buffer, at) => this.hear(message as Message | MapMessage as MapMessage, new Taker(buffer, at)), (state) => (this.status.textContent = state));
  }

  private build(): void {
    (document.getElementById("controls") as HTMLElement).append(this.play, make("label", {}, "time", this.time), this.clock);
    (document.getElementById("panels") as HTMLElement).append(
      panel("list", "sequences", 1, make("label", {}, "colour by", this.facts), this.list),
      panel("som", "grid of poses", 1, this.grid.canvas, make("label", {}, "outliers above", this.outliers, this.outlierNote)),
      panel("pca", "PCA", 1, this.plane.canvas),
      panel("pose", "pose", 1, this.detail, this.about, this.markers,
        make("div", { class: "legend" }, make("label", {}, "stretch (s)", this.stretch), make("label", {}, "band (s)", this.band), this.nearest), this.found),
      panel("variation", "variation by marker and class", 1, this.barHost),
      panel("detail", "sequences in detail", 4, make("div", { class: "legend" }, make("label", {}, "seen from", this.from), this.over, this.difference), this.details),
    );
  }

  private listen(): void {
    const redraw = () => this.draw();
    this.facts.onchange = () => { this.listSequences(); redraw(); };
    this.from.onchange = redraw;
    this.outliers.oninput = redraw;
    this.time.oninput = () => this.move();
    this.play.onclick = () => this.setPlaying(!this.playing);
    this.over.onclick = () => { this.over.setAttribute("aria-pressed", String(this.over.ariaPressed !== "true")); redraw(); };
    this.nearest.onclick = () => this.query();
    for (const view of [this.grid, this.plane]) {
      const pick = (event: MouseEvent) => this.shown ? view.nearest(this.shown, ...inside(event)) : -1;
      view.canvas.onclick = (event) => {
        if (view === this.grid && this.shown) this.shown.cell = this.grid.cellAt(this.shown, ...inside(event));
        const frame = pick(event);
        if (frame >= 0) this.pick(frame);
        redraw();
      };
      view.canvas.oncontextmenu = (event) => {
        event.preventDefault();
        const frame = pick(event);
        if (frame >= 0) { this.pick(frame); this.query(frame); }
      };
    }
    this.detail.onpointermove = (event) => {
      if (!event.buttons || !this.shown) return;
      this.shown.eye.turn += event.movementX / 80;
      this.shown.eye.tip = Math.max(-1.5, Math.min(1.5, this.shown.eye.tip + event.movementY / 80));
      redraw();
    };
  }

  private hear(message: MapMessage, taker: Taker): void {
    const shown = this.shown;
    if (message.t === "hello") return this.begin(message);
    if (!shown) return;
    const many = shown.hello.markers.length;
    switch (message.t) {
      case "points": {
        const { n, bins, low, high } = message;
        shown.points = { n, bins, low, high, frames: taker.i4(n), pca: taker.f4(2 * n), som: taker.f4(2 * n), density: taker.f4(bins * bins), rank: taker.u2(n) };
        document.body.dataset["points"] = String(n);
        break;
      }
      case "cells":
        shown.cells = this.cellsOf(message.cells, message.sequences, message.bundle, many, taker);
        break;
      case "frames": {
        const k = message.numbers.length;
        this.place(message.ask, { numbers: message.numbers, cell: message.cell, poses: taker.f4(3 * many * k), pca: taker.f4(2 * k), som: taker.f4(2 * k), rank: taker.u2(k) });
        break;
      }
      case "curve":
        this.curves.set(message.s, { frames: taker.i4(message.n), poses: taker.f4(3 * many * message.n), rank: taker.u2(message.n) });
        break;
      case "near":
        this.answer(message);
        break;
      case "search":
        this.status.textContent = message.state === "ready" ? "connected" : "queries are not answered; see the terminal";
        document.body.dataset["search"] = message.state;
        this.nearest.disabled = message.state !== "ready";
    }
    this.draw();
  }

  private cellsOf(cells: number, sequences: number, many: number, markers: number, taker: Taker): CellSet {
    return { many, sequences, held: taker.u4(cells * sequences), spread: taker.f4(cells), mean: taker.f4(cells * markers * 3), bundle: taker.f4(cells * many * markers * 3) };
  }

  private begin(hello: MapHello): void {
    const ends = hello.sequences.map((s) => s.last);
    this.shown = {
      hello, points: null, cells: null, eye: { turn: 0, tip: 0.1 }, chosen: new Set(hello.sequences.slice(0, 3).keys()), quantile: 0.99, moving: null, picked: null,
      near: null, nearPoses: null, cell: -1, body: { markers: hello.markers, bones: hello.bones, chosen: new Set(hello.used.slice(-4)) },
      tint: (s) => shade(this.classOf(s)), of: (frame) => ends.findIndex((end) => frame < end),
    };
    (document.getElementById("name") as HTMLElement).textContent = `${hello.name}: ${hello.poses} poses`;
    const names = [...new Set(hello.sequences.flatMap((s) => Object.keys(s.facts)))];
    this.facts.replaceChildren(make("option", { value: "" }, "sequence"), ...names.map((n) => make("option", { value: n }, n)));
    const left = hello.markers.filter((_, m) => !hello.used.includes(m));
    const shares = hello.explained.map((e) => (100 * e).toFixed(0)).join(" + ");
    this.note("som", `quantisation error ${hello.quantisation.toPrecision(3)} ${hello.unit}, topographic error ${hello.topographic.toPrecision(2)}`);
    this.note("pca", `${shares} % of the variance${left.length ? `; left out: ${left.join(", ")}` : ""}${hello.placeless ? `; ${hello.placeless} poses have no place` : ""}`);
    this.listMarkers();
    this.listSequences();
    this.choose();
  }

  private note(name: string, text: string): void {
    const head = document.querySelector(`#${name} header`) as HTMLElement;
    head.querySelector("output")?.remove();
    head.append(make("output", {}, text));
  }

  /** The number of a sequence's class, of the fact that colours: its colour. */
  private classOf(s: number): number {
    const fact = this.facts.value;
    return fact ? this.classes().indexOf(this.shown?.hello.sequences[s]?.facts[fact] ?? "") : s;
  }

  private classes(): string[] {
    const fact = this.facts.value;
    return fact ? [...new Set(this.shown?.hello.sequences.map((s) => s.facts[fact] ?? ""))].sort() : [];
  }

  private listMarkers(): void {
    const { body, hello } = this.shown as Shown;
    this.markers.replaceChildren(...body.markers.map((name, m) => {
      const box = make("input", { type: "checkbox", "aria-label": name });
      box.checked = body.chosen.has(m);
      box.onchange = () => { box.checked ? body.chosen.add(m) : body.chosen.delete(m); this.draw(); };
      const swatch = make("i");
      swatch.style.background = shade(m);
      return make("label", {}, box, swatch, hello.used.includes(m) ? name : `${name} (left out)`);
    }));
  }

  private listSequences(): void {
    const shown = this.shown as Shown;
    this.list.replaceChildren(...shown.hello.sequences.map((one, s) => {
      const box = make("input", { type: "checkbox", "aria-label": one.name });
      box.checked = shown.chosen.has(s);
      box.onchange = () => {
        box.checked ? shown.chosen.add(s) : shown.chosen.delete(s);
        if (shown.chosen.size > MOST_CHOSEN) { shown.chosen.delete(s); box.checked = false; }
        this.choose();
      };
      const swatch = make("i");
      swatch.style.background = shown.tint(s);
      const facts = Object.entries(one.facts).map(([k, v]) => `${k} ${v}`).join(", ");
      const more = [`${((one.last - one.first) / shown.hello.rate_hz).toFixed(1)} s`, facts, one.missing.length ? `lacks ${one.missing.join(", ")}` : ""];
      return make("div", { class: "legend" }, make("label", {}, box, swatch, one.name), more.filter(Boolean).join("; "));
    }));
    this.barHost.replaceChildren(bars(shown, this.facts.value, this.classes()));
  }

  /** Other sequences are chosen. */
  private choose(): void {
    const shown = this.shown as Shown;
    for (const s of shown.chosen) {
      if (!this.paces.has(s)) this.paces.set(s, { shift: 0, scale: 1 });
      if (!this.curves.has(s)) this.connection.ask({ do: "curve", sequence: s, points: CURVE_POINTS });
    }
    this.rows.clear();
    this.details.replaceChildren();
    this.time.max = String(Math.max(...[...shown.chosen].map((s) => this.length(s)), 0.01));
    this.move();
  }

  /** How long a sequence takes on the common time (s). */
  private length(s: number): number {
    const one = this.shown?.hello.sequences[s], pace = this.paces.get(s) ?? { shift: 0, scale: 1 };
    return one ? ((one.last - one.first) / (this.shown as Shown).hello.rate_hz - pace.shift) / pace.scale : 0;
  }

  /** The time was moved: where each chosen sequence stands then. One question at a time, the newest counts. */
  private move(): void {
    const shown = this.shown;
    if (!shown) return;
    this.clock.textContent = `${Number(this.time.value).toFixed(2)} s`;
    if (this.waiting) { this.wants = true; return this.draw(); }
    const t = Number(this.time.value);
    const numbers = [...shown.chosen].map((s) => {
      const one = shown.hello.sequences[s], pace = this.paces.get(s);
      if (!one || !pace) return 0;
      return Math.max(one.first, Math.min(one.last - 1, one.first + Math.round((pace.scale * t + pace.shift) * shown.hello.rate_hz)));
    });
    this.asked = performance.now();
    this.waiting = this.connection.ask({ do: "frames", numbers, ask: MOVING });
    this.draw();
  }

  private place(ask: number, set: PoseSet): void {
    const shown = this.shown as Shown;
    if (ask === PICKED) shown.picked = set;
    if (ask === NEAR) shown.nearPoses = set;
    if (ask === COMPARED) this.compared = set;
    if (ask !== MOVING) return;
    shown.moving = set;
    document.body.dataset["frames"] = JSON.stringify(set.numbers);
    document.body.dataset["moved_ms"] = (performance.now() - this.asked).toFixed(1);
    this.waiting = false;
    if (this.wants) { this.wants = false; this.move(); }
  }

  private pick(frame: number): void {
    document.body.dataset["picked"] = String(frame);
    this.connection.ask({ do: "frames", numbers: [frame], ask: PICKED });
  }

  /** Ask for what is nearest to the picked pose, or to the stretch around it. */
  private query(frame = this.shown?.picked?.numbers[0] ?? -1): void {
    const shown = this.shown as Shown, one = shown.hello.sequences[shown.of(frame)];
    if (frame < 0 || !one) return;
    const half = Math.round((Number(this.stretch.value) * shown.hello.rate_hz) / 2);
    this.connection.ask({
      do: "near", first: Math.max(one.first, frame - half), last: Math.min(one.last - 1, frame + half), count: 20, band_s: Number(this.band.value) || 0,
      markers: [...shown.body.chosen].length ? [...shown.body.chosen] : [],
    });
  }

  private answer(message: NearMessage): void {
    const shown = this.shown as Shown;
    shown.near = message;
    document.body.dataset["near"] = JSON.stringify(message.found);
    this.connection.ask({ do: "frames", numbers: message.found.map(([, a, b]) => (a + b) >> 1), ask: NEAR });
    this.found.replaceChildren(make("p", {}, `${message.found.length} found in ${message.ms.toFixed(0)} ms`), ...message.found.map(([s, first, last, apart]) => {
      const one = shown.hello.sequences[s], at = ((first - (one?.first ?? 0)) / shown.hello.rate_hz).toFixed(2);
      const button = make("button", { type: "button" }, `${one?.name ?? ""} at ${at} s: ${apart.toPrecision(3)} ${shown.hello.unit}`);
      button.onclick = () => {
        shown.chosen.add(s);
        this.connection.ask({ do: "frames", numbers: [(message.first + message.last) >> 1, (first + last) >> 1], ask: COMPARED });
        this.listSequences();
        this.choose();
        this.pick((first + last) >> 1);
      };
      return button;
    }));
  }

  private setPlaying(plays: boolean): void {
    this.play.setAttribute("aria-pressed", String(plays));
    cancelAnimationFrame(this.playing);
    this.playing = 0;
    if (!plays) return;
    let before = performance.now();
    const step = (now: number) => {
      const end = Number(this.time.max), t = Number(this.time.value) + Math.max(0, now - before) / 1000;
      before = now;
      this.time.value = String(t > end ? 0 : t);
      this.move();
      this.playing = requestAnimationFrame(step);
    };
    this.playing = requestAnimationFrame(step);
  }

  private draw(): void {
    const shown = this.shown;
    if (!shown) return;
    shown.quantile = Number(this.outliers.value);
    this.outlierNote.textContent = shown.quantile.toFixed(3);
    this.grid.draw(shown);
    this.plane.draw(shown);
    this.drawDetail(shown);
    this.drawCurves(shown);
  }

  /** The pose that is picked, those of the chosen sequences now, or the bundle of a cell. */
  private drawDetail(shown: Shown): void {
    const pen = this.detail.getContext("2d") as CanvasRenderingContext2D, box = { x: 0, y: 0, width: DETAIL, height: DETAIL };
    pen.clearRect(0, 0, DETAIL, DETAIL);
    if (!shown.cells) return;
    const view = extent(shown.cells.mean, shown.eye);
    const draw = (set: PoseSet, dots: number, tint: (k: number) => string) =>
      set.numbers.forEach((_, k) => drawPose(pen, set.poses, k, shown.body, shown.eye, box, view, tint(k), dots));
    if (shown.moving) draw(shown.moving, 2.9, (k) => shown.tint(shown.of(shown.moving?.numbers[k] ?? 0)));
    if (this.compared) draw(this.compared, 0, () => colour("accent"));
    if (shown.picked) draw(shown.picked, 4, () => colour("ink"));
    const told: string[] = [];
    const frame = shown.picked?.numbers[0];
    if (frame !== undefined) {
      const one = shown.hello.sequences[shown.of(frame)];
      const rank = shown.picked?.rank[0] ?? 0;
      told.push(`${one?.name ?? ""} at ${((frame - (one?.first ?? 0)) / shown.hello.rate_hz).toFixed(2)} s${rank > 65535 * shown.quantile ? ", an outlier" : ""}`);
    }
    if (shown.cell >= 0) {
      const { cells } = shown, fact = this.facts.value;
      const parts = new Map<string, number>();
      shown.hello.sequences.forEach((one, s) => {
        const name = fact ? (one.facts[fact] ?? "") : one.name;
        parts.set(name, (parts.get(name) ?? 0) + (cells.held[shown.cell * cells.sequences + s] as number));
      });
      const shares = [...parts].filter(([, n]) => n).map(([name, n]) => `${name} ${n}`).join(", ");
      told.push(`cell ${shown.cell}: ${held(cells, shown.cell)} poses (${shares || "none"}), spread ${(cells.spread[shown.cell] as number).toPrecision(2)} ${shown.hello.unit}`);
    }
    this.about.textContent = told.join("; ");
  }

  private drawCurves(shown: Shown): void {
    const coordinate = this.from.value === "2" ? 2 : 1, at = Number(this.time.value), until = Number(this.time.max);
    const rows: CurveRow[] = [...shown.chosen].flatMap((s) => {
      const curve = this.curves.get(s), pace = this.paces.get(s);
      return curve && pace ? [{ sequence: s, curve, pace }] : [];
    });
    const [one, two] = rows;
    if (this.over.ariaPressed === "true" && one && two) {
      this.row(shown, "over", `${this.name(one)} and, dashed, ${this.name(two)}`, null).draw(shown, [one, two], coordinate, 0, until, at);
      this.difference.textContent = `they differ by ${CurveView.difference(shown, [one, two]).toPrecision(3)} ${shown.hello.unit} (rms over chosen markers)`;
    } else this.difference.textContent = "";
    for (const row of rows) this.row(shown, String(row.sequence), this.name(row), row.pace).draw(shown, [row], coordinate, 0, until, at);
    document.body.dataset["rows"] = String(rows.length);
  }

  private name(row: CurveRow): string {
    return this.shown?.hello.sequences[row.sequence]?.name ?? "";
  }

  /** The canvas of a row, with what shifts and scales it in time. */
  private row(shown: Shown, key: string, title: string, pace: Pace | null): CurveView {
    const known = this.rows.get(key);
    if (known) return known;
    const made = new CurveView();
    const head = make("div", { class: "legend" }, title);
    for (const what of pace ? (["shift", "scale"] as const) : []) {
      const input = make("input", { type: "number", step: "0.05", "aria-label": `${what} of ${title}`, value: String(pace?.[what]) });
      input.oninput = () => {
        const value = Number(input.value);
        if (pace && Number.isFinite(value) && (what === "shift" || value > 0.05)) pace[what] = value;
        this.move();
      };
      head.append(make("label", {}, what === "shift" ? "shifted by (s)" : "times", input));
    }
    const host = make("div", { class: "row", "data-row": key }, head, made.canvas);
    key === "over" ? this.details.prepend(host) : this.details.append(host);
    this.rows.set(key, made);
    document.body.dataset["chosen"] = [...shown.chosen].join(",");
    return made;
  }
}

/** Where on a canvas an event lies, in its own pixels. */
function inside(event: MouseEvent): [number, number] {
  const canvas = event.currentTarget as HTMLCanvasElement, box = canvas.getBoundingClientRect();
  return [((event.clientX - box.x) / box.width) * canvas.width, ((event.clientY - box.y) / box.height) * canvas.height];
}

new MapPage();
