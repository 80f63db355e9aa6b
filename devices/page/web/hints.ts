// What people type behind a word that an operator understands, and names with their units.

export const HINTS: Record<string, string> = { stage: "1.2 m/s", "leave out": "17 TA", use: "17", "this is:": "squat", speed: "1.2" };

/** Ends of names that say a unit, longest first. */
const UNITS: Record<string, string> = { m_s: "m/s", per_min: "1/min", hz: "Hz", ms: "ms", mm: "mm", pct: "%", deg: "°", kg: "kg", uV: "µV", mV: "mV", s: "s", m: "m" };

/** A parameter's name for people, its unit in brackets: "for_s" is "for (s)". */
export const titled = (name: string): string => {
  const unit = Object.keys(UNITS).find((end) => name.endsWith(`_${end}`));
  return (unit ? `${name.slice(0, -unit.length - 1)} (${UNITS[unit]})` : name).replace(/_/g, " ");
};
