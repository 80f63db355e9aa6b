"""What an index says of a recorded session."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from kinegraph.operators.cycles.cycle import is_closed
from kinegraph.operators.emg.quality import QUALITY
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording import Recording

COLUMNS = ("session", "subject", "begun (UTC)", "length (s)", "facts", "accepted", "rejected", "not good")
YEAR_NS = 366 * 86_400 * NS


def index(folder: Path) -> list[dict[str, str]]:
    """A row per recording in a folder and below, in order of date, then of name."""
    rows = [_row(folder, path) for path in _recordings(folder)]
    return sorted(rows, key=lambda row: (row["begun (UTC)"], row["session"]))


def _recordings(folder: Path) -> Iterator[Path]:
    """Files, and sessions that are folders of numbered files."""
    seen: set[Path] = set()
    for file in sorted(folder.rglob("*.mcap")):
        path = file.parent if file.parent != folder and re.fullmatch(r".*\.\d{4}", file.stem) else file
        if path not in seen:
            seen.add(path)
            yield path


def _row(folder: Path, path: Path) -> dict[str, str]:
    row = dict.fromkeys(COLUMNS, "")
    row["session"] = str(path.relative_to(folder))
    try:
        with Recording.open(path) as recording:
            _fill(row, recording)
    except KinegraphError as error:
        row["facts"] = f"cannot be read: {error}"
    return row


def _fill(row: dict[str, str], recording: Recording) -> None:
    facts = dict(recording.header.get("session") or {})
    row["subject"] = str(facts.pop("subject", ""))
    row["facts"] = ", ".join(f"{name} {value}" for name, value in facts.items() if value not in (None, "", [], {}))
    begun = recording.begin_of_inputs
    if begun > YEAR_NS:
        row["begun (UTC)"] = str(np.datetime64(begun, "ns").astype("datetime64[s]")).replace("T", " ")
    row["length (s)"] = f"{recording.duration_ns / NS:.1f}"
    closed = [name for name, stream in recording.streams.items() if is_closed(stream.spec.dtype)]
    if closed:
        last = next((name for name in closed if "review" in name or "stage" in name), closed[0])
        reasons = {int(r["number"]): str(r["rejected"]) for r in recording.read(last)[1]}
        accepted = sum(not reason for reason in reasons.values())
        row["accepted"], row["rejected"] = str(accepted), str(len(reasons) - accepted)
    for name, stream in recording.streams.items():
        if stream.spec.dtype == QUALITY:
            verdicts = {str(r["name"]): r for r in recording.read(name)[1]}
            bad = [
                f"{who} {r['session_flag']} ({r['session_reason']})"
                for who, r in verdicts.items()
                if r["session_flag"] != "good"
            ]
            row["not good"] = "; ".join(bad)
