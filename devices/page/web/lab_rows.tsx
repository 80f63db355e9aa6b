// Sessions as a list: who, when, and the result in one line.

import { day, lasting, type Summary } from "./lab_api";

export function Rows({ sessions }: { sessions: Summary[] }) {
  return (
    <ul class="sessions">
      {sessions.map((one) => (
        <li key={one.id}>
          <a href={`#/session/${encodeURIComponent(one.id)}`}>
            <span class="what"><strong>{one.subject || one.title}</strong> {one.subject ? one.title : ""}</span>
            <span class="when">{one.runs ? <span class="live">running for {lasting(Date.now() / 1000 - one.began_s)}</span> : day(one.began_s)}</span>
            <span class={one.error ? "bad" : "result"}>{one.error ? one.error.split("\n")[0] : one.result && one.result !== "-" ? one.result : one.lasted_s ? lasting(one.lasted_s) : one.kind}</span>
          </a>
        </li>
      ))}
    </ul>
  );
}
