// The ward: all beds in one list, those that need attention first; alarms above it; a bed's own page behind its name.

import { render } from "preact";
import { useEffect, useState } from "preact/hooks";
import { send, size } from "./lab_api";
import { usePolled } from "./lab_poll";
import { showTheme, ThemeButton } from "./lab_theme";

type Level = "alarm" | "attention" | "note" | "well";
interface Order { id?: string; state?: string; text?: string }
interface Bed {
  bed: string; level: Level; state: string; troubles: { level: Level; kind: string; text: string }[]; version: string; graph: string; digest: string;
  offset_s: number | null; uncertainty_s: number | null; free_bytes: number; recording: string; waiting: number; night: string; order: Order; heard_s: number | null;
  session: Record<string, string>;
}
interface Alarm { id: string; bed: string; kind: string; level: Level; text: string; raised: number; over: number | null }
interface Ward { beds: Bed[]; alarms: Alarm[]; server: { there: boolean; error: string } }

const NAMES: Record<Level, string> = { alarm: "alarm", attention: "attention", note: "note", well: "well" };
const POLL_MS = 500;

function useHash(): string {
  const [hash, set] = useState(location.hash);
  useEffect(() => {
    const moved = () => set(location.hash);
    addEventListener("hashchange", moved);
    return () => removeEventListener("hashchange", moved);
  }, []);
  return hash;
}

function App() {
  const [, place = "", ...rest] = useHash().split("/");
  const bed = decodeURIComponent(rest.join("/"));
  return (
    <>
      <header class="top">
        <a class="brand" href="#/">kinegraph ward</a>
        {place === "bed" ? <nav aria-label="ward"><a href="#/">all beds</a></nav> : null}
        <ThemeButton />
      </header>
      <main id="main" tabindex={-1} class={place === "bed" ? "within" : "sheet wide"}>{place === "bed" ? <BedView key={bed} bed={bed} /> : <Beds />}</main>
    </>
  );
}

function Beds() {
  const [ward, error, ask] = usePolled<Ward>("api/ward", POLL_MS);
  const [filter, search] = useState("");
  const [chosen, choose] = useState<string[] | null>(null);
  if (!ward) return <p class="quiet" role="status">{error || "asking the ward…"}</p>;
  const counts = (["alarm", "attention", "note", "well"] as Level[]).map((level) => [level, ward.beds.filter((one) => one.level === level).length] as const);
  const words = (one: Bed) => [one.bed, one.state, one.graph, one.digest, one.version, ...Object.values(one.session)].join(" ").toLowerCase();
  const shown = ward.beds.filter((one) => words(one).includes(filter.toLowerCase()));
  const mixed = [...tally(ward.beds.map((one) => one.digest.slice(0, 6))), ...tally(ward.beds.map((one) => one.version))];
  return (
    <>
      {error ? <p class="bad" role="alert">{error}</p> : null}
      {ward.server.there ? null : <p class="bad" role="alert">The server does not answer ({ward.server.error || "no reason"}); beds go on and keep what they have to send.</p>}
      <div class="actions wardtop">
        <strong>{ward.beds.length} beds</strong>
        {counts.filter(([, n]) => n).map(([level, n]) => <span key={level} class={`level ${level}`}>{n} {NAMES[level]}</span>)}
        {mixed.map(([name, n]) => <button key={name} type="button" title="beds with it" onClick={() => search(filter === name ? "" : name)}>{n} × {name}</button>)}
        {chosen ? null : <button type="button" onClick={() => choose([])}>roll out…</button>}
        <label class="find">find <input type="search" value={filter} onInput={(e) => search((e.target as HTMLInputElement).value)} /></label>
      </div>
      {chosen ? (
        <div class="actions wardtop">
          <strong>{chosen.length} chosen</strong>
          <button type="button" onClick={() => choose(shown.map((one) => one.bed))}>all {shown.length} shown</button>
          {chosen.length ? <Orders beds={chosen} done={ask} /> : null}
          <button type="button" onClick={() => choose(null)}>done</button>
        </div>
      ) : null}
      {ward.alarms.length ? <Alarms alarms={ward.alarms} done={ask} /> : null}
      <div class="bedlist">
        <table class="beds">
          <thead><tr><th>bed</th><th>state</th><th>last night</th><th>graph</th><th>version</th><th class="number">clock</th><th class="number">disk</th><th>recording</th></tr></thead>
          <tbody>{shown.map((one) => <Row key={one.bed} one={one} chosen={chosen} choose={choose} />)}</tbody>
        </table>
      </div>
    </>
  );
}

/** Each text with how often it is there; nothing where all are the same. */
function tally(texts: string[]): [string, number][] {
  const counts = new Map<string, number>();
  for (const text of texts.filter(Boolean)) counts.set(text, (counts.get(text) ?? 0) + 1);
  return counts.size > 1 ? [...counts].sort((a, b) => b[1] - a[1]) : [];
}

