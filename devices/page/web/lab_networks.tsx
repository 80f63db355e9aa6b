// Networks that a use needs and that are not on this machine: what they are, their licence, and a button that downloads them.

import { useEffect, useState } from "preact/hooks";
import { get, type Networks, send } from "./lab_api";

const POLL_MS = 500;

export function Download({ networks, done }: { networks: Networks; done: () => void }) {
  const [id, setId] = useState("");
  const [status, setStatus] = useState("");
  const [error, setError] = useState("");
  useEffect(() => {
    if (!id) return undefined;
    const failed = (text: string) => { setError(text); setId(""); };
    const timer = setInterval(() => void get<{ status: string; code: number }>(`api/checks/${id}`).then((found) => {
      const last = found.status.trim().split("\n").at(-1) ?? "";
      setStatus(last);
      if (found.code === 0) done();
      else if (found.code > 0) failed(last.replace(/^kinegraph: /, ""));
    }, (broken: Error) => failed(broken.message)), POLL_MS);
    return () => clearInterval(timer);
  }, [id]);
  const begin = () => {
    setError("");
    setStatus("");
    send<{ id: string }>("api/downloads", { name: networks.name }).then((made) => setId(made.id), (broken: Error) => setError(broken.message));
  };
  const [, count, total] = /^(\d+) of (\d+) MB/.exec(status) ?? [];
  return (
    <section><h2>Networks</h2>
      <p>This use {networks.needed ? "needs" : "is better with"} what is no part of kinegraph: {networks.what}. Licence: {networks.licence}. It is downloaded once, from npm’s registry, and checked.</p>
      <div class="actions">
        <button type="button" class="primary" disabled={!!id} onClick={begin}>Download</button>
        {id && total ? <progress value={Number(count)} max={Number(total)} aria-label="download" /> : null}
        <output role="status" class={error ? "bad" : "quiet"}>{error || (id ? status || "connecting…" : "some 50 MB; nothing else is sent or asked for")}</output>
      </div>
    </section>
  );
}
