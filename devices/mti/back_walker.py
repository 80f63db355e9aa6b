"""Someone who walks with an inertial sensor at the lower back: a simulated MTi on a simulated line, read as a real one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from kinegraph.devices.mti.simulator import SimulatedMti
from kinegraph.devices.mti.source import Mti
from kinegraph.devices.people.walking_back import Manner
from kinegraph.stream.chunk import Specs
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source


@dataclass(frozen=True, slots=True)
class BackWalker(Source):
    """A person of one of two manners of walking, in real time: 25 s of walking with a turn, 5 s of standing, and so on.

    imu, timing   of `devices.mti.Mti`, read through a pseudo-terminal
    """

    outputs: ClassVar[tuple[str, ...]] = ("imu", "timing")

    manner: Manner = param("brisk", help="brisk: fast, with marked heel contacts; shuffling: slow, soft, swaying")
    person: int = param(101, least=0, help="another number, another person; the shipped model was trained on 0 to 23")

    @property
    def chunk_s(self) -> float:
        return self._sensor("").chunk_s

    def specs(self) -> Specs:
        return self._sensor("").specs()

    def prepare(self) -> None:
        self._sensor("").prepare()

    def read(self, feed: Feed) -> None:
        device = SimulatedMti(site="lower_back", manner=self.manner, seed=self.person)
        with device.serving() as address:
            self._sensor(address).read(feed)

    def _sensor(self, port: str) -> Mti:
        return Mti(port=port or "/dev/null")
