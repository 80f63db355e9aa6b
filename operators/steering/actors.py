"""Fits actors' markers to those of a model, in the ranges that these had in training (thesis 9.3.2, figure 9.1)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.operators.inputs.directions import turned_to
from kinegraph.operators.inputs.lengths import length_of, metres
from kinegraph.operators.inputs.marker_columns import marker_columns
from kinegraph.operators.steering.model.stored import KIND, MAKER, from_model
from kinegraph.operators.steering.operator import model_file
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.model_file import read_model
from kinegraph.stream.domain.axes import Axes, in_axes
from kinegraph.stream.errors import ParameterError, nearest
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

MOST = 2.5
"""No marker goes farther than this many standard deviations of its training."""


@kernel
def match_ranges(
    rows: Samples,
    columns: Times,
    scale: Samples,
    wanted: float,
    usual: Samples,
    spread: Samples,
    sums: Samples,
    held: Samples,
    out: Samples,
) -> None:
    """Markers of actors, `rows` (n, width), as those of a model, into `out` (n, m, 3).

    columns  (k, 7)  the model's marker, the columns of the actor's marker, and of the one that it is seen from, along the model's axes
    scale    (3,)    what turns them into the model's coordinates
    sums     (k, 7)  how many samples an actor's range was learned from (at most `wanted`), their sums and those of their squares
    held     (m, 3)  the newest of each
    """
    for i in range(rows.shape[0]):
        for k in range(columns.shape[0]):
            c, s = columns[k], sums[k]
            known = True
            for a in range(3):
                v = rows[i, c[1 + a]] - rows[i, c[4 + a]]
                known = known and v == v
            if not known:
                continue
            learns = s[0] < wanted
            s[0] += 1.0 if learns else 0.0
            for a in range(3):
                v = scale[a] * (rows[i, c[1 + a]] - rows[i, c[4 + a]])
                if learns:
                    s[1 + a] += v
                    s[4 + a] += v * v
                elif spread[c[0], a] > 0.0:
                    mean = s[1 + a] / s[0]
                    deviation = math.sqrt(max(s[4 + a] / s[0] - mean * mean, 1e-8))
                    z = min(max((v - mean) / deviation, -MOST), MOST)
                    held[c[0], a] = usual[c[0], a] + z * spread[c[0], a]
        out[i] = held


@dataclass(slots=True)
class ActorsState:
    sums: Samples
    held: Samples


class _Cast(Operator[ActorsState]):
    """What does not change while samples come."""

    __slots__ = ("columns", "scale", "spread", "usual", "wanted")
    columns: Times
    scale: Samples
    wanted: float
    usual: Samples
    spread: Samples


@dataclass(frozen=True, slots=True)
class Actors(_Cast):
    """Markers of one or several actors (points, 3) in; out come the markers of a mesh model, for operators.steering.SteerMesh.

    `limbs` says which marker of the model an actor's marker moves, and what that is seen from: {hoof_fl: [first.foot_l, first.hip]}. In the
    first `learn_s` an actor's marker is seen its range is learned, mean and standard deviation of each axis; from then on it is mapped to
    the range in which the model's marker moved in the training. What is not seen stays: an actor who leaves freezes only his own limbs.
    Markers of the model without an actor stay at their mean. No delay.

    An input that declares its axes is turned to those of the model: up stays up, and who walks forward moves the mesh's limbs forward. One
    without axes, or for a model trained on such, is taken as it is: operators.filters.turn_axes.TurnAxes declares and turns
    axes.

    >>> given, made = tried(Actors)
    >>> given["in"][-1, 0].round(2), made[-1, 0].round(2)
    (array([-0.55,  0.2 , -0.87]), array([ 0.19, -1.18,  0.18]))
    """

    inputs = {"in": Input(finite=True)}

    limbs: Mapping[str, tuple[str, str]] = param(
        help="the model's marker: [actor's marker, the marker that it is seen from]"
    )
    model: Path | None = param(None, help="the model that is steered, or `dog`; left out: the simple quadruped")
    learn_s: float = param(3.0, above=0.0, help="how long an actor's range of motion is learned")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        unit = length_of(spec)
        model = read_model(model_file(self.model), KIND, MAKER)
        learned, _ = from_model(model)
        axes = Axes.from_facts(model.header.get("axes"))
        order, signs = turned_to(axes, spec)
        rows = []
        for name, (actor, seen_from) in self.limbs.items():
            if name not in learned.markers:
                raise ParameterError("limbs", name, f"a marker of the model; {nearest(name, learned.markers)}")
            places = [marker_columns(spec, one, "limbs")[a] for one in (actor, seen_from) for a in order]
            rows.append((learned.markers.index(name), *places))
        if not rows:
            raise ParameterError("limbs", dict(self.limbs), "a mapping of at least one marker of the model")
        object.__setattr__(self, "columns", np.array(rows, np.int64))
        object.__setattr__(self, "scale", metres(unit) * np.array(signs))
        object.__setattr__(self, "wanted", max(2.0, self.learn_s * (spec.rate_hz or 30.0)))
        object.__setattr__(self, "usual", learned.usual)
        object.__setattr__(self, "spread", learned.spread)
        self.set_state(ActorsState(np.zeros((len(rows), 7)), learned.usual.copy()))
        settling_s = spec.settling_s + self.learn_s
        names, m = learned.markers, len(learned.markers)
        meta = {key: value for key, value in in_axes(spec, axes).items() if key != "skeleton"}
        out = StreamSpec((m, 3), rate_hz=spec.rate_hz, channels=names, units=("m",), settling_s=settling_s, meta=meta)
        return {"out": out}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        out = np.empty((len(chunk.time), *s.held.shape))
        if len(chunk.time):
            match_ranges(
                chunk.data, self.columns, self.scale, self.wanted, self.usual, self.spread, s.sums, s.held, out
            )
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rows = np.random.default_rng(8).normal(0.0, 0.1, (120, 3, 3)).cumsum(axis=0)
        rows[70:80, 1] = np.nan
        spec = StreamSpec((3, 3), rate_hz=30.0, channels=("hip", "foot_l", "foot_r"), units=("m",))
        limbs = {"hoof_fl": ("foot_l", "hip"), "hoof_fr": ("foot_r", "hip")}
        return [Case(cls(limbs=limbs, learn_s=1.0), {"in": (spec, grid(30.0, 120), rows)}, least=120)]
