"""Numbers of a stream as OSC messages over UDP, for TouchDesigner, Max, Unity, a game or a sonification."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.devices.osc.sender import OscSender
from kinegraph.devices.osc.writer import bundles, floats
from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param


@dataclass(slots=True)
class OscState:
    """An outlet to a network has no state."""


@dataclass(slots=True)
class OscRuntime:
    """The channels' addresses; the socket, once there is one."""

    addresses: tuple[str, ...]
    sender: OscSender | None = None


@dataclass(frozen=True, slots=True)
class OscOutlet(Outlet[OscState, OscRuntime]):
    """Sends each sample of a signal as a bundle of OSC 1.0 messages, one per channel: `address`/CHANNEL with one float32, by UDP.

    A channel's name has "_" for every character that OSC addresses do not take. A value that is not finite is not sent. In replay the
    outlet is silent. UDP does not report what is lost.
    """

    host: str = param("127.0.0.1", help="who receives")
    port: int = param(9000, least=1, most=65535, help="the receiver's UDP port")
    address: str = param("/kinegraph", help="what every address begins with")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_signal or spec.dtype.kind not in "iuf":
            raise InputError("in", spec.describe(), "a signal: rows of numeric channels")
        if not self.address.startswith("/") or self.address.endswith("/") or not self.address.isascii():
            raise ParameterError("address", self.address, "an OSC address such as /kinegraph")
        names = spec.channels or tuple(str(i + 1) for i in range(spec.shape[0]))
        self.set_state(OscState(), OscRuntime(tuple(f"{self.address}/{_plain(name)}" for name in names)))
        return {}

    def begin(self) -> None:
        self.runtime.sender = OscSender("OSC", self.host, self.port)

    def process(self, port: str, chunk: Chunk) -> None:
        runtime = self.runtime
        if runtime.sender is None:
            return
        for row in np.asarray(chunk.data, np.float64).tolist():
            result = zip(runtime.addresses, row, strict=True)
            runtime.sender.send(bundles(floats(name, [value]) for name, value in result if np.isfinite(value)))

    def close(self) -> None:
        if self.runtime.sender is not None:
            self.runtime.sender.close()
            self.runtime.sender = None


def _plain(name: str) -> str:
    """A channel's name as a part of an OSC address."""
    return "".join(c if (c.isascii() and c.isalnum()) or c in "-_." else "_" for c in name)
