// The page: what the server tells goes to the streams, the panels draw them, and what a person does goes back.

import { AnswerPanel } from "./answer";
import { Arranger } from "./arrange";
import { CyclesPanel } from "./cycles";
import { EventsPanel, TablePanel } from "./events";
import { FramePanel } from "./frame";
import { HINTS, titled } from "./hints";
import { HypnogramPanel } from "./hypnogram";
import { LiveMapPanel } from "./map_live";
import { OwnPanel } from "./own";
import { showKeys } from "./keys";
import { make, type Page, Panel, type Span } from "./panel";
import { AvatarPanel, ScenePanel } from "./scene";
import { drawing, picture, saveTable } from "./save";
import { SignalPanel } from "./signal";
import { SimilarityPanel } from "./similarity";
import { GraphPanel, LogPanel, StatePanel } from "./state";
import { Stream } from "./store";
import { MARKS, Player, Replayer, Timeline } from "./timeline";
import { WeeksPanel } from "./weeks";
import { Connection, type Hello, type Message, type StateMessage, VERSION } from "./wire";

const WINDOWS_S = [2, 5, 10, 30, 60, 300, 1800, 3600, 36000];
const LOOK_MS = 80;
const WAITS = "starting: ";
const STARTING = `${WAITS}compiling, then waiting for`;
/** How far the compilation is, in its own words. */
const KERNELS = /kernel (\d+) of (\d+)/;
/** What people type, for which no session waits. */
const MANUAL = "stream.manual.";
const GONE = "kinegraph is no longer running";
/** A long window begins with the session, until it is full; but not shorter than this share of it. */
const [LONG_S, SHORTEST] = [300, 1 / 8];
/** Fewer words than this need no menus. */
const FEW = 4;
/** A panel of this width is as wide as the page. */
const WHOLE = 4;
const DRAW_MS = 1000 / 60;
/** Panels about the engine: folded away where a graph has an answer. */
const ENGINE = new Set(["state", "graph", "log"]);
/** Panels without anything to save. */
const TEXTS = new Set(["state", "log", "answer"]);
/** Within the lab, which has the session's name and its controls. */
const EMBEDDED = window.parent !== window;
/** The avatar alone, on a transparent background: for OBS and other programs that lay it over a picture. */
const ALONE = "#avatar";
const SLOW_DRAW_MS = 250;
/** The fact of a session that names the devices that are not real. */
const SIMULATED = "simulated_sources";
/** A machine that draws slowly rests for as long as it drew. */
const BREATH = 2;
/** How slowly the right edge gives way where samples come late (s per s). */
const DRIFT = 0.02;

class Main implements Page {
  t0_ms = 0;
  recording = false;
  private hello: Hello | null = null;
  private streams: Stream[] = [];
  private panels: Panel[] = [];
  private window_s = 10;
  private held: Span | null = null;
  private ahead = -Infinity;
  private next = 0;
  private readonly seen = new Set<Element>();
  private readonly watch = new IntersectionObserver((entries) => {
    for (const { target, isIntersecting } of entries) isIntersecting ? this.seen.add(target) : this.seen.delete(target);
  });
  private readonly host = document.getElementById("panels") as HTMLElement;
  private readonly inner = make("div", { class: "panels" });
  private readonly folded = make("details", { class: "signals" }, make("summary", {}, "signals"), this.inner);
  private readonly waits = make("span");
  private readonly progress = make("progress", { "aria-label": "kernels that are compiled" });
  private readonly waiting = make("div", { class: "waiting", hidden: "" }, make("strong", {}, "Starting"), this.waits, this.progress);
  private readonly status = document.getElementById("status") as HTMLOutputElement;
  private readonly controls = document.getElementById("controls") as HTMLElement;
  private readonly windows = make("select", { "aria-label": "seconds shown" });
  private readonly pause = make("button", { type: "button", "aria-pressed": "false", title: "P" }, "pause");
  private readonly gap = make("button", { type: "button", title: "G" }, "next gap");
  private readonly mark = make("input", { type: "text", maxlength: "64", placeholder: "mark this moment", "aria-label": "annotation" });
  private readonly connection: Connection;
  private readonly arranger = new Arranger(this.host, () => this.panels, (panels) => this.arrange(panels), () => this.window_s);
  private readonly footer = document.getElementById("line") as HTMLElement;
  private readonly player = new Player();
  private readonly replayer = new Replayer((what) => this.connection.ask(what));
  private timeline: Timeline | null = null;
  private at = 0;
  private length = 0;
  private moved = true;
  /** Whether a recording's gaps are all known. */
  private read = false;
  private looked = 0;
  private answered = NaN;
  private onset = NaN;
  private starting = false;
  /** Whether the end of a take was asked for, and not yet answered. */
  private ending = false;
  private devices: string[] = [];
  /** Why the session has ended. */
  private over = "";

