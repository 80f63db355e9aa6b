"""The trial itself: operators that break one law each are caught for that law, and a sound one passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.filters.iir import Highpass, Lowpass, Notch
from kinegraph.operators.filters.moving import MovingMean
from kinegraph.operators.filters.rectify import Rectify
from kinegraph.stream.chunk import FOREVER, NEVER, Chunk, Specs, StreamSpec
from kinegraph.stream.laws import RULES, Broken, Choices, Conformance, checks, lags, smallest, trials
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param
from tests.laws.broken_operators import Excused, Sound, all_broken

pytestmark = pytest.mark.quick

SEEDS = range(30)


def complaint(cls: type[Operator[Any]]) -> Broken | None:
    """What is wrong with an operator, if anything."""
    try:
        for make in trials(cls):
            trial = make()
            for check in checks(trial).values():
                check()
            for seed in SEEDS:
                trial.attempt(choices := Choices(seed))
    except Broken as broken:
        return smallest(trial.attempt, choices, broken) if "choices" in locals() else broken
    return None


@pytest.mark.parametrize(("cls", "rule"), all_broken().items(), ids=[c.__name__ for c in all_broken()])
def test_a_broken_operator_is_caught_for_what_it_breaks(cls: type[Operator[Any]], rule: str) -> None:
    broken = complaint(cls)
    assert broken is not None, f"{cls.__name__} was not caught"
    assert broken.rule == rule, str(broken)
    assert RULES[rule].advice in str(broken)


@pytest.mark.parametrize("cls", [Sound, Excused])
def test_a_sound_operator_passes(cls: type[Operator[Any]]) -> None:
    assert complaint(cls) is None


def test_every_rule_has_an_operator_that_breaks_it() -> None:
    assert set(all_broken().values()) == set(RULES)


@dataclass(slots=True)
class SmoothState:
    level: float


@dataclass(frozen=True, slots=True)
class Smooth(Operator[SmoothState]):
    """Exponential smoothing of one channel, with its centre of weight (1 - share) / share samples back; `declared` compensates for it."""

    share: float = param(0.1)
    declared: bool = param(False)

    @property
    def late_ns(self) -> int:
        return round((1 - self.share) / self.share * 10**7) if self.declared else 0

    def open(self, specs: Specs) -> Specs:
        self.set_state(SmoothState(0.0), delay_s=self.late_ns / 1e9)
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        out = np.empty(chunk.data.shape)
        for i, row in enumerate(chunk.data):
            if np.isfinite(row[0]):
                self.state.level += self.share * (row[0] - self.state.level)
            out[i] = self.state.level if np.isfinite(row[0]) else np.nan
        until = chunk.until if chunk.until in (NEVER, FOREVER) else chunk.until - self.late_ns
        return Chunk(chunk.time - self.late_ns, out, until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(1).normal(size=(400, 1))
        return [Case(cls(), {"in": (StreamSpec((1,), rate_hz=100.0), grid(100.0, 400), data)}, least=400)]


def test_a_delay_that_is_not_declared_gets_a_hint() -> None:
    case = Smooth.cases()[0]
    assert lags(Conformance(case)) == {"out": pytest.approx(0.09, abs=0.002)}
    assert lags(Conformance(replace(case, operator=Smooth(declared=True)))) == {}


@pytest.mark.parametrize("cls", [MovingMean, Lowpass, Highpass, Notch, Rectify, Envelope])
def test_our_filters_stand_where_their_input_does(cls: type[Operator[Any]]) -> None:
    assert [lags(make()) for make in trials(cls)] == [{} for _ in trials(cls)]
