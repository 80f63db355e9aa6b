// A strip chart's other views: the spectrum of all its channels, or the spectrogram of one, made by the server when it is asked.

import { TABLE } from "./frame";
import { colour, type Page, shade, Sheet, type Span } from "./panel";
import type { Stream } from "./store";
import type { SpectrumMessage } from "./wire";

export type View = "lines" | "spectrum" | "spectrogram";

const PAUSE_MS = 300;
const PATIENCE_MS = 5000;
const LEFT = 56;
const FOOT = 20;
/** As many dB below the largest value are shown. */
const DEPTH_DB = 80;

export class Analysis {
  readonly sheet: Sheet;
  private message: SpectrumMessage | null = null;
  private times = new Float64Array(0);
  private values = new Float32Array(0);
  private asked = -Infinity;
  private waiting = false;
  private key = "";

  constructor(private readonly host: HTMLElement, height: number, private readonly stream: Stream, private readonly page: Page) {
    this.sheet = new Sheet(host, height);
    this.sheet.canvas.setAttribute("role", "img");
    this.sheet.canvas.setAttribute("aria-label", "nothing yet");
    this.show(false);
  }

  show(shown: boolean): void {
    if (shown) this.host.append(this.sheet.canvas);
    else this.sheet.canvas.remove();
    if (!shown) this.message = null;
    this.key = "";
  }

  take(message: SpectrumMessage, buffer: ArrayBuffer, at: number): void {
    this.waiting = false;
    const { bins, windows } = message;
    const lead = message.t === "spectrogram" ? windows : 0;
    this.times = new Float64Array(buffer, at, lead);
    const size = message.t === "spectrogram" ? bins * windows : bins * Math.max(1, this.stream.info.shape[0] ?? 1);
    this.values = new Float32Array(buffer, at + 8 * lead, bins ? size : 0);
    this.message = message;
  }

  /** Draw what came last, and ask for what is to be seen now; the loudest frequency in Hz, NaN where there is none. */
  draw(view: "spectrum" | "spectrogram", channel: number, span: Span): number {
    this.ask(view, channel, span);
    const pen = this.sheet.clear();
    pen.font = "12px system-ui, sans-serif";
    const { message } = this;
    if (message?.t !== view || !message.bins) {
      pen.fillStyle = colour("dim");
      pen.fillText(message?.t === view ? "too few samples without a gap" : "asked for", LEFT + 8, 24);
      return NaN;
    }
    return view === "spectrum" ? this.lines(pen, message) : this.map(pen, message, span);
  }

  private ask(what: View, channel: number, { begin, end }: Span): void {
    const now = performance.now();
    if (now - this.asked < PAUSE_MS || (this.waiting && now - this.asked < PATIENCE_MS)) return;
    const key = `${what} ${channel} ${begin} ${end}`;
    if (key === this.key && this.message) return;
    this.waiting = this.page.ask({ do: "analyse", stream: this.stream.number, what, begin, end, channel });
    this.asked = now;
    this.key = key;
  }

  private lines(pen: CanvasRenderingContext2D, { bins, bin_hz }: SpectrumMessage): number {
    const level = this.values.map((v) => 10 * Math.log10(Math.max(v, 1e-30)));
    const most = Math.ceil(level.reduce((a, b) => Math.max(a, b), -Infinity) / 10) * 10;
    const least = Math.max(most - DEPTH_DB, Math.floor(level.reduce((a, b) => Math.min(a, b), Infinity) / 10) * 10);
    const { width, height } = this.sheet;
    const x = (k: number) => LEFT + ((width - LEFT - 8) * k) / (bins - 1);
    const y = (v: number) => 6 + (height - FOOT - 6) * (1 - Math.max(0, (v - least) / Math.max(1, most - least)));
    this.frequencies(pen, bins * bin_hz, (hz) => x(hz / bin_hz), true);
    pen.textAlign = "right";
    for (let v = least; v <= most; v += 20) {
      pen.fillStyle = colour("rule");
      pen.fillRect(LEFT, y(v), width - LEFT - 8, 0.5);
      pen.fillStyle = colour("dim");
      pen.fillText(`${v} dB`, LEFT - 4, y(v) + 4);
    }
    pen.textAlign = "left";
    let [loudest, peak] = [-Infinity, NaN];
    for (let c = 0; c < level.length / bins; c++) {
      pen.beginPath();
      for (let k = 0; k < bins; k++) {
        const v = level[c * bins + k] as number;
        pen.lineTo(x(k), y(v));
        if (k && v > loudest) [loudest, peak] = [v, k * bin_hz];
      }
      pen.strokeStyle = shade(c);
      pen.stroke();
    }
    return peak;
  }

  private map(pen: CanvasRenderingContext2D, { bins, bin_hz, windows, hop }: SpectrumMessage, span: Span): number {
    const { width, height } = this.sheet;
    const step = hop ?? 1;
    const [first, last] = [this.times[0] as number, this.times[windows - 1] as number];
    const columns = Math.round((last - first) / step) + 1;
    const image = new ImageData(columns, bins);
    const pixels = new Uint32Array(image.data.buffer);
    const most = this.values.reduce((a, b) => Math.max(a, b), -Infinity);
    let [loudest, peak] = [-Infinity, NaN];
    for (let w = 0; w < windows; w++) {
      const column = Math.round(((this.times[w] as number) - first) / step);
      for (let k = 0; k < bins; k++) {
        const v = this.values[w * bins + k] as number;
        if (k && v > loudest) [loudest, peak] = [v, k * bin_hz];
        if (v !== v) continue;
        const shown = Math.max(0, Math.min(255, Math.round(255 * (1 - (most - v) / DEPTH_DB))));
        pixels[(bins - 1 - k) * columns + column] = TABLE[shown] as number;
      }
    }
    const canvas = document.createElement("canvas");
    canvas.width = columns;
    canvas.height = bins;
    (canvas.getContext("2d") as CanvasRenderingContext2D).putImageData(image, 0, 0);
    pen.imageSmoothingEnabled = false;
    const x = (t: number) => LEFT + ((width - LEFT - 8) * (t - span.begin)) / (span.end - span.begin);
    pen.save();
    pen.beginPath();
    pen.rect(LEFT, 0, width - LEFT - 8, height);
    pen.clip();
    pen.drawImage(canvas, x(first - step / 2), 4, x(last + step / 2) - x(first - step / 2), height - FOOT - 4);
    pen.restore();
    const y = (hz: number) => 4 + (height - FOOT - 4) * (1 - hz / (bins * bin_hz));
    this.frequencies(pen, bins * bin_hz, y, false);
    pen.fillStyle = colour("dim");
    for (const share of [0.02, 0.5, 0.9]) pen.fillText(this.page.clock(span.begin + share * (span.end - span.begin)), LEFT + share * (width - LEFT - 8), height - 5);
    return peak;
  }

  private frequencies(pen: CanvasRenderingContext2D, most: number, place: (hz: number) => number, across: boolean): void {
    const raw = most / 6;
    const ten = 10 ** Math.floor(Math.log10(raw));
    const step = ten * ([1, 2, 5, 10].find((k) => k * ten >= raw) ?? 10);
    pen.fillStyle = colour("dim");
    for (let hz = 0; hz <= most; hz += step) {
      const text = `${Number(hz.toPrecision(3))} Hz`;
      if (across) pen.fillText(text, Math.min(place(hz), this.sheet.width - 50), this.sheet.height - 5);
      else pen.fillText(text, 2, Math.max(10, place(hz) + 4), LEFT - 4);
    }
  }
}
