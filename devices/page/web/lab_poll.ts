// What the lab's server says, asked for again and again.

import { useCallback, useEffect, useState } from "preact/hooks";
import { get } from "./lab_api";

const POLL_MS = 3000;

/** The newest answer, why there is no answer, and a way to ask at once. */
export function usePolled<T>(path: string, every_ms = POLL_MS): [T | null, string, () => void] {
  const [found, set] = useState<T | null>(null);
  const [error, fail] = useState("");
  const ask = useCallback(() => {
    get<T>(path).then((one) => { set(one); fail(""); }, (e: Error) => fail(e instanceof TypeError ? "the lab does not answer; sessions go on" : e.message));
  }, [path]);
  useEffect(() => {
    ask();
    const timer = setInterval(ask, every_ms);
    return () => clearInterval(timer);
  }, [ask, every_ms]);
  return [found, error, ask];
}
