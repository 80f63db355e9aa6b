// A heat map of frames: a colour scale in the stream's unit, pixels without a value hatched.

import { make, type Page, Panel, type Span } from "./panel";
import type { Stream } from "./store";
import type { PanelInfo } from "./wire";

/** Viridis, at nine places. */
const STOPS = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121], [144, 215, 67], [253, 231, 37]];
const STEPS = 256;
const METRES_PER_MM = 0.001;

/** Colours as little-endian RGBA. */
export const TABLE = Uint32Array.from({ length: STEPS }, (_, i) => {
  const place = (i / (STEPS - 1)) * (STOPS.length - 1);
  const [a, b] = [STOPS[Math.floor(place)] as number[], STOPS[Math.ceil(place)] as number[]];
  const [r, g, blue] = [0, 1, 2].map((k) => Math.round((a[k] as number) + ((b[k] as number) - (a[k] as number)) * (place % 1)));
  return (255 << 24) | ((blue as number) << 16) | ((g as number) << 8) | (r as number);
});
const HATCH = [0xff000000 | 0x303030, 0xff000000 | 0xa0a0a0];

export class FramePanel extends Panel {
  private readonly canvas = make("canvas", { role: "img", "aria-label": "no picture yet" });
  private readonly legend = make("div", { class: "legend" });
  private readonly bar = make("canvas", { width: "128", height: "10", "aria-hidden": "true" });
  private readonly limits = make("span");
  private least = NaN;
  private most = NaN;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.canvas.style.width = "100%";
    this.canvas.style.imageRendering = "pixelated";
    this.legend.append(this.bar, this.limits);
    this.body.append(this.canvas, this.legend);
    const pen = this.bar.getContext("2d") as CanvasRenderingContext2D;
    const image = pen.createImageData(128, 10);
    const pixels = new Uint32Array(image.data.buffer);
    for (let i = 0; i < pixels.length; i++) pixels[i] = TABLE[(i % 128) * 2] as number;
    pen.putImageData(image, 0, 0);
  }

  draw(_span: Span): void {
    const newest = this.streams[0]?.newest;
    if (!newest) return;
    const [h, w] = newest.shape as [number, number];
    const pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;
    if (this.canvas.width !== w || this.canvas.height !== h) {
      this.canvas.width = w;
      this.canvas.height = h;
      this.canvas.style.maxHeight = "26rem";
      this.canvas.style.objectFit = "contain";
    }
    const isDepth = newest.data instanceof Uint16Array;
    const valid = (v: number) => v === v && !(isDepth && v === 0);
    this.rescale(newest.data, valid);
    const image = pen.createImageData(w, h);
    const pixels = new Uint32Array(image.data.buffer);
    const scale = (STEPS - 1) / Math.max(this.most - this.least, 1e-9);
    let invalid = 0;
    for (let i = 0; i < pixels.length; i++) {
      const v = newest.data[i] as number;
      if (valid(v)) pixels[i] = TABLE[Math.max(0, Math.min(STEPS - 1, Math.round((v - this.least) * scale)))] as number;
      else {
        pixels[i] = HATCH[((i % w) + Math.floor(i / w)) % 4 ? 0 : 1] as number;
        invalid++;
      }
    }
    pen.putImageData(image, 0, 0);
    this.tell(invalid, pixels.length);
    this.stamp();
  }

  private rescale(data: ArrayLike<number>, valid: (v: number) => boolean): void {
    const { least, most } = this.info;
    let [a, b] = [Infinity, -Infinity];
    for (let i = 0; i < data.length; i++) {
      const v = data[i] as number;
      if (!valid(v)) continue;
      if (v < a) a = v;
      if (v > b) b = v;
    }
    if (a > b) [a, b] = [0, 1];
    const slow = (old: number, now: number, keep: boolean) => (this.page.recording || Number.isNaN(old) || !keep ? now : old + (now - old) * 0.1);
    this.least = least ?? slow(this.least, a, a > this.least);
    this.most = most ?? slow(this.most, b, b < this.most);
  }

  private tell(invalid: number, all: number): void {
    const unit = this.streams[0]?.info.units[0] ?? "";
    const [scale, shown] = unit === "mm" ? [METRES_PER_MM, "m"] : [1, unit];
    const text = `${(this.least * scale).toPrecision(3)} to ${(this.most * scale).toPrecision(3)} ${shown}; hatched: no value (${((100 * invalid) / all).toFixed(0)} %)`;
    this.limits.textContent = text;
    this.canvas.setAttribute("aria-label", `heat map, ${text}`);
    this.element.dataset["invalid"] = String(invalid);
    this.element.dataset["least"] = String(this.least);
  }
}
