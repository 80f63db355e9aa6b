// The fields of a graph's form: one for each type of value that a setting may have.

import { useId } from "preact/hooks";
import { titled } from "./hints";
import type { Field, Found, Source, Value } from "./lab_api";

const MUSCLES = ["TA", "SO", "GM", "GL", "RF", "VM", "VL", "BF", "ST", "GMAX", "GMED", "AL", "PL", "ES"];
const SIDED = MUSCLES.flatMap((muscle) => [`L_${muscle}`, `R_${muscle}`]);

export type Values = Record<string, Value>;
interface Given { field: Field; value: Value | undefined; change: (value: Value | undefined) => void }

const isTable = (value: Value): value is Record<string, Value>[] =>
  Array.isArray(value) && value.length > 0 && value.every((row) => typeof row === "object" && row !== null && !Array.isArray(row));
const isNames = (value: Value): value is string[] => Array.isArray(value) && value.length > 0 && value.every((one) => typeof one === "string");
/** What was typed, as YAML reads it where that is a number or JSON; else text. */
const read = (text: string): Value => {
  try {
    return JSON.parse(text) as Value;
  } catch {
    return text;
  }
};
const written = (value: Value | undefined): string => (value === undefined || value === null ? "" : typeof value === "string" ? value : JSON.stringify(value));

export function FormField({ field, value, change }: Given) {
  const id = useId();
  const shown = value === undefined ? field.value : value;
  const wide = isTable(field.value) || isNames(field.value);
  const limits = [field.min !== null ? `from ${field.min}` : "", field.max !== null ? `to ${field.max}` : ""].filter(Boolean).join(" ");
  return (
    <div class={`field${wide ? " wide" : ""}`}>
      <label for={id}>{field.label}{field.unit ? <span class="unit"> {field.unit}</span> : null}</label>
      <Input id={id} field={field} value={shown} change={change} />
      {field.help || limits ? <small id={`${id}-help`}>{[field.help, limits].filter(Boolean).join("; ")}</small> : null}
    </div>
  );
}

function Input({ id, field, value, change }: { id: string; field: Field; value: Value; change: Given["change"] }) {
  if (field.choices.length)
    return (
      <select id={id} value={written(value)} onChange={(e) => change(field.choices.find((one) => written(one) === e.currentTarget.value))}>
        {field.choices.map((one) => <option key={written(one)} value={written(one)}>{written(one)}</option>)}
      </select>
    );
  if (field.type === "boolean") return <input id={id} type="checkbox" checked={value === true} onChange={(e) => change(e.currentTarget.checked)} />;
  if (isTable(field.value)) return <Table id={id} rows={isTable(value) ? value : field.value} columns={[...new Set(field.value.flatMap(Object.keys))]} change={change} />;
  if (isNames(field.value)) return <Names id={id} field={field} names={isNames(value) ? value : field.value} change={change} />;
  if (field.type === "number" || field.type === "integer")
    return (
      <input id={id} type="number" step={field.type === "integer" ? 1 : "any"} min={field.min ?? undefined} max={field.max ?? undefined} value={written(value)}
        placeholder="as the graph has it" onInput={(e) => change(e.currentTarget.value === "" ? undefined : Number(e.currentTarget.value))} />
    );
  const plain = field.type === "text";
  return <input id={id} type="text" value={written(value)} placeholder="as the graph has it" autocomplete="off" spellcheck={false}
    onInput={(e) => change(e.currentTarget.value === "" && field.value === null ? undefined : plain ? e.currentTarget.value : read(e.currentTarget.value))} />;
}

/** Names of channels or muscles: each typed or chosen. */
function Names({ id, field, names, change }: { id: string; field: Field; names: string[]; change: Given["change"] }) {
  const sided = names.some((name) => /^[LR]_/.test(name));
  return (
    <div class="names" role="group" aria-label={field.label}>
      <datalist id={`${id}-names`}>{(sided ? SIDED : MUSCLES).map((name) => <option key={name} value={name} />)}</datalist>
      {names.map((name, i) => (
        <input id={i ? undefined : id} key={i} list={`${id}-names`} value={name} size={6} aria-label={`${field.label} ${i + 1}`}
          onInput={(e) => change(names.map((old, k) => (k === i ? e.currentTarget.value : old)))} />
      ))}
      <button type="button" aria-label={`one more of ${field.label}`} onClick={() => change([...names, ""])}>+</button>
      <button type="button" aria-label={`one less of ${field.label}`} disabled={names.length < 2} onClick={() => change(names.slice(0, -1))}>−</button>
    </div>
  );
}

