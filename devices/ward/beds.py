"""What beds report, as lines of a ward: state, what needs attention and why, facts of the fleet. No network, no clock."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from kinegraph.stream.chunk import NS
from kinegraph.stream.text.time_text import about, in_hours

SILENT_S = 20.0
"""A bed that reports every 5 s is silent after this time; whatever is silent is on the page within 60 s."""
SENSOR_S = 20.0
LOW_DISK_BYTES = 2 << 30
WAITING_MESSAGES = 600
"""A minute of messages that the server has not taken."""

Level = Literal["alarm", "attention", "note", "well"]
LEVELS: tuple[Level, ...] = ("alarm", "attention", "note", "well")


@dataclass(frozen=True, slots=True)
class Trouble:
    """Something that needs attention. `kind` is the same as long as it lasts."""

    level: Level
    kind: str
    text: str


@dataclass(slots=True)
class WardBed:
    """What is known of one bed. Times are of the ward's clock (s).

    status, agent    the last report of the graph's outlet, and of the bed's agent; {}: no report yet
    listening_s      since when the ward has been connected: before that, reports may have been missed
    offset_s, uncertainty_s   of the bed's clock; None: not measured
    night            last night in one line
    order            what is being rolled out, and how far it is
    """

    name: str
    status: dict[str, Any] = field(default_factory=dict)
    status_s: float = 0.0
    agent: dict[str, Any] = field(default_factory=dict)
    agent_s: float = 0.0
    listening_s: float = 0.0
    offset_s: float | None = None
    uncertainty_s: float | None = None
    night: str = ""
    order: dict[str, Any] = field(default_factory=dict)

    def awaited(self, now_s: float) -> bool:
        """Whether the ward has just been connected, and the bed has not reported since: nothing is known of it now."""
        return self.status_s < self.listening_s and now_s - self.listening_s < SILENT_S

    def silence(self, now_s: float) -> Trouble | None:
        """Why nothing comes from the bed, as far as the ward can know."""
        quiet_s = now_s - self.status_s
        if (self.status or self.agent) and self.awaited(now_s):
            return Trouble("note", "awaited", "the ward waits for its report")
        if self.status and quiet_s < SILENT_S and not self.status.get("ended"):
            return None
        since = f"silent for {about(quiet_s)}" if self.status else "has not reported yet"
        if self.agent and now_s - self.agent_s < SILENT_S:
            if self.agent.get("running"):
                return Trouble("alarm", "process hangs", f"{since}: the process runs and reports nothing")
            if self.status.get("ended") and not self.agent.get("failed"):
                return Trouble("note", "ended", "the session has ended")
            return Trouble("alarm", "process gone", f"{since}: the process is gone")
        if self.agent:
            return Trouble("alarm", "network gone", f"{since}: the network or the machine is gone")
        if self.status.get("ended"):
            return Trouble("note", "ended", "the session has ended")
        if not self.status:
            return Trouble("note", "new", since)
        return Trouble("alarm", "silent", f"{since}: process or network gone")

    def troubles(self, now_s: float) -> list[Trouble]:
        """All that needs attention, the worst first."""
        silence = self.silence(now_s)
        if silence:
            return [silence]
        found, status = [], self.status
        streams = status.get("streams", {})
        pulse = streams.get(status.get("pulse", ""))
        if pulse:
            quiet_s = (status["now"] - pulse["last"]) / NS if pulse["last"] else float(status.get("age_s", 0.0))
            quiet_s += now_s - self.status_s
            if quiet_s >= SENSOR_S:
                found.append(Trouble("alarm", "sensor gone", f"no samples of {status['pulse']} for {about(quiet_s)}"))
        if (view := _row(streams, "what")) and view["what"] == "moved":
            found.append(Trouble("attention", "camera moved", "the camera was moved"))
        if 0 <= status.get("free_bytes", -1) < LOW_DISK_BYTES:
            found.append(Trouble("attention", "disk", f"{status['free_bytes'] / 1e9:.1f} GB left on the disk"))
        if status.get("spool_dropped"):
            found.append(Trouble("alarm", "spool", f"{status['spool_dropped']} messages were lost: the spool was full"))
        elif status.get("waiting", 0) > WAITING_MESSAGES:
            found.append(Trouble("note", "waiting", f"{status['waiting']} messages wait for the server"))
        if self.order.get("state") in ("refused", "rolled back"):
            found.append(Trouble("attention", "order", f"rollout {self.order['state']}: {self.order.get('text', '')}"))
        return sorted(found, key=lambda one: LEVELS.index(one.level))

    def row(self, now_s: float) -> dict[str, Any]:
        """The bed's line on the page."""
        troubles, status = self.troubles(now_s), self.status
        silent = self.silence(now_s)
        state = silent.text if silent else state_of(status.get("streams", {}), int(status.get("now", 0)))
        facts = {**status, **self.agent} if silent else {**self.agent, **status}  # what runs knows best what it is
        return {
            "bed": self.name,
            "level": troubles[0].level if troubles else "well",
            "state": state,
            "troubles": [{"level": one.level, "kind": one.kind, "text": one.text} for one in troubles],
            "version": facts.get("version", ""),
            "graph": facts.get("graph", ""),
            "digest": facts.get("digest", ""),
            "offset_s": self.offset_s,
            "uncertainty_s": self.uncertainty_s,
            "free_bytes": facts.get("free_bytes", -1),
            "recording": status.get("recording", ""),
            "waiting": status.get("waiting", 0),
            "night": self.night,
            "order": self.order,
            "session": status.get("session", {}),
            "heard_s": round(now_s - max(self.status_s, self.agent_s), 1) if self.status or self.agent else None,
            "streams": status.get("streams", {}),
        }


