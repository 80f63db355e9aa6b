"""A finding: a file, device or sender claims one thing, and what arrives is another."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from kinegraph.stream.text.time_text import moment

if TYPE_CHECKING:
    from kinegraph.stream.recording import Recording

REPORT = "finding"
"""The kind of a session's log entry that holds one."""
KINDS = {
    "rate": "samples come at another rate than declared",
    "order": "stamps run backwards",
    "epoch": "stamps are of another clock, or of another year",
    "leap": "stamps leap, and nothing is marked as lost",
    "repeat": "many samples have the stamp of the one before",
    "standstill": "stamps stand still",
    "unit": "values cannot be in the declared unit",
    "rotation": "quaternions are not of length 1",
    "header": "a file's header contradicts what follows, or breaks its format's rules",
    "clock": "the device's time is not in the declared unit, or stands still",
}
"""Every kind of finding, in words; docs/use/findings.md has the remedies."""


@dataclass(frozen=True, slots=True)
class Finding:
    """A claim that does not hold.

    kind         one of KINDS
    stream       of which it is claimed; of a file's header, the file
    claimed      what was declared, and what was `seen` instead, in words
    since_ns     stamp from which on it was seen; 0: all along
    consequence  what is wrong in the results if nothing is done, and the `remedy`: what to set
    """

    kind: str
    stream: str
    claimed: str
    seen: str
    consequence: str
    remedy: str
    since_ns: int = 0

    @property
    def text(self) -> str:
        """One sentence for people."""
        since = f" from {moment(self.since_ns)} on" if self.since_ns else ""
        what = f"claims {self.claimed}; seen: {self.seen}" if self.claimed else self.seen
        return "; ".join(filter(None, [f"{self.stream!r} {what}{since}", self.consequence, self.remedy]))

    def facts(self) -> dict[str, Any]:
        """JSON-like: as logs and recordings keep it. `what` is the kind: an entry of a log has a kind of its own."""
        record = asdict(self)
        return {"what": record.pop("kind"), **record}

    @classmethod
    def from_facts(cls, facts: Mapping[str, Any]) -> Finding:
        """What `facts` gave; what is missing is empty."""
        words = {name: str(facts.get(name, "")) for name in ("stream", "claimed", "seen", "consequence", "remedy")}
        return cls(str(facts.get("what", "")), **words, since_ns=int(facts.get("since_ns", 0)))


def wrong_rate(stream: str, claimed_hz: float, seen_hz: float, remedy: str, since_ns: int = 0) -> Finding:
    """Samples come at another rate."""
    return Finding(
        "rate", stream, f"{claimed_hz:g} Hz", f"{seen_hz:.5g} Hz",
        f"filters and windows would be off by a factor of {claimed_hz / seen_hz:.3g}; nothing is called lost", remedy, since_ns,
    )  # fmt: skip


def recorded_findings(recording: Recording) -> list[Finding]:
    """Those of a session or of imported files, oldest first."""
    imported = recording.header.get("imported")
    found: Iterable[Any] = imported.get("findings", ()) if isinstance(imported, dict) else ()
    entries = [*found, *(entry for entry in recording.log if entry.get("kind") == REPORT)]
    return [Finding.from_facts(entry) for entry in entries if isinstance(entry, dict)]
