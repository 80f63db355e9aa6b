// A panel that an operator, an outlet or an installed package brings: a module from this page's own address (docs/extend/panel.md says how).

import { colour, make, type Page, Panel, shade, Sheet, type Span } from "./panel";
import type { Stream } from "./store";
import type { PanelInfo } from "./wire";

/** What a module's default export is given. */
export interface Tools {
  body: HTMLElement;
  streams: Stream[];
  info: PanelInfo;
  sheet(height: number): Sheet;
  make: typeof make;
  colour: typeof colour;
  shade: typeof shade;
  clock(at: number): string;
  note(text: string): void;
}
/** What it gives back. */
interface Drawn { draw(span: Span): void; restyle?(): void; leave?(): void }

export class OwnPanel extends Panel {
  private drawn: Drawn | null = null;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.element.classList.add("own");
    void this.load();
  }

  draw(span: Span): void {
    try {
      this.drawn?.draw(span);
      if (this.drawn) this.element.dataset["drawn"] = String(Number(this.element.dataset["drawn"] ?? 0) + 1);
    } catch (error) {
      this.fail(error);
    }
    this.stamp();
  }

  override restyle(): void {
    this.drawn?.restyle?.();
  }

  override leave(): void {
    this.drawn?.leave?.();
  }

  private async load(): Promise<void> {
    const tools: Tools = {
      body: this.body, streams: this.streams, info: this.info, make, colour, shade,
      sheet: (height) => new Sheet(this.body, height),
      clock: (at) => this.page.clock(at, true),
      note: (text) => { this.note.textContent = text; },
    };
    try {
      const place = new URL(`panels/${encodeURIComponent(this.info.kind)}.js`, location.href).href;
      const module = (await import(place)) as { default: (tools: Tools) => Drawn };
      this.drawn = module.default(tools);
    } catch (error) {
      this.fail(error);
    }
  }

  private fail(error: unknown): void {
    this.drawn = null;
    this.note.textContent = `this panel failed: ${String(error)}`.slice(0, 300);
    this.note.classList.add("bad");
  }
}
