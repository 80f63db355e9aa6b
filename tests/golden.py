"""`python -m tests.golden --write [WORDS]`: renew the golden answers of the operators in whose path one of the words stands (of all: none).

A golden answer is a summary of what an operator gives: on the samples of its `cases`, on the same with gaps and bad values, rounded,
standing still, louder and backwards, with each parameter turned to another value; and what it answers to parameters and streams that it may
refuse. One file an operator, in tests/laws/golden; one line an answer. `tests/laws/test_golden_answers.py` compares. Without `--write`
nothing is written; either way it prints which answers changed, and how: give the reason in the commit.
"""

from __future__ import annotations

import argparse
import random
import re
import sys
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import MISSING, dataclass, fields, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

import numpy as np

from stream.chunk import FOREVER, Array, Specs, StreamSpec
from stream.conformance.broken import Broken
from stream.conformance.case_samples import Tapes, tapes_of, with_faults
from stream.conformance.cut import Delivery, steps, whole
from stream.conformance.play import Output, Player
from stream.errors import KinegraphError
from stream.graph.parts import catalogue, find
from stream.operator import Case, Operator
from tests.other_samples import otherwise, rounded_off, with_data

HOUSE = Path(__file__).resolve().parent.parent
ANSWERS = Path(__file__).parent / "laws" / "golden"
FAULTS = 6
"""On so many drawings of gaps and bad values each case is tried."""
WIDTH = 8
"""Numbers of a sample that are summed up one by one; of more, every eighth goes to the same sum."""
RELATIVE = 2e-6
"""How far a sum may be off, relative to the root mean square of what is summed: processors round functions differently."""
NOTHING = 1e-15
"""What rounding leaves of numbers that cancel each other."""
PROBES, LARGE, HUGE = (-1, 0, 0.5), 1000, 1_000_000_000
"""Given to every parameter that is a number: which of them are refused, and in which words. Huge ones only where there is a bound, since
a window of 30 years is refused by one machine's memory and not by another's."""
RATES, PERIODS = (0.3, 0.49, 0.5, 1.0), (0.4, 1.0, 2.5)
"""Given to every parameter in Hz, of the first input's rate, and to every one in seconds, in its periods."""
FEW = 4
"""Times are exact where on average so many of them lie as long after one that was given."""
TOLD: dict[str, Any] = {
    "side": "left",
    "label": "made up",
    "device": "made up",
    "height_unit": "cm",
    "limb_names": ["left", "right"],
}
"""What a source may have said of its stream: which operators pass on, some refuse, and some go by."""
MOST = 20
"""So many changes of one operator are printed."""
SAME = "as: "
"""Stands in the file before the name of another answer."""

Answers = dict[str, str]
"""By what was asked, the summary."""


def answers(use: str) -> Answers:
    """All golden answers of an operator, by their names."""
    return dict(given(use))


def given(use: str) -> Iterator[tuple[str, str]]:
    """One golden answer after the other, with its name; on all cases what costs little comes first, so that most changes are soon found."""
    cls = find(use)
    assert issubclass(cls, Operator)
    asked = [_Asked(k, case, tapes_of(case)) for k, case in enumerate(cls.cases())]
    for questions in (_Asked.opened, _Asked.plain, _Asked.faults, _Asked.otherwise, _Asked.turned):
        for one in asked:
            for name, ask in questions(one):
                for part, text in _caught(ask).items():
                    yield f"{one.place} {name} {part}".strip(), text


Questions = Iterator[tuple[str, Callable[[], Answers]]]


