// A panel as a picture, and what it shows as a table.

import { colour, make, type Panel, type Span } from "./panel";
import type { Cell } from "./wire";

const [PAD, HEAD] = [12, 26];

function save(name: string, blob: Blob): void {
  const link = make("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

const named = (panel: Panel, end: string): string => `${(panel.element.getAttribute("aria-label") ?? panel.info.kind).replace(/[^\w.-]+/g, "_")}.${end}`;

/** The canvases of a panel, where they stand, under its title; a panel without any has no picture. */
export function picture(panel: Panel): void {
  const canvases = [...panel.element.querySelectorAll("canvas")];
  const box = panel.element.getBoundingClientRect();
  const ratio = window.devicePixelRatio || 1;
  const copy = make("canvas", { width: String(Math.round(box.width * ratio)), height: String(Math.round(box.height * ratio)) });
  const pen = copy.getContext("2d") as CanvasRenderingContext2D;
  pen.scale(ratio, ratio);
  pen.fillStyle = colour("panel");
  pen.fillRect(0, 0, box.width, box.height);
  pen.fillStyle = colour("ink");
  pen.font = "600 14px system-ui, sans-serif";
  pen.fillText(panel.element.getAttribute("aria-label") ?? "", PAD, HEAD - 6);
  for (const canvas of canvases) {
    const at = canvas.getBoundingClientRect();
    pen.drawImage(canvas, at.x - box.x, at.y - box.y, at.width, at.height);
  }
  copy.toBlob((blob) => { if (blob) save(named(panel, "png"), blob); });
}

/** The drawing of a panel, with the colours that it has now. */
export function drawing(panel: Panel): void {
  const svg = panel.element.querySelector("svg");
  if (!svg) return;
  const copy = svg.cloneNode(true) as SVGElement;
  const [from, to] = [svg, copy].map((one) => [one, ...one.querySelectorAll<SVGElement>("*")]) as [SVGElement[], SVGElement[]];
  from.forEach((one, i) => {
    const style = getComputedStyle(one);
    for (const name of ["fill", "stroke", "stroke-width", "stroke-dasharray", "font", "paint-order"]) to[i]?.style.setProperty(name, style.getPropertyValue(name));
  });
  copy.style.background = colour("panel");
  copy.setAttribute("xmlns", "http://www.w3.org/2000/svg");
  save(named(panel, "svg"), new Blob([new XMLSerializer().serializeToString(copy)], { type: "image/svg+xml" }));
}

const quoted = (cell: Cell | undefined): string => {
  const text = cell === null || cell === undefined || (typeof cell === "number" && Number.isNaN(cell)) ? "" : String(cell);
  return /[",\n]/.test(text) ? `"${text.replace(/"/g, '""')}"` : text;
};

/** What a panel shows, stream by stream: times in seconds since the session's beginning. */
export function table(panel: Panel, span: Span): string {
  const parts = panel.streams.map((stream) => {
    const lines: Cell[][] = [];
    if (stream.signal.time.length) {
      const { time, low, high, thin } = stream.signal;
      const names = stream.info.channels.length ? stream.info.channels : low.map((_, c) => `${c + 1}`);
      lines.push(["time_s", ...(thin ? names.flatMap((name) => [`${name}_min`, `${name}_max`]) : names)]);
      time.forEach((t, i) => {
        if (t >= span.begin && t <= span.end) lines.push([t, ...low.flatMap((values, c) => (thin ? [values[i] ?? null, high[c]?.[i] ?? null] : [values[i] ?? null]))]);
      });
    } else if (stream.info.kind === "events") {
      lines.push(["time_s", ...stream.info.fields.map(([name, , unit]) => (unit ? `${name} [${unit === "ns" ? "s" : unit}]` : name))]);
      lines.push(...stream.rows);
    } else if (stream.newest) {
      const [rows, columns] = stream.newest.shape as [number, number];
      lines.push(stream.info.channels.length === columns ? stream.info.channels : Array.from({ length: columns ?? 1 }, (_, c) => c + 1));
      for (let r = 0; r < rows; r++) lines.push([...stream.newest.data.slice(r * (columns ?? 1), (r + 1) * (columns ?? 1))]);
    }
    return [`# ${stream.info.name}${stream.info.units[0] ? ` [${stream.info.units[0]}]` : ""}`, ...lines.map((line) => line.map(quoted).join(","))].join("\n");
  });
  return parts.join("\n\n") + "\n";
}

export const saveTable = (panel: Panel, span: Span): void => save(named(panel, "csv"), new Blob([table(panel, span)], { type: "text/csv" }));