  constructor() {
    this.host.before(this.waiting);
    document.body.classList.toggle("embedded", EMBEDDED);
    document.body.classList.toggle("alone", location.hash === ALONE);
    const dark = matchMedia("(prefers-color-scheme: dark)");
    this.theme(localStorage.getItem("theme") ?? (dark.matches ? "dark" : "light"));
    dark.onchange = () => { if (!localStorage.getItem("theme")) this.theme(dark.matches ? "dark" : "light"); };
    this.connection = new Connection((m, buffer, at) => this.hear(m, buffer, at), (state) => this.say(this.over && state !== "connected" ? `${this.over}; ${GONE}` : state));
    this.folded.ontoggle = () => {
      this.fill();
      this.look();
    };
    this.arranger.button.addEventListener("click", () => {
      if (this.arranger.button.getAttribute("aria-pressed") === "true") this.folded.open = true; // what is folded is arranged as well
    });
    addEventListener("storage", () => this.theme(localStorage.getItem("theme") ?? "light"));
    addEventListener("keydown", (event) => this.key(event));
    addEventListener("resize", () => {
      this.fill();
      this.look();
    });
    requestAnimationFrame((now) => this.frame(now));
  }

  clock(at: number, fine = false): string {
    const time = new Date(this.t0_ms + at * 1000);
    if (Number.isNaN(time.getTime())) return "";
    return time.toLocaleTimeString([], { hour12: false }) + (fine ? `.${String(time.getMilliseconds()).padStart(3, "0")}` : "");
  }

  get runs(): boolean {
    return (this.hello?.mode === "live" && !this.over) || (this.hello?.mode === "replay" && !this.replayer.stands);
  }

  seek(at: number): void {
    this.at = Math.max(0, Math.min(this.length, at));
    this.moved = true;
  }

  ask(what: object): boolean {
    return this.connection.ask(what);
  }

  private say(state: string): void {
    this.status.textContent = state;
    const waits = state.startsWith(WAITS);
    const [, done, all] = KERNELS.exec(state) ?? [];
    this.waiting.hidden = !waits;
    if (waits) this.waits.textContent = state.slice(WAITS.length);
    this.progress.hidden = !all;
    if (all) Object.assign(this.progress, { max: Number(all), value: Number(done) });
    document.body.dataset["state"] = state;
  }

  private hear(message: Message, buffer: ArrayBuffer, at: number): void {
    const now = Date.now();
    switch (message.t) {
      case "hello": return this.begin(message);
      case "signal": return this.streams[message.s]?.addSignal(message, buffer, at, now);
      case "events": return this.streams[message.s]?.addEvents(message, now);
      case "state":
        for (const panel of this.panels) if (panel instanceof StatePanel || panel instanceof GraphPanel) panel.take(message);
        if (message.over) this.end(message.over, message.reports ?? []);
        else if (message.starting) this.say(`starting: ${message.starting}`);
        else if (this.starting) this.begun(message.table);
        return;
      case "gaps":
        this.timeline?.take(message.s, message.gaps);
        this.countGaps();
        this.moved = true;
        return;
      case "moments":
        this.timeline?.takeEvents(message.s, message.at);
        return;
      case "log":
        for (const panel of this.panels) if (panel instanceof LogPanel) panel.take(message);
        for (const { text } of message.lines) if (this.ending && /^take (not )?written/.test(text)) this.ended(text);
        return;
      case "spectrum":
      case "spectrogram":
        for (const panel of this.panels) if (panel instanceof SignalPanel && panel.streams[0]?.number === message.s) panel.takeSpectrum(message, buffer, at);
        return;
      case "pace":
        return this.replayer.take(message);
      case "looked":
        this.answered = message.at;
        return;
      case "progress":
        if (message.share === 1) {
          this.moved = this.read = true;
          this.countGaps();
        }
        return this.say(message.share < 1 ? `${message.what}: ${Math.round(100 * message.share)} %` : "recording");
      default: return this.streams[message.s]?.addNewest(message, buffer, at, now);
    }
  }

