"""`kinegraph files import --preview`: what was understood of files, before anything is written."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kinegraph.stream.chunk import NS
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.time_text import moment

if TYPE_CHECKING:
    from kinegraph.devices.formats.findings import Findings
    from kinegraph.stream.recording.series import Series

FIRST = 4
"""Numbers, names and events of each stream that are shown."""
YEAR_NS = 366 * 86_400 * NS
"""Times before this are seconds of a file that tells no date."""


def show(series: Sequence[Series], findings: Findings) -> None:
    """Say of every file its kind, of every stream rate, unit, length, gaps and first values, then facts and doubts."""
    for file, kind in findings.kinds.items():
        say(f"{file.name}: {kind}")
    for one in series:
        say(f"\n{one.name}: {len(one)} samples, {one.spec.describe()}")
        for line in _lines(one):
            say(f"    {line}")
    if findings.facts:
        say("\nfacts: " + ", ".join(f"{key} {value}" for key, value in findings.facts.items()))
    for text in (*findings.doubts, *(finding.text for finding in findings.claims)):
        say(f"\ndoubtful: {text}")


def _lines(one: Series) -> list[str]:
    lines = []
    if one.spec.channels and not one.spec.is_event:
        lines.append(f"channels: {_some(one.spec.channels)}")
    if not len(one):
        return [*lines, "empty"]
    lines.append(f"from {moment(int(one.time[0]), 4)} to {moment(int(one.time[-1]), 4)}")
    if one.spec.is_event:
        return [*lines, f"first: {_some([_event(row) for row in one.data])}"]
    lost = int(one.lost[one.lost > 0].sum()) if one.lost is not None else 0
    missing = int(np.isnan(one.data).sum()) if one.data.dtype.kind == "f" else 0
    gaps = [f"{lost} samples lost in {int((one.lost != 0).sum())} gaps"] if one.lost is not None and lost else []
    gaps += [f"{missing} of {one.data.size} values missing"] if missing else []
    lines.append(f"gaps: {', '.join(gaps) or 'none'}")
    first = one.data[0].ravel()
    lines.append(f"first values: {_some([f'{value:g}' for value in first.astype(np.float64)])}")
    return lines


def _some(texts: Sequence[str]) -> str:
    more = f", ... ({len(texts)})" if len(texts) > FIRST else ""
    return ", ".join(texts[:FIRST]) + more


def _event(row: np.void) -> str:
    text = " ".join(str(row[name]) for name in row.dtype.names or () if name != "onset")
    onset = int(row["onset"]) if "onset" in (row.dtype.names or ()) else 0
    return f"{moment(onset, 4)} {text}".strip()
