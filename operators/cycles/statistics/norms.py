"""Each cycle beside a laboratory's own normative bands."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.operators.contacts.limbs import Belonging
from kinegraph.operators.cycles.cycle import POINTS, Expected, check_cycles, some_cycles
from kinegraph.operators.cycles.statistics.norm_file import read_bands
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.finite import only_finite
from kinegraph.stream.errors import KinegraphError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

AGAINST = np.dtype(
    [
        ("onset", "<i8"), ("end", "<i8"), ("number", "<i8"), ("name", "<U16"), ("outside_pct", "<f8"), ("above_pct", "<f8"),
        ("below_pct", "<f8"), ("furthest_pct", "<f8"), ("beyond", "<f8"),
    ]
)  # fmt: skip
"""A muscle of a cycle beside its band: for how much of the cycle it lies outside, above and below; where it is furthest outside (NaN: it
is not), and by how much (above positive)."""
STEP_PCT = 100 / POINTS


@dataclass(slots=True)
class NormativeBandsState:
    """low, high (100, m): the bands; NaN for a muscle without a band."""

    expected: Expected
    low: Samples
    high: Samples
    limbs: Belonging
    names: list[str]


@dataclass(frozen=True, slots=True)
class NormativeBands(Operator[NormativeBandsState]):
    """Cycles and their events in; with every accepted cycle, the bands that it is held against, and how it lies in them.

    low, high   (100, muscles) the bands from the table `file`, with each cycle, for the page and the report; NaN for a muscle without one
    against     one event per muscle that has a band (`AGAINST`)

    The table (CSV) is the laboratory's own: no bands come with this software, since they depend on speed, age, electrodes and filters. Its
    columns are muscle, cycle_pct, and low and high, or mean and sd, with the unit in brackets: "low [% MVC]". The unit must be the
    cycles', which names the normalisation, too; another is refused. With several limbs a row for TA holds for L_TA and R_TA.

    >>> made = apply(NormativeBands.cases()[0].operator, **some_cycles(8, 2, seed=1))
    >>> made["low"][0, ::50].round().tolist(), made["high"][0, ::50].round().tolist()
    ([[44.0, 69.0], [44.0, 19.0]], [[56.0, 81.0], [56.0, 31.0]])
    """

    inputs = {"closed": Input(), "cycles": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("low", "high", "against")

    file: str = param("", help="the table with the bands; left out: there are no bands")
    sds: float = param(2.0, above=0.0, help="of mean and sd: how many sd a band reaches to each side")

    def open(self, specs: Specs) -> Specs:
        spec = check_cycles(specs)
        unit = spec.units[0] if len(spec.units) == 1 else ""
        low, high = (np.full((POINTS, spec.shape[1]), np.nan) for _ in range(2))
        try:
            found, bands = read_bands(Path(self.file), self.sds) if self.file else (unit, {})
        except KinegraphError as error:
            raise ParameterError("file", self.file, f"a table of bands: {error}") from None
        if found != unit:
            raise ParameterError(
                "file", f"bands in {found or 'no unit'}", f"bands in {unit or 'no unit'}, as the cycles are"
            )
        muscles = dict(spec.meta.get("muscles") or {})
        for i, channel in enumerate(spec.channels):
            band = bands.get(channel, bands.get(muscles.get(channel, channel)))
            if band is not None:
                low[:, i], high[:, i] = band
        if self.file and np.isnan(low).all():
            raise ParameterError("file", ", ".join(bands), f"bands of these muscles: {', '.join(spec.channels)}")
        state = NormativeBandsState(
            Expected.empty(specs["closed"].dtype), low, high, Belonging.of(spec), list(spec.channels)
        )
        self.set_state(state, decision_s={"against": 0.0})
        meta = {**spec.meta, "norms": Path(self.file).name}
        units = ("ns", "ns", "", "", "%", "%", "%", "%", unit)
        return {
            "low": spec.derive(meta=meta),
            "high": spec.derive(meta=meta),
            "against": StreamSpec((), AGAINST, units=units, meta=meta),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        made: list[tuple[int, Array]] = []
        if port == "closed":
            s.expected.note(chunk)
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                made.append((stamp, self._rows(closed[0], only_finite(curve))))
        lost, stamps = -1 if chunk.lost else 0, np.array([stamp for stamp, _ in made], np.int64)
        bands = [np.repeat(band[None], len(made), axis=0) for band in (s.low, s.high)]
        rows = np.concatenate([np.empty(0, AGAINST), *(rows for _, rows in made)])
        return [
            ("low", Chunk(stamps, bands[0], chunk.until, lost)),
            ("high", Chunk(stamps, bands[1], chunk.until, lost)),
            ("against", Chunk(stamps.repeat([len(rows) for _, rows in made]), rows, chunk.until, lost)),
        ]

    @classmethod
    def cases(cls) -> list[Case]:
        file = str(Path(__file__).with_name("made_up_bands.csv"))
        return [Case(cls(file), some_cycles(20, 3, 7), least=60), Case(cls(file, 1.0), some_cycles(12, 2, 8), least=30)]

    def _rows(self, closed: np.void, curve: Samples) -> Array:
        s = self.state
        mine = s.limbs.mine(closed) & ~np.isnan(s.low).any(axis=0) & ~np.isnan(curve).any(axis=0)
        rows = np.zeros(int(mine.sum()), AGAINST)
        for name in ("onset", "end", "number"):
            rows[name] = closed[name]
        rows["name"] = [name for name, one in zip(s.names, mine, strict=True) if one]
        over = beyond(curve[:, mine], s.low[:, mine], s.high[:, mine])
        rows["above_pct"], rows["below_pct"] = (over > 0).sum(axis=0) * STEP_PCT, (over < 0).sum(axis=0) * STEP_PCT
        rows["outside_pct"] = (over != 0).sum(axis=0) * STEP_PCT
        furthest = np.abs(over).argmax(axis=0)
        rows["beyond"] = over[furthest, np.arange(len(rows))]
        rows["furthest_pct"] = np.where(rows["beyond"] != 0, furthest * STEP_PCT, np.nan)
        return rows


def beyond(curve: Samples, low: Samples, high: Samples) -> Samples:
    """By how much each point (n, m) lies above (positive) or below (negative) its band; 0 inside."""
    return np.asarray(np.where(curve > high, curve - high, np.where(curve < low, curve - low, 0.0)))
