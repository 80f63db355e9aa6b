"""A simulated device for any frames that a graph declares: somebody who walks where the units are an inertial sensor's, else slow waves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import numpy as np

from kinegraph.devices.ble.simulated_peripheral import PeripheralInReach
from kinegraph.devices.ble.simulated_radio import in_reach
from kinegraph.devices.frames.datagram_simulator import sending
from kinegraph.devices.frames.declared import NS_PER, Field, Frame
from kinegraph.devices.frames.packet_decoder import escaped
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.people.walking_back import Back
from kinegraph.devices.people.walking_limb import GRAVITY
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server, Simulator
from kinegraph.devices.transport.bluetooth import parse
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.params import param

SWING = {"deg": 25.0, "rad": 0.45}
"""How far angles go, by their unit."""
WORN = {
    "g": ("acceleration", 1 / GRAVITY), "m/s2": ("acceleration", 1.0), "m/s^2": ("acceleration", 1.0),
    "deg/s": ("angular_velocity", 180 / np.pi), "rad/s": ("angular_velocity", 1.0),
}  # fmt: skip
"""By unit: what somebody who walks has at the lower back, and the factor into that unit. The axis is the name's last letter."""
PERSON = 101
"""A walker whom the shipped model of walking manners was not trained on, as of `devices.mti.back_walker`."""
STRIDES_HZ = 0.95
OTHERWISE_HZ = 50.0
MAX_BEHIND = 5000


@dataclass(frozen=True, slots=True)
class SimulatedBinary(Simulator):
    """What a graph declares with `use: devices.frames.Binary`: config=FILE, and node=NAME if there are several."""

    port_name: ClassVar[str] = "ttyBINARY"

    config: str = param(help="the graph, a YAML file")
    node: str = param("", help="its node; left out: the first")

    def brain(self) -> BinaryModel:
        from kinegraph.stream.graph.reading.load import load

        nodes = {n.name: n.part for n in load(Path(self.config)).sources if isinstance(n.part, Binary)}
        if not nodes or (self.node and self.node not in nodes):
            raise KinegraphError(
                f"{self.config} has the devices.frames.source nodes {list(nodes)}; {self.node or 'one'} is wanted"
            )
        return BinaryModel(nodes[self.node] if self.node else next(iter(nodes.values())))


@contextmanager
def serving(brain: BinaryModel, faults: FaultInjection = GOOD) -> Iterator[str]:
    """The address of a device with these frames."""
    with Server(brain, line_at(name=SimulatedBinary.port_name), faults) as server:
        yield server.address