  /** The session starts: what it still waits for, until all devices are there. */
  private begun(table: StateMessage["table"]): void {
    const waiting = this.devices.filter((name) => Object.entries(table).some(([stream, row]) => row["state"] === "starting" && `${stream}.`.startsWith(`${name}.`)));
    if (waiting.length) return this.say(`starting: waiting for ${waiting.join(", ")}`);
    if (!Object.keys(table).length) return;
    this.starting = false;
    this.say("live");
  }

  /** The session has ended: say so, and link what it has left. */
  private end(why: string, reports: string[]): void {
    const first = !this.over;
    this.over = why;
    if (first && this.hello) this.toolbar(this.hello);
    this.say(why);
    const links = reports.map((name, i) => make("a", { href: `reports/${i}`, target: "_blank", rel: "noopener" }, name.replace(/\.html$/, "")));
    if (links.length) this.status.append(": ", ...links.flatMap((link, i) => (i ? [", ", link] : [link])));
  }

  private begin(hello: Hello): void {
    if (hello.v > VERSION) return this.say("this page is older than its server: load it again");
    this.hello = hello;
    this.t0_ms = hello.t0_ms;
    this.recording = hello.mode === "recording";
    this.ahead = -Infinity;
    document.title = `${hello.name} · kinegraph`;
    const facts = Object.entries(hello.session).map(([key, value]) => (key === SIMULATED ? `simulated: ${value}` : `${titled(key)}: ${value}`)).join(" · ");
    (document.getElementById("name") as HTMLElement).replaceChildren(hello.name, ...(facts ? [make("small", {}, facts)] : []));
    this.streams = hello.streams.map((info, i) => new Stream(info, i));
    for (const panel of this.panels) panel.leave();
    this.panels = hello.panels.map((info) => this.panel(info, hello)).filter((p): p is Panel => p !== null);
    const asked = Math.max(0, ...hello.panels.map((p) => p.window_s ?? 0));
    if (asked) this.window_s = WINDOWS_S.find((w) => w >= asked) ?? asked;
    this.arrange(this.panels);
    this.arranger.renew();
    this.length = hello.length_s ?? 0;
    this.read = hello.whole === true;
    this.timeline = this.recording ? new Timeline(this.footer, hello, this.streams, this) : null;
    this.toolbar(hello);
    this.starting = hello.mode === "live";
    this.over = "";
    this.devices = hello.nodes.filter((node) => node.kind === "source" && !node.use.startsWith(MANUAL)).map((node) => node.name);
    this.say(this.starting ? `${STARTING} ${this.devices.join(", ")}` : hello.mode);
    this.look();
  }

  /** Show these panels, in this order. */
  private arrange(panels: Panel[]): void {
    for (const panel of this.panels) if (!panels.includes(panel)) panel.leave();
    this.panels = panels;
    this.watch.disconnect();
    this.seen.clear();
    const answered = panels.some((p) => p.info.kind === "answer");
    const isFolded = (p: Panel) => p.info.folded || (answered && ENGINE.has(p.info.kind));
    const under = panels.filter(isFolded);
    this.inner.replaceChildren(...under.map((p) => p.element));
    this.host.replaceChildren(...panels.filter((p) => !isFolded(p)).map((p) => p.element), ...(under.length ? [this.folded] : []));
    for (const panel of panels) this.equip(panel);
    for (const panel of panels) this.watch.observe(panel.element);
    this.fill();
  }

  /** Where a row's panels leave a place free, the last of them takes it. */
  private fill(): void {
    this.fillIn(this.host);
    if (this.folded.open) this.fillIn(this.inner);
  }

  private fillIn(host: HTMLElement): void {
    for (const panel of this.panels) if (panel.element.parentElement === host) panel.element.style.gridColumn = ""; // a wide one makes columns of its own
    const columns = getComputedStyle(host).gridTemplateColumns.split(" ").length;
    const rows: { free: number; last: Panel | null; wide: number }[] = [];
    for (const panel of this.panels) {
      if (panel.element.parentElement !== host) continue;
      const wide = panel.info.wide === WHOLE || panel.info.kind === "answer" ? columns : Math.min(columns, panel.info.wide ?? 1);
      panel.element.style.gridColumn = `span ${wide}`;
      const row = rows.find(({ free }) => free >= wide) ?? rows[rows.push({ free: columns, last: null, wide }) - 1];
      if (!row) continue;
      Object.assign(row, { free: row.free - wide, last: panel, wide });
    }
    for (const { free, last, wide } of rows) if (free && last) last.element.style.gridColumn = `span ${wide + free}`;
  }

