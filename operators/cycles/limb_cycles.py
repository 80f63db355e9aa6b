"""Gait cycles of several limbs in one stream: each limb's channels cut at its own touch-downs."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.contacts.limb_contacts import LIMB_CONTACT
from kinegraph.operators.contacts.limbs import (
    LIMB,
    LimbsState,
    OnePerLimb,
    channels_of,
    check_limbs,
    check_named,
    merged,
    with_limb,
)
from kinegraph.operators.cycles.cycle import CLOSED
from kinegraph.operators.cycles.cycle_outputs import CycleOutputs
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec
from kinegraph.stream.operator import Case, Input, grid
from kinegraph.stream.params import param

LIMB_CLOSED = np.dtype([*CLOSED.descr, ("limb", LIMB)])
"""A cycle's event with the name of its limb; the numbers count the cycles of all limbs."""


class _Placed(OnePerLimb[Cycles]):
    """Where each limb's channels stand in the signal."""

    __slots__ = ("places",)
    places: list[list[int]]


@dataclass(frozen=True, slots=True)
class LimbCycles(_Placed):
    """A regular signal of all limbs' channels and all limbs' contacts in (events with a field `limb`), whole cycles of each limb out.

    Outputs as of `operators.cycles.cycles.Cycles`, in order of time. A sample of `cycles` has all channels; those of other limbs are NaN,
    and count as not measured for whatever adds cycles up. `closed` has a field `limb`. Of l limbs, the cycles of limb i have the numbers i,
    i + l, i + 2 l ..., so every number stands for one cycle of one limb.

    `limbs` selects each limb's channels by a pattern with a star for the muscle: {left: "L_*", right: "R_*"}; L_TA is then the left TA. A
    channel that fits no pattern is cut by the first limb. The other parameters are those of `Cycles`, and so are reasons, delay and memory.

    >>> emg = series(np.zeros((300, 2)), rate_hz=100, channels=["L_TA", "R_TA"])
    >>> steps = events([1, 1.5, 2, 2.5], LIMB_CONTACT, limb=["left", "right", "left", "right"])
    >>> found = apply(LimbCycles({"left": "L_*", "right": "R_*"}), signal=emg, touchdown=steps)["closed"]
    >>> found[["limb", "duration_s"]].tolist()
    [('left', 1.0), ('right', 1.0)]
    """

    inputs = {"signal": Input(), "touchdown": Input(), "liftoff": Input(optional=True)}
    outputs: ClassVar[tuple[str, ...]] = ("cycles", "closed", "maxima", "panorama")

    limbs: dict[str, str] = param(help='per limb, the pattern of its channels: {left: "L_*", right: "R_*"}')
    shortest_s: float = param(0.4, above=0.0, help="a shorter cycle is rejected")
    longest_s: float = param(4.0, above=0.0, most=60.0, help="a longer cycle is rejected")
    bounce_s: float = param(0.05, least=0.0, help="contacts so soon after a touch-down are the same contact")
    off_median: float = param(0.5, least=0.0, help="rejected beyond this part of the limb's recent median duration")
    min_stance_pct: float = param(15.0, least=0.0, most=100.0, help="rejected if the foot stands for less")
    max_stance_pct: float = param(90.0, least=0.0, most=100.0, help="rejected if the foot stands for more")
    gap_s: float = param(0.05, least=0.0, help="a longer gap inside rejects the cycle, a shorter one is interpolated")
    late_s: float = param(1.0, least=0.0, help="how long after it happened a touch-down may be reported")
    missing: Literal["muscle", "cycle"] = param("muscle", help="what a NaN spoils: its muscle, or the limb's cycle")

    def open(self, specs: Specs) -> Specs:
        check_named(specs, ("touchdown", "liftoff"))
        spec = specs["signal"]
        names = list(spec.channels or [f"channel {i + 1}" for i in range(spec.shape[0])])
        check_limbs(self.limbs, names)
        shared = {f.name: getattr(self, f.name) for f in fields(Cycles)}
        parts = [Cycles(**shared) for _ in self.limbs]
        muscles = channels_of(self.limbs, names)
        for part, mine in zip(parts, muscles.values(), strict=True):
            units = spec.units if len(spec.units) == 1 else tuple(spec.unit_of(name) for name in mine)
            part.open({**specs, "signal": spec.derive(shape=(len(mine),), channels=tuple(mine), units=units)})
        object.__setattr__(self, "parts", parts)
        object.__setattr__(self, "places", [[names.index(name) for name in mine] for mine in muscles.values()])
        state = LimbsState([part.state for part in parts], np.zeros((len(parts), len(self.inputs)), np.int64))
        self.set_state(state, delay_s=max(part.delay_s for part in parts), decision_s=parts[0].decision_s)
        found = {limb: list(mine) for limb, mine in muscles.items()}
        named = {channel: muscle for mine in muscles.values() for channel, muscle in mine.items()}
        meta = {k: v for k, v in spec.meta.items() if k != "side"} | {"limbs": found, "muscles": named}
        return CycleOutputs.specs(tuple(names), spec, LIMB_CLOSED, self.longest_s, meta)

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]] | None:
        if port == "signal":
            shares = [
                Chunk(chunk.time, np.ascontiguousarray(chunk.data[:, mine]), chunk.until, chunk.lost)
                for mine in self.places
            ]
        else:
            shares = self.share(port, list(self.limbs), chunk)
        made = [part.process(port, share) for part, share in zip(self.parts, shares, strict=True)]
        if not any(made):
            return None
        outputs: dict[str, list[Chunk]] = {name: [] for name in ("closed", "cycles", "maxima", "panorama")}
        for i, (part, out) in enumerate(zip(self.parts, made, strict=True)):
            part_out: dict[str, Chunk] = dict(out or ())
            for name in part.outputs:
                each = part_out.get(name) or part.state.made.blank(name, chunk.until)
                outputs[name].append(Chunk(each.time, self._of_limb(name, each.data, i), each.until, each.lost))
        return [(name, merged(chunks)) for name, chunks in outputs.items()]

    def _of_limb(self, name: str, data: Array, i: int) -> Array:
        """What limb `i` says, with the numbers and channels of all limbs."""
        if name in ("cycles", "panorama"):
            wide = np.full((*data.shape[:2], sum(map(len, self.places))), np.nan)
            wide[:, :, self.places[i]] = data
            return wide
        rows = with_limb(data, LIMB_CLOSED, list(self.limbs)[i]) if name == "closed" else data.copy()
        rows["number"] = (rows["number"] - 1) * len(self.limbs) + i + 1
        if name == "maxima":
            rows["muscle"] = np.array(self.places[i], np.int64)[rows["muscle"]]
        return rows

    @classmethod
    def cases(cls) -> list[Case]:
        inputs = some_limbs(7)
        limbs = {"left": "L_*", "right": "R_*"}
        bare = {port: given for port, given in inputs.items() if port != "liftoff"}
        return [Case(cls(limbs), inputs, least=60), Case(cls(limbs, missing="cycle", late_s=0.5), bare, least=60)]


