"""A session's cycles by limb and by stage, and what two limbs have in common: what a report remembers of them, in bounded memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.reports.session.contents.revisions import REVISABLE
from kinegraph.devices.reports.session.contents.running import Running
from kinegraph.stream.chunk import Array, Samples, Specs, Times

MAX_STAGES = 16
"""This many stages are reported apart; later ones count in the session's numbers only."""
GAIT = ("cadence", "duration_s", "stance_pct")
BURSTS = ("cycles", "per_cycle", "on_pct", "on_sd_pct", "off_pct", "off_sd_pct", "duration_pct", "duration_sd_pct")
EMPTY = -1


@dataclass(slots=True)
class Groups:
    """
    limbs, limb_gait     per limb: cadence, duration, stance (3,) of its accepted cycles
    stages, ...          per stage: cadence, duration, stance and belt speed (4,), the curves (100, m), the numbers (fields, m)
    where (64, 2)        limb and stage of the latest cycles, in the places where `Revisable` keeps them;  speeds (64,)
    phases, duties       per limb of the footfalls: where in the stride it comes down, for how much it stands
    support              (3,) double support, flight, feet;  gaits, strides: the gaits' names, and how many strides of each
    bursts               per muscle the latest cycles, bursts per cycle, then on, off and duration, each with its deviation (8,)
    active (100, m)      in which share of the cycles each muscle was active
    indices              the latest symmetry indices: name, measure, and (4,) mean, low, high, pairs
    """

    limbs: list[str]
    limb_gait: list[Running]
    stages: list[str]
    stage_gait: list[Running]
    stage_curves: list[Running]
    stage_fields: list[Running]
    where: Times
    speeds: Samples
    feet: list[str]
    phases: list[Running]
    duties: list[Running]
    support: Running
    gaits: list[str]
    strides: list[int]
    burst_names: list[str]
    bursts: list[Samples]
    active: Samples
    index_names: list[str]
    indices: list[Samples]

    @staticmethod
    def empty(specs: Specs) -> Groups:
        limbs = list(specs["cycles"].meta.get("limbs") or ())
        feet = list(specs["footfalls"].meta.get("limb_names") or ()) if "footfalls" in specs else []
        return Groups(
            limbs, [Running.of((len(GAIT),)) for _ in limbs], [], [], [], [], np.full((REVISABLE, 2), EMPTY), np.zeros(REVISABLE),
            feet, [Running.of((1,), 100.0) for _ in feet], [Running.of((1,)) for _ in feet], Running.of((3,)), [], [],
            [], [], np.full(specs["cycles"].shape, np.nan), [], [],
        )  # fmt: skip

    def closed(self, k: int, row: Any, shape: tuple[int, ...], fields: int) -> None:
        """An accepted cycle, kept at `k`."""
        names = row.dtype.names or ()
        gait = [float(row[name]) for name in GAIT]
        self.where[k] = EMPTY
        if "limb" in names and str(row["limb"]) in self.limbs:
            self.where[k, 0] = self.limbs.index(str(row["limb"]))
            self.limb_gait[self.where[k, 0]].add(np.array(gait))
        stage = str(row["stage"]) if "stage" in names else ""
        if not stage or (stage not in self.stages and len(self.stages) == MAX_STAGES):
            return
        if stage not in self.stages:
            self.stages.append(stage)
            self.stage_gait.append(Running.of((len(GAIT) + 1,)))
            self.stage_curves.append(Running.of(shape))
            self.stage_fields.append(Running.of((fields, shape[1])))
        self.where[k, 1], self.speeds[k] = self.stages.index(stage), float(row["speed_m_s"])
        self.stage_gait[self.where[k, 1]].add(np.array([*gait, self.speeds[k]]))

    def curve(self, k: int, curve: Samples) -> None:
        if self.where[k, 1] != EMPTY:
            self.stage_curves[self.where[k, 1]].add(curve)

    def numbers(self, k: int, values: Samples) -> None:
        """The muscles' numbers (fields, m) of a cycle."""
        if self.where[k, 1] != EMPTY:
            self.stage_fields[self.where[k, 1]].add(values)

    def take_out(self, k: int, gait: Samples, curve: Samples, fields: Samples) -> None:
        """A cycle is about to be reported again."""
        limb, stage = (int(i) for i in self.where[k])
        if limb != EMPTY:
            self.limb_gait[limb].remove(gait)
        if stage != EMPTY:
            self.stage_gait[stage].remove(np.array([*gait, self.speeds[k]]))
            self.stage_curves[stage].remove(curve)
            self.stage_fields[stage].remove(fields)
        self.where[k] = EMPTY

    def add(self, port: str, rows: Array) -> None:
        """Footfalls, gaits, symmetry indices."""
        for row in rows:
            if port == "footfalls" and str(row["limb"]) in self.feet:
                i = self.feet.index(str(row["limb"]))
                self.phases[i].add(np.array([row["phase_pct"]]))
                self.duties[i].add(np.array([row["duty_pct"]]))
            elif port == "gait":
                self.support.add(np.array([row["double_support_pct"], row["flight_pct"], row["feet"]]))
                self._count(str(row["gait"]))
            elif port == "active":
                self.active = np.array(row)
            elif port == "bursts":
                self._bursts(row)
            elif port == "symmetry":
                self._index(row)

    def _count(self, gait: str) -> None:
        if gait not in self.gaits:
            self.gaits.append(gait)
            self.strides.append(0)
        self.strides[self.gaits.index(gait)] += 1

    def _bursts(self, row: Any) -> None:
        name = str(row["name"])
        if name not in self.burst_names:
            self.burst_names.append(name)
            self.bursts.append(np.zeros(len(BURSTS)))
        self.bursts[self.burst_names.index(name)] = np.array([float(row[field]) for field in BURSTS])

    def _index(self, row: Any) -> None:
        name = f"{row['name']}|{row['measure']}"
        if name not in self.index_names:
            self.index_names.append(name)
            self.indices.append(np.zeros(4))
        values = [row["mean_pct"], row["low_pct"], row["high_pct"], row["pairs"]]
        self.indices[self.index_names.index(name)] = np.array(values, np.float64)
