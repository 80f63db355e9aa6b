"""A program that sends the messages which a graph declares by OSC."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from kinegraph.devices.frames.datagram_simulator import sending
from kinegraph.devices.frames.declared import NS_PER
from kinegraph.devices.osc.inlet import OscArgument, OscInlet, OscStream
from kinegraph.devices.osc.vmc_protocol import text
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.stream.chunk import NS

OTHERWISE_HZ = 50.0
WAVES_HZ = 0.95
MAX_BEHIND = 5000


class OscModel:
    """The program without its network: what each stream has to say as time passes. A counter is an int32, all else float64."""

    def __init__(self, of: OscInlet) -> None:
        self._streams = of.streams
        self._said = [0] * len(of.streams)
        self._zero = [0] * len(of.streams)

    def receive(self, data: bytes) -> bytes:
        return b""

    def say(self, seconds: float) -> list[bytes]:
        found = []
        for k, stream in enumerate(self._streams):
            due = int(seconds * (stream.rate_hz or OTHERWISE_HZ))
            found += [self.message(k, i) for i in range(max(self._said[k], due - MAX_BEHIND), due)]
            self._said[k] = max(self._said[k], due)
        return found

    def restart(self) -> None:
        self._zero = list(self._said)

    def message(self, k: int, turn: int) -> bytes:
        """Message `turn` of stream `k`."""
        stream = self._streams[k]
        types, arguments = ",", b""
        for place, argument in enumerate(stream.arguments):
            counts = argument.role == "counter"
            types += "i" if counts else "d"
            number = self.number(stream, argument, place, turn, self._zero[k])
            arguments += struct.pack(">i", int(number)) if counts else struct.pack(">d", number)
        return text(stream.address) + text(types) + arguments

    @staticmethod
    def number(stream: OscStream, argument: OscArgument, place: int, turn: int, zero: int = 0) -> float:
        """What an argument of the message `turn` holds."""
        hz = stream.rate_hz or OTHERWISE_HZ
        if argument.role == "counter":
            return (turn - zero) % (1 << 31)
        if argument.role == "time":
            return (turn - zero) / hz * NS / NS_PER[argument.unit] / argument.scale
        return float(np.sin(2 * np.pi * WAVES_HZ * turn / hz + 0.9 * place)) / argument.scale


@contextmanager
def serving(model: OscModel, faults: FaultInjection = GOOD) -> Iterator[int]:
    """The UDP port at which to listen for it."""
    with sending(model, faults) as address:
        yield int(address.rsplit(":", 1)[1])


@contextmanager
def simulated(source: OscInlet) -> Iterator[OscInlet]:
    """What `--simulate` puts in its place."""
    with serving(OscModel(source)) as port:
        yield replace(source, host="127.0.0.1", port=port)
