// Cycles as they close: per channel the mean with its band, and the last cycle over it.

import { colour, type Page, Panel, shade, Sheet, type Span } from "./panel";
import type { Newest, Stream } from "./store";
import type { PanelInfo } from "./wire";

const CELL_WIDTH = 150;
const CELL_HEIGHT = 92;
const PAD = 6;
const HEAD = 18;

/** Panels' streams: the mean, its standard deviation, and the cycles themselves. */
export class CyclesPanel extends Panel {
  private readonly sheet = new Sheet(this.body, this.height);
  private drawn = -1;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.sheet.canvas.setAttribute("role", "img");
  }

  override restyle(): void {
    this.drawn = -1;
  }

  draw(_span: Span): void {
    const [mean, sd, last] = this.streams;
    const names = mean?.info.channels ?? [];
    const columns = Math.max(1, Math.min(names.length, Math.floor(this.body.clientWidth / CELL_WIDTH)));
    const state = this.streams.reduce((n, s) => n * 31 + s.count, columns * 7 + this.body.clientWidth);
    if (state === this.drawn) return;
    this.drawn = state;
    this.sheet.canvas.style.height = `${Math.ceil(names.length / columns) * CELL_HEIGHT}px`;
    const pen = this.sheet.clear();
    const cell = this.sheet.width / columns;
    names.forEach((name, c) => {
      const [x, y] = [(c % columns) * cell, Math.floor(c / columns) * CELL_HEIGHT];
      this.drawChannel(pen, c, name, x + PAD, y, cell - 2 * PAD, mean?.newest ?? null, sd?.newest ?? null, last?.newest ?? null);
    });
    this.note.textContent = last?.newest ? `${last.newest.count ? `${last.newest.count} cycles; ` : ""}line: last, band: mean ± SD` : "no cycle yet";
    this.stamp();
    this.element.dataset["cycles"] = String((last ?? mean)?.newest?.count ?? 0);
    this.sheet.canvas.setAttribute("aria-label", `${names.length} channels, ${this.note.textContent}`);
  }

  private drawChannel(
    pen: CanvasRenderingContext2D, c: number, name: string, left: number, top: number, width: number,
    mean: Newest | null, sd: Newest | null, last: Newest | null
  ): void {
    const rows = [mean && column(mean, c), sd && column(sd, c), last && column(last, c)];
    const [middle, band, newest] = rows as (number[] | null)[];
    const tops = [...(middle ?? []).map((m, i) => m + (band?.[i] ?? 0)), ...(newest ?? [])].filter((v) => v === v);
    const most = this.info.most ?? (tops.length ? Math.max(...tops) : 1);
    const height = CELL_HEIGHT - HEAD - PAD;
    const y = (v: number) => top + HEAD + height * (1 - Math.max(0, Math.min(1, v / most)));
    const x = (i: number, n: number) => left + (width * i) / Math.max(1, n - 1);
    pen.font = "12px system-ui, sans-serif";
    pen.fillStyle = colour("ink");
    pen.fillText(name, left, top + 12);
    pen.fillStyle = colour("dim");
    pen.textAlign = "right";
    pen.fillText(`${Number(most.toPrecision(2))} ${this.streams[0]?.info.units[0] ?? ""}`, left + width, top + 12);
    pen.textAlign = "left";
    pen.strokeStyle = colour("rule");
    pen.strokeRect(left + 0.5, top + HEAD + 0.5, width, height);
    if (middle && band) {
      pen.beginPath();
      middle.forEach((m, i) => pen.lineTo(x(i, middle.length), y(m + (band[i] ?? 0))));
      for (let i = middle.length - 1; i >= 0; i--) pen.lineTo(x(i, middle.length), y((middle[i] as number) - (band[i] ?? 0)));
      pen.fillStyle = colour("rule");
      pen.fill();
    }
    this.line(pen, middle ?? null, x, y, colour("dim"), 1);
    this.line(pen, newest ?? null, x, y, shade(c), 1.8);
  }

  private line(
    pen: CanvasRenderingContext2D, values: number[] | null, x: (i: number, n: number) => number, y: (v: number) => number, stroke: string, wide: number
  ): void {
    if (!values) return;
    pen.beginPath();
    let down = false;
    values.forEach((v, i) => {
      if (v !== v) down = false;
      else if (down) pen.lineTo(x(i, values.length), y(v));
      else {
        pen.moveTo(x(i, values.length), y(v));
        down = true;
      }
    });
    pen.strokeStyle = stroke;
    pen.lineWidth = wide;
    pen.stroke();
    pen.lineWidth = 1;
  }
}

const column = (newest: Newest, c: number): number[] => {
  const [points, channels] = newest.shape as [number, number];
  return Array.from({ length: points }, (_, i) => newest.data[i * channels + c] as number);
};
