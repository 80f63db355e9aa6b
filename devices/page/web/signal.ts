// Strip charts: one lane per channel, gaps as gaps, a measure between two cursors.

import uPlot from "uplot";

import { colour, make, type Page, Panel, shade, type Span } from "./panel";
import { Analysis, type View } from "./spectrum";
import type { Stream } from "./store";
import { type Line, Strips } from "./strips";
import type { PanelInfo, SpectrumMessage } from "./wire";

const FILL = 0.46;
/** How fast a channel's scale shrinks after a large value has left, per frame. */
const SHRINK = 0.02;
const SIGNIFICANT = 3;
/** Half the scale of a channel that does not change. */
const FLAT = 1e-12;
/** A lane is no lower, so that its name can be read. */
const LANE_LEAST = 16;
/** How wide the names' column is, and what a long name adds, in pixels. */
const [NAMES, NAMES_SHORT, LETTER] = [116, 8, 6.4];
/** How far the chart is from its panel's right edge, in pixels. */
const EDGE = 8;
/** How far a key moves a cursor, as a share of the chart's width. */
const KEY_STEP = 0.02;

interface Scale { middle: number; half: number }

export class SignalPanel extends Panel {
  private plot: uPlot | null = null;
  private readonly stream: Stream;
  private readonly scales: Scale[];
  private common = false;
  private readonly analysis: Analysis;
  private readonly view = make("select", { "aria-label": "view" }, ...["lines", "spectrum", "spectrogram"].map((v) => make("option", { value: v }, v)));
  private readonly channel = make("select", { "aria-label": "channel", hidden: "" });
  private span: Span = { begin: 0, end: 1, at: 1 };
  private readonly strips = new Strips();
  private labels = "";

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.stream = streams[0] as Stream;
    this.scales = this.stream.signal.low.map(() => ({ middle: 0, half: 0 }));
    const common = make("button", { type: "button", "aria-pressed": "false" }, "one scale");
    common.onclick = () => {
      this.common = !this.common;
      common.setAttribute("aria-pressed", String(this.common));
    };
    this.analysis = new Analysis(this.body, this.height, this.stream, page);
    this.channel.append(...this.channels.map((name, c) => make("option", { value: String(c) }, name)));
    this.view.onchange = () => this.show(this.view.value as View);
    if (this.stream.info.rate_hz) this.tools.append(this.view, this.channel);
    if (this.scales.length > 1) this.tools.append(common);
  }

  /** Lines, or what the server makes of them. */
  private show(view: View): void {
    this.analysis.show(view !== "lines");
    this.channel.hidden = view !== "spectrogram" || this.scales.length < 2;
    if (view !== "lines") this.restyle();
  }

  takeSpectrum(message: SpectrumMessage, buffer: ArrayBuffer, at: number): void {
    if (message.t === this.view.value && (message.t === "spectrum" || message.channel === Number(this.channel.value))) this.analysis.take(message, buffer, at);
  }

  override widths(span_s: number, pixels: number): Map<number, number> {
    const rate = this.stream.info.rate_hz ?? 0;
    const width = rate * span_s > 2 * pixels ? 2 ** Math.ceil(Math.log2((span_s * 1e9) / pixels)) : 0;
    return new Map([[this.stream.number, width]]);
  }

  override restyle(): void {
    this.plot?.destroy();
    this.plot = null;
  }

  /** Shift and the arrows: to the sides, the second cursor; up and down, both. Escape ends measuring. */
  protected override key({ key, shiftKey }: KeyboardEvent): boolean {
    const plot = this.plot;
    if (!plot) return false;
    const [all, step] = [plot.over.clientWidth, plot.over.clientWidth * KEY_STEP];
    let { left, width } = plot.select;
    if (key === "Escape" && width) {
      plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      this.note.textContent = "";
      return true;
    }
    if (!shiftKey || !key.startsWith("Arrow")) return false;
    if (!width) left = this.page.recording ? plot.valToPos(this.span.at, "x") : all / 2;
    if (key === "ArrowRight") width += step;
    if (key === "ArrowLeft") width = Math.max(step, width - step);
    if (key === "ArrowUp") left += step;
    if (key === "ArrowDown") left -= step;
    left = Math.max(0, Math.min(all - step, left));
    plot.setSelect({ left, top: 0, width: Math.min(Math.max(width, step), all - left), height: plot.over.clientHeight });
    return true;
  }

  draw(span: Span): void {
    this.span = span;
    const width = this.body.clientWidth;
    if (!width) return;
    const view = this.view.value as View;
    this.element.dataset["view"] = view;
    if (view !== "lines") {
      this.element.dataset["peak"] = String(this.analysis.draw(view, Number(this.channel.value), span));
      return;
    }
    this.plot ??= this.made(width);
    if (this.plot.width !== width) this.plot.setSize({ width, height: this.height });
    this.rescale(...this.part());
    this.plot.setScale("x", { min: span.begin, max: span.end });
    const labels = this.channels.map((name, c) => this.label(name, c)).join();
    if (labels !== this.labels) this.plot.redraw(false, true); // where the time stands still, nothing else has them written again
    this.labels = labels;
    this.element.dataset["labels"] = labels;
    this.element.dataset["gaps"] = String(gaps(this.stream.signal.low[0] ?? []));
  }

  protected override get height(): number {
    return Math.max(super.height, LANE_LEAST * this.scales.length + 40);
  }

  private names(width: number, names: string[]): number {
    const longest = Math.max(...names.map((name) => name.length));
    return Math.round(Math.min(Math.max(NAMES, width * 0.35), NAMES + LETTER * Math.max(0, longest - NAMES_SHORT)));
  }

  private get channels(): string[] {
    const { channels } = this.stream.info;
    return this.scales.map((_, c) => channels[c] ?? String(c + 1));
  }

  private unit(c: number): string {
    const { units } = this.stream.info;
    return units[units.length === 1 ? 0 : c] ?? "";
  }

  private made(width: number): uPlot {
    const [count, names] = [this.scales.length, this.channels];
    const axis = { stroke: colour("dim"), grid: { stroke: colour("rule"), width: 0.5 }, ticks: { stroke: colour("rule") } };
    const options: uPlot.Options = {
      width,
      height: this.height,
      padding: [4, EDGE, 0, 0],
      legend: { show: false },
      cursor: { sync: { key: "page", scales: ["x", null] }, drag: { x: true, y: false, setScale: false }, points: { show: false } },
      scales: { x: { time: false }, y: { range: [0, count] } },
      series: [{}, { show: false }],
      axes: [
        { ...axis, size: 26, space: 90, values: (plot: uPlot, at: number[]) => at.map((t) => this.hour(plot, t)) },
        {
          ...axis, size: this.names(width, names), splits: () => names.map((_, c) => count - c - 0.5), filter: (_: uPlot, splits: number[]) => splits,
          values: () => names.map((name, c) => this.label(name, c)),
        },
      ],
      hooks: {
        draw: [(plot) => this.lines(plot), (plot) => this.cursor(plot)], setCursor: [(plot) => this.read(plot)], setSelect: [(plot) => this.measure(plot)] },
    };
    return new uPlot(options, [[], []], this.body);
  }

  /** The time of day, where there is room for it. */
  private hour(plot: uPlot, at: number): string {
    const text = this.page.clock(at, this.span.end - this.span.begin < 8);
    const { begin, end } = this.span;
    const [wide, x] = [plot.over.clientWidth, ((at - begin) / (end - begin)) * plot.over.clientWidth];
    return wide && x + (LETTER * text.length) / 2 > wide + EDGE ? "" : text;
  }

  private label(name: string, c: number): string {
    const scale = this.scales[c] as Scale;
    return scale.half > FLAT ? `${name} ±${short(scale.half)} ${this.unit(c)}` : name;
  }

  /** Each channel in its lane, the least and the greatest value of a bucket one after the other. */
  private lines({ ctx, bbox }: uPlot): void {
    const { time, low, high, thin, width } = this.stream.signal;
    const { begin, end } = this.span;
    const [first, last] = this.part();
    const step = thin ? 2 : 1;
    const [across, lane] = [bbox.width / (end - begin), bbox.height / low.length];
    const x = new Float64Array((last - first) * step);
    for (let i = first, k = 0; i < last; i++, k += step) {
      x[k] = ((time[i] as number) - begin) * across;
      if (thin) x[k + 1] = (x[k] as number) + (width / 2) * across;
    }
    const lines = low.map((lows, c): Line => {
      const { middle, half } = this.scales[c] as Scale;
      const [zero, factor] = [(c + 0.5) * lane, half ? (FILL * lane) / half : 0];
      const y = new Float64Array(x.length);
      const highs = high[c] as number[];
      for (let i = first, k = 0; i < last; i++, k += step) {
        y[k] = zero - ((lows[i] as number) - middle) * factor;
        if (thin) y[k + 1] = zero - ((highs[i] as number) - middle) * factor;
      }
      return { x, y, colour: shade(c) };
    });
    this.strips.draw(ctx, bbox, lines, Math.max(1, window.devicePixelRatio));
    this.element.dataset["points"] = String(x.length);
  }

  /** The points within the span, and one on each side: the line goes on beyond both edges. */
  private part(): [number, number] {
    const { time } = this.stream.signal;
    const first = Math.max(0, from(time, this.span.begin) - 1);
    return [first, Math.max(first, Math.min(time.length, from(time, this.span.end) + 1))];
  }

  private rescale(first: number, last: number): void {
    const { low, high, thin } = this.stream.signal;
    const { least, most } = this.info;
    const found = low.map((lows, c) => extremes(lows, thin ? (high[c] as number[]) : lows, first, last));
    const widest = Math.max(...found.map(([a, b]) => (b - a) / 2));
    found.forEach(([a, b], c) => {
      const scale = this.scales[c] as Scale;
      if (least != null && most != null) [a, b] = [least, most];
      if (a > b) return;
      const half = Math.max(this.common ? widest : (b - a) / 2, FLAT);
      scale.half = half >= scale.half ? half : Math.max(half, scale.half * (1 - SHRINK));
      scale.middle = (a + b) / 2;
    });
  }

  /** Where a recording is looked at. */
  private cursor(plot: uPlot): void {
    if (!this.page.recording) return;
    const x = plot.valToPos(this.span.at, "x", true);
    plot.ctx.fillStyle = colour("ink");
    plot.ctx.fillRect(x, plot.bbox.top, 1, plot.bbox.height);
  }

  /** The value under the cursor. */
  private read(plot: uPlot): void {
    const { left, top } = plot.cursor;
    if (left == null || top == null || left < 0 || top < 0 || this.element.classList.contains("stale") || plot.select.width > 1) return;
    const at = plot.posToVal(left, "x");
    const c = Math.min(this.scales.length - 1, Math.max(0, Math.floor(this.scales.length - plot.posToVal(top, "y"))));
    const value = this.value(c, at);
    const shown = Number.isNaN(value) ? "gap" : `${value.toPrecision(SIGNIFICANT)} ${this.unit(c)}`;
    this.note.textContent = `${this.channels[c]} ${shown} at ${this.page.clock(at, true)}`;
  }

  private value(c: number, at: number): number {
    const { time, low, high, thin } = this.stream.signal;
    let i = time.length - 1;
    while (i > 0 && (time[i] as number) > at) i--;
    const value = (low[c] as number[])[i] ?? NaN;
    return thin ? (value + ((high[c] as number[])[i] ?? NaN)) / 2 : value;
  }

  /** What lies between two cursors: the duration, and per channel how far its values range. */
  private measure(plot: uPlot): void {
    const { left, width } = plot.select;
    if (width < 2) return;
    const [from, to] = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    const { time, low, high, thin } = this.stream.signal;
    const [first, last] = [time.findIndex((t) => t >= from), time.findLastIndex((t) => t <= to)];
    const parts = this.channels.slice(0, 6).map((name, c) => {
      const [a, b] = extremes(low[c] as number[], (thin ? high : low)[c] as number[], Math.max(first, 0), last + 1);
      return a > b ? `${name} -` : `${name} ${a.toPrecision(SIGNIFICANT)} to ${b.toPrecision(SIGNIFICANT)}`;
    });
    this.note.textContent = `${((to - from) * 1000).toFixed(0)} ms: ${parts.join("; ")}`;
  }
}

/** The first of some times that is not before `at`. */
function from(time: number[], at: number): number {
  let [low, high] = [0, time.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((time[middle] as number) < at) low = middle + 1;
    else high = middle;
  }
  return low;
}

function extremes(low: number[], high: number[], first: number, last: number): [number, number] {
  let [least, most] = [Infinity, -Infinity];
  for (let i = first; i < last; i++) {
    if ((low[i] as number) < least) least = low[i] as number;
    if ((high[i] as number) > most) most = high[i] as number;
  }
  return [least, most];
}

/** A number with two digits that count, and no exponent. */
const short = (value: number): string => (value >= 1e6 || value < 1e-4 ? value.toExponential(0) : String(Number(value.toPrecision(2))));

const gaps = (values: number[]): number => values.reduce((n, v, i) => n + Number(v !== v && (i === 0 || values[i - 1] === values[i - 1])), 0);
