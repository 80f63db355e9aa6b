// The library: every session, by text; files from elsewhere are dropped here.

import { useState } from "preact/hooks";
import { day, drop, type Home, lasting, size } from "./lab_api";
import { usePolled } from "./lab_poll";

export function Library() {
  const [home, error, ask] = usePolled<Home>("api/home");
  const [text, setText] = useState("");
  const [status, setStatus] = useState("");
  const [over, setOver] = useState(false);
  if (!home) return <p class="quiet" role="status">{error || "reading the lab’s folder…"}</p>;
  const wanted = text.toLowerCase().split(/\s+/).filter(Boolean);
  const found = home.sessions.filter((one) => {
    const all = [one.subject, one.name, one.title, one.kind, one.remarks, one.result, one.devices, day(one.began_s)].join(" ").toLowerCase();
    return wanted.every((word) => all.includes(word));
  });
  const take = async (files: FileList | null) => {
    for (const file of files ?? []) {
      setStatus(`importing ${file.name} (${size(file.size)})…`);
      try {
        const { id } = await drop(file);
        setStatus("");
        location.hash = `#/session/${encodeURIComponent(id)}`;
      } catch (failed) {
        setStatus((failed as Error).message);
      }
    }
    ask();
  };
  return (
    <>
      <h1>Library</h1>
      <div class="actions">
        <label class="inline">Find <input type="search" value={text} placeholder="subject, use, date…" onInput={(e) => setText(e.currentTarget.value)} /></label>
        <span class="quiet">{found.length} of {home.sessions.length} sessions, {size(found.reduce((sum, one) => sum + one.bytes, 0))}; {size(home.free_bytes)} free</span>
      </div>
      <div class="scroll tall" tabindex={0} role="region" aria-label="sessions">
        <table>
          <thead><tr>{["Date", "Subject", "Use", "Result", "Length", "Size"].map((head) => <th key={head} scope="col">{head}</th>)}</tr></thead>
          <tbody>{found.map((one) => (
            <tr key={one.id}>
              <td><a href={`#/session/${encodeURIComponent(one.id)}`}>{day(one.began_s)}</a></td><td>{one.subject}</td><td>{one.title}{one.kind !== "session" ? ` (${one.kind})` : ""}</td>
              <td class={one.error ? "bad wraps" : "wraps"}>{one.runs ? "running" : one.error ? one.error.split("\n")[0] : one.result === "-" ? "" : one.result}</td>
              <td class="number">{one.lasted_s ? lasting(one.lasted_s) : ""}</td><td class="number">{size(one.bytes)}</td>
            </tr>
          ))}</tbody>
        </table>
      </div>
      <label class={`drop${over ? " over" : ""}`} onDragOver={(e) => { e.preventDefault(); setOver(true); }} onDragLeave={() => setOver(false)}
        onDrop={(e) => { e.preventDefault(); setOver(false); void take(e.dataTransfer?.files ?? null); }}>
        <span>Drop a recording of another program here, or choose one</span>
        <input type="file" onChange={(e) => void take(e.currentTarget.files)} />
        <span role="status" class="quiet">{status}</span>
      </label>
    </>
  );
}
