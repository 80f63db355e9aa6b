// Set up: the form of a graph, its devices, presets, and the start of a session.

import { useEffect, useState } from "preact/hooks";
import { type Form, type Found, get, send, type Value } from "./lab_api";
import { Check } from "./lab_check";
import { Devices, Fields, type Values } from "./lab_form";
import { Download } from "./lab_networks";
import { BedRegion } from "./lab_region";

const SUBJECT = "session.subject";

/** Values that the next form of this graph begins with: those of the session that it repeats. */
export const again: { graph: string; values: Values } = { graph: "", values: {} };

export function Setup({ graph }: { graph: string }) {
  const [form, setForm] = useState<Form | null>(null);
  const [found, setFound] = useState<Found[] | null>(null);
  const [values, setValues] = useState<Values>(again.graph === graph ? again.values : {});
  const [simulate, setSimulate] = useState(true);
  const [chosen, setChosen] = useState<Record<string, string>>({});
  const [status, setStatus] = useState("");
  const [busy, setBusy] = useState(false);
  const read = () => void get<Form>(`api/form?graph=${encodeURIComponent(graph)}`).then(setForm, (error: Error) => setStatus(error.message));
  useEffect(() => {
    read();
    get<Found[]>("api/devices").then((all) => {
      setFound(all);
      setSimulate(!all.some((one) => one.use));
    }, () => setFound([]));
  }, [graph]);
  if (!form) return <p class={status ? "bad" : "quiet"} role="status">{status || "reading the graph…"}</p>;
  const change = (name: string, value: Value | undefined) =>
    setValues((old) => {
      const { [name]: _, ...rest } = old;
      return value === undefined ? rest : { ...rest, [name]: value };
    });
  const all = (): Values => {
    const subject = form.fields.find((field) => field.name === SUBJECT)?.value;
    const given: Values = { ...(subject ? { [SUBJECT]: subject } : {}), ...values };
    if (!simulate)
      for (const [node, address] of Object.entries(chosen)) {
        const device = (found ?? []).find((one) => one.address === address);
        for (const [name, value] of Object.entries(device?.parameters ?? {})) if (!(`${node}.${name}` in given)) given[`${node}.${name}`] = value;
      }
    return given;
  };
  const attempt = async (act: () => Promise<void>) => {
    setBusy(true);
    setStatus("");
    try {
      await act();
    } catch (error) {
      setStatus((error as Error).message);
    }
    setBusy(false);
  };
  const start = (kind = "session") => attempt(async () => {
    const devices = form.devices.some((source) => source.can_simulate);
    const { id } = await send<{ id: string }>("api/sessions", { graph, values: all(), simulate: simulate && devices, kind });
    location.hash = `#/session/${encodeURIComponent(id)}`;
  });
  const keep = () => {
    const name = prompt("Name of the preset");
    if (name) void attempt(async () => {
      const { graph: made } = await send<{ graph: string }>("api/presets", { graph, name, values: all() });
      setStatus(`kept as ${made}; kinegraph run takes it`);
    });
  };
  const facts = form.fields.filter((field) => field.name.startsWith("session."));
  const region = form.fields.find((field) => /(^|\.)regions$/.test(field.name));
  const simulated = simulate && form.devices.some((one) => one.can_simulate);
  const sleepers = form.fields.find((field) => /(^|\.)sleepers$/.test(field.name));
  const names = sleepers ? (values[sleepers.name] ?? sleepers.value) : null;
  const settings = form.fields.filter((field) => !field.name.startsWith("session."));
  return (
    <form class="setup" onSubmit={(e) => { e.preventDefault(); void start(); }}>
      <h1>{form.title}</h1>
      <p class="quiet">{form.summary}</p>
      {form.networks.name ? <Download networks={form.networks} done={read} /> : null}
      <section><h2>Who</h2><Fields fields={facts} values={values} change={change} /></section>
      <section><h2>Devices</h2>
        <Devices values={values} rehearse={(all, chosen) => setValues((old) => {
          const kept = Object.fromEntries(Object.entries(old).filter(([key]) => !all.includes(key)));
          return { ...kept, ...chosen };
        })} sources={form.devices} found={found} simulate={simulate} choose={setSimulate} chosen={chosen} pick={(node, address) => setChosen((old) => ({ ...old, [node]: address }))} />
      </section>
      {settings.length ? <section><h2>Settings</h2><Fields fields={settings} values={values} change={change} /></section> : null}
      {form.checks.length ? (
        <section><h2>Check</h2>
          {form.checks.includes("bed") && region ? <BedRegion graph={graph} name={region.name} values={all} given={values[region.name] ?? region.value} sleepers={Array.isArray(names) ? Math.max(1, names.length) : 1} simulate={simulated} change={change} /> : null}
          {form.checks.filter((kind) => kind !== "mvc").map((kind) => <Check key={kind} kind={kind} graph={graph} values={all} simulate={simulated} />)}
          {form.checks.includes("mvc") ? <div class="actions"><button type="button" disabled={busy} onClick={() => void start("mvc")}>Strongest contractions…</button><span class="quiet">muscle by muscle, as a reference for amplitudes</span></div> : null}
        </section>
      ) : null}
      <div class="actions starting">
        <button type="submit" class="primary" disabled={busy || !!form.networks.needed}>Start</button>
        <button type="button" disabled={busy} onClick={keep}>Save as preset</button>
        {form.networks.needed ? <span class="quiet">after the networks are downloaded</span> : null}
        <span role="status" class={status.startsWith("kept") ? "good" : "bad"}>{status}</span>
      </div>
    </form>
  );
}
