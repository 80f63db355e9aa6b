// The two views of the map: the grid of cells with their poses, and the PCA; trajectories, outliers, places that move.

import { type Body, drawPose, type Eye, extent } from "./map_pose";
import type { CellSet, MapHello, NearMessage, PointSet, PoseSet } from "./map_wire";
import { colour, make } from "./panel";

/** What both views show. */
export interface Shown {
  hello: MapHello; points: PointSet | null; cells: CellSet | null; body: Body; eye: Eye;
  chosen: Set<number>; tint(sequence: number): string; quantile: number;
  moving: PoseSet | null; picked: PoseSet | null; near: NearMessage | null; nearPoses: PoseSet | null; cell: number; of(frame: number): number;
}
type Place = (k: number, set: { pca: Float32Array; som: Float32Array }) => [number, number];

abstract class MapView {
  readonly canvas = make("canvas");
  protected readonly pen = this.canvas.getContext("2d") as CanvasRenderingContext2D;

  constructor(protected readonly size: number) {
    this.canvas.width = this.canvas.height = size;
  }

  protected abstract ground(shown: Shown): void;
  protected abstract place(shown: Shown): Place;

  draw(shown: Shown): void {
    const { pen } = this;
    pen.clearRect(0, 0, this.size, this.size);
    if (!shown.points) return;
    this.ground(shown);
    const place = this.place(shown);
    this.trajectories(shown, shown.points, place);
    this.outliers(shown, shown.points, place);
    const ring = (set: PoseSet | null, wide: number, tint: (frame: number) => string, filled: boolean) => set?.numbers.forEach((frame, k) => {
      if ((set.cell[k] as number) < 0) return;
      pen.beginPath();
      pen.arc(...place(k, set), wide, 0, 7);
      pen.strokeStyle = filled ? colour("panel") : tint(frame);
      pen.fillStyle = tint(frame);
      pen.lineWidth = 2;
      if (filled) pen.fill();
      pen.stroke();
    });
    ring(shown.nearPoses, 6, () => colour("accent"), false);
    ring(shown.picked, 9, () => colour("ink"), false);
    ring(shown.moving, 7, (frame) => shown.tint(shown.of(frame)), true);
    pen.lineWidth = 1;
  }

  /** The point nearest to a place on the canvas: its frame, or -1. */
  nearest(shown: Shown, x: number, y: number): number {
    if (!shown.points) return -1;
    const place = this.place(shown);
    let best = -1, least = 20 * 20;
    for (let k = 0; k < shown.points.n; k++) {
      const [a, b] = place(k, shown.points);
      const apart = (a - x) ** 2 + (b - y) ** 2;
      if (apart < least) [best, least] = [k, apart];
    }
    return best < 0 ? -1 : (shown.points.frames[best] as number);
  }

  private trajectories(shown: Shown, points: PointSet, place: Place): void {
    const { pen } = this;
    const gap = 1.5 * shown.hello.step;
    for (const s of shown.chosen) {
      const one = shown.hello.sequences[s];
      if (!one) continue;
      pen.strokeStyle = shown.tint(s);
      pen.globalAlpha = 0.55;
      pen.beginPath();
      let before = -Infinity, drawn = 0;
      for (let k = lowest(points.frames, one.first); k < points.n && (points.frames[k] as number) < one.last; k++) {
        const [x, y] = place(k, points), frame = points.frames[k] as number;
        frame - before > gap ? pen.moveTo(x, y) : pen.lineTo(x, y);
        before = frame;
        drawn++;
      }
      pen.stroke();
      pen.globalAlpha = 1;
      this.canvas.dataset["trajectory"] = `${s}:${drawn}`;
    }
  }

  private outliers(shown: Shown, points: PointSet, place: Place): void {
    const { pen } = this, least = 65535 * shown.quantile;
    pen.strokeStyle = colour("bad");
    let found = 0;
    for (let k = 0; k < points.n; k++) {
      if ((points.rank[k] as number) <= least || !shown.chosen.has(shown.of(points.frames[k] as number))) continue;
      const [x, y] = place(k, points);
      pen.beginPath();
      pen.arc(x, y, 4, 0, 7);
      pen.stroke();
      found++;
    }
    this.canvas.dataset["outliers"] = String(found);
  }
}