def some_limbs(seed: int) -> dict[str, tuple[StreamSpec, Array, Array]]:
    """Made-up inputs for trying operators on: four channels of two legs and a trunk muscle, contacts of both, some at equal stamps."""
    rng = np.random.default_rng(seed)
    n = 900
    signal = StreamSpec((5,), rate_hz=60.0, channels=("L_TA", "R_TA", "L_SO", "R_SO", "ES"), units=("uV",))
    smooth = np.apply_along_axis(np.convolve, 0, rng.random((n + 8, 5)), np.ones(9) / 9, "valid")
    right = (1e9 + np.cumsum(1.0 + 0.1 * rng.random(13)) * 1e9).astype(np.int64)
    left = right + np.where(np.arange(13) == 6, 0, 520_000_000)
    spec = StreamSpec((), LIMB_CONTACT, units=("ns", ""), meta={"limb_names": ["left", "right"]})
    made = {"signal": (signal, grid(60.0, n), smooth)}
    for port, after, late in (("touchdown", 0.0, 30_000_000), ("liftoff", 0.6e9, 30_000_000)):
        onset = np.concatenate([left, right]) + int(after)
        rows = np.zeros(len(onset), LIMB_CONTACT)
        rows["onset"], rows["limb"] = onset, np.repeat(["left", "right"], 13)
        order = np.argsort(onset, kind="stable")
        made[port] = (spec, onset[order] + late, rows[order])
    return made


def some_hooves(strides: int) -> dict[str, tuple[StreamSpec, Array, Array]]:
    """Made-up contacts of four hooves: from a pace over walk and trot to a walk again, and in the last quarter of the strides a gallop."""
    names, n = ["left hind", "right hind", "left fore", "right fore"], np.arange(strides)
    gallops = n >= strides * 3 // 4
    hind, lag, duty = np.where(gallops, 0.15, 0.5), 0.025 * n, np.where(gallops, 0.4, 0.62)
    phases = np.stack([np.zeros(strides), hind, lag % 1.0, (hind + lag) % 1.0], axis=1)
    spec = StreamSpec((), LIMB_CONTACT, units=("ns", ""), meta={"limb_names": names})
    made = {}
    for port, after in (("touchdown", 0.0), ("liftoff", duty[:, None])):
        onset = (1e9 * (1.0 + n[:, None] + phases + after)).round().astype(np.int64).ravel()
        rows = np.zeros(len(onset), LIMB_CONTACT)
        rows["onset"], rows["limb"] = onset, np.tile(names, strides)
        order = np.argsort(onset, kind="stable")
        made[port] = (spec, onset[order] + 30_000_000, rows[order])
    return made