  /** Ways to take what a panel shows elsewhere. */
  private equip(panel: Panel): void {
    if (panel.element.querySelector(".save") || TEXTS.has(panel.info.kind)) return;
    const button = (label: string, title: string, act: () => void) => {
      const made = make("button", { type: "button", class: "save", title }, label);
      made.onclick = act;
      return made;
    };
    const head = panel.element.querySelector("header");
    if (panel.streams.length) head?.append(button("CSV", "save what is shown as a table", () => saveTable(panel, this.span())));
    if (panel instanceof GraphPanel) head?.append(button("SVG", "save as a drawing", () => drawing(panel)));
    else if (panel.info.kind !== "table") head?.append(button("PNG", "save as a picture", () => {
      panel.draw(this.span());
      picture(panel);
    }));
  }

  private panel(info: Hello["panels"][number], hello: Hello): Panel | null {
    const streams = info.of.map((name) => this.streams.find((s) => s.info.name === name)).filter((s): s is Stream => s !== undefined);
    if (info.of.length && !streams.length && !info.missing?.length) return null;
    switch (info.kind) {
      case "answer": return new AnswerPanel(info, streams, this);
      case "signal": return streams.length ? new SignalPanel(info, streams, this) : null;
      case "events": return new EventsPanel(info, streams, this);
      case "table": return new TablePanel(info, streams, this);
      case "cycles": return new CyclesPanel(info, streams, this);
      case "frame": return new FramePanel(info, streams, this);
      case "hypnogram": return streams.length ? new HypnogramPanel(info, streams, this) : null;
      case "weeks": return streams.length ? new WeeksPanel(info, streams, this) : null;
      case "map": return streams.length ? new LiveMapPanel(info, streams, this) : null;
      case "similarity": return streams.length ? new SimilarityPanel(info, streams, this) : null;
      case "avatar": return new AvatarPanel(info, streams, this);
      case "scene": return new ScenePanel(info, streams, this);
      case "state": return new StatePanel(info, this);
      case "log": return new LogPanel(info, this);
      case "graph": return new GraphPanel(info, this, hello);
      default: return new OwnPanel(info, streams, this);
    }
  }

  private toolbar(hello: Hello): void {
    this.windows.replaceChildren(...WINDOWS_S.map((w) => make("option", { value: String(w) }, w < 120 ? `${w} s` : `${w / 60} min`)));
    this.windows.value = String(this.window_s);
    this.windows.onchange = () => {
      this.window_s = Number(this.windows.value);
      this.look();
    };
    this.pause.onclick = () => this.hold();
    this.mark.onfocus = () => { this.onset = this.now(); };
    this.mark.onkeydown = (event) => {
      if (event.key === "Enter") this.annotate();
      if (event.key === "Escape") this.mark.blur();
    };
    const button = make("button", { type: "button", title: "M, or a digit" }, "mark");
    button.onclick = () => this.annotate();
    const theme = make("button", { type: "button", title: "light or dark" }, "theme");
    theme.onclick = () => {
      this.theme(document.documentElement.dataset["theme"] === "dark" ? "light" : "dark");
      localStorage.setItem("theme", document.documentElement.dataset["theme"] ?? "");
    };
    const last = EMBEDDED ? [this.arranger.button] : [this.arranger.button, theme];
    const values = (this.over ? [] : hello.values).map((v) => this.slider(v));
    if (this.recording) {
      this.seek(Math.min(this.length, this.at || this.window_s / 2));
      this.gap.onclick = () => this.seek(this.timeline?.nextGap(this.at) ?? this.at);
      this.countGaps();
      return this.controls.replaceChildren(this.player.button, this.player.speed, this.windows, this.gap, this.mark, button, ...last);
    }
    const { button: hold, step, speed, whole } = this.replayer;
    if (hello.mode === "replay") return this.controls.replaceChildren(hold, step, speed, whole, this.windows, ...last);
    const marking = hello.mode === "live" && !this.over && !EMBEDDED ? [this.mark, button, ...this.words(hello.words ?? []), ...(hello.takes ? [this.takes()] : [])] : [];
    this.controls.replaceChildren(...values, this.windows, this.pause, ...marking, ...last);
  }

