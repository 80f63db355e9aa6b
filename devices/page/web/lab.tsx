// The lab: home, set up, run, finish, library. Which of them is shown stands in the address behind the #.

import { render } from "preact";
import { useEffect, useState } from "preact/hooks";
import { showKeys } from "./keys";
import { type Home, size } from "./lab_api";
import { Library } from "./lab_library";
import { usePolled } from "./lab_poll";
import { Rows } from "./lab_rows";
import { SessionView } from "./lab_session";
import { Setup } from "./lab_setup";
import { showTheme, ThemeButton } from "./lab_theme";

function useHash(): string {
  const [hash, set] = useState(location.hash);
  useEffect(() => {
    const heard = () => set(location.hash);
    addEventListener("hashchange", heard);
    return () => removeEventListener("hashchange", heard);
  }, []);
  return hash;
}

/** "?" shows the keys: those of the session's page where there is one, which also has its own keys. */
function keys(event: KeyboardEvent): void {
  const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLTextAreaElement || event.target instanceof HTMLSelectElement;
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  const page = document.querySelector<HTMLIFrameElement>("iframe.page")?.contentWindow;
  if (page && /^[?p0-9]$/.test(event.key)) page.dispatchEvent(new KeyboardEvent("keydown", { key: event.key }));
  else if (event.key === "?") showKeys("lab");
  else if (event.key === "m" && page) {
    document.querySelector<HTMLInputElement>(".marking input")?.focus();
    event.preventDefault();
  }
}

function App() {
  const [, place = "", ...rest] = useHash().split("/");
  const what = decodeURIComponent(rest.join("/"));
  useEffect(() => { document.getElementById("main")?.focus({ preventScroll: true }); scrollTo(0, 0); }, [place, what]);
  return (
    <>
      <header class={`top ${place === "session" ? "slim" : ""}`}>
        <a class="brand" href="#/">kinegraph lab</a>
        <nav aria-label="lab">
          <a href="#/" aria-current={place === "" ? "page" : undefined}>Home</a>
          <a href="#/library" aria-current={place === "library" ? "page" : undefined}>Library</a>
        </nav>
        <ThemeButton />
      </header>
      <main id="main" tabindex={-1} class={place === "session" ? "within" : "sheet"}>
        {place === "setup" ? <Setup key={what} graph={what} /> : place === "session" ? <SessionView key={what} id={what} /> : place === "library" ? <Library /> : <HomeView />}
      </main>
    </>
  );
}

function HomeView() {
  const [home, error] = usePolled<Home>("api/home");
  const [devices] = usePolled<{ kind: string; address: string; what: string; note: string }[]>("api/devices", 8000);
  if (!home) return <p class="quiet" role="status">{error || "reading the lab’s folder…"}</p>;
  const running = home.sessions.filter((one) => one.runs);
  const recent = home.sessions.filter((one) => !one.runs).slice(0, 6);
  const connected = (devices ?? []).filter((one) => one.address);
  return (
    <>
      {error ? <p class="bad" role="alert">{error}</p> : null}
      {running.length ? <section><h2>Running now</h2><Rows sessions={running} /></section> : null}
      <section>
        <h1>What do you want to measure?</h1>
        <ul class="cards">{home.uses.map((one) => <li key={one.graph}><a class="card" href={`#/setup/${encodeURIComponent(one.graph)}`}><strong>{one.title}</strong><span>{one.what}</span></a></li>)}</ul>
        {[["Presets", home.presets], ["Own graphs", home.graphs]].map(([title, offers]) => (offers as Home["uses"]).length ? (
          <div key={title as string}><h2>{title as string}</h2>
            <ul class="cards">{(offers as Home["uses"]).map((one) => <li key={one.graph}><a class="card" href={`#/setup/${encodeURIComponent(one.graph)}`}><strong>{one.title}</strong><span>{one.what}</span></a></li>)}</ul></div>
        ) : null)}
        <details class="more"><summary>more graphs ({home.more.length})</summary>
          <ul class="plain">{home.more.map((one) => <li key={one.graph}><a href={`#/setup/${encodeURIComponent(one.graph)}`}>{one.title}</a> <span class="quiet">{one.what}</span></li>)}</ul>
        </details>
      </section>
      <div class="pair">
        <section><h2>Recent sessions</h2>{recent.length ? <Rows sessions={recent} /> : <p class="quiet">No session yet. Choose a use above; each can run on simulated devices.</p>}</section>
        <section><h2>Connected</h2>
          {devices === null ? <p class="quiet">looking for devices…</p> : connected.length ? (
            <ul class="plain">{connected.map((one) => <li key={one.kind + one.address}><strong>{one.what || one.address}</strong> <span class="quiet">{one.kind}{one.note ? `; ${one.note}` : ""}</span></li>)}</ul>
          ) : <p class="quiet">No device is connected.</p>}
          <p class="quiet">{size(home.free_bytes)} free in {home.folder}</p>
        </section>
      </div>
    </>
  );
}

addEventListener("keydown", keys);
showTheme();
render(<App />, document.getElementById("app") as HTMLElement);
