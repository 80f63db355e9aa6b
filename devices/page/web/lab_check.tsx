// Checks before a session: electrodes or the bed as traffic lights with the reason; and strongest contractions as live bars.

import { useEffect, useRef, useState } from "preact/hooks";
import { get, send } from "./lab_api";
import type { Values } from "./lab_form";
import { Stream } from "./store";
import { Connection, type Hello, type Message } from "./wire";

const POLL_MS = 500;
const BARS_MS = 100;
/** `kinegraph emg calibrate mvc` keeps the highest mean over so long. */
const WINDOW_S = 0.5;
/** A try begins above this share of the best, and is over below that. */
const [BEGINS, OVER] = [0.5, 0.25];
const TRIES = 3;

interface Electrode { name: string; rest: number; contraction: number; flag: string; reason: string; advice?: string }
interface Foot { name: string; flag: string; reason: string; advice: string }
interface Finding { well: boolean; text: string }
interface Checked { status: string; code: number; found: { unit?: string; electrodes?: Electrode[]; contacts?: Foot[]; findings?: Finding[]; problems?: string[] } }

const TITLES: Record<string, [string, string]> = {
  electrodes: ["Check the electrodes", "5 s of rest, then 10 s in which every muscle is contracted in turn. Nothing is kept."],
  contacts: ["Check the foot contacts", "15 s of walking, as in the session. Nothing is kept."],
  bed: ["Check the bed", "A minute out of bed, then a minute lying still in it. Nothing is stored."],
};

export function Check({ kind, graph, values, simulate }: { kind: string; graph: string; values: () => Values; simulate: boolean }) {
  const [id, setId] = useState("");
  const [state, setState] = useState<Checked | null>(null);
  const [error, setError] = useState("");
  useEffect(() => {
    if (!id) return undefined;
    const timer = setInterval(() => void get<Checked>(`api/checks/${id}`).then((found) => {
      setState(found);
      if (found.code >= 0) clearInterval(timer);
    }, (failed: Error) => { setError(failed.message); clearInterval(timer); }), POLL_MS);
    return () => clearInterval(timer);
  }, [id]);
  const begin = () => {
    setState(null);
    setError("");
    send<{ id: string }>("api/checks", { kind, graph, values: values(), simulate }).then((made) => setId(made.id), (failed: Error) => setError(failed.message));
  };
  const runs = id !== "" && !error && (state === null || state.code < 0);
  const [title, what] = TITLES[kind] ?? [kind, ""];
  const status = state?.status.trim().split("\n").at(-1)?.replace(/^kinegraph: /, "") ?? "";
  const lights = [...(state?.found.electrodes ?? []), ...(state?.found.contacts ?? [])];
  const findings = [...(state?.found.findings ?? []), ...(state?.found.problems ?? []).map((text) => ({ well: false, text }))];
  return (
    <div class="check">
      <div class="actions">
        <button type="button" disabled={runs} onClick={begin}>{state && !runs ? `${title} again` : title}</button>
        <output role="status" class={error ? "bad" : runs ? "prompt" : "quiet"}>{error || (runs ? status || "getting ready…" : state ? status : what)}</output>
      </div>
      {lights.length ? <ul class="lights">{lights.map((one) => (
        <li key={one.name} class={one.flag}><i aria-hidden="true" /><strong>{one.name}</strong> <span>{one.reason ? `${one.flag}: ${one.reason}` : one.flag}</span>{one.advice ? <small>{one.advice}</small> : null}</li>
      ))}</ul> : null}
      {findings.length ? <ul class="lights">{findings.map((one) => <li key={one.text} class={one.well ? "good" : "bad"}><i aria-hidden="true" /><span>{one.text}</span></li>)}</ul> : null}
    </div>
  );
}

/** The envelope of every muscle now, and the strongest half second of each: contract again for another try, the best counts. */
export function Bars({ id, mark }: { id: string; mark: (text: string) => void }) {
  const [bars, setBars] = useState<{ names: string[]; now: number[]; best: number[]; tries: number[]; unit: string }>({ names: [], now: [], best: [], tries: [], unit: "" });
  const kept = useRef<{ best: number[]; tries: number[]; contracts: boolean[] }>({ best: [], tries: [], contracts: [] });
  const again = (c: number, name: string) => {
    kept.current.best[c] = 0;
    kept.current.tries[c] = 0;
    mark(`again ${name}`);
  };
  useEffect(() => {
    let stream: Stream | null = null;
    const begin = (hello: Hello) => {
      const number = hello.streams.findIndex((one) => one.kind === "signal" && /envelope$/.test(one.name));
      const info = hello.streams[number];
      if (!info) return;
      stream = new Stream(info, number);
      connection.ask({ do: "see", streams: { [number]: 0 } });
    };
    const heard = (message: Message, buffer: ArrayBuffer, at: number) => {
      if (message.t === "hello") begin(message);
      else if (message.t === "signal" && stream && message.s === stream.number) stream.addSignal(message, buffer, at, Date.now());
    };
    const connection = new Connection(heard, () => undefined, `sessions/${encodeURIComponent(id)}/socket`);
    const timer = setInterval(() => {
      if (!stream?.signal.time.length) return;
      const { time, low } = stream.signal;
      const newest = time.at(-1) as number;
      const from = time.findIndex((t) => t > newest - WINDOW_S);
      const now = low.map((values) => values.slice(from).reduce((sum, v) => sum + (v === v ? v : 0), 0) / Math.max(1, values.length - from));
      const { best, tries, contracts } = kept.current;
      now.forEach((v, c) => {
        best[c] = Math.max(v, best[c] ?? 0);
        if (!contracts[c] && v > BEGINS * (best[c] as number)) {
          tries[c] = (tries[c] ?? 0) + 1;
          contracts[c] = true;
        } else if (v < OVER * (best[c] as number)) contracts[c] = false;
      });
      stream.forget(newest - 2);
      setBars({ names: stream.info.channels, now, best: [...best], tries: [...tries], unit: stream.info.units[0] ?? "" });
    }, BARS_MS);
    return () => {
      clearInterval(timer);
      connection.close();
    };
  }, [id]);
  const full = Math.max(1e-9, ...bars.best);
  return (
    <section class="bars-live" aria-label="strongest contractions">
      <h2>Contract one muscle after the other, as strongly as possible, for 3 s; three times each. The best counts; “Again” forgets what a muscle did before.</h2>
      {bars.names.length ? bars.names.map((name, c) => (
        <div class="barline" key={name}>
          <strong>{name}</strong>
          <meter min={0} max={full} value={bars.now[c] ?? 0} aria-label={`${name} now`} />
          <strong>{(bars.best[c] ?? 0).toFixed(0)} <span class="unit">{bars.unit}</span></strong>
          <span class={(bars.tries[c] ?? 0) >= TRIES ? "good" : "quiet"}>{Math.min(TRIES, bars.tries[c] ?? 0)} of {TRIES}</span>
          <button type="button" aria-label={`take ${name} again`} onClick={() => again(c, name)}>Again</button>
        </div>
      )) : <p class="quiet">waiting for the envelope…</p>}
    </section>
  );
}
