// A session: while it runs its page with large controls, and afterwards what it has left.

import { useEffect, useMemo, useRef, useState } from "preact/hooks";
import { day, type Form, get, type Home, lasting, send, size, type State, type Summary } from "./lab_api";
import { Bars } from "./lab_check";
import { Fields, type Values } from "./lab_form";
import { usePolled } from "./lab_poll";
import { again } from "./lab_setup";
import { HINTS } from "./hints";
import { Connection, type Hello, type Message } from "./wire";

const POLL_MS = 1000;
/** What operators.cycles.stages understands. */
const [PAUSE, RESUME] = ["pause stage", "resume stage"];
const EXPORTS = ["csv", "xdf", "matlab", "xlsx", "c3d", "edf", "parquet"];

export function SessionView({ id }: { id: string }) {
  const path = `api/sessions/${encodeURIComponent(id)}`;
  const [state, error, ask] = usePolled<State>(path, POLL_MS);
  if (!state) return <p class="quiet" role="status">{error || "reading the session…"}</p>;
  return state.runs ? <Running state={state} path={path} lost={error} ask={ask} /> : <Finished state={state} path={path} />;
}

function useHello(id: string, there: boolean): Hello | null {
  const [hello, set] = useState<Hello | null>(null);
  useEffect(() => {
    if (!there) return undefined;
    const heard = (message: Message) => { if (message.t === "hello") set(message); };
    const connection = new Connection(heard, () => undefined, `sessions/${encodeURIComponent(id)}/socket`);
    return () => connection.close();
  }, [id, there]);
  return hello;
}

function Running({ state, path, lost, ask }: { state: State; path: string; lost: string; ask: () => void }) {
  const hello = useHello(state.id, state.page);
  const [status, setStatus] = useState("");
  const [ending, setEnding] = useState(false);
  const [stopping, setStopping] = useState(false);
  const text = useRef<HTMLInputElement>(null);
  const act = (what: string, given: object = {}, done = "") =>
    send(`${path}/${what}`, given).then(() => { setStatus(done); ask(); }, (error: Error) => setStatus(error.message));
  const mark = (word: string) => void act("mark", { text: word }, `marked: ${word}`);
  const [paused, setPaused] = useState(false);
  const offered = hello?.words ?? [];
  const canPause = offered.includes(PAUSE);
  const words = offered.filter((word) => word !== PAUSE && word !== RESUME);
  const pause = () => { mark(paused ? RESUME : PAUSE); setPaused(!paused); };
  const groups: [string, string[]][] = [["Stages", words.filter((word) => /stage|next/.test(word))], [words.some((word) => word.startsWith("leave out")) ? "Cycles and more" : "More", words.filter((word) => !/stage|next/.test(word))]];
  const source = useMemo(() => `sessions/${encodeURIComponent(state.id)}/`, [state.id]);
  return (
    <div class="run">
      <div class="bar">
        <div class="facts">
          <span class={`light ${state.page ? "on" : ""}`} role="img" aria-label={state.page ? "recording" : "starting"} />
          <strong class="clock">{lasting(state.now_s - state.began_s)}</strong>
          <span class="who"><strong>{state.subject || state.title}</strong>
            <output role="status" class={lost ? "bad" : "quiet"}>{lost || status || `${size(state.free_bytes)} of disk left`}</output></span>
        </div>
        {state.controls ? (
          <div class="large" role="toolbar" aria-label="session">
            <form class="marking" onSubmit={(e) => { e.preventDefault(); mark(text.current?.value.trim() || "mark"); if (text.current) text.current.value = ""; }}>
              <input ref={text} maxlength={64} placeholder="what happened" aria-label="what happened" />
              <button type="submit">Mark</button>
            </form>
            {canPause ? <button type="button" aria-pressed={paused} onClick={pause}>{paused ? "Resume stage" : "Pause stage"}</button> : null}
            {groups.map(([title, group]) => group.length ? (
              <details key={title} class="menu"><summary>{title}</summary><div onClick={(e) => { if (e.target instanceof HTMLButtonElement) e.currentTarget.closest("details")?.removeAttribute("open"); }}>{group.map((word) => <Word key={word} word={word} mark={mark} />)}</div></details>
            ) : null)}
            {ending ? (
              <span class="sure"><button type="button" class="danger" onClick={() => { setStopping(true); setEnding(false); void act("stop"); }}>End the session</button><button type="button" onClick={() => setEnding(false)}>Go on</button></span>
            ) : <button type="button" class="stop" disabled={stopping} onClick={() => setEnding(true)}>{stopping ? "ending…" : "Stop"}</button>}
          </div>
        ) : <div class="large"><span class="quiet">somebody else controls this session</span><button type="button" onClick={() => void act("control")}>Take control</button></div>}
      </div>
      {state.page && state.kind === "mvc" ? <Bars id={state.id} mark={mark} /> : state.page ? <iframe class="page" src={source} title="what the session measures" /> : (
        <div class="waiting" role="status"><p>Starting</p><p class="quiet">{lastLine(state.output) || "devices are looked for, and kernels are made ready; the first start of a use takes longest"}</p></div>
      )}
    </div>
  );
}

