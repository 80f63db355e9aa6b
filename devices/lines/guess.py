"""What lines of numbers a device prints, guessed from its bytes: delimiter, columns, counter, time. No port, no clock."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass

import numpy as np

from kinegraph.devices.lines.protocol import LineDecoder

LEAST = 5
"""This many good lines must have come."""
SHARE = 0.9
_PRINTED = re.compile(rb"[\t\r\n -~]")
_NAMED = re.compile(r"\s*([^:=,;\t]+?)\s*[:=]")


@dataclass(slots=True)
class LinesGuess:
    """A declaration as a graph holds it; `step`: by how much the column `time` goes on from line to line; `lines`: how many there were."""

    delimiter: str
    columns: list[str]
    counter: str = ""
    time: str = ""
    step: float = 0.0
    lines: int = 0


def guess(data: bytes) -> LinesGuess | None:
    """What these bytes are, if they are lines of as many numbers each."""
    if not data or len(_PRINTED.findall(data)) < SHARE * len(data):
        return None
    lines = [line.strip() for line in data.decode("ascii", "replace").splitlines()[1:-1] if line.strip()]
    made = max((_with(lines, delimiter) for delimiter in (",", ";", "\t", " ")), key=lambda one: one.lines)
    if made.lines < max(LEAST, 0.5 * len(lines)):
        return None
    rows = LineDecoder(tuple(made.columns), made.delimiter).feed(data).rows
    for i, name in enumerate(made.columns):
        steps = np.diff(rows[:, i])
        usual = float(np.median(steps)) if len(steps) else 0.0
        if usual == 1 and np.mean(steps == 1) >= SHARE and not made.counter:
            made.counter = name
        elif usual > 0 and np.quantile(np.abs(steps - usual), SHARE) < 0.2 * usual and not made.time:
            made.time, made.step = name, usual
    return made


def _with(lines: list[str], delimiter: str) -> LinesGuess:
    """The columns, if this stands between them."""
    parts = [line.split() if delimiter == " " else line.rstrip(delimiter).split(delimiter) for line in lines]
    count = Counter(map(len, parts)).most_common(1)[0][0] if parts else 0
    if count < 2 and delimiter != ",":
        return LinesGuess(delimiter, [])
    names = [f"x{i + 1}" for i in range(count)]
    labels = next((found for one in parts if len(one) == count and all(found := [_NAMED.match(p) for p in one])), None)
    if labels:
        names = [m[1] for m in labels if m]
    else:
        named = next((one for one in parts if len(one) == count and not any(map(_is_number, one)) and all(one)), None)
        names = [name.strip() for name in named] if named and len(set(named)) == count else names
    text = "\n".join(["", *lines, ""]).encode("ascii", "replace")
    return LinesGuess(delimiter, names, lines=len(LineDecoder(tuple(names), delimiter).feed(text).rows))


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True
