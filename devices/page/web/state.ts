// The engine's health as a table, the graph with live rates on its edges, and the log.

import { make, type Page, Panel, type Span } from "./panel";
import type { Hello, LogMessage, PanelInfo, Row, StateMessage } from "./wire";

const COLUMNS: [string, string][] = [
  ["rate_hz", "rate /s"], ["p50_us", "p50 µs"], ["p99_us", "p99 µs"], ["cpu_pct", "CPU %"], ["queue", "queue"], ["dropped", "dropped"], ["late", "late"], ["gaps", "gaps"],
];
const MOST_LINES = 200;
const SVG = "http://www.w3.org/2000/svg";
const TROUBLES = new Set(["dropped", "late", "gaps"]);

export class StatePanel extends Panel {
  private readonly table = make("table");
  private begun = false;
  private state: StateMessage | null = null;

  constructor(info: PanelInfo, page: Page) {
    super({ title: "engine", ...info }, [], page);
    this.body.append(make("div", { class: "scroll", tabindex: "0" }, this.table));
  }

  take(state: StateMessage): void {
    this.state = state;
    this.begun = true;
  }

  protected override get waits(): boolean {
    return !this.begun;
  }

  draw(_span: Span): void {
    const { state } = this;
    if (!state) return;
    this.state = null;
    const heads = ["stream or node", ...COLUMNS.map(([, title]) => title), ""];
    const rows = Object.entries(state.table).filter(([, row]) => row["kind"] !== "recording");
    const body = rows.map(([name, row]) => make("tr", {}, make("td", {}, name), ...COLUMNS.map(([key]) => cell(key, row[key])), trouble(row)));
    this.table.replaceChildren(make("thead", {}, make("tr", {}, ...heads.map((h) => make("th", { scope: "col" }, h)))), make("tbody", {}, ...body));
    this.note.textContent = [
      `${state.clients} looking`, state.skipped ? `this page is slow: ${state.skipped} updates came together` : "",
      state.dropped ? `${state.dropped} views dropped` : "", recording(state.table["recording"]), state.over,
    ].filter(Boolean).join(" · ");
    this.element.dataset["rows"] = String(rows.length);
  }
}

function cell(key: string, value: string | number | undefined): HTMLElement {
  const bad = TROUBLES.has(key) && Number(value) > 0;
  const shown = typeof value !== "number" ? "" : Number.isInteger(value) ? String(value) : value.toFixed(1);
  return make("td", { class: bad ? "number bad" : "number" }, shown);
}

function trouble(row: Row): HTMLElement {
  const trouble = row["error"] || (["running", "ended", "stopped", undefined].includes(row["state"] as string) ? row["findings"] : row["state"]);
  return make("td", { class: "bad" }, String(trouble ?? ""));
}

const recording = (row: Row | undefined): string =>
  row ? `recorded ${(Number(row["bytes"]) / 1e6).toFixed(1)} MB${row["error"] ? `, ${row["error"]}` : ""}` : "";

/** The newest message is on top; one that comes again is shown once, with its last time and how often it came. */
export class LogPanel extends Panel {
  private readonly lines = make("pre", { class: "log" });
  private readonly shown = new Map<string, { line: HTMLElement; count: number }>();

  constructor(info: PanelInfo, page: Page) {
    super({ title: "log", ...info }, [], page);
    this.body.append(make("div", { class: "scroll", tabindex: "0", role: "log" }, this.lines));
  }

  take(message: LogMessage): void {
    for (const { at, level, text } of message.lines) {
      const bad = level === "error" ? "bad" : level === "warning" ? "warn" : "";
      const key = `${level} ${text}`;
      const before = this.shown.get(key);
      before?.line.remove();
      this.shown.delete(key);
      const count = (before?.count ?? 0) + 1;
      const time = new Date(at * 1000).toLocaleTimeString([], { hour12: false });
      const line = make("span", { class: bad }, `${time} ${text}${count > 1 ? ` (${count} times)` : ""}\n`);
      this.shown.set(key, { line, count });
      this.lines.prepend(line);
    }
    for (const [key, { line }] of this.shown) {
      if (this.shown.size <= MOST_LINES) break;
      line.remove();
      this.shown.delete(key);
    }
  }

  protected override get waits(): boolean {
    return !this.lines.childElementCount;
  }

  draw(): void {}
}

/** How far apart the rates of a node's outputs stand. */
const FLOW = 11;
const BOX = { width: 150, height: 40, across: 210, down: 58 };

export class GraphPanel extends Panel {
  private readonly rates = new Map<string, SVGTextElement>();
  private readonly flows = new Map<string, SVGTextElement>();
  private readonly outputs = new Map<string, number>();
  private readonly boxes = new Map<string, SVGRectElement>();
  private state: StateMessage | null = null;

