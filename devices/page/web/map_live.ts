// The live map: where the newest pose lies, and how it came there; of a grid, its cells with their poses (docs/method/motion-map.md).

import { type Body, drawPose, extent, type Eye } from "./map_pose";
import { colour, type Page, Panel, Sheet, shade, type Span } from "./panel";
import type { Stream } from "./store";
import type { PanelInfo } from "./wire";

/** Places are kept so long, and so many are drawn. */
const KEEP_S = 600, MOST_DRAWN = 4000;
/** How large the markers of a pose are that no lines join. */
const DOT = 3;
const EYE: Eye = { turn: 0, tip: 0.1 };
/** From places of the map to places on the sheet. */
type Place = (x: number, y: number) => [number, number];

export class LiveMapPanel extends Panel {
  private readonly sheet: Sheet;
  private readonly path: Stream | undefined;
  private readonly cells: Stream | undefined;
  private readonly shares: Stream | undefined;
  private readonly figure: Body;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.sheet = new Sheet(this.body, 1.5 * this.height);
    [this.path, this.shares] = streams.filter((s) => s.info.kind === "signal");
    this.cells = streams.find((s) => s.info.kind === "curves");
    if (this.path) this.path.keep_s = KEEP_S;
    this.figure = bodyOf(this.cells);
  }

  draw(span: Span): void {
    const pen = this.sheet.clear(), signal = this.path?.signal;
    if (!signal) return;
    const { time, low: [xs, ys] } = signal;
    if (!xs || !ys) return;
    const until = this.page.recording ? span.at : Infinity;
    let last = time.length - 1;
    while (last >= 0 && (time[last] as number) > until) last--;
    const place = this.cells ? this.ground(pen) : this.spread(xs, ys, last);
    if (!place) return;
    const known = (i: number) => !Number.isNaN((xs[i] as number) + (ys[i] as number));
    const step = Math.max(1, Math.ceil((last + 1) / MOST_DRAWN));
    pen.fillStyle = colour("dim");
    pen.globalAlpha = 0.5;
    for (let i = 0; i <= last; i += step) if (known(i)) pen.fillRect(...place(xs[i] as number, ys[i] as number), 1.5, 1.5);
    pen.globalAlpha = 1;
    this.trail(pen, span.end - span.begin, last, place);
    while (last >= 0 && !known(last)) last--;
    if (last < 0) return;
    const [x, y] = place(xs[last] as number, ys[last] as number);
    pen.beginPath();
    pen.arc(x, y, 7, 0, 7);
    pen.fillStyle = shade(1);
    pen.fill();
    this.element.dataset["place"] = JSON.stringify([xs[last], ys[last]]);
    this.element.dataset["spot"] = JSON.stringify([x, y]);
    this.tell();
  }

  /** The way of the newest seconds, as long as the page shows. */
  private trail(pen: CanvasRenderingContext2D, window_s: number, last: number, place: Place): void {
    const { time, low: [xs, ys] } = (this.path as Stream).signal;
    pen.strokeStyle = shade(0);
    pen.beginPath();
    let first = last, draws = false;
    while (first > 0 && (time[first - 1] as number) > (time[last] as number) - window_s) first--;
    for (let i = first; i <= last; i++) {
      const [x, y] = [xs?.[i] as number, ys?.[i] as number];
      if (Number.isNaN(x + y)) { draws = false; continue; }
      draws ? pen.lineTo(...place(x, y)) : pen.moveTo(...place(x, y));
      draws = true;
    }
    pen.stroke();
  }

  /** The cells with their poses, in rows of `columns`; null before the first map. */
  private ground(pen: CanvasRenderingContext2D): Place | null {
    const newest = this.cells?.newest, columns = this.cells?.info.columns ?? 1;
    if (!newest) return null;
    const count = newest.shape[0] as number, side = Math.min(this.sheet.width / columns, this.sheet.height / Math.ceil(count / columns));
    const poses = newest.data as Float32Array, view = extent(poses, EYE);
    const left = Math.max(0, (this.sheet.width - side * columns) / 2);
    for (let c = 0; c < count; c++) {
      const box = { x: left + side * (c % columns), y: side * Math.floor(c / columns), width: side, height: side };
      pen.strokeStyle = colour("rule");
      pen.strokeRect(box.x, box.y, side, side);
      if (this.figure.markers.length) drawPose(pen, poses, c, this.figure, EYE, box, view, colour("ink"), this.figure.bones.length ? 1.5 : DOT);
    }
    this.element.dataset["cells"] = String(count);
    return (x, y) => [left + side * (x + 0.5), side * (y + 0.5)];
  }

  /** All places fit the sheet, one scale for both axes. */
  private spread(xs: number[], ys: number[], last: number): Place | null {
    let [left, right, bottom, top] = [Infinity, -Infinity, Infinity, -Infinity];
    for (let i = 0; i <= last; i++) {
      const [x, y] = [xs[i] as number, ys[i] as number];
      if (Number.isNaN(x + y)) continue;
      [left, right, bottom, top] = [Math.min(left, x), Math.max(right, x), Math.min(bottom, y), Math.max(top, y)];
    }
    if (left > right) return null;
    const scale = 0.9 * Math.min(this.sheet.width / Math.max(right - left, 1e-9), this.sheet.height / Math.max(top - bottom, 1e-9));
    return (x, y) => [this.sheet.width / 2 + scale * (x - (left + right) / 2), this.sheet.height / 2 - scale * (y - (bottom + top) / 2)];
  }

  private tell(): void {
    const shares = this.shares?.signal.low.map((values) => values.at(-1) ?? NaN) ?? [];
    if (shares.length && !shares.some(Number.isNaN)) this.note.textContent = `${shares.map((s) => (100 * s).toFixed(0)).join(" + ")} % of the variance`;
  }
}

/** The markers whose coordinates the cells hold (`name.x`, `name.y`, `name.z`, one after the other), and what joins them; none, if it is no poses. */
function bodyOf(cells: Stream | undefined): Body {
  const names = cells?.info.channels ?? [], markers = names.filter((_, i) => i % 3 === 0).map((n) => n.replace(/\.x$/, ""));
  const poses = names.every((n, i) => n === `${markers[Math.floor(i / 3)]}.${"xyz"[i % 3]}`);
  if (!poses || !names.length) return { markers: [], bones: [], chosen: new Set() };
  const bones = (cells?.info.bones ?? []).map((pair) => pair.map((end) => (typeof end === "number" ? end : markers.indexOf(end))) as [number, number]);
  return { markers, bones: bones.filter(([a, b]) => a >= 0 && b >= 0), chosen: new Set() };
}
