"""Markers over OSC, for whatever wants positions rather than a pose: games, sound, projection."""

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
class OscPointsState:
    """sent: how many samples."""

    sent: int = 0


@dataclass(slots=True)
class OscPointsRuntime:
    """The points' addresses; the socket, once there is one."""

    addresses: tuple[str, ...]
    sender: OscSender | None = None


@dataclass(frozen=True, slots=True)
class OscPoints(Outlet[OscPointsState, OscPointsRuntime]):
    """Sends markers or joints (points, 3): /markers/NAME with x, y and z as float32, a bundle (or several) a sample, by UDP.

    Axes and unit are those of the stream. A point that is not known (NaN) is not sent. Spaces and signs that OSC keeps for itself become
    underscores in names; points without names are numbered from 0.
    """

    host: str = param("127.0.0.1", help="who receives")
    port: int = param(9000, least=1, most=65535, help="the receiver's UDP port")
    address: str = param("/markers", help="what precedes the points' names")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if len(spec.shape) != 2 or spec.shape[1] != 3 or spec.dtype.kind != "f":
            raise InputError("in", spec.describe(), "points (points, 3)")
        if not self.address.startswith("/") or self.address.endswith("/") or not _is_plain(self.address):
            raise ParameterError(
                "address", self.address, "one that begins with a slash and has no ending one, in ASCII"
            )
        names = spec.channels or tuple(map(str, range(spec.shape[0])))
        addresses = tuple(f"{self.address}/{_plain(name)}" for name in names)
        if len(set(addresses)) < len(addresses):
            raise InputError("in", spec.describe(), "points with names that differ in letters or digits")
        self.set_state(OscPointsState(), OscPointsRuntime(addresses))
        return {}

    def begin(self) -> None:
        self.runtime.sender = OscSender("markers", self.host, self.port)

    def process(self, port: str, chunk: Chunk) -> None:
        sender = self.runtime.sender
        if sender is None:
            return
        for points in chunk.data:
            known = np.flatnonzero(np.isfinite(points).all(axis=1)).tolist()
            sender.send(bundles(floats(self.runtime.addresses[k], points[k].tolist()) for k in known))
        self.state.sent += len(chunk)

    def close(self) -> None:
        if self.runtime.sender is not None:
            self.runtime.sender.close()
            self.runtime.sender = None


def _is_plain(text: str) -> bool:
    return text.isascii() and text.isprintable() and not set(text) & set(" #*,?[]{}")


def _plain(name: str) -> str:
    return "".join(c if c.isascii() and (c.isalnum() or c in "_-.") else "_" for c in name)
