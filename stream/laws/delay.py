"""How far an output stands behind its input by its stamps: what no law can ask, as some filters leave their stamps on purpose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.laws.case_samples import CaseSamples
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.laws import Conformance
from kinegraph.stream.laws.play import Player
from kinegraph.stream.operator import Case

ONE_WAY = 0.7
"""The part of a response that goes one way, as smoothing does; what lets slow changes not pass has no lag to speak of."""
PERIODS = 1.0
"""Up to this many periods of the slower stream are a matter of taste."""


def lags(trial: Conformance) -> dict[str, float]:
    """Seconds from an impulse to the centre of what it leads to, by outputs' stamps, where that is more than a sample.

    Only for an operator of one regular input and regular outputs of the same width, with an impulse response of one sign.
    """
    tapes = list(trial.tapes.items())
    if len(tapes) != 1 or not tapes[0][1].spec.period_ns or not tapes[0][1].is_float:
        return {}
    port, tape = tapes[0]
    at = len(tape) // 3
    quiet, struck = (_answer(trial, port, _impulse(tape, at, size)) for size in (0.0, 1.0))
    found = {}
    for name, (time, before) in quiet.items():
        after = struck[name][1]
        if before.shape != after.shape or not len(time) or before.shape[1] != tape.columns().shape[1]:
            continue
        change = np.nan_to_num(after - before).sum(axis=1)
        if abs(change.sum()) <= ONE_WAY * np.abs(change).sum():
            continue
        lag = float((change * (time - tape.time[at])).sum() / change.sum())
        if lag > PERIODS * max(tape.spec.period_ns, trial.reference.outputs[name].spec.period_ns):
            found[name] = lag / NS
    return found


def _impulse(tape: CaseSamples, at: int, size: float) -> CaseSamples:
    data = np.zeros_like(tape.data)
    data[at] = size
    return replace(tape, data=data)


def _answer(trial: Conformance, port: str, tape: CaseSamples) -> dict[str, tuple[Array, Array]]:
    """Stamps (n,) and numbers (n, m) of every regular output."""
    case = Case(trial.case.operator, {port: (tape.spec, tape.time, tape.data)})
    player = Player(case, excused=frozenset(trial.excused)).play(whole({port: tape}))
    return {
        name: (output.time, output.data.reshape(len(output.time), -1).astype(np.float64))
        for name, output in player.outputs.items()
        if output.spec.period_ns and output.spec.dtype.kind == "f"
    }