/** A list of mappings, as the stages of a protocol: a row each. */
function Table({ id, rows, columns, change }: { id: string; rows: Record<string, Value>[]; columns: string[]; change: Given["change"] }) {
  const put = (i: number, column: string, text: string) =>
    change(rows.map((row, k) => {
      if (k !== i) return row;
      const { [column]: _, ...rest } = row;
      return text === "" ? rest : { ...rest, [column]: read(text) };
    }));
  return (
    <div class="scroll">
      <table id={id} class="rows">
        <thead><tr>{columns.map((column) => <th key={column} scope="col">{titled(column)}</th>)}<th><span class="unseen">remove</span></th></tr></thead>
        <tbody>
          {rows.map((row, i) => (
            <tr key={i}>
              {columns.map((column) => <td key={column}><input value={written(row[column])} size={Math.max(6, written(row[column]).length)} aria-label={`${titled(column)}, row ${i + 1}`} onInput={(e) => put(i, column, e.currentTarget.value)} /></td>)}
              <td><button type="button" aria-label={`remove row ${i + 1}`} disabled={rows.length < 2} onClick={() => change(rows.filter((_, k) => k !== i))}>×</button></td>
            </tr>
          ))}
        </tbody>
      </table>
      <button type="button" onClick={() => change([...rows, { ...rows.at(-1) }])}>add a row</button>
    </div>
  );
}

/** The fields by what they belong to: facts and settings of the graph in the open, those of its parts folded. */
export function Fields({ fields, values, change }: { fields: Field[]; values: Values; change: (name: string, value: Value | undefined) => void }) {
  const one = (field: Field) => <FormField key={field.name} field={field} value={values[field.name]} change={(value) => change(field.name, value)} />;
  const parts = [...new Set(fields.map((field) => field.part).filter(Boolean))];
  return (
    <>
      <div class="fields">{fields.filter((field) => !field.part).map(one)}</div>
      {parts.length ? (
        <details class="more">
          <summary>more settings ({fields.filter((field) => field.part).length})</summary>
          {parts.map((part) => (
            <fieldset key={part}><legend>{part.replace(/[._]/g, " ")}</legend><div class="fields">{fields.filter((field) => field.part === part).map(one)}</div></fieldset>
          ))}
        </details>
      ) : null}
    </>
  );
}

/** Which devices: those that are connected, or simulated ones. */
export function Devices({ sources, found, simulate, choose, chosen, pick, values, rehearse }: {
  values: Values;
  rehearse: (all: string[], chosen: Values) => void;
  sources: Source[]; found: Found[] | null; simulate: boolean; choose: (simulate: boolean) => void; chosen: Record<string, string>; pick: (node: string, address: string) => void;
}) {
  const real = sources.filter((source) => source.can_simulate);
  if (!real.length) {
    const tried = Object.assign({}, ...sources.map((source) => source.rehearsals)) as Source["rehearsals"];
    const all = Object.values(tried).flatMap(Object.keys);
    const now = Object.entries(tried).find(([, made]) => Object.entries(made).every(([key, value]) => written(values[key]) === written(value)))?.[0] ?? "";
    return (
      <>
        <p class="quiet">This use needs no device: what it measures is simulated.</p>
        {all.length ? (
          <div class="field"><label for="rehearsal">Try what goes wrong</label>
            <select id="rehearsal" value={now} onChange={(e) => rehearse(all, tried[e.currentTarget.value] ?? {})}>
              <option value="">nothing</option>{Object.keys(tried).map((text) => <option key={text} value={text}>{text}</option>)}
            </select></div>
        ) : null}
      </>
    );
  }
  return (
    <>
      <div class="choice" role="radiogroup" aria-label="devices">
        <label><input type="radio" name="devices" checked={!simulate} onChange={() => choose(false)} /> connected</label>
        <label><input type="radio" name="devices" checked={simulate} onChange={() => choose(true)} /> simulated</label>
      </div>
      {simulate ? <p class="quiet">Simulated devices speak the real protocols: {real.map((source) => source.node).join(", ")}.</p> : real.map((source) => {
        const fitting = (found ?? []).filter((one) => one.use === source.use);
        return (
          <div class="field" key={source.node}>
            <label for={`device-${source.node}`}>{source.node}</label>
            <select id={`device-${source.node}`} value={chosen[source.node] ?? ""} onChange={(e) => pick(source.node, e.currentTarget.value)}>
              <option value="">{String(source.given["port"] ?? source.given["address"] ?? source.given["name"] ?? "the first that is found")}</option>
              {fitting.map((one) => <option key={one.address} value={one.address}>{one.what || one.address}</option>)}
            </select>
            <small>{found === null ? "looking for devices…" : fitting.length ? `${fitting.length} found` : `no ${source.use.split(".").at(-1)} found; connect it, or choose simulated`}</small>
          </div>
        );
      })}
    </>
  );
}
