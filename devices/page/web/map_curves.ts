// Sequences in detail: chosen markers over time, from the side or from above, outliers shaded, two over one another with their difference.

import type { Shown } from "./map_views";
import type { Curve } from "./map_wire";
import { colour, make, shade } from "./panel";

/** When a sequence stands where on the common time: its own second `scale * t + shift`. */
export interface Pace { shift: number; scale: number }
const HEIGHT = 110, WIDTH = 1180;

/** What one row shows. */
export interface CurveRow { sequence: number; curve: Curve; pace: Pace }

export class CurveView {
  readonly canvas = make("canvas", { width: String(WIDTH), height: String(HEIGHT) });
  private readonly pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;

  /** Draw the chosen markers of one sequence, or of two over one another; coordinate 1 is seen from the side, 2 from above. */
  draw(shown: Shown, rows: CurveRow[], coordinate: 1 | 2, from: number, until: number, at: number): void {
    const { pen } = this;
    pen.clearRect(0, 0, WIDTH, HEIGHT);
    const x = (t: number) => ((t - from) / Math.max(until - from, 1e-9)) * WIDTH;
    const [low, high] = this.limits(shown, rows, coordinate);
    const y = (v: number) => HEIGHT - 6 - ((v - low) / Math.max(high - low, 1e-9)) * (HEIGHT - 12);
    rows.forEach((row, r) => {
      if (r === 0) this.shadeOutliers(shown, row, x);
      for (const m of shown.body.chosen) {
        pen.strokeStyle = shade(m);
        pen.setLineDash(r ? [4, 3] : []);
        pen.beginPath();
        let open = false;
        row.curve.frames.forEach((_, k) => {
          const value = row.curve.poses[3 * (k * shown.body.markers.length + m) + coordinate] as number;
          if (Number.isNaN(value)) open = false;
          else {
            open ? pen.lineTo(x(this.time(shown, row, k)), y(value)) : pen.moveTo(x(this.time(shown, row, k)), y(value));
            open = true;
          }
        });
        pen.stroke();
      }
    });
    pen.setLineDash([]);
    pen.strokeStyle = colour("ink");
    pen.strokeRect(x(at), 0, 0.5, HEIGHT);
  }

  /** The rms distance (in the poses' unit) of the chosen markers of two sequences, over the time that they share; NaN without one. */
  static difference(shown: Shown, [a, b]: [CurveRow, CurveRow]): number {
    const many = shown.body.markers.length;
    let total = 0, count = 0;
    const view = new CurveView();
    let j = 0;
    for (let k = 0; k < a.curve.frames.length; k++) {
      const t = view.time(shown, a, k);
      while (j + 1 < b.curve.frames.length && view.time(shown, b, j + 1) <= t) j++;
      if (view.time(shown, b, j) > t || t > view.time(shown, b, b.curve.frames.length - 1)) continue;
      for (const m of shown.body.chosen) for (let c = 0; c < 3; c++) {
        const off = (a.curve.poses[3 * (k * many + m) + c] as number) - (b.curve.poses[3 * (j * many + m) + c] as number);
        if (!Number.isNaN(off)) [total, count] = [total + off * off, count + 1 / 3];
      }
    }
    return Math.sqrt(total / count);
  }

  private time(shown: Shown, row: CurveRow, k: number): number {
    const first = shown.hello.sequences[row.sequence]?.first ?? 0;
    return (((row.curve.frames[k] as number) - first) / shown.hello.rate_hz - row.pace.shift) / row.pace.scale;
  }

  private limits(shown: Shown, rows: CurveRow[], coordinate: number): [number, number] {
    let [low, high] = [Infinity, -Infinity];
    for (const { curve } of rows) for (const m of shown.body.chosen) for (let k = 0; k < curve.frames.length; k++) {
      const value = curve.poses[3 * (k * shown.body.markers.length + m) + coordinate] as number;
      if (!Number.isNaN(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
    }
    return [low, high];
  }

  private shadeOutliers(shown: Shown, row: CurveRow, x: (t: number) => number): void {
    this.pen.fillStyle = colour("dim");
    this.pen.globalAlpha = 0.35;
    let found = 0;
    row.curve.rank.forEach((rank, k) => {
      if (rank <= 65535 * shown.quantile) return;
      const begin = x(this.time(shown, row, k));
      this.pen.fillRect(begin, 0, Math.max(1.5, x(this.time(shown, row, k + 1 < row.curve.rank.length ? k + 1 : k)) - begin), HEIGHT);
      found++;
    });
    this.pen.globalAlpha = 1;
    this.canvas.dataset["shaded"] = String(found);
  }
}
