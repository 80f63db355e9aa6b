// How alike moments are, as a square that grows: from a stream that gives, of each moment, its distance to those before it.

import { TABLE } from "./frame";
import { make, type Page, Panel, type Span } from "./panel";
import type { Stream } from "./store";
import type { PanelInfo } from "./wire";

const KEEP_S = 3600;

export class SimilarityPanel extends Panel {
  private readonly canvas = make("canvas", { role: "img", "aria-label": "nothing yet" });
  private drawn = "";

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    for (const stream of streams) stream.keep_s = KEEP_S;
    Object.assign(this.canvas.style, { width: "100%", maxHeight: `${this.height * 1.5}px`, objectFit: "contain", imageRendering: "pixelated" });
    this.body.append(this.canvas);
  }

  draw(span: Span): void {
    const [stream] = this.streams;
    if (!stream) return;
    const { time, low } = stream.signal;
    const lags = low.length;
    let last = time.length - 1;
    while (this.page.recording && last >= 0 && (time[last] as number) > span.at) last--;
    const n = Math.min(lags + 1, last + 1);
    const key = `${n} ${time[last]} ${this.info.most}`;
    if (n < 2 || key === this.drawn) return;
    this.drawn = key;
    const value = (i: number, j: number): number => (i === j ? 0 : ((low[i - j - 1] as number[])[last - (n - 1) + i] as number));
    const most = this.info.most ?? this.largest(n, value);
    const image = new ImageData(n, n);
    const pixels = new Uint32Array(image.data.buffer);
    for (let i = 0; i < n; i++) {
      for (let j = 0; j <= i; j++) {
        const v = value(i, j);
        if (v === v) pixels[i * n + j] = pixels[j * n + i] = TABLE[Math.round(255 * (1 - Math.min(1, v / most)))] as number;
      }
    }
    this.canvas.width = this.canvas.height = n;
    (this.canvas.getContext("2d") as CanvasRenderingContext2D).putImageData(image, 0, 0);
    this.tell(n, most, time[last - n + 1] as number, time[last] as number);
  }

  private largest(n: number, value: (i: number, j: number) => number): number {
    let most = 0;
    for (let i = 1; i < n; i++) for (let j = 0; j < i; j++) if (value(i, j) > most) most = value(i, j);
    return most || 1;
  }

  private tell(n: number, most: number, from: number, to: number): void {
    const unit = this.streams[0]?.info.units[0] ?? "";
    const text = `${this.page.clock(from)} to ${this.page.clock(to)}; light: alike, dark: ${Number(most.toPrecision(2))} ${unit} apart`;
    this.note.textContent = text;
    this.canvas.setAttribute("aria-label", `self-similarity, ${text}`);
    this.element.dataset["size"] = String(n);
    this.element.dataset["most"] = String(most);
    this.element.dataset["until"] = to.toFixed(6);
  }
}