/** The first place in rising numbers that holds at least this one. */
export function lowest(numbers: Int32Array, wanted: number): number {
  let [low, high] = [0, numbers.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((numbers[middle] as number) < wanted) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** The grid: each cell a bundle of its poses and their mean; the more poses, the darker. */
export class GridView extends MapView {
  protected ground(shown: Shown): void {
    const { cells, hello } = shown, { pen } = this;
    if (!cells) return;
    const side = this.side(shown), counts = [...Array(hello.rows * hello.columns).keys()].map((c) => held(cells, c)), most = Math.max(1, ...counts);
    const view = extent(cells.mean, shown.eye);
    counts.forEach((count, c) => {
      const box = { x: side * (c % hello.columns), y: side * Math.floor(c / hello.columns), width: side, height: side };
      pen.globalAlpha = 0.3 * Math.sqrt(count / most);
      pen.fillStyle = colour("accent");
      pen.fillRect(box.x, box.y, side - 1, side - 1);
      pen.globalAlpha = 0.25;
      for (let k = 0; k < cells.many; k++) drawPose(pen, cells.bundle, c * cells.many + k, shown.body, shown.eye, box, view, colour("dim"), 0);
      pen.globalAlpha = 1;
      drawPose(pen, cells.mean, c, shown.body, shown.eye, box, view, colour("ink"), 1.8);
      if (c === shown.cell) pen.strokeRect(box.x + 1, box.y + 1, side - 3, side - 3);
    });
  }

  protected place(shown: Shown): Place {
    const side = this.side(shown);
    return (k, set) => [side * ((set.som[2 * k] as number) + 0.5), side * ((set.som[2 * k + 1] as number) + 0.5)];
  }

  /** The number of the cell at a place. */
  cellAt(shown: Shown, x: number, y: number): number {
    const side = this.side(shown), [column, row] = [Math.floor(x / side), Math.floor(y / side)];
    return column >= 0 && column < shown.hello.columns && row >= 0 && row < shown.hello.rows ? row * shown.hello.columns + column : -1;
  }

  private side(shown: Shown): number {
    return this.size / Math.max(shown.hello.rows, shown.hello.columns);
  }
}

/** How many poses a cell has. */
export const held = (cells: CellSet, c: number): number => cells.held.subarray(c * cells.sequences, (c + 1) * cells.sequences).reduce((a, b) => a + b, 0);

/** The PCA: all poses as dots, those that are not drawn as density. */
export class PlaneView extends MapView {
  protected ground(shown: Shown): void {
    const points = shown.points as PointSet, { pen } = this, place = this.place(shown);
    const most = points.density.reduce((a, b) => Math.max(a, b), 0), { bins, low, high } = points;
    pen.fillStyle = colour("accent");
    for (let i = 0; i < bins * bins; i++) {
      const count = points.density[i] as number;
      if (!count) continue;
      const at = (x: number, y: number) => place(0, { pca: Float32Array.of(low[0] + (x * (high[0] - low[0])) / bins, low[1] + (y * (high[1] - low[1])) / bins), som: points.som });
      const [[a, b], [c, d]] = [at(i % bins, Math.floor(i / bins)), at((i % bins) + 1, Math.floor(i / bins) + 1)];
      pen.globalAlpha = 0.35 * Math.sqrt(count / most);
      pen.fillRect(Math.min(a, c), Math.min(b, d), Math.abs(c - a) + 0.5, Math.abs(d - b) + 0.5);
    }
    this.canvas.dataset["density"] = String(bins);
    pen.globalAlpha = 0.5;
    pen.fillStyle = colour("dim");
    for (let k = 0; k < points.n; k++) {
      const [x, y] = place(k, points);
      pen.fillRect(x, y, 1.2, 1.2);
    }
    pen.globalAlpha = 1;
  }

  protected place(shown: Shown): Place {
    const { low, high } = shown.points as PointSet;
    const scale = (0.92 * this.size) / Math.max(high[0] - low[0], high[1] - low[1], 1e-9);
    return (k, set) => [
      this.size / 2 + scale * ((set.pca[2 * k] as number) - (low[0] + high[0]) / 2), this.size / 2 - scale * ((set.pca[2 * k + 1] as number) - (low[1] + high[1]) / 2),
    ];
  }
}
