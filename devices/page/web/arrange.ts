// Arranging panels by hand, and saying it as the section `page:` of a graph.

import { make, type Panel } from "./panel";
import type { PanelInfo } from "./wire";

const WIDEST = 4;
const TALLS = [0.5, 1, 1.5, 2, 3, 4];
const COPY = "copy";
/** Streams that only the page has. */
const OWN = new Set(["marks"]);

/** The section as YAML. Texts are written as JSON strings, which YAML reads as they are. */
export function section(panels: PanelInfo[], window_s: number): string {
  let timed = false;
  const lines = panels.map((info) => {
    const of = info.of.filter((name) => !OWN.has(name));
    const more: Record<string, unknown> = { title: info.title || undefined, wide: info.wide, tall: info.tall, least: info.least ?? undefined, most: info.most ?? undefined, folded: info.folded, show: info.show };
    if (!timed && (info.kind === "signal" || info.kind === "events")) {
      more["window_s"] = window_s;
      timed = true;
    }
    const parts = Object.entries(more).filter(([, value]) => value !== undefined).map(([key, value]) => `${key}: ${JSON.stringify(value)}`);
    return `    - {${[`kind: ${info.kind}`, ...(of.length ? [`of: ${JSON.stringify(of)}`] : []), ...parts].join(", ")}}`;
  });
  return `page:\n  panels:\n${lines.join("\n")}\n`;
}

/** The button, each panel's handles while it is pressed, and the text. */
export class Arranger {
  readonly button = make("button", { type: "button", "aria-pressed": "false" }, "arrange");
  private readonly text = make("textarea", { readonly: "", rows: "8", "aria-label": "the section page: of the graph" });
  private readonly copy = make("button", { type: "button" }, COPY);
  private readonly box = make("div", { class: "arrangement", hidden: "" }, make("p", {}, "In the graph's file, this makes the page look so:"), this.copy, this.text);
  private handles: HTMLElement[] = [];

  constructor(host: HTMLElement, private readonly panels: () => Panel[], private readonly arranged: (panels: Panel[]) => void, private readonly window_s: () => number) {
    this.button.onclick = () => this.toggle();
    this.copy.onclick = () => {
      this.text.select();
      this.copy.textContent = document.execCommand("copy") ? "copied" : "select and copy it by hand"; // the clipboard's newer way asks for TLS
    };
    host.before(this.box);
  }

  /** Other panels are there now. */
  renew(): void {
    if (!this.box.hidden) this.toggle();
  }

  private toggle(): void {
    const on = this.box.hidden;
    this.box.hidden = !on;
    this.button.setAttribute("aria-pressed", String(on));
    for (const handle of this.handles) handle.remove();
    this.handles = on ? this.panels().map((panel) => this.handle(panel)) : [];
    this.write();
  }

  private write(): void {
    this.copy.textContent = COPY;
    this.text.value = section(this.panels().map((panel) => panel.info), this.window_s());
  }

  private handle(panel: Panel): HTMLElement {
    const { info } = panel;
    const step = (label: string, name: string, act: () => void) => {
      const button = make("button", { type: "button", "aria-label": name, title: name }, label);
      button.onclick = () => {
        act();
        panel.resize();
        this.write();
        button.focus();
      };
      return button;
    };
    const handle = make("span", { class: "handles" },
      step("←", "earlier", () => this.move(panel, -1)), step("→", "later", () => this.move(panel, 1)),
      step("↔", "wider", () => {
        info.wide = ((info.wide ?? 1) % WIDEST) + 1;
        this.arranged(this.panels());
      }),
      step("↕", "taller", () => { info.tall = TALLS.find((t) => t > (info.tall ?? 1)) ?? (TALLS[0] as number); }),
      step("×", "remove", () => this.arranged(this.panels().filter((p) => p !== panel))));
    panel.element.prepend(handle);
    return handle;
  }

  private move(panel: Panel, by: number): void {
    const panels = [...this.panels()];
    const from = panels.indexOf(panel);
    const to = Math.max(0, Math.min(panels.length - 1, from + by));
    panels.splice(to, 0, ...panels.splice(from, 1));
    this.arranged(panels);
  }
}
