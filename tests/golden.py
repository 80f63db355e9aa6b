"""`python -m tests.golden [WORD] [--write]`: what operators, commands and graphs answer otherwise than tests/laws/golden says.

A golden answer is a table that a person can review. Of an operator: one of its `cases()`, a few samples of each input and output, with
channels, units and stamps in seconds. Of a command: what it prints. Of a graph: what it makes of a simulated walk. WORD chooses by name:
`gait`, `Envelope`, `train-map`. With `--write` the answers of today are kept; the commit says why they changed.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import MISSING, fields
from functools import partial
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, StreamSpec
from kinegraph.stream.graph.components import catalogue, find
from kinegraph.stream.laws.case_samples import tapes_of
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.play import Player
from kinegraph.stream.operator import Operator

ANSWERS = Path(__file__).parent / "laws" / "golden"
MAX_LINES = 40
MAX_BYTES = 1_000_000
"""Of all golden answers together."""
INPUT_ROWS, OUTPUT_ROWS = 3, 12
"""At most so many samples of an input and of an output are shown."""
MANY = 6
"""Of so many streams, one sample of each input."""
COLUMNS, ELEMENTS = 8, 3
"""At most so many numbers of a sample, and of an event's field that is an array."""
DIGITS = 5
"""Of a column's largest value; all others are rounded to the same place."""
NOISE = 1e-9
"""Relative to a stream's largest value: what rounding leaves of numbers that cancel each other is shown as 0."""
NUMBER = re.compile(r"(?<![\w.])[-+−]?\d+(?:\.\d+)?(?:e[-+]\d+)?", re.ASCII)

Column = tuple[str, list[str]]
"""A head and one text for each row."""


def answer(use: str) -> str:
    """An operator's golden answer: the first of its cases that gives output."""
    cls = find(use)
    assert issubclass(cls, Operator)
    for case in cls.cases():
        tapes = tapes_of(case)
        player = Player(case).play(whole(tapes))
        if any(len(output) for output in player.outputs.values()):
            break
    inputs = [(port, t.spec, t.time, t.data) for port, t in tapes.items()]
    outputs = [(name, o.spec, o.time, o.data) for name, o in player.outputs.items()]
    start = min(int(time[0]) for _, _, time, _ in inputs if len(time))
    lines = [_called(case.operator), _timing(player.operator)]
    most = INPUT_ROWS if len(inputs) + len(outputs) < MANY else 1
    for port, spec, time, data in inputs:
        lines += ["", *table(f"in   {port}", spec, time, data, evenly(len(time), most), start)]
    filled = sum(len(time) > 0 for _, _, time, _ in outputs)
    room = (MAX_LINES - len(lines) - 2 * len(outputs) - filled) // filled
    for name, spec, time, data in outputs:
        rows = evenly(len(time), min(OUTPUT_ROWS, max(1, room - 1)))
        lines += ["", *table(f"out  {name}", spec, time, data, rows, start, mean=room > 1)]
    return "".join(f"{line.rstrip()}\n" for line in lines)


def _called(operator: Operator[Any]) -> str:
    """The operator with those parameters that are not the usual ones."""
    given = []
    for f in fields(operator):  # type: ignore[arg-type]
        value = getattr(operator, f.name)
        if f.default is MISSING or value != f.default:
            is_path = isinstance(value, Path) or (isinstance(value, str) and "/" in value)
            given.append(f"{f.name}={Path(value).name if is_path else value!r}")
    return f"{type(operator).__name__}({', '.join(given)})"


def _timing(operator: Operator[Any]) -> str:
    decided = "".join(f"; {name} is decided after {s:g} s" for name, s in sorted(operator.decision_s.items()) if s)
    return f"delay {operator.delay_s:g} s{decided}"


def evenly(count: int, most: int) -> list[int]:
    """Evenly chosen, the first and the last among them; of one only, the last."""
    return np.unique(np.linspace(count - 1, 0, min(count, most)).round().astype(int)).tolist()