  private countGaps(): void {
    const count = this.timeline?.missing.length ?? 0;
    this.gap.textContent = count ? `next gap (${count})` : this.read ? "no gap" : "next gap";
    this.gap.disabled = !count && this.read;
  }

  private slider(value: Hello["values"][number]): HTMLElement {
    const bounded = Math.abs(value.least) < 1e6 && Math.abs(value.most) < 1e6;
    const step = bounded ? String((value.most - value.least) / 200) : "any";
    const input = make("input", { type: bounded ? "range" : "number", step, min: String(value.least), max: String(value.most), value: String(value.initial) });
    const shown = make("output", {}, `${value.initial} ${value.unit}`);
    input.oninput = () => { shown.textContent = `${input.value} ${value.unit}`; };
    input.onchange = () => this.connection.ask({ do: "tell", node: value.node, text: input.value });
    return make("label", {}, value.node, input, shown);
  }

  /** What may be typed for operators: stages and exclusions in a menu each, where there are many. */
  private words(words: string[]): HTMLElement[] {
    if (words.length < FEW) return words.map((word) => this.word(word));
    const isStage = (word: string) => /stage|next/.test(word);
    const groups: [string, string[]][] = [["stages", words.filter(isStage)], ["exclusions and more", words.filter((word) => !isStage(word))]];
    return groups.filter(([, group]) => group.length).map(([title, group]) =>
      make("details", { class: "menu" }, make("summary", {}, title), make("div", {}, ...group.map((word) => this.word(word)))));
  }

  /** A button for a word that an operator understands; with a field, where the word takes a text. */
  private word(word: string): HTMLElement {
    const button = make("button", { type: "button", class: "word" }, word.trim());
    if (!word.endsWith(" ")) {
      button.onclick = () => this.annotate(word);
      return button;
    }
    const field = make("input", { type: "text", size: "8", maxlength: String(64 - word.length), "aria-label": word.trim(), placeholder: HINTS[word.trim()] ?? "" });
    const say = () => {
      if (!field.value.trim()) return field.focus();
      this.annotate(word + field.value.trim());
      field.value = "";
      field.blur();
    };
    button.onclick = say;
    field.onkeydown = (event) => { if (event.key === "Enter") say(); };
    return make("span", { class: "word" }, button, field);
  }

  /** What became of a take. */
  private ended(text: string): void {
    this.ending = false;
    this.say(text);
  }

  /** A button that records what the avatar does, from one press to the next, under the name in the field beside it. */
  private takes(): HTMLElement {
    const field = make("input", { type: "text", maxlength: "64", placeholder: "name of the take", "aria-label": "name of the take" });
    const button = make("button", { type: "button", "aria-pressed": "false", title: "record what the avatar does; a second press writes its files" }, "take");
    button.onclick = () => {
      const on = button.getAttribute("aria-pressed") !== "true";
      const name = field.value.trim() || "take";
      if (!this.connection.ask({ do: "take", name, on })) return this.say("not connected: no take");
      button.setAttribute("aria-pressed", String(on));
      button.textContent = on ? "end take" : "take";
      field.disabled = on;
      this.ending = !on;
      this.say(on ? `recording: ${name}` : `ending: ${name}`);
    };
    return make("span", { class: "word" }, button, field);
  }

  private annotate(text = this.mark.value.trim() || "mark"): void {
    const at = Number.isFinite(this.onset) && this.mark.value ? this.onset : this.now();
    const sent = this.connection.ask({ do: "mark", text, at: Number.isFinite(at) ? at : null });
    this.say(sent ? `marked: ${text}` : "not connected: not marked");
    this.mark.value = "";
    this.onset = NaN;
    this.mark.blur();
  }

