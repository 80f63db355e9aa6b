// Bar charts of how much each marker varies, per sequence or per class of a fact.

import type { Shown } from "./map_views";
import { make, shade } from "./panel";

/** The rms of several deviations; NaN of none. */
const pooled = (values: (number | null | undefined)[]): number => {
  const known = values.filter((v): v is number => typeof v === "number");
  return Math.sqrt(known.reduce((a, b) => a + b * b, 0) / known.length);
};

/** Per marker a bar for each class of `fact` (of the chosen sequences where no fact is named), as long as it varies; the greatest is named. */
export function bars(shown: Shown, fact: string, classes: string[]): HTMLElement {
  const { hello } = shown;
  const groups = fact
    ? classes.map((name) => ({ name: name || "not said", of: hello.sequences.filter((s) => (s.facts[fact] ?? "") === name) }))
    : hello.sequences.map((s) => ({ name: s.name, of: [s] })).slice(0, 12);
  const all = hello.markers.map((_, m) => groups.map((g) => pooled(g.of.map((s) => s.variation[m]))));
  const most = Math.max(...all.flat().filter((v) => !Number.isNaN(v)), 1e-12);
  const host = make("div", { class: "scroll" });
  hello.markers.forEach((marker, m) => {
    const row = make("div", { class: "bars", "data-marker": marker }, make("span", {}, marker));
    groups.forEach((group, g) => {
      const value = all[m]?.[g] ?? NaN;
      const bar = make("i", { title: `${group.name}: ${value.toPrecision(3)} ${hello.unit}`, "data-class": group.name, "data-value": String(value) });
      bar.style.width = Number.isNaN(value) ? "0" : `${(100 * value) / most}%`;
      bar.style.background = shade(g);
      row.append(bar);
    });
    host.append(row);
  });
  host.append(make("div", { class: "legend" }, ...groups.map((group, g) => {
    const swatch = make("i");
    swatch.style.background = shade(g);
    return make("span", {}, swatch, group.name);
  })));
  return host;
}