def table(
    title: str, spec: StreamSpec, time: Array, data: Array, rows: Sequence[int], start: int, *, mean: bool = False
) -> Iterator[str]:
    """Some samples of a stream, one line each; `mean`: and the mean of all."""
    yield f"{title}: {len(time)} samples, {_described(spec, data)}"
    if not len(time):
        return
    columns: list[Column] = [("s", [f"{(int(time[i]) - start) / NS:.6f}" for i in rows] + ["mean"] * mean)]
    found = list(_fields(spec, data) if spec.is_event else _numbers(spec, data))
    largest = max((_largest(values) for _, values, _ in found), default=0.0) if not spec.is_event else 0.0
    for head, values, unit in found:
        show = _shown(values, unit, start, NOISE * largest)
        average = [_average(values, show, spec.is_event)] if mean else []
        columns.append((f"{head}/{_unit(unit)}" if unit else head, [*(show(values[i]) for i in rows), *average]))
    widths = [max(map(len, (head, *texts))) for head, texts in columns]
    for k in range(-1, len(columns[0][1])):
        texts = (head if k < 0 else texts[k] for head, texts in columns)
        yield "  ".join(text.rjust(width) for text, width in zip(texts, widths, strict=True))


def _average(values: Array, show: Callable[[Any], str], is_event: bool) -> str:
    """Of what is finite; whole numbers of events are counts and codes, without a tolerance."""
    if values.dtype.kind in "iu" and not is_event:
        return f"{values.mean():.2f}"
    return show(_finite(values).mean()) if _finite(values).size else "-"


def _described(spec: StreamSpec, data: Array) -> str:
    kind = "events" if spec.is_event else f"{' x '.join(map(str, spec.shape))} {spec.dtype}"
    rate = f" at {spec.rate_hz:g} Hz" if spec.rate_hz else ""
    settling = f", settle in {spec.settling_s:g} s" if spec.settling_s else ""
    missing = int((~np.isfinite(data)).sum()) if data.dtype.kind == "f" else 0
    return kind + rate + settling + (f", {missing} numbers are not finite" if missing else "")


def _unit(unit: str) -> str:
    return "s" if unit == "ns" else unit.replace("uV", "µV")


Named = Iterator[tuple[str, Array, str]]
"""By name: the values of all samples, and their unit."""


def _numbers(spec: StreamSpec, data: Array) -> Named:
    """Some numbers of a sample, evenly chosen: `TA`, `knee[2]`, `[5,7]`."""
    for flat in evenly(int(np.prod(spec.shape, dtype=int)), COLUMNS):
        place = np.unravel_index(flat, spec.shape)
        others = [str(k) for axis, k in enumerate(place) if not spec.channels or axis != spec.channel_axis]
        channel = spec.channels[int(place[spec.channel_axis])] if spec.channels else ""
        unit = spec.units[0] if len(spec.units) == 1 or not channel else spec.unit_of(channel)
        values = data.reshape(len(data), -1)[:, flat]
        for name, part, _ in _parts("", values):
            yield (f"{channel}[{','.join(others)}]" if others else channel) + name, part, unit


def _fields(spec: StreamSpec, data: Array) -> Named:
    for field in spec.channels:
        for name, values, _ in _parts(field, data[field]):
            yield name, values, spec.unit_of(field)


def _parts(name: str, values: Array) -> Named:
    """Values that are records or arrays, one by one."""
    if values.dtype.names:
        for field in values.dtype.names:
            yield from _parts(f"{name}.{field}", values[field])
    elif values.ndim > 1:
        flat = values.reshape(len(values), -1)
        yield from ((f"{name}[{k}]", flat[:, k], "") for k in evenly(flat.shape[1], ELEMENTS))
    else:
        yield name, values, ""


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)] if values.dtype.kind == "f" else values[:0]


def _largest(values: Array) -> float:
    return float(np.abs(_finite(values)).max(initial=0.0))


