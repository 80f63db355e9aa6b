"""A session that has been through a soak, held against what was offered to it."""

from __future__ import annotations

import csv
import re
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Self

import numpy as np

from kinegraph.stream.chunk import Times
from kinegraph.stream.recording import Recording
from tests.soak.ledger import Ledger, by_stamps, marked, mended
from tests.soak.uses import RATE_HZ
from tests.soak.watched import Watched

AT_A_KILL_S = 0.75
"""The most that a kill may cost: `flush_s` of half a second, and what was on its way."""
AT_THE_END_S = 1.0
ENDED_WELL = 0
LOST_DATA = 5


@dataclass(slots=True)
class Judged:
    """What came of one use: the ledger of each stream, what each calm kill cost (s), and what does not hold.

    damaged    lines with digits damaged on the way; a line has no checksum
    """

    name: str
    ledgers: dict[str, Ledger] = field(default_factory=dict)
    damaged: int = 0
    kills_s: list[float] = field(default_factory=list)
    complaints: list[str] = field(default_factory=list)

    @classmethod
    def table(cls, judged: list[Self]) -> str:
        header = [
            "stream",
            "offered",
            "recorded",
            "lost, counted",
            "in gaps of unknown size",
            "unaccounted for",
            "twice",
        ]
        lines = ["| " + " | ".join(header) + " |", "|---|" + "--:|" * (len(header) - 1)]
        for one in judged:
            for name, at in one.ledgers.items():
                cells = (at.offered, at.recorded, at.counted, at.uncounted, at.silent + at.invented, at.twice)
                lines.append(f"| {one.name} {name} | " + " | ".join(f"{n:,}".replace(",", " ") for n in cells) + " |")
        if damaged := sum(one.damaged for one in judged):
            lines.append(f"\n{damaged} lines had damaged digits, as lines without a checksum may")
        kills = [s for one in judged for s in one.kills_s]
        if kills:
            lines.append(
                f"\n{len(kills)} kills of an undisturbed session cost {np.median(kills):.2f} s in the median, {max(kills):.2f} s at most"
            )
        return "\n".join(lines)


def judge(watched: Watched) -> Judged:
    """Read what a session left behind."""
    judged = Judged(watched.use.name)
    if not watched.going:
        judged.complaints.append(f"{judged.name}: nothing was recorded; its processes ended with {watched.ends}")
        return judged
    with Recording.open(watched.session) as recording:
        _, lost = marked(recording, "lines")
        index, judged.damaged = mended(recording.read("lines")[1][:, 0].astype(np.int64), lost, watched.offered)
        judged.ledgers["lines"] = Ledger.of(index, lost)
        for name in watched.use.regular:
            times, lost = marked(recording, name)
            rate_hz = recording.stream(name).spec.rate_hz
            assert rate_hz, "a regular stream"
            judged.ledgers[name] = Ledger.of(by_stamps(times, lost, rate_hz), lost)
        dropped = sum(stream.dropped for stream in recording.streams.values())
    rows, lost = _table(watched.folder / "lines.csv")
    judged.ledgers["lines, table"] = Ledger.of(mended(rows, lost, watched.offered)[0], lost)
    _complain(judged, watched, index, dropped)
    return judged


def _table(path: Path) -> tuple[Times, Times]:
    """The true index of each row of the table, and what the table says is missing before it."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [(round(float(row["index"])), int(row["lost"])) for row in csv.DictReader(file)]
    both = np.array(rows, np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _complain(judged: Judged, watched: Watched, index: Times, dropped: int) -> None:
    """Everything that does not hold, in words."""
    say = judged.complaints.append
    for name, ledger in judged.ledgers.items():
        if not ledger.balanced:
            say(f"{judged.name}: {name} does not balance: {ledger}")
    for at, calm in watched.kills:
        before = index[index < at]
        if calm and len(before):
            judged.kills_s.append((at - int(before[-1])) / RATE_HZ)
    if judged.kills_s and max(judged.kills_s) > AT_A_KILL_S:
        say(f"{judged.name}: a kill cost {max(judged.kills_s):.2f} s")
    *before_last, last = watched.ends
    if set(before_last) - {-9} or last not in ({ENDED_WELL, LOST_DATA} if watched.filled else {ENDED_WELL}):
        say(
            f"{judged.name}: its processes ended with {watched.ends}; the last one's log ends\n{_end(watched.folder / 'log.txt')}"
        )
    reported = (watched.folder / "log.txt").read_text(errors="replace")
    for word in ("Traceback", "soak:"):
        if found := re.search(rf".*{word}.*(\n.*)*", reported):
            say(f"{judged.name}: its log holds\n{found[0][:2000]}")
    if code := _replay(watched, verify=not dropped):
        say(f"{judged.name}: its replay ended with {code}\n{_end(watched.folder / 'replay.txt')}")


def _end(path: Path) -> str:
    """The last lines of a process's output."""
    return "\n".join(path.read_text(errors="replace").splitlines()[-12:])


def _replay(watched: Watched, *, verify: bool) -> int:
    """The exit code of a replay; held against the live results, unless the full disk took samples from the recording."""
    call = [sys.executable, "-m", "kinegraph", "replay", str(watched.graph), str(watched.session), "-q"]
    settings = [word for one in (*watched.use.live, *watched.options) for word in ("--set", one)]
    with (watched.folder / "replay.txt").open("wb") as log:
        return subprocess.run(
            [*call, *settings, *(["--verify"] if verify else [])], cwd=watched.folder, stdout=log, stderr=log
        ).returncode