  constructor(info: PanelInfo, page: Page, private readonly graph: Hello) {
    super({ title: "graph", wide: 2, ...info }, [], page);
    const place = this.places();
    const width = Math.max(...[...place.values()].map(([x]) => x)) + BOX.width + 10;
    const height = Math.max(...[...place.values()].map(([, y]) => y)) + BOX.height + 10;
    const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, width: String(width), height: String(height), role: "img", "aria-label": "the graph" });
    for (const [edge, to, port] of graph.edges) this.edge(svg, edge, to, port, place);
    svg.append(...this.flows.values());
    for (const node of graph.nodes) this.node(svg, node.name, node.use, node.kind, place.get(node.name) as [number, number]);
    this.body.append(make("div", { class: "scroll", tabindex: "0" }, svg as unknown as Node));
  }

  take(state: StateMessage): void {
    this.state = state;
  }

  draw(): void {
    if (!this.state) return;
    for (const [name, row] of Object.entries(this.state.table)) {
      const node = this.nodeOf(name);
      const text = this.rates.get(name) ?? this.rates.get(node);
      if (text) text.textContent = `${Number(row["rate_hz"] ?? 0).toFixed(1)}/s${row["p99_us"] ? ` · p99 ${Number(row["p99_us"]).toFixed(0)} µs` : ""}`;
      this.boxes.get(node)?.classList.toggle("failed", Boolean(row["error"] || row["findings"]) || row["state"] === "stale");
    }
    for (const [edge, rate] of Object.entries(this.state.edges ?? {})) {
      const text = this.flows.get(edge) ?? this.flows.get(edge.replace(/\.out$/, ""));
      if (text) text.textContent = `${rate < 10 ? rate.toFixed(1) : rate.toFixed(0)}/s`;
    }
    this.state = null;
  }

  /** The node of "node.output"; nodes of a part have dots in their names. */
  private nodeOf(edge: string): string {
    let node = edge;
    while (node.includes(".") && !this.graph.nodes.some((one) => one.name === node)) node = node.slice(0, node.lastIndexOf("."));
    return node;
  }

  /** Each node as far to the right as its inputs ask for. */
  private places(): Map<string, [number, number]> {
    const depth = new Map<string, number>();
    for (const node of this.graph.nodes) {
      const before = this.graph.edges.filter(([, to]) => to === node.name).map(([edge]) => depth.get(this.nodeOf(edge)) ?? 0);
      depth.set(node.name, before.length ? 1 + Math.max(...before) : 0);
    }
    const rows = new Map<number, number>();
    return new Map(this.graph.nodes.map((node) => {
      const d = depth.get(node.name) as number;
      const row = rows.get(d) ?? 0;
      rows.set(d, row + 1);
      return [node.name, [8 + d * BOX.across, 8 + row * BOX.down]];
    }));
  }

  private edge(svg: SVGElement, edge: string, to: string, port: string, place: Map<string, [number, number]>): void {
    const [a, b] = [place.get(this.nodeOf(edge)), place.get(to)];
    if (!a || !b) return;
    const [x1, y1, x2, y2] = [a[0] + BOX.width, a[1] + BOX.height / 2, b[0], b[1] + BOX.height / 2];
    const path = draw("path", { d: `M${x1},${y1} C${x1 + 30},${y1} ${x2 - 30},${y2} ${x2},${y2}` });
    path.append(draw("title", {}, `${edge} to ${port}`));
    svg.append(path);
    if (this.flows.has(edge)) return;
    const node = this.nodeOf(edge);
    const before = this.outputs.get(node) ?? 0;
    this.outputs.set(node, before + 1);
    const flow = draw("text", { x: String(x1 + 4), y: String(a[1] + FLOW * (before + 1)), class: "dim flow" }) as SVGTextElement;
    this.flows.set(edge, flow);
  }

  private node(svg: SVGElement, name: string, use: string, kind: string, [x, y]: [number, number]): void {
    const box = draw("rect", { x: String(x), y: String(y), width: String(BOX.width), height: String(BOX.height), rx: "5", class: kind });
    box.append(draw("title", {}, use));
    const rate = draw("text", { x: String(x + 8), y: String(y + 32), class: "dim" }, use.split(".").at(-1) ?? "") as SVGTextElement;
    svg.append(box, draw("text", { x: String(x + 8), y: String(y + 16) }, name), rate);
    this.rates.set(name, rate);
    this.boxes.set(name, box as SVGRectElement);
  }
}

function draw(tag: string, attributes: Record<string, string>, text = ""): SVGElement {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.textContent = text;
  return element;
}
