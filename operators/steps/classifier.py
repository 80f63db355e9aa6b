"""What a person's steps say about them, by a trained forest: step by step, as a running vote, "uncertain" where it is (thesis, ch. 7)."""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, nan, sqrt
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.operators.steps.forest import Forest, StepModel
from kinegraph.operators.steps.steps import STEP, Steps, some_walk
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Operator
from kinegraph.stream.params import param

UNCERTAIN, NOBODY = "uncertain", "nobody enrolled"
MAX_CLASSES = 64
SHIPPED = Path(__file__).with_name("walking_manner.npz")
"""Made by `python -m tests.walking_model` from simulated people: "brisk" and "shuffling"."""


def judgement(classes: int) -> np.dtype[np.void]:
    """One step's: the likeliest class and every class's probability; `told` is that class, or "uncertain" below the model's threshold. And
    of all steps so far: `vote` is the class of most reported steps, `share` of these, with its 95 % interval; `decided` is the
    vote once the interval lies above one half, else "uncertain"; `settles`: after how many steps it would at this share, -1: never."""
    return np.dtype(
        [
            ("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("likeliest", "<U16"), ("probability", "<f8"), ("told", "<U16"),
            ("steps", "<i8"), ("sure", "<i8"), ("vote", "<U16"), ("share", "<f8"), ("low", "<f8"), ("high", "<f8"), ("decided", "<U16"),
            ("settles", "<i8"), ("mean", "<f8", (classes,)), ("probabilities", "<f8", (classes,)),
        ]
    )  # fmt: skip


def wilson(hits: float, of: float) -> tuple[float, float]:
    """Wilson's 95 % interval of a share; NaN of nothing."""
    if of <= 0:
        return nan, nan
    z2 = 1.96**2
    middle, half = (hits + z2 / 2) / (of + z2), 1.96 * sqrt(hits * (of - hits) / of + z2 / 4) / (of + z2)
    return middle - half, middle + half


@dataclass(slots=True)
class StepClassifierState:
    """counts (k,): sure steps of each class;  total (k,): sum of probabilities;  steps: with features"""

    forest: Forest
    features: Array
    classes: list[str]
    threshold: float
    open_set: bool
    counts: Samples
    total: Samples
    steps: int


@dataclass(frozen=True, slots=True)
class StepClassifier(Operator[StepClassifierState]):
    """Steps (`operators.steps.steps.Steps`) in, an event per walking step out: what the model takes it for, and the running vote.

    `model` is a file of `kinegraph motion train steps`; without one, a forest of two manners of simulated walking. It is refused for
    another sensor site, rate or axes. Its header says how well it recognises people that it has never seen, and so does the output's `meta`
    (`accuracy`). Turns, first and slow steps, and steps with NaN features count for nothing. A model that was no better than guessing
    with left-out subjects says "uncertain" at every step.

    With a model of persons, `decided` is "nobody enrolled" where the mean probability of the likeliest stays below the model's threshold.

    >>> given, made = tried(StepClassifier)
    >>> len(given["in"]), made[["likeliest", "steps"]][-1].item()
    (24, ('a', 19))
    """

    outputs: ClassVar[tuple[str, ...]] = ("judgement",)

    model: str = param(
        "", help="a file of `kinegraph motion train steps`; empty: the shipped one, of simulated walkers"
    )

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if spec.dtype != STEP:
            raise InputError("in", spec.describe(), "steps (operators.steps.steps.Steps)")
        model = some_model() if self.model == SOME else StepModel.read(Path(self.model) if self.model else SHIPPED)
        if len(model.classes) > MAX_CLASSES:
            raise InputError("in", f"{len(model.classes)} classes", f"at most {MAX_CLASSES}")
        model.check_steps(spec, self.model or SHIPPED.name)
        k = len(model.classes)
        self.set_state(
            StepClassifierState(
                model.forest, model.features, model.classes, float(model.header["uncertain_below"]),
                model.header.get("target") == "person", np.zeros(k), np.zeros(k), 0,
            )
        )  # fmt: skip
        about = {name: model.header.get(name) for name in ("target", "accuracy", "subjects", "verdict")}
        dtype = judgement(k)
        units = ("ns", "ns", *("",) * (len(dtype.names or ()) - 2))
        return {"judgement": StreamSpec((), dtype, units=units, meta={**spec.meta, **about, "classes": model.classes})}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        known = np.isin(chunk.data["kind"], ("walk",)) & np.isfinite(
            chunk.data["features"][:, self.state.features]
        ).all(axis=1)
        rows = [self._judge(step) for step in chunk.data[known]]
        data = np.concatenate([np.empty(0, judgement(len(self.state.classes))), *rows])
        return Chunk(np.ascontiguousarray(chunk.time[known]), data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        spec, time, data = some_walk(16.0, 100.0, 6)
        finder = Steps()
        out = finder.open({"in": spec})["steps"]
        steps = finder.process("in", Chunk(time, data, int(time[-1])))
        return [Case(cls(model=SOME), {"in": (out, steps.time, steps.data)}, least=10)]

    def _judge(self, step: np.void) -> Array:
        s, row = self.state, np.zeros(1, judgement(len(self.state.classes)))
        p = s.forest.probabilities(np.ascontiguousarray(step["features"][s.features]))
        best = int(np.argmax(p))
        sure = bool(p[best] >= s.threshold)
        s.steps += 1
        s.total += p
        if sure or s.open_set:
            s.counts[best] += 1
        for name in ("onset", "end", "number"):
            row[name] = step[name]
        row["likeliest"], row["probability"] = s.classes[best], p[best]
        row["told"] = s.classes[best] if sure else NOBODY if s.open_set else UNCERTAIN
        row["probabilities"], row["mean"] = p, s.total / s.steps
        self._vote(row)
        return row

    def _vote(self, row: Array) -> None:
        s = self.state
        hits, of = float(s.counts.max()), float(s.counts.sum())
        low, high = wilson(hits, of)
        row["steps"], row["sure"], row["share"], row["low"], row["high"] = (
            s.steps,
            of,
            hits / of if of else nan,
            low,
            high,
        )
        vote = s.classes[int(np.argmax(s.counts))] if of else UNCERTAIN
        row["vote"], row["settles"] = vote, settles_after(hits, of, s.steps)
        row["decided"] = vote if of and low > 0.5 else UNCERTAIN
        if s.open_set and float((s.total / s.steps).max()) < s.threshold:
            row["decided"] = NOBODY


def settles_after(hits: float, of: float, steps: int) -> int:
    """After how many steps, going on at this share, the vote's interval would lie above one half; -1: not at this share."""
    share = hits / of if of else 0.0
    if share <= 0.5:
        return -1
    need = 1.96**2 * (1.0 - (2.0 * share - 1.0) ** 2) / (2.0 * share - 1.0) ** 2
    return max(ceil(max(need, 4.0) / (of / steps)), 1)


SOME = "(made up)"


def some_model() -> StepModel:
    """A forest of two stumps, for trying the operator on."""
    forest = Forest(
        np.array([0, 3]), np.array([0, -2, -2, 1, -2, -2]), np.array([0.9, -2, -2, 0.55, -2, -2]),
        np.array([1, -1, -1, 4, -1, -1]), np.array([2, -1, -1, 5, -1, -1]),
        np.array([[0.5, 0.5], [0.9, 0.1], [0.2, 0.8], [0.5, 0.5], [0.7, 0.3], [0.4, 0.6]]),
    )  # fmt: skip
    header = {"target": "gait", "site": "lower_back", "rate_hz": 100.0, "axes": "gravity", "uncertain_below": 0.6}
    return StepModel(forest, ["a", "b"], np.arange(50), header)
