// Where the bed is: drawn and dragged on what the camera sees now. Frames are shown and forgotten.

import { useEffect, useRef, useState } from "preact/hooks";
import { TABLE } from "./frame";
import { CLIENT, type Value } from "./lab_api";
import type { Values } from "./lab_form";

/** First row, first column, rows, columns, in the camera's pixels. */
type Region = [number, number, number, number];
interface Frame { rows: number; columns: number; step: number }
interface Grip { index: number; corner: boolean; x: number; y: number; from: Region }

const HEADER_BYTES = 12;
const LEAST_PX = 16;
/** The middle of the picture, where no region is known yet. */
const MIDDLE = [0.2, 0.25, 0.6, 0.5] as const;

const isRegions = (value: Value | undefined): value is Region[] =>
  Array.isArray(value) && value.length > 0 && value.every((one) => Array.isArray(one) && one.length === 4 && one.every((n) => typeof n === "number"));

/** Depth as colours: near is bright. Pixels without a value are black. */
function paint(canvas: HTMLCanvasElement, { rows, columns }: Frame, depth: Uint16Array): void {
  if (canvas.width !== columns || canvas.height !== rows) Object.assign(canvas, { width: columns, height: rows });
  const known = depth.filter((d) => d > 0).sort();
  const [near, far] = [known[Math.floor(known.length * 0.02)] ?? 0, known[Math.floor(known.length * 0.98)] ?? 1];
  const pen = canvas.getContext("2d") as CanvasRenderingContext2D;
  const image = pen.createImageData(columns, rows);
  const pixels = new Uint32Array(image.data.buffer);
  const scale = (TABLE.length - 1) / Math.max(1, far - near);
  depth.forEach((d, i) => { pixels[i] = d ? (TABLE[Math.max(0, Math.min(TABLE.length - 1, Math.round((far - d) * scale)))] as number) : 0xff000000; });
  pen.putImageData(image, 0, 0);
}

/** Frames as they come, until the signal ends it. */
async function watch(body: object, signal: AbortSignal, take: (frame: Frame, depth: Uint16Array) => void): Promise<void> {
  const answer = await fetch("api/look", { method: "POST", signal, headers: { "X-Client": CLIENT, "Content-Type": "application/json" }, body: JSON.stringify(body) });
  if (!answer.ok || !answer.body) throw new Error(((await answer.json()) as { error: string }).error);
  const reader = answer.body.getReader();
  let kept = new Uint8Array(0);
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    const all = new Uint8Array(kept.length + value.length);
    all.set(kept);
    all.set(value, kept.length);
    kept = all;
    while (kept.length >= HEADER_BYTES) {
      const [rows, columns, step] = new Uint32Array(kept.slice(0, HEADER_BYTES).buffer) as unknown as [number, number, number];
      const end = HEADER_BYTES + 2 * rows * columns;
      if (kept.length < end) break;
      take({ rows, columns, step }, new Uint16Array(kept.slice(HEADER_BYTES, end).buffer));
      kept = kept.slice(end);
    }
  }
}

