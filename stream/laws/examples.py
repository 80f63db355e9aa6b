"""Operators on a few samples, for the examples in their docstrings and for trying one out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np

from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.data.series import Series
from kinegraph.stream.laws.case_samples import tapes_of
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.play import Player
from kinegraph.stream.operator import Case, Operator

Given: TypeAlias = Series | tuple[StreamSpec, Array, Array]
IN_SECONDS = ("onset", "end")


def apply(operator: Operator[Any], **inputs: Given) -> Any:
    """Feed an operator with several inputs as a graph does: its output as an array, or a mapping of arrays for several outputs."""
    tuples = {
        port: (given.spec, given.time, given.data) if isinstance(given, Series) else given
        for port, given in inputs.items()
    }
    case = Case(operator, tuples)
    player = Player(case).play(whole(tapes_of(case)))
    made: Mapping[str, Array] = {name: output.data for name, output in player.outputs.items()}
    return made if len(made) > 1 else next(iter(made.values()), None)


def events(at_s: Sequence[float], kind: Any = (("onset", "<i8"),), units: Sequence[str] = (), **fields: Any) -> Series:
    """Events stamped `at_s` (seconds), with these fields; `onset` and `end` are in seconds as well, and `onset` defaults to the stamp."""
    time = np.round(np.asarray(at_s, float) * NS).astype(np.int64)
    rows = np.zeros(len(time), np.dtype(list(kind) if isinstance(kind, tuple) else kind))
    for name, values in {"onset": at_s, **fields}.items():
        if name in (rows.dtype.names or ()):
            rows[name] = np.round(np.asarray(values, float) * NS) if name in IN_SECONDS else values
    return Series(
        "events", StreamSpec((), rows.dtype, units=tuple(units) or ("",) * len(rows.dtype.names or ())), time, rows
    )


def tried(kind: type[Operator[Any]]) -> tuple[dict[str, Array], Any]:
    """Run an operator on the first of its cases: the input samples by port, and what `apply` returns."""
    case = kind.cases()[0]
    return {port: data for port, (_, _, data) in case.inputs.items()}, apply(case.operator, **case.inputs)
