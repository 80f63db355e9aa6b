"""Poses from other programs: the VMC protocol over UDP, received."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.gltf.vrm_reader import read_vrm
from kinegraph.devices.osc.protocol import OscError, read_osc
from kinegraph.devices.osc.vmc_frames import VmcFrames
from kinegraph.devices.transport.datagrams import UdpTransport
from kinegraph.devices.transport.transport import unreachable
from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.domain.humanoid import usual_body
from kinegraph.stream.domain.skeleton import JointTree
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

PATIENCE_S = 0.1


@dataclass(frozen=True, slots=True)
class Vmc(Source):
    """Poses that another program sends by the VMC protocol (a motion capture suit, a face tracker, another kinegraph).

    A pose comes once all bones that its sender had before have come, or with the next frame; stamps are those of arrival. Rotations are
    those of VRM's 22 body bones; fingers, eyes and blend shapes are not taken. `avatar` names the VRM file that the sender uses.
    """

    host: str = param("127.0.0.1", help="the address that is listened on; 0.0.0.0: all, for senders on other machines")
    port: int = param(39540, least=1, most=65535, help="the UDP port that is listened on")
    avatar: Path | None = param(None, help="the VRM file of the sender's avatar; left out: a body of usual size")

    def _tree(self) -> JointTree:
        return read_vrm(self.avatar) if self.avatar else usual_body()

    def specs(self) -> Specs:
        return {"out": self._tree().spec(None)}

    def missing(self) -> str:
        return unreachable(f"udp://{self.host}:{self.port}")

    def read(self, feed: Feed) -> None:
        frames = VmcFrames(self._tree().offsets[0])
        with UdpTransport(f"udp://{self.host}:{self.port}") as port:
            feed.ready()
            while not feed.stopped:
                if not (data := port.read(PATIENCE_S)):
                    now = feed.now()
                    feed.emit(Chunk(np.empty(0, np.int64), np.empty((0, frames.width)), now - 1))
                    continue
                now = feed.now()
                try:
                    rows = frames.feed(read_osc(data))
                except OscError:
                    feed.problem("not OSC")
                    continue
                for why, count in frames.dropped.items():
                    if count:
                        feed.problem(why, count)
                frames.dropped.clear()
                for row in rows:
                    feed.emit(Chunk(np.array([now]), row[None], now))