export function BedRegion({ graph, name, values, given, sleepers, simulate, change }: {
  graph: string; name: string; values: () => Values; given: Value; sleepers: number; simulate: boolean; change: (name: string, value: Value | undefined) => void;
}) {
  const [looks, setLooks] = useState(false);
  const [frame, setFrame] = useState<Frame | null>(null);
  const [error, setError] = useState("");
  const canvas = useRef<HTMLCanvasElement>(null);
  const grip = useRef<Grip | null>(null);
  const regions = isRegions(given) ? given : [];
  useEffect(() => {
    if (!looks) return undefined;
    const ending = new AbortController();
    setError("");
    setFrame(null);
    watch({ graph, values: values(), simulate }, ending.signal, (now, depth) => {
      if (canvas.current) paint(canvas.current, now, depth);
      setFrame((old) => (old && old.rows === now.rows && old.columns === now.columns ? old : now));
    }).then(() => setLooks(false), (failed: Error) => {
      if (ending.signal.aborted) return;
      setError(failed.message);
      setLooks(false);
    });
    return () => ending.abort();
  }, [looks, simulate]);
  const [height, width] = frame ? [frame.rows * frame.step, frame.columns * frame.step] : [1, 1];
  const put = (all: Region[]) => change(name, all as unknown as Value);
  const draw = () => {
    const [top, left, tall, wide] = MIDDLE;
    put(Array.from({ length: sleepers }, (_, i): Region => [top * height, (left + (i * wide) / sleepers) * width, tall * height, (wide / sleepers) * width].map(Math.round) as Region));
  };
  const moved = (index: number, corner: boolean, down: number, right: number, from: Region) => {
    const [row, column, rows, columns] = from;
    const clamp = (value: number, least: number, most: number) => Math.round(Math.max(least, Math.min(most, value)));
    const made: Region = corner
      ? [row, column, clamp(rows + down, LEAST_PX, height - row), clamp(columns + right, LEAST_PX, width - column)]
      : [clamp(row + down, 0, height - rows), clamp(column + right, 0, width - columns), rows, columns];
    put(regions.map((one, i) => (i === index ? made : one)));
  };
  const hold = (index: number, corner: boolean) => (e: PointerEvent) => {
    (e.currentTarget as Element).setPointerCapture(e.pointerId);
    grip.current = { index, corner, x: e.clientX, y: e.clientY, from: regions[index] as Region };
    e.stopPropagation();
    e.preventDefault();
  };
  const drag = (e: PointerEvent) => {
    const [held, box] = [grip.current, canvas.current?.getBoundingClientRect()];
    if (held && box) moved(held.index, held.corner, ((e.clientY - held.y) / box.height) * height, ((e.clientX - held.x) / box.width) * width, held.from);
  };
  const key = (index: number) => (e: KeyboardEvent) => {
    const step = { ArrowUp: [-8, 0], ArrowDown: [8, 0], ArrowLeft: [0, -8], ArrowRight: [0, 8] }[e.key];
    if (!step) return;
    moved(index, e.shiftKey, step[0] as number, step[1] as number, regions[index] as Region);
    e.preventDefault();
  };
  const share = (part: number, whole: number) => `${(100 * part) / whole}%`;
  return (
    <div class="check">
      <div class="actions">
        <button type="button" aria-pressed={looks} onClick={() => setLooks(!looks)}>{looks ? "Close the camera" : "Draw the bed"}</button>
        <span role="status" class={error ? "bad" : "quiet"}>{error || (looks ? (frame ? "drag the frame onto the bed, its corner to its size; nothing is stored" : "opening the camera…") : "on what the camera sees; without it, the bed is found")}</span>
        {looks && frame && !regions.length ? <button type="button" class="primary" onClick={draw}>Draw a frame</button> : null}
        {regions.length ? <button type="button" onClick={() => change(name, undefined)}>Let it be found</button> : null}
      </div>
      {looks ? (
        <div class="camera" hidden={!frame}>
          <canvas ref={canvas} role="img" aria-label="what the camera sees" />
          {frame ? regions.map((one, i) => (
            <div key={i} class="region" tabindex={0} role="group" aria-label={`bed ${i + 1}: rows ${one[0]} to ${one[0] + one[2]}, columns ${one[1]} to ${one[1] + one[3]}; arrows move it, with Shift they size it`}
              style={{ top: share(one[0], height), left: share(one[1], width), height: share(one[2], height), width: share(one[3], width) }}
              onPointerDown={hold(i, false)} onPointerMove={drag} onPointerUp={() => { grip.current = null; }} onKeyDown={key(i)}>
              <i class="corner" onPointerDown={hold(i, true)} onPointerMove={drag} onPointerUp={() => { grip.current = null; }} />
            </div>
          )) : null}
        </div>
      ) : null}
    </div>
  );
}