class BinaryModel:
    """The device without its cable: every kind of frame once in a turn, in the order of their declaration.

    `number` tells what field `place` of a frame holds in turn `i`, so that what a reader makes of it can be checked.
    """

    def __init__(self, of: Binary) -> None:
        self._layouts = of.layouts()
        self._rate = max((f.rate_hz for f in of.frames if f.rate_hz), default=OTHERWISE_HZ)
        self._wraps, self._framing = of.wraps_ns, of.framing
        self._said = self._zero = 0
        self._back, self._turn = Back("brisk", PERSON, self._rate), -1
        self._measured: dict[str, Samples] = {}
        self.heard = b""
        self.ahead_s = 0.0

    def receive(self, data: bytes) -> bytes:
        self.heard += data
        return b""

    def say(self, seconds: float) -> list[bytes]:
        due = int(seconds * self._rate)
        first = max(self._said, due - MAX_BEHIND)
        packets = [self.frame(kind, i) for i in range(first, due) for kind in range(len(self._layouts))]
        self._said = max(self._said, due)
        return packets

    def restart(self) -> None:
        self._zero = self._said

    def frame(self, kind: int, turn: int) -> bytes:
        """One frame as it is sent."""
        layout = self._layouts[kind]
        frame, seen = layout.frame, Counter[str]()
        numbers: dict[int, float] = {}
        for i, f in enumerate(layout.fields):
            earlier = (frame.samples - 1 - seen[f.name]) / frame.samples if f.is_channel else 0.0
            numbers[i] = self.number(frame, frame.fields.index(f), turn, earlier)
            seen[f.name] += 1
        return escaped(layout.build(numbers), self._framing)

    def number(self, frame: Frame, place: int, turn: int, earlier: float = 0.0) -> float:
        """A field's content: a whole number, unless it is of type f. `earlier`: than the frame, in frames."""
        f = frame.fields[place]
        if f.role == "counter":
            return (turn - self._zero) % (1 << f.bits)
        if f.role == "time":
            return self._clock(frame, f, turn - self._zero)
        if not f.name:
            return 0
        if f.unit in WORN and f.name[-1] in "xyz":
            high = 2.0 ** (f.bits - 1) - 1
            value = (self._worn(f, turn) - f.offset) / f.scale
            return value if f.type[0] == "f" else float(np.clip(round(value), -high, high))
        wave = np.sin(2 * np.pi * STRIDES_HZ * (turn - earlier) / self._rate + 0.9 * place)
        high = 2.0 ** (f.bits - 1) - 1
        low = 0.0 if f.type[0] == "u" else -high
        if f.unit in SWING:
            value = (SWING[f.unit] * wave - f.offset) / f.scale
        else:
            value = wave / f.scale if f.type[0] == "f" else (0.25 * high * wave + (high if f.type[0] == "u" else 0))
        return (
            float(value)
            if f.type[0] == "f"
            else float(np.clip(round(value), low, 2 * high if f.type[0] == "u" else high))
        )

    def _worn(self, f: Field, turn: int) -> float:
        """What the sensor measures in turn `turn`, in the field's unit."""
        if turn != self._turn:
            self._turn, self._measured = turn, self._back.measure(np.array([turn]))
        kind, factor = WORN[f.unit]
        return factor * float(self._measured[kind][0, "xyz".index(f.name[-1])])

    def _clock(self, frame: Frame, f: Field, turn: int) -> float:
        """This field's part of the device's time: the largest unit holds what is left, each other one its remainder."""
        ns = round(turn * NS / self._rate) + round(self.ahead_s * NS)
        if self._wraps:
            ns %= self._wraps
        if f.type[0] == "f":
            return ns / (NS_PER[f.unit] * f.scale)
        if f.scale != 1.0:
            return float(round(ns / (NS_PER[f.unit] * f.scale)) % (1 << f.bits))
        larger = [NS_PER[g.unit] for g in frame.with_role("time") if NS_PER[g.unit] > NS_PER[f.unit]]
        return float((ns % min(larger) if larger else ns) // NS_PER[f.unit] % (1 << f.bits))


class NotifyingModel:
    """Frames as a Bluetooth LE peripheral notifies them."""

    def __init__(self, source: Binary, model: BinaryModel) -> None:
        self.name, self._notify, written = parse(source.port)
        self.advertised: tuple[str, ...] = ("ffe5",)
        self._model = model
        self.services = {"ffe5": {self._notify: ["notify"]} | ({written: ["write"]} if written else {})}

    def connected(self, yes: bool) -> None: ...

    def hold(self, characteristic: str) -> bytes:
        return b""

    def receive(self, characteristic: str, data: bytes) -> list[tuple[str, bytes]]:
        self._model.receive(data)
        return []

    def say(self, seconds: float) -> list[tuple[str, bytes]]:
        return [(self._notify, frame) for frame in self._model.say(seconds)]


def notifying(
    source: Binary, model: BinaryModel, faults: FaultInjection = GOOD
) -> AbstractContextManager[PeripheralInReach]:
    """A peripheral that notifies a device's frames."""
    return in_reach(NotifyingModel(source, model), faults)


@contextmanager
def simulated(source: Binary) -> Iterator[Binary]:
    """What `--simulate` puts in its place."""
    model = BinaryModel(source)
    if source.port.startswith("ble://"):
        with notifying(source, model):
            yield source
        return
    with sending(model) if source.port.startswith("udp://") else serving(model) as address:
        yield replace(source, port=address)