/** A word that an operator understands; with a field, where it takes a text. */
function Word({ word, mark }: { word: string; mark: (word: string) => void }) {
  const field = useRef<HTMLInputElement>(null);
  if (!word.endsWith(" ")) return <button type="button" onClick={() => mark(word)}>{word}</button>;
  return (
    <form onSubmit={(e) => { e.preventDefault(); const status = field.current?.value.trim(); if (status) mark(word + status); if (field.current) field.current.value = ""; }}>
      <input ref={field} size={10} aria-label={word.trim()} placeholder={HINTS[word.trim()] ?? ""} /><button type="submit">{word.trim()}</button>
    </form>
  );
}

const lastLine = (text: string): string => text.trim().split("\n").at(-1) ?? "";

function Finished({ state, path }: { state: State; path: string }) {
  const reports = state.files.filter((name) => name.endsWith(".html"));
  const [shown, show] = useState("");
  const [status, setStatus] = useState("");
  const [busy, setBusy] = useState("");
  const report = shown || reports[0] || "";
  const file = (name: string, save = false) => `${path}/files/${encodeURIComponent(name)}${save ? "?save" : ""}`;
  const attempt = async (what: string, act: () => Promise<string>) => {
    setBusy(what);
    setStatus("");
    try {
      setStatus(await act());
    } catch (error) {
      setStatus((error as Error).message);
    }
    setBusy("");
  };
  const save = (name: string) => {
    const link = document.createElement("a");
    link.href = file(name, true);
    link.download = name;
    link.click();
  };
  const pdf = () => attempt("pdf", async () => { const { file: made } = await send<{ file: string }>(`${path}/pdf`, {}); save(made); return `saved ${made}`; });
  const exported = (format: string) => attempt("export", async () => {
    const { file: made, note } = await send<{ file: string; note: string }>(`${path}/export`, { format });
    save(made);
    return note || `saved ${made}`;
  });
  const reference = () => attempt("mvc", async () => {
    const { file: made } = await send<{ file: string }>(`${path}/calibrate`, {});
    const form = await get<Form>(`api/form?graph=${encodeURIComponent(state.graph)}`);
    const named = (end: string) => form.fields.find((field) => field.name === end || field.name.endsWith(`.${end}`))?.name;
    const [scale, method] = [named("scale"), named("method")];
    Object.assign(again, { graph: state.graph, values: { ...state.values, ...(scale ? { [scale]: made } : {}), ...(method ? { [method]: "mvc" } : {}) } });
    location.hash = `#/setup/${encodeURIComponent(state.graph)}`;
    return "";
  });
  const repeat = () => {
    Object.assign(again, { graph: state.graph, values: state.values });
    location.hash = `#/setup/${encodeURIComponent(state.graph)}`;
  };
  return (
    <div class="sheet finished">
      <header class="plainhead">
        <h1>{state.subject || state.title}</h1>
        <p class="quiet">{state.title}, {day(state.began_s)}{state.lasted_s ? `, ${lasting(state.lasted_s)}` : ""}, {[size(state.bytes), state.devices].filter(Boolean).join(", ")}</p>
      </header>
      {state.error ? <section class="problem" role="alert"><h2>It ended with an error</h2><pre>{state.error}</pre></section> : null}
      {state.result && state.result !== "-" ? <p class="answerline">{state.result}</p> : null}
      <div class="actions">
        {reports.length ? <button type="button" class="primary" disabled={!!busy} onClick={() => void pdf()}>{busy === "pdf" ? "printing…" : "PDF"}</button> : null}
        {reports.length ? <a class="button" href={file(report)} target="_blank" rel="noopener">Open the report alone</a> : null}
        {state.recorded ? <label class="inline">Export <select disabled={!!busy} value="" onChange={(e) => { const { value } = e.currentTarget; e.currentTarget.value = ""; if (value) void exported(value); }}>
          <option value="">{busy === "export" ? "exporting…" : "as…"}</option>{EXPORTS.map((one) => <option key={one} value={one}>{one}</option>)}
        </select></label> : null}
        {state.kind === "mvc" ? <button type="button" class="primary" disabled={!!busy} onClick={() => void reference()}>{busy === "mvc" ? "computing…" : "Use as the reference"}</button> : null}
        {state.graph ? <button type="button" onClick={repeat}>Once more with these settings</button> : null}
      </div>
      <p role="status" class="status">{status}</p>
      <Remarks state={state} path={path} />
      {state.kind !== "import" ? <Compare state={state} path={path} done={show} /> : null}
      {reports.length > 1 ? <div class="choice">{reports.map((name) => <button type="button" key={name} aria-pressed={name === report} onClick={() => show(name)}>{name.replace(/\.html$/, "")}</button>)}</div> : null}
      {report ? <iframe class="report" src={file(report)} title="report" sandbox="" /> : <p class="quiet">{state.error ? "" : "No report: this use writes none, or the session was too short for one."}</p>}
      {state.files.length ? <details class="more"><summary>files ({state.files.length})</summary><ul class="plain">{state.files.map((name) => <li key={name}><a href={file(name, true)} download={name}>{name}</a></li>)}</ul></details> : null}
      {state.graph && state.recorded ? <Again state={state} path={path} /> : null}
      <Delete path={path} />
    </div>
  );
}

