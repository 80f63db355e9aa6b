// What the lab's browser asks its server for.

export interface Offer { graph: string; title: string; what: string }
export interface Summary {
  id: string; graph: string; name: string; title: string; subject: string; kind: "session" | "replay" | "import" | "mvc"; remarks: string; result: string; devices: string;
  began_s: number; lasted_s: number | null; runs: boolean; error: string; bytes: number;
}
export interface Home { uses: Offer[]; more: Offer[]; presets: Offer[]; graphs: Offer[]; sessions: Summary[]; free_bytes: number; folder: string }
export type Value = string | number | boolean | null | Value[] | { [key: string]: Value };
export interface Field {
  name: string; label: string; unit: string; help: string; type: string; min: number | null; max: number | null; choices: Value[]; value: Value; part: string;
}
export interface Source { node: string; use: string; can_simulate: boolean; given: Record<string, Value>; rehearsals: Record<string, Record<string, Value>> }
/** Networks that a graph needs and that are not there; {}: all are there. */
export interface Networks { name?: string; what?: string; licence?: string; needed?: boolean }
export interface Form { graph: string; title: string; name: string; summary: string; fields: Field[]; devices: Source[]; networks: Networks; checks: string[] }
export interface Found { kind: string; address: string; what: string; yaml: string; note: string; use: string; parameters: Record<string, Value> }
export interface State extends Summary {
  values: Record<string, Value>; page: boolean; output: string; files: string[]; recorded: boolean; free_bytes: number; now_s: number; controls: boolean;
}

/** Who this browser tab is, so that one at a time controls a session. */
export const CLIENT = sessionStorage.getItem("client") ?? crypto.getRandomValues(new Uint32Array(3)).join("-");
sessionStorage.setItem("client", CLIENT);

async function answered<T>(response: Response): Promise<T> {
  const kind = response.headers.get("content-type") ?? "";
  const found = kind.startsWith("application/json") ? await response.json() : { error: await response.text() };
  if (!response.ok) throw new Error(found.error || response.statusText);
  return found as T;
}

export const get = async <T>(path: string): Promise<T> => answered<T>(await fetch(path, { headers: { "X-Client": CLIENT } }));

export const send = async <T>(path: string, what: unknown, method = "POST"): Promise<T> =>
  answered<T>(await fetch(path, { method, headers: { "X-Client": CLIENT, "Content-Type": "application/json" }, body: JSON.stringify(what) }));

export const drop = async (file: File): Promise<{ id: string }> =>
  answered(await fetch(`api/import?name=${encodeURIComponent(file.name)}`, { method: "POST", body: file }));

export const size = (bytes: number): string =>
  bytes > 1e9 ? `${(bytes / 1e9).toFixed(1)} GB` : bytes > 1e6 ? `${(bytes / 1e6).toFixed(1)} MB` : `${Math.ceil(bytes / 1e3)} kB`;

export const lasting = (s: number): string => {
  const [h, m] = [Math.floor(s / 3600), Math.floor(s / 60) % 60];
  return `${h ? `${h}:` : ""}${h ? String(m).padStart(2, "0") : m}:${String(Math.floor(s) % 60).padStart(2, "0")}`;
};

export const day = (s: number): string => new Date(s * 1000).toLocaleString([], { dateStyle: "medium", timeStyle: "short" });
