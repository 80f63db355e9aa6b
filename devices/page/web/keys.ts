// The keys of the page, shown at "?".

import { make } from "./panel";

const KEYS: Record<string, [string, string][]> = {
  lab: [],
  live: [["M", "mark this moment, with a word"], ["0 to 9", "mark at once"], ["P", "hold the view; the session goes on"]],
  replay: [["space", "hold or go on"], ["→", "a step"]],
  recording: [["space", "play or hold"], ["← →", "move; with Shift, further"], ["G", "the next gap"], ["M", "mark this moment"], ["0 to 9", "mark at once"]],
};
const ALWAYS: [string, string][] = [["Tab", "from panel to panel; some have keys of their own"], ["?", "these keys"]];

export function showKeys(mode: string): void {
  document.querySelector("dialog.keys")?.remove();
  const rows = [...(KEYS[mode] ?? []), ...ALWAYS].map(([key, what]) => make("tr", {}, make("th", { scope: "row" }, key), make("td", {}, what)));
  const close = make("button", { type: "button" }, "close");
  const dialog = make("dialog", { class: "keys", "aria-label": "keys" }, make("h2", {}, "Keys"), make("table", {}, make("tbody", {}, ...rows)), close);
  close.onclick = () => dialog.close();
  dialog.onclose = () => dialog.remove();
  document.body.append(dialog);
  dialog.showModal();
}