def _shown(values: Array, unit: str, start: int, noise: float) -> Callable[[Any], str]:
    """How the values of a column are shown, all of them alike."""
    if values.dtype.kind == "i" and unit == "ns":
        return partial(_seconds, start)
    if values.dtype.kind != "f":
        return lambda value: (value.decode() if isinstance(value, bytes) else str(value)).replace(" ", "_") or "-"
    largest = _largest(values)
    if largest <= noise or largest == 0.0:
        return lambda value: "0.0" if np.isfinite(value) else str(value)
    before = int(np.floor(np.log10(largest))) + 1
    form = f".{max(1, DIGITS - before)}f" if -3 <= before <= 7 else f".{DIGITS - 1}e"
    return lambda value: f"{value:z{form}}"


def _seconds(start: int, value: Any) -> str:
    ns = int(value)
    if abs(ns) >= FOREVER - 1 or ns <= NEVER:
        return "never" if ns < 0 else "open"
    return f"{(ns - start if ns >= start else ns) / NS:z.6f}"


def alike(one: str, other: str, relative: float = 0.0) -> bool:
    """The same words and whole numbers, and others that differ by one in the last place at most: processors round differently."""
    if one == other:
        return True
    if _words(one) != _words(other):
        return False
    pairs = zip(NUMBER.findall(one), NUMBER.findall(other), strict=True)
    return all(_near(a, b, relative) for a, b in pairs)


def _words(line: str) -> list[str]:
    return NUMBER.sub(" # ", line).split()


def _near(one: str, other: str, relative: float) -> bool:
    if one == other or "." not in one or "." not in other:
        return one == other
    a, b = _value(one), _value(other)
    return abs(a - b) <= max(1.01 * _last_place(one), 1.01 * _last_place(other), relative * max(abs(a), abs(b)))


def _value(text: str) -> float:
    return float(text.replace("−", "-"))


def _last_place(text: str) -> float:
    digits, _, exponent = text.partition("e")
    return float(10.0 ** (int(exponent or 0) - len(digits.partition(".")[2])))


def differences(kept: str, found: str, relative: float = 0.0) -> list[str]:
    """The lines that are others, as `- was` and `+ is`."""
    pairs = zip_longest(kept.splitlines(), found.splitlines(), fillvalue="")
    differing = [(old, new) for old, new in pairs if not alike(old, new, relative)]
    return [f"{sign} {line}" for pair in differing for sign, line in zip("-+", pair, strict=True) if line]


def read(path: Path) -> str:
    return path.read_text(encoding="utf-8") if path.exists() else ""


def operators() -> dict[str, Path]:
    """By operator, the file of its golden answer; a source of motion is none."""
    found = catalogue(("operators",))[0].items()
    return {use: ANSWERS / f"{use}.txt" for use, part in found if issubclass(part, Operator)}


def main() -> int:
    from tests import golden_commands, golden_graphs

    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("word", nargs="?", default="", help="only those with this in their name")
    parser.add_argument("--write", action="store_true", help="keep the answers of today")
    given = parser.parse_args()
    questions = [(path, partial(answer, use), 0.0) for use, path in operators().items()]
    for name, path in golden_commands.scenes().items():
        questions.append((path, partial(golden_commands.answer, name), golden_commands.RELATIVE))
    for name, path in golden_graphs.graphs().items():
        questions.append((path, partial(golden_graphs.answer, name), 0.0))
    changed = 0
    for path, ask, relative in questions:
        if given.word not in path.stem:
            continue
        found = ask()
        if lines := differences(read(path), found, relative):
            changed += 1
            print(path.stem, *lines, sep="\n", flush=True)
            if given.write:
                path.parent.mkdir(exist_ok=True)
                path.write_text(found, encoding="utf-8")
    for stray in sorted({*ANSWERS.rglob("*.txt")} - {path for path, *_ in questions}):
        print(f"{stray.name}: nothing has this name")
        if given.write:
            stray.unlink()
    print(f"{changed} answers {'written' if given.write else 'changed'}")
    return 1 if changed and not given.write else 0


if __name__ == "__main__":
    sys.exit(main())
