// What people type behind a word that an operator understands.

export const HINTS: Record<string, string> = { stage: "1.2 m/s", "leave out": "17 TA", use: "17", "this is:": "squat", speed: "1.2" };