function Remarks({ state, path }: { state: State; path: string }) {
  const [text, set] = useState(state.remarks);
  const [kept, keep] = useState(state.remarks);
  return (
    <section class="remarks">
      <h2><label for="remarks">Remarks</label></h2>
      <textarea id="remarks" rows={2} value={text} onInput={(e) => set(e.currentTarget.value)} onBlur={() => void send(`${path}/remarks`, { text }).then(() => keep(text), () => undefined)} />
      <small class="quiet">{text === kept ? (text ? "kept" : "") : "kept when you leave the field"}</small>
    </section>
  );
}

function Compare({ state, path, done }: { state: State; path: string; done: (file: string) => void }) {
  const [others, setOthers] = useState<Summary[]>([]);
  const [chosen, choose] = useState("");
  const [status, setStatus] = useState("");
  useEffect(() => {
    void get<Home>("api/home").then((home) => {
      const found = home.sessions.filter((one) => one.id !== state.id && !one.runs && one.graph === state.graph && !one.error);
      const mine = found.filter((one) => one.subject === state.subject);
      setOthers([...mine, ...found.filter((one) => one.subject !== state.subject)]);
      choose(mine[0]?.id ?? found[0]?.id ?? "");
    }, (error: Error) => setStatus(error.message));
  }, [state.id]);
  if (!others.length) return null;
  const compare = () => {
    setStatus("comparing…");
    void send<{ file: string }>(`${path}/compare`, { with: [chosen] }).then(({ file }) => { setStatus(""); done(file); }, (error: Error) => setStatus(error.message));
  };
  return (
    <section class="actions">
      <label class="inline">Compare with <select value={chosen} onChange={(e) => choose(e.currentTarget.value)}>{others.map((one) => <option key={one.id} value={one.id}>{one.subject || one.name}, {day(one.began_s)}</option>)}</select></label>
      <button type="button" onClick={compare}>Compare</button><span role="status" class="status">{status}</span>
    </section>
  );
}

function Again({ state, path }: { state: State; path: string }) {
  const [form, setForm] = useState<Form | null>(null);
  const [values, setValues] = useState<Values>({});
  const [status, setStatus] = useState("");
  const open = () => { if (!form) get<Form>(`api/form?graph=${encodeURIComponent(state.graph)}`).then(setForm, (error: Error) => setStatus(error.message)); };
  const begin = () => void send<{ id: string }>(`${path}/replay`, { values }).then(({ id }) => { location.hash = `#/session/${encodeURIComponent(id)}`; }, (error: Error) => setStatus(error.message));
  return (
    <details class="more" onToggle={open}>
      <summary>replay this recording with other settings, into a new session</summary>
      {form ? <Fields fields={form.fields.filter((field) => !field.name.startsWith("session."))} values={values} change={(name, value) => setValues((old) => {
        const { [name]: _, ...rest } = old;
        return value === undefined ? rest : { ...rest, [name]: value };
      })} /> : null}
      <div class="actions"><button type="button" onClick={begin}>Replay</button><span role="status" class="bad">{status}</span></div>
    </details>
  );
}

function Delete({ path }: { path: string }) {
  const [sure, ask] = useState(false);
  const remove = () => void send(path, {}, "DELETE").then(() => { location.hash = "#/library"; }, () => ask(false));
  return <div class="actions end">{sure ? <><button type="button" class="danger" onClick={remove}>Delete the session and its recording</button><button type="button" onClick={() => ask(false)}>Keep it</button></> : <button type="button" onClick={() => ask(true)}>Delete…</button>}</div>;
}