def attention(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Beds sorted by what needs attention, then by name as people count (bed2 before bed10)."""
    return sorted(rows, key=lambda row: (LEVELS.index(row["level"]), natural(row["bed"])))


def natural(name: str) -> tuple[Any, ...]:
    parts: list[tuple[int, str]] = []
    digits = ""
    for sign in f"{name} ":
        if sign.isdigit():
            digits += sign
            continue
        if digits:
            parts.append((int(digits), ""))
            digits = ""
        parts.append((-1, sign))
    return tuple(parts)


def state_of(streams: dict[str, Any], now: int) -> str:
    """A bed's state in one line, from the last events of its streams."""
    breathing = _row(streams, "rate")
    rate = f" {breathing['rate']:.0f}/min" if breathing and breathing["rate"] else ""
    presence, sleep = _row(streams, "state", ("in", "out")), _row(streams, "state", ("sleep", "wake"))
    if presence and presence["state"] == "out":
        return f"out of bed for {about((now - presence['_last']) / NS)}"
    if sleep:
        return f"{'asleep' if sleep['state'] == 'sleep' else 'awake in bed'}{rate}"
    if presence:
        return f"in bed{rate}"
    if rate:
        return f"breathing{rate}"
    events = [name for name, one in streams.items() if one["row"]]
    if events:
        newest = max(events, key=lambda name: streams[name]["last"])
        texts = [str(v) for v in streams[newest]["row"].values() if isinstance(v, str) and v]
        return ", ".join(texts) or newest
    samples = sum(one["samples"] for one in streams.values())
    return f"{samples} samples" if samples else "no samples yet"


def _row(streams: dict[str, Any], name: str, among: tuple[str, ...] = ()) -> dict[str, Any] | None:
    """The newest event with that field, with one of these values if any are given; `_last` is its stamp."""
    found = [
        {**one["row"], "_last": one["last"]}
        for one in streams.values()
        if name in one["row"] and (not among or one["row"][name] in among)
    ]
    return max(found, key=lambda row: row["_last"]) if found else None


def night_line(facts: dict[str, Any]) -> str:
    """Last night in one line, from the night's facts."""
    n = facts.get("numbers") or {}
    if not n:
        return ""
    efficiency = f", {n['se']:.0f} %" if n.get("se") is not None else ""
    return f"{in_hours(n.get('tst') or 0)} asleep{efficiency}"
