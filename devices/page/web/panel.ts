// What every panel is: a titled box that draws streams of a span of time.

import type { Stream } from "./store";
import type { PanelInfo } from "./wire";

/** The span of time that all panels show (s since the beginning); `at` is the moment of what is shown as a whole. */
export interface Span { begin: number; end: number; at: number }

/** Who arranges the panels. */
export interface Page {
  readonly t0_ms: number;
  readonly recording: boolean;
  /** Whether a stream that gives nothing has fallen silent; in a recording, and where a replay stands still, it has not. */
  readonly runs: boolean;
  clock(at: number, fine?: boolean): string;
  /** Move the cursor of a recording. */
  seek(at: number): void;
  /** Ask the server; whether it could be asked. */
  ask(what: object): boolean;
}

export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K, attributes: Record<string, string> = {}, ...inside: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...inside);
  return element;
}

export const colour = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

/** Colours for channels and kinds of events: distinct for the colour-blind as far as twelve can be (after Paul Tol), light and dark. */
const LIGHT = ["#1f5fa8", "#b0481c", "#2a7d3f", "#8a3f98", "#8a6a00", "#b22a5b", "#0f7c85", "#5b5bd6", "#6b4f2e", "#4d6b00", "#a3333d", "#42596e"];
const DARK = ["#79b4f2", "#f29e6b", "#7ed491", "#d79be6", "#e6c65a", "#f28bb3", "#62cdd6", "#a9a9ff", "#cfae86", "#b4d35e", "#f08f96", "#a9c0d6"];
export const shade = (i: number): string => {
  const colours = document.documentElement.dataset["theme"] === "dark" ? DARK : LIGHT;
  return colours[i % colours.length] as string;
};

/** A panel of more streams is not called after all of them. */
const NAMED = 3;
const NOTHING = "nothing yet";

export abstract class Panel {
  readonly element: HTMLElement;
  protected readonly body = make("div", { class: "body" });
  protected readonly note = make("output");
  protected readonly tools = make("span");
  /** Stands in the middle while there is nothing to draw. */
  protected readonly empty = make("p", { class: "empty", hidden: "" }, NOTHING);

  constructor(readonly info: PanelInfo, readonly streams: Stream[], protected readonly page: Page) {
    const title = info.title || (streams.length <= NAMED ? streams.map((s) => s.info.name).join(", ") : "") || info.kind;
    const head = make("header", {}, make("h2", {}, title), this.tools, this.note);
    this.element = make("section", { class: `panel ${info.kind} wide${info.wide ?? 1}`, "aria-label": title, tabindex: "0" }, head, this.body, this.empty);
    this.element.dataset["of"] = info.of.join(" ");
    this.element.addEventListener("keydown", (event) => {
      if (event.target !== this.element || event.ctrlKey || event.metaKey || event.altKey || !this.key(event)) return;
      event.preventDefault();
      event.stopPropagation();
    });
    if (info.missing?.length) this.note.textContent = `not shown here: ${info.missing.join(", ")}`;
  }

  /** Of each stream: ns for each point. */
  widths(_span_s: number, _pixels: number): Map<number, number> {
    return new Map(this.streams.map((s) => [s.number, 0]));
  }

  /** Draw what there is. */
  abstract draw(span: Span): void;

  /** A key, while the panel itself has the focus; whether it was one of its own. */
  protected key(_event: KeyboardEvent): boolean {
    return false;
  }

  /** The theme was changed, or the size. */
  restyle(): void {}

  /** Its `info` says another size. */
  resize(): void {
    this.element.className = this.element.className.replace(/wide\d/, `wide${this.info.wide ?? 1}`);
    this.restyle();
  }

  /** The panel goes from the page. */
  leave(): void {}

  /** Note the moment of what is shown as a whole. */
  protected stamp(): void {
    const newest = this.streams.map((s) => s.newest?.at ?? -Infinity);
    const at = Math.max(...newest);
    if (Number.isFinite(at)) this.element.dataset["at"] = at.toFixed(6);
  }

  protected get height(): number {
    return Math.round(260 * (this.info.tall ?? 1));
  }

  /** Whether nothing has come yet that could be drawn. */
  protected get waits(): boolean {
    return this.streams.length > 0 && this.streams.every((s) => !s.count);
  }

  /** Grey the panel where its streams have fallen silent, and say since when; say that nothing has come yet. */
  age(now: number): void {
    this.empty.hidden = !this.waits;
    const silent = Math.max(0, ...this.streams.map((s) => s.stale(now)));
    const stale = silent > 0 && this.page.runs;
    if (stale !== this.element.classList.contains("stale")) {
      this.element.classList.toggle("stale", stale);
      this.note.classList.toggle("since", stale);
      if (!stale) this.note.textContent = "";
    }
    if (stale) this.note.textContent = `nothing for ${silent.toFixed(0)} s, since ${this.page.clock((Date.now() - this.page.t0_ms) / 1000 - silent)}`;
  }
}

/** A canvas that is as wide as its panel, sharp on every screen. */
export class Sheet {
  readonly canvas = make("canvas");
  readonly context = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  width = 0;
  height = 0;

  constructor(host: HTMLElement, height: number) {
    host.append(this.canvas);
    this.canvas.style.height = `${height}px`;
    this.canvas.style.width = "100%";
  }

  /** Make it fit, and clear it. */
  clear(): CanvasRenderingContext2D {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = window.devicePixelRatio || 1;
    const [w, h] = [Math.round(clientWidth * ratio), Math.round(clientHeight * ratio)];
    if (this.canvas.width !== w || this.canvas.height !== h) {
      this.canvas.width = w;
      this.canvas.height = h;
    }
    this.width = clientWidth;
    this.height = clientHeight;
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, clientWidth, clientHeight);
    return this.context;
  }
}