@dataclass(slots=True)
class _Asked:
    """A case, and the questions on it, by what they cost; some are asked on the first case only."""

    place: int
    case: Case
    tapes: Tapes
    _faults: list[Tapes] | None = None

    def opened(self) -> Questions:
        """What needs no sample."""
        yield "opened", lambda: _opened(self.case.operator, {port: t.spec for port, t in self.tapes.items()})
        if self.place:
            return
        yield "declared", lambda: _declared(type(self.case.operator))
        for port, tape in self.tapes.items():
            for name, spec in _other_specs(tape.spec):
                specs = {p: spec if p == port else t.spec for p, t in self.tapes.items()}
                yield f"{port}-{name}", partial(_opened, self.case.operator, specs)
        probed = (*_probed(self.case.operator), *_by_rate(self.case))
        for name, given in {f"{field}?{value!r}": {field: value} for field, value in probed}.items():
            yield name, partial(_given, self.case, given)

    def plain(self) -> Questions:
        size = max(1, max(len(t) for t in self.tapes.values()) // 20)
        yield "plain", lambda: _played(self.case, steps(self.tapes, size))

    def faults(self) -> Questions:
        for k, faulty in enumerate(self._faulty()):
            yield f"fault-{k}", partial(_played, self.case, whole(faulty))

    def otherwise(self) -> Questions:
        for name, other in otherwise(self.tapes, self.case.operator):
            yield name, partial(_played_on, self.case, other)

    def turned(self) -> Questions:
        for field, value in () if self.place else _turned(self.case.operator):
            yield f"{field}={value!r}", partial(_played_with, self.case, {field: value}, self.tapes)
            rounded = with_data(self.tapes, rounded_off)
            yield f"{field}={value!r} rounded", partial(_played_with, self.case, {field: value}, rounded)
            for faulty in self._faulty()[:1]:
                yield f"{field}={value!r} fault-0", partial(_played_with, self.case, {field: value}, faulty)

    def _faulty(self) -> list[Tapes]:
        """The samples with at least two faults, drawn some times."""
        if self._faults is None:
            drawn = (with_faults(random.Random(seed).randint, self.tapes, 2.0) for seed in range(50))
            self._faults = [*islice((faulty for faulty, told in drawn if len(told) > 1), FAULTS)]
        return self._faults


def _caught(ask: Callable[[], Answers]) -> Answers:
    try:
        return ask()
    except (KinegraphError, Broken) as error:
        return {"": f"{type(error).__name__}: {_rounded(str(error))}"}
    except Exception as error:  # noqa: BLE001  no operator should; but where one does, that is its answer
        return {"": type(error).__name__}


def _played(case: Case, delivery: Delivery) -> Answers:
    player, given = Player(case).play(delivery), _times_given(delivery)
    return {name: " ".join(_summary(output, given)) for name, output in player.outputs.items()} or {"": "runs"}


def _times_given(delivery: Delivery) -> Array:
    """Every time that an operator is given: stamps, ends of chunks, and what events say."""
    found = [np.zeros(1, np.int64)]
    for _, chunk in delivery:
        found += [chunk.time, [chunk.until] if abs(chunk.until) < FOREVER - 1 else []]
        found += [np.ravel(chunk.data[n]) for n in chunk.data.dtype.names or () if chunk.data.dtype[n].base == np.int64]
    return np.unique(np.concatenate(found).astype(np.int64))


def _played_on(case: Case, tapes: Tapes) -> Answers:
    """On samples whose specs may be others than the case's, too."""
    inputs = {port: (tape.spec, tape.time, tape.data) for port, tape in tapes.items()}
    return _played(replace(case, inputs=inputs), whole(tapes))


def _declared(cls: type[Operator[Any]]) -> Answers:
    """What its parameters are when nobody gives them, and within which bounds they may be."""
    told = {}
    for f in fields(cls):  # type: ignore[arg-type]
        bounds = {k: v for k, v in sorted(f.metadata.get("kinegraph", {}).items()) if k != "description"}
        told[f.name] = _rounded(f"{'required' if f.default is MISSING else repr(f.default)} {bounds}")
    return told


def _played_with(case: Case, changes: dict[str, Any], tapes: Tapes) -> Answers:
    return _played(replace(case, operator=_other(case.operator, changes)), whole(tapes))


def _given(case: Case, changes: dict[str, Any]) -> Answers:
    operator = _other(case.operator, changes)
    operator.open({port: spec for port, (spec, _, _) in case.inputs.items()})
    return {"": "is accepted"}


def _other(operator: Operator[Any], changes: dict[str, Any]) -> Operator[Any]:
    return replace(operator, **changes)  # type: ignore[type-var]


def _opened(operator: Operator[Any], specs: Specs) -> Answers:
    fresh = operator.fresh()
    out = fresh.open(dict(specs))
    delays = f"delay {fresh.delay_s!r} decision {dict(sorted(fresh.decision_s.items()))}"
    return {"": _rounded(delays), **{name: _rounded(repr(spec.to_json())) for name, spec in out.items()}}


def _rounded(text: str) -> str:
    """On one line, with long numbers cut to nine digits, and paths from the root of the tree."""
    text = text.replace(f"{HOUSE}/", "")
    return " ".join(re.sub(r"\d+\.\d{9,}(e[-+]?\d+)?", lambda m: f"{float(m[0]):.9g}", text).split())


def _other_specs(spec: StreamSpec) -> Iterator[tuple[str, StreamSpec]]:
    """The same stream as something else, which an operator may refuse, or answer otherwise."""
    yield "irregular", spec.derive(rate_hz=None)
    yield "rate", spec.derive(rate_hz=2.0 * (spec.rate_hz or 5.0))
    yield "slow", spec.derive(rate_hz=0.5)
    yield "unit", spec.derive(units=("furlong",))
    yield "bare", spec.derive(meta={})
    yield "told", spec.derive(meta={**spec.meta, **TOLD})
    if not spec.is_event:
        yield "int16", spec.derive(dtype=np.dtype(np.int16))
        yield "nameless", spec.derive(channels=(), units=spec.units[:1])
        yield "frame", spec.derive(shape=(*spec.shape, 2), channels=(), units=spec.units[:1])
    else:
        fields = spec.dtype.descr
        yield "signal", StreamSpec((2,), rate_hz=100.0, channels=("a", "b"), units=("uV",))
        yield "less", spec.derive(dtype=np.dtype(fields[:-1]), channels=(), units=spec.units[: len(fields) - 1])
        units = spec.units if len(spec.units) == 1 else (*spec.units, "")
        yield "more", spec.derive(dtype=np.dtype([*fields, ("added", "<f8")]), channels=(), units=units)
    event = np.dtype([("onset", np.int64), ("name", "S8")])
    yield "event", StreamSpec((), event)
    if spec.is_signal:
        units = spec.units if len(spec.units) == 1 else ()
        yield "one", spec.derive(shape=(1,), channels=spec.channels[:1], units=units or spec.units[:1])
        yield "none", spec.derive(shape=(0,), channels=(), units=spec.units[:1])


def _hints(operator: Operator[Any]) -> dict[str, Any]:
    try:
        return get_type_hints(type(operator))
    except NameError:
        return {}


def _turned(operator: Operator[Any]) -> Iterator[tuple[str, Any]]:
    """Each parameter at another value, where what it may be is known."""
    for f in fields(operator):  # type: ignore[arg-type]
        value = getattr(operator, f.name)
        if isinstance(value, bool):
            yield f.name, not value
        elif isinstance(value, int):
            yield from ((f.name, given) for given in {value + 1, value // 2})
        elif isinstance(value, float):
            yield from ((f.name, given) for given in {value * 1.25, value * 0.5})
        elif value is None:
            yield from ((f.name, given) for given in (2, 0.5))
        hint = _hints(operator).get(f.name)
        choices = get_args(hint) if get_origin(hint) is Literal else ()
        yield from ((f.name, choice) for choice in choices if choice != value)


def _probed(operator: Operator[Any]) -> Iterator[tuple[str, Any]]:
    for f in fields(operator):  # type: ignore[arg-type]
        value = getattr(operator, f.name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            bounded = f.metadata.get("kinegraph", {}).keys() & {"below", "most"}
            yield from ((f.name, probe) for probe in (*PROBES, HUGE if bounded else LARGE))
        elif isinstance(value, tuple) or value is None:
            yield from ((f.name, probe) for probe in ((), ("nobody",), -1.0))
        elif isinstance(value, str):
            yield from ((f.name, probe) for probe in ("", "nobody"))


def _by_rate(case: Case) -> Iterator[tuple[str, Any]]:
    """Frequencies and times that an input's rate just allows, or just does not."""
    rate = next((spec.rate_hz for spec, _, _ in case.inputs.values() if spec.rate_hz), None)
    if rate:
        for f in fields(case.operator):  # type: ignore[arg-type]
            given = RATES if f.name.endswith("_hz") else PERIODS if f.name.endswith("_s") else ()
            yield from ((f.name, float(f"{part * rate if given is RATES else part / rate:.6g}")) for part in given)


def _summary(output: Output, given: Array) -> Iterator[str]:
    """How many samples and chunks there were, where samples are missing; then sums over stamps, ends of chunks and every number.

    Of times that follow those which are `given` at few distances, every nanosecond counts: nothing is computed there that processors do
    differently.
    """
    times, data = output.time, output.data
    lost = np.asarray(output.lost, np.int64)
    yield f"n={len(times)} lost={int(lost.clip(0).sum())}/{int((lost < 0).sum())}"
    if len(times):
        yield f"from={int(times[0])}"
        yield f"time={_sums(times - times[0])}"
        yield from _exact("stamps", times, given)
        yield f"lost-at={_sums(lost)}"
    until = np.array([chunk.until for chunk, *_ in output.kept if abs(chunk.until) < FOREVER - 1], np.int64)
    if len(until):
        yield f"until={len(output.kept)}:{_sums(until - (times[0] if len(times) else until[0]))}"
        yield from _exact("ends", until, np.union1d(given, times))
    for name, column in _columns(data):
        if data.dtype.names and column.dtype == np.int64:
            yield from _exact(f"exact-{name}", column[(column > 0) & (column < FOREVER - 1)], given)
        yield f"{name}={_sums(column)}" if column.dtype.kind in "biuf" else f"{name}=#{_digest(column)}"


def _exact(name: str, times: Array, given: Array) -> Iterator[str]:
    after = times - given[np.searchsorted(given, times, "right") - 1]
    if len(times) >= FEW and len(np.unique(after)) <= len(times) // FEW:
        yield f"{name}=#{_digest(times)}"


def _columns(data: Array) -> Iterator[tuple[str, Array]]:
    if data.dtype.names:
        for name in data.dtype.names:
            for part, column in _columns(data[name]):
                yield f"{name}{part}", column
        return
    flat = data.reshape(len(data), -1) if len(data) else data.reshape(0, int(np.prod(data.shape[1:])))
    for k in range(min(WIDTH, flat.shape[1])):
        yield f".{k}" if flat.shape[1] > 1 else "", flat[:, k::WIDTH].reshape(-1)


def _digest(column: Array) -> int:
    return zlib.crc32(column.tobytes())


def _sums(column: Array) -> str:
    """How many numbers are not finite, their root mean square, and a sum of them with weights that tell places apart."""
    values = column.astype(np.float64)
    good = np.isfinite(values)
    odd = int((~good).sum())
    places = np.flatnonzero(good) + 1.0
    values = values[good]
    if not len(values):
        return f"{odd}"
    scale = float(np.abs(values).max()) or 1.0
    rms = scale * float(np.sqrt(np.mean((values / scale) ** 2)))
    weighted = float(np.sum(((places * 0.6180339887498949) % 1.0 + 0.25) * values) / np.sqrt(len(values)))
    return f"{odd},{rms:.8g},{weighted:.8g}"


def alike(one: str, other: str, relative: float = RELATIVE) -> bool:
    """Whether two summaries say the same; sums may differ by what processors differ by."""
    if one == other:
        return True
    first, second = one.split(" "), other.split(" ")
    return len(first) == len(second) and all(
        a == b or _near(a, b, relative) for a, b in zip(first, second, strict=True)
    )


def _near(one: str, other: str, relative: float = RELATIVE) -> bool:
    (name, _, a), (same, _, b) = one.rpartition("="), other.rpartition("=")
    first, second = a.replace(":", ",").split(","), b.replace(":", ",").split(",")
    if name != same or len(first) != len(second) or len(first) < 3 or first[:-2] != second[:-2]:
        return False
    x, y = np.array([first[-2:], second[-2:]], np.float64)
    return bool((np.abs(x - y) <= max(relative * max(x[0], y[0]), NOTHING)).all())


def read(use: str) -> Answers:
    path = ANSWERS / f"{use}.txt"
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    kept: Answers = {}
    for name, _, text in (line.partition(" | ") for line in lines):
        kept[name] = kept[text.removeprefix(SAME)] if text.startswith(SAME) else text
    return kept


def write(use: str, found: Answers) -> None:
    """Keep the answers, in the order of those that were kept before, so that only what changed is seen to change."""
    ANSWERS.mkdir(exist_ok=True)
    first: dict[str, str] = {}
    lines = []
    found = {**{name: found[name] for name in read(use) if name in found}, **found}
    for name, text in found.items():
        lines.append(f"{name} | {SAME + first[text] if text in first and len(text) > len(SAME + name) else text}\n")
        first.setdefault(text, name)
    (ANSWERS / f"{use}.txt").write_text("".join(lines), encoding="utf-8")


def changes(kept: Answers, found: Answers) -> list[str]:
    """What differs, in words, one line an answer."""
    return list(changing(kept, found.items()))


def changing(kept: Answers, found: Iterable[tuple[str, str]]) -> Iterator[str]:
    """The same, one after the other as answers come; those that do not come, at the end."""
    missing = dict(kept)
    for name, new in found:
        old = missing.pop(name, "nothing")
        if not alike(old, new):
            yield f"{name}: {_where(old, new)}"
    yield from (f"{name}: {_where(old, 'nothing')}" for name, old in missing.items())


def _where(old: str, new: str) -> str:
    parts = [(a, b) for a, b in zip(old.split(" "), new.split(" "), strict=False) if a != b and not _near(a, b)]
    return f"{parts[0][0]} was, {parts[0][1]} is" if "=" in old and parts else f"{old} -- was, is -- {new}"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument(
        "words", nargs="*", help="operators in whose path one of these stands; all, where none is given"
    )
    parser.add_argument("--write", action="store_true", help="keep the answers that are given now")
    given = parser.parse_args()
    uses = [use for use in catalogue(("operators",))[0] if not given.words or any(w in use for w in given.words)]
    differing = 0
    for use in uses:
        began = time.process_time()
        found = answers(use)
        told = changes(read(use), found)
        differing += len(told)
        seconds = time.process_time() - began
        print(
            f"{use}: {len(found)} answers in {seconds:.1f} s, {len(told)} changed", *told[:MOST], sep="\n  ", flush=True
        )
        if given.write and told:
            write(use, found)
    for stray in [p for p in ANSWERS.glob("*.txt") if p.stem not in catalogue(("operators",))[0]]:
        print(f"{stray}: no operator has this name")
        if given.write:
            stray.unlink()
    return 0 if given.write or not differing else 1


if __name__ == "__main__":
    sys.exit(main())
