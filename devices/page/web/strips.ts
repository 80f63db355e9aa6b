// The lines of a strip chart, one lane below the other. Many points are painted, column of pixels by column of pixels, into an image: a
// stroke of as many takes ten times as long. Few are stroked.

import { make } from "./panel";

/** Points to a column of pixels from which on lines are painted. */
const DENSE = 0.5;

/** Points of one line: their places in pixels; NaN is a gap. */
export interface Line { x: Float64Array; y: Float64Array; colour: string }
export interface Box { left: number; top: number; width: number; height: number }

export class Strips {
  private readonly canvas = make("canvas");
  private readonly pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;
  private image = new ImageData(1, 1);
  private pixels = new Uint32Array(this.image.data.buffer);
  /** Of each column, what the line covers. */
  private top = new Float32Array(0);
  private bottom = new Float32Array(0);

  /** Draw lines of this thickness into a box of a canvas; places are from the box's corner on. */
  draw(pen: CanvasRenderingContext2D, box: Box, lines: Line[], thickness: number): void {
    const [width, height] = [Math.round(box.width), Math.round(box.height)];
    if (width < 1 || height < 1) return;
    const [dense, few] = [[] as Line[], [] as Line[]];
    for (const line of lines) (line.x.length > DENSE * width ? dense : few).push(line);
    if (dense.length) {
      this.fit(width, height);
      for (const line of dense) this.paint(line, thickness / 2);
      this.pen.putImageData(this.image, 0, 0);
      pen.drawImage(this.canvas, Math.round(box.left), Math.round(box.top));
    }
    pen.save();
    pen.translate(box.left, box.top);
    pen.beginPath();
    pen.rect(0, 0, width, height);
    pen.clip();
    pen.lineWidth = thickness;
    for (const line of few) stroke(pen, line);
    pen.restore();
  }

  private fit(width: number, height: number): void {
    if (this.image.width !== width || this.image.height !== height) {
      this.image = new ImageData(width, height);
      this.pixels = new Uint32Array(this.image.data.buffer);
      [this.canvas.width, this.canvas.height] = [width, height];
      [this.top, this.bottom] = [new Float32Array(width), new Float32Array(width)];
    } else this.pixels.fill(0);
  }

  /** Find what the line covers of each column, then fill row by row. */
  private paint({ x, y, colour }: Line, half: number): void {
    const { top, bottom } = this;
    const { width, height } = this.image;
    top.fill(Infinity);
    bottom.fill(-Infinity);
    const cover = (column: number, a: number, b: number) => {
      if (a < (top[column] as number)) top[column] = a;
      if (b > (bottom[column] as number)) bottom[column] = b;
    };
    for (let i = 0; i < x.length; i++) {
      const toX = x[i] as number;
      const toY = y[i] as number;
      if (toY !== toY) continue;
      if (toX >= 0 && toX < width) cover(Math.floor(toX), toY, toY);
      const fromX = i ? (x[i - 1] as number) : NaN;
      const fromY = i ? (y[i - 1] as number) : NaN;
      if (fromY !== fromY || !(toX > fromX)) continue;
      const slope = (toY - fromY) / (toX - fromX);
      const last = Math.min(width, toX);
      for (let column = Math.max(0, Math.floor(fromX)); column < last; column++) {
        const a = fromY + slope * (Math.max(column, fromX) - fromX);
        const b = fromY + slope * (Math.min(column + 1, toX) - fromX);
        cover(column, Math.min(a, b), Math.max(a, b));
      }
    }
    let highest = Infinity;
    let lowest = -Infinity;
    for (let column = 0; column < width; column++) {
      if ((top[column] as number) > (bottom[column] as number)) continue;
      highest = Math.min(highest, top[column] = (top[column] as number) - half);
      lowest = Math.max(lowest, bottom[column] = (bottom[column] as number) + half);
    }
    this.fill(Math.max(0, Math.floor(highest)), Math.min(height, Math.ceil(lowest)), colour);
  }

  private fill(first: number, last: number, colour: string): void {
    const { top, bottom, pixels } = this;
    const { width } = this.image;
    const [red, green, blue] = [1, 3, 5].map((i) => parseInt(colour.slice(i, i + 2), 16)) as [number, number, number];
    const clear = ((blue << 16) | (green << 8) | red) >>> 0;
    const full = (clear | 0xff000000) >>> 0;
    for (let row = first; row < last; row++) {
      const begin = row * width;
      for (let column = 0; column < width; column++) {
        const a = top[column] as number;
        const b = bottom[column] as number;
        if (a >= row + 1 || b <= row) continue;
        const share = Math.min(b, row + 1) - Math.max(a, row);
        if (share >= 1) pixels[begin + column] = full;
        else if (!pixels[begin + column]) pixels[begin + column] = (clear | (Math.round(255 * share) << 24)) >>> 0;
      }
    }
  }
}

function stroke(pen: CanvasRenderingContext2D, { x, y, colour }: Line): void {
  pen.strokeStyle = colour;
  pen.lineJoin = "round";
  pen.beginPath();
  let there = false;
  for (let i = 0; i < x.length; i++) {
    const is = y[i] === y[i];
    if (is && there) pen.lineTo(x[i] as number, y[i] as number);
    else if (is) pen.moveTo(x[i] as number, y[i] as number);
    there = is;
  }
  pen.stroke();
}
