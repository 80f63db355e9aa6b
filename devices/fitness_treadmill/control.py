"""A treadmill's speed and incline set from a graph, through the source that is connected to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from kinegraph.devices.fitness_treadmill import protocol as ftms
from kinegraph.devices.fitness_treadmill.targets import Targets, targets_of
from kinegraph.stream.chunk import Chunk, Samples, Specs
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

KINDS: Mapping[str, tuple[int, float, str]] = {"speed": (ftms.SPEED, 3.6, "m/s"), "incline": (ftms.INCLINE, 1.0, "%")}
"""By port: the setting, the factor to its unit there (km/h, %), and the unit here."""


@dataclass(slots=True)
class TreadmillCommand:
    """The last speed and incline that were asked for (2,)."""

    last: Samples = field(default_factory=lambda: np.full(2, np.nan))


class TreadmillConnection:
    """The way to the source; None while nothing is set (a replay)."""

    def __init__(self) -> None:
        self.targets: Targets | None = None


@dataclass(frozen=True, slots=True)
class TreadmillControl(Outlet[TreadmillCommand, TreadmillConnection]):
    """Sets the treadmill that `devices.fitness_treadmill.FtmsTreadmill` with the same `device` and `control: true` is connected to.

    speed     a signal of one channel, m/s
    incline   a signal of one channel, %

    Only changes of at least `step` are sent; NaN leaves a setting as it is. The source holds them within the treadmill's own limits and its
    `max_kmh`. A belt that moves can throw a person: keep that low, and the safety key attached. In a replay nothing is set.
    """

    inputs = {"speed": Input(), "incline": Input(optional=True)}
    in_order: ClassVar[bool] = False

    device: str = param("", help="as the source has it")
    step: float = param(0.02, above=0, help="a smaller change (m/s or %) is not sent")

    def open(self, specs: Specs) -> Specs:
        for port, spec in specs.items():
            unit = KINDS[port][2]
            if (
                not spec.is_signal
                or spec.shape != (1,)
                or spec.unit_of(spec.channels[0] if spec.channels else "") not in ("", unit)
            ):
                raise InputError(port, spec.describe(), f"a signal of one channel in {unit}")
        self.set_state(TreadmillCommand(), TreadmillConnection())
        return {}

    def begin(self) -> None:
        self.runtime.targets = targets_of(self.device)

    def process(self, port: str, chunk: Chunk) -> None:
        if not len(chunk) or self.runtime.targets is None:
            return
        place, (kind, factor, _) = [*self.inputs].index(port), KINDS[port]
        value = float(chunk.data[-1, 0])
        if np.isfinite(value) and not abs(value - self.state.last[place]) < self.step:
            self.state.last[place] = value
            self.runtime.targets.set(kind, value * factor)

    def close(self) -> None:
        self.runtime.targets = None