  private key(event: KeyboardEvent): void {
    const typing = event.target instanceof HTMLInputElement || event.target instanceof HTMLSelectElement;
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "?") return showKeys(this.hello?.mode ?? "live");
    if (this.timeline) {
      const at = this.timeline.key(event.key, this.span());
      if (at !== null) this.seek(at);
      if (event.key === " ") this.player.toggle();
      if (event.key === "m") this.mark.focus();
      if (/^[0-9]$/.test(event.key)) this.annotate(event.key);
      if (at !== null || event.key === " " || event.key === "m") event.preventDefault();
    } else if (this.hello?.mode === "replay") {
      if (this.replayer.key(event.key)) event.preventDefault();
    } else if (event.key === "p") this.hold();
    else if (event.key === "m" && this.mark.isConnected) {
      event.preventDefault();
      this.mark.focus();
    } else if (this.hello?.mode === "live" && /^[0-9]$/.test(event.key)) this.annotate(event.key);
  }

  private hold(): void {
    this.held = this.held ? null : this.span();
    this.pause.setAttribute("aria-pressed", String(this.held !== null));
  }

  private theme(name: string): void {
    document.documentElement.dataset["theme"] = name;
    for (const panel of this.panels ?? []) panel.restyle();
  }

  /** Tell the server what is looked at. */
  private look(): void {
    if (this.recording) {
      this.moved = true;
      return;
    }
    const streams: Record<string, number> = {};
    for (const panel of this.panels) {
      if (!this.folded.open && panel.element.parentElement === this.inner) continue;
      const pixels = Math.max(100, panel.element.clientWidth - 110) * Math.min(2, window.devicePixelRatio);
      for (const [stream, width] of panel.widths(this.window_s, pixels)) streams[stream] = Math.min(streams[stream] ?? Infinity, width);
    }
    this.connection.ask({ do: "see", streams });
  }

  /** Of a recording: ask for what is around the cursor, not more often than it can be drawn. */
  private scrub(now: number): void {
    if (now - this.looked < LOOK_MS) return;
    const step = this.player.step(Math.min(0.5, (now - this.looked) / 1000));
    this.looked = now;
    if (step) this.seek(this.at + step);
    if (!this.moved) return;
    const { begin, end, at } = this.span();
    const streams = [...new Set([...this.panels.flatMap((p) => p.streams.map((s) => s.number)), ...this.marks()])];
    this.moved = !this.connection.ask({ do: "look", streams, begin, end, at, points: Math.max(200, Math.min(2000, this.host.clientWidth)) });
  }

  private marks(): number[] {
    return this.streams.filter((s) => MARKS.has(s.info.name)).map((s) => s.number);
  }

  /** The session's time now, as far as samples have shown it (s since the beginning). */
  private now(): number {
    if (this.recording) return this.at;
    return this.ahead + Date.now() / 1000;
  }

  private span(): Span {
    if (this.held) return this.held;
    if (this.recording) return { begin: this.at - this.window_s / 2, end: this.at + this.window_s / 2, at: this.at };
    const newest = Math.max(-Infinity, ...this.streams.filter((s) => s.info.kind !== "events").map((s) => s.last).filter((t) => t === t));
    if ((this.hello?.mode === "replay" || this.over) && Number.isFinite(newest)) return { begin: newest - this.window_s, end: newest, at: newest };
    const ahead = newest - Date.now() / 1000;
    if (Number.isFinite(ahead)) this.ahead = Math.max(ahead, this.ahead - (DRIFT * DRAW_MS) / 1000);
    const end = Number.isFinite(this.ahead) ? this.now() : this.hello ? (Date.now() - this.t0_ms) / 1000 : 0;
    const long = this.window_s >= LONG_S ? Math.max(this.window_s * SHORTEST, Math.min(this.window_s, end)) : this.window_s;
    return { begin: end - long, end, at: end };
  }

  private frame(now: number): void {
    requestAnimationFrame((later) => this.frame(later));
    if (now < this.next) return;
    const span = this.span();
    if (this.recording) this.scrub(now);
    this.timeline?.draw(span);
    for (const panel of this.panels) {
      if (this.seen.has(panel.element)) panel.draw(span);
      panel.age(Date.now());
    }
    this.next = now - 2 + Math.max(document.hidden ? SLOW_DRAW_MS : DRAW_MS, BREATH * (performance.now() - now));
    if (!this.recording) for (const stream of this.streams) stream.forget((this.held ?? span).begin);
    if (this.recording) document.body.dataset["looked"] = String(this.answered);
    if (this.hello) document.body.dataset["drawn"] = String(Number(document.body.dataset["drawn"] ?? 0) + 1);
  }
}

new Main();