function Row({ one, chosen, choose }: { one: Bed; chosen: string[] | null; choose: (beds: string[]) => void }) {
  const more = one.troubles.map((t) => t.text).filter((text) => text !== one.state);
  return (
    <tr class={one.level}>
      <th scope="row">
        {chosen ? <input type="checkbox" aria-label={`choose ${one.bed}`} checked={chosen.includes(one.bed)} onChange={(e) => choose((e.target as HTMLInputElement).checked ? [...chosen, one.bed] : chosen.filter((name) => name !== one.bed))} /> : null}
        <a href={`#/bed/${encodeURIComponent(one.bed)}`}>{one.bed}</a>{Object.values(one.session).map((text) => <small key={text}> {text}</small>)}
      </th>
      <td><span class={`level ${one.level}`} title={NAMES[one.level]}>{one.state}</span>{more.map((text) => <small key={text} class="bad"> {text}</small>)}</td>
      <td>{one.night}</td>
      <td title={one.digest}>{one.graph} <small>{one.digest.slice(0, 6)}</small>{one.order.state && one.order.state !== "done" ? <small> {one.order.state}</small> : null}</td>
      <td>{one.version}</td>
      <td class="number" title={one.uncertainty_s === null ? "" : `± ${ms(one.uncertainty_s)}`}>{one.offset_s === null ? "" : ms(one.offset_s)}</td>
      <td class="number">{one.free_bytes < 0 ? "" : size(one.free_bytes)}</td>
      <td>{one.recording}{one.waiting > 20 ? <small> {one.waiting} wait</small> : null}</td>
    </tr>
  );
}

const ms = (s: number): string => (Math.abs(s) < 10 ? `${(s * 1e3).toFixed(1)} ms` : `${s.toFixed(0)} s`);

function Alarms({ alarms, done }: { alarms: Alarm[]; done: () => void }) {
  const [all, showAll] = useState(false);
  const shown = all ? alarms : alarms.slice(0, 3);
  const acknowledge = (ids: string[]) => Promise.all(ids.map((id) => send(`api/alarms/${id}/acknowledge`, { by: "page" }))).then(done, done);
  return (
    <section class="alarms" aria-label="alarms" role="status">
      <ul class="plain">
        {shown.map((one) => (
          <li key={one.id}>
            <time>{new Date(one.raised * 1000).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" })}</time> <strong>{one.bed}</strong> <span>{one.text}{one.over ? " (over)" : ""}</span>
            <button type="button" onClick={() => acknowledge([one.id])}>acknowledge</button>
          </li>
        ))}
      </ul>
      <div class="actions">
        {alarms.length > 3 ? <button type="button" onClick={() => showAll(!all)}>{all ? "show three" : `show all ${alarms.length}`}</button> : null}
        {alarms.length > 1 ? <button type="button" onClick={() => acknowledge(alarms.map((one) => one.id))}>acknowledge all</button> : null}
      </div>
    </section>
  );
}

function BedView({ bed }: { bed: string }) {
  const [ward, , ask] = usePolled<Ward>("api/ward", 2000);
  const [view, set] = useState({ id: "", page: false, error: "" });
  useEffect(() => {
    let over = false;
    const look = (id: string) =>
      fetch(`api/views/${encodeURIComponent(id)}`).then((r) => r.json()).then((found: { page: boolean; runs: boolean; output: string }) => {
        if (over) return;
        set({ id, page: found.page, error: found.runs ? "" : found.output || "its page has ended" });
        if (!found.page && found.runs) setTimeout(() => look(id), 700);
      });
    send<{ id: string }>(`api/beds/${encodeURIComponent(bed)}/open`, {}).then((found) => look(found.id), (e: Error) => set({ id: "", page: false, error: e.message }));
    return () => { over = true; };
  }, [bed]);
  const one = ward?.beds.find((each) => each.bed === bed);
  return (
    <>
      <div class="actions bedtop">
        <h1>{bed}</h1>
        {one ? <span class={`level ${one.level}`}>{one.state}</span> : null}
        {one ? (
          <span class="order">
            <small>{one.graph} {one.digest.slice(0, 6)}{one.order.state ? `, ${one.order.state}${one.order.text ? `: ${one.order.text}` : ""}` : ""}</small>
            <Orders beds={[one.bed]} done={ask} />
          </span>
        ) : null}
      </div>
      {view.error ? <p class="bad" role="alert">{view.error}</p> : null}
      {view.page ? <iframe class="page" title={`page of ${bed}`} src={`sessions/${encodeURIComponent(view.id)}/`} /> : view.error ? null : <p class="quiet" role="status">opening the bed’s page…</p>}
    </>
  );
}

function Orders({ beds, done }: { beds: string[]; done: () => void }) {
  const [error, fail] = useState("");
  const order = (what: object) => send("api/orders", { beds, ...what }).then(() => { fail(""); done(); }, (e: Error) => fail(e.message));
  const chosen = async (e: Event) => {
    const file = (e.target as HTMLInputElement).files?.[0];
    if (file) await order({ graph: await file.text() });
  };
  const install = (e: Event) => {
    e.preventDefault();
    const version = String(new FormData(e.target as HTMLFormElement).get("version") ?? "").trim();
    if (version) void order({ version });
  };
  return (
    <>
      <label class="button">roll out a graph <input type="file" accept=".yaml,.yml" hidden onChange={chosen} /></label>
      <form onSubmit={install}><input name="version" size={8} placeholder="version" aria-label="version" /> <button type="submit">install</button></form>
      <button type="button" onClick={() => order({ back: true })}>roll back</button>
      {error ? <small class="bad" role="alert">{error}</small> : null}
    </>
  );
}

const app = document.getElementById("app");
showTheme();
if (app) render(<App />, app);
