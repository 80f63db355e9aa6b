"""A simulated NatNet server on loopback, 3.0 to 4.2: a rigid body, a skeleton, labelled markers, a force plate."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from kinegraph.devices.natnet import protocol as protocol
from kinegraph.devices.natnet.build import build_frame, build_models
from kinegraph.devices.natnet.protocol import (
    NatNetBody,
    NatNetError,
    NatNetFrame,
    NatNetMarker,
    NatNetModels,
    ServerInfo,
    Version,
)
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection, FaultInjector
from kinegraph.devices.transport.closing import ClosesAtExit

if TYPE_CHECKING:
    from kinegraph.devices.natnet.source import NatNet

TICK_HZ = 10_000_000
FORGETS_S = 5.0
MODELS = NatNetModels(
    sets={"Shank": ["knee", "ankle", "toe"]},
    bodies={7: "Shank"},
    markers={7: ["knee", "ankle", "toe"]},
    skeletons={2: ("Fred", {1: ("Hips", 0), 2: ("LThigh", 1)})},
    analog={("plate", 1): ["Fx", "Fy", "Fz"]},
)
PLATE_SAMPLES = 5


@dataclass(frozen=True, slots=True)
class NatNetScene:
    """What is moved: `frame` gives frame i. Every 50th frame the ankle is occluded, every 100th the body lost."""

    rate_hz: float = 120.0
    models: NatNetModels = field(default_factory=lambda: MODELS)
    plate_samples: int = PLATE_SAMPLES

    def frame(self, number: int) -> NatNetFrame:
        t = number / self.rate_hz
        swing = np.sin(2 * np.pi * 0.9 * t)
        half = 0.3 * swing
        at = (float(number % 1000), 1.0 + 0.1 * float(swing), float(np.cos(t)))
        rotation = (0.0, 0.0, float(np.sin(half)), float(np.cos(half)))
        tracked = number % 100 != 99
        made = NatNetFrame(number, time_s=t, ticks=tuple(round(t * TICK_HZ) + 5_000_000_000 + k for k in (0, 40, 90)))  # type: ignore[arg-type]
        markers = [(at[0], at[1] - 0.2 * k, at[2]) for k in range(3)]
        made.sets = dict.fromkeys(self.models.sets, markers)
        for i in self.models.bodies:
            made.bodies.append(NatNetBody(i, at, rotation, 0.0005, tracked))
            made.markers += [
                NatNetMarker(i, k + 1, p, 0.02, 1 if k == 1 and number % 50 == 49 else 10, 0.0003)
                for k, p in enumerate(markers)
            ]
        for number_of, (_, bones) in self.models.skeletons.items():
            made.skeletons[number_of] = [
                NatNetBody(
                    number_of << 16 | bone,
                    (0.0, 0.9 - 0.4 * bone, float(number % 500)),
                    (0.0, 0.0, 0.0, 1.0),
                    0.001,
                    True,
                )
                for bone in bones
            ]
        for key, names in self.models.analog.items():
            made.analog[key] = [
                tuple(float(1000 * c + self.plate_samples * (number % 1000) + k) for k in range(self.plate_samples))
                for c in range(len(names))
            ]
        return made


class NatNetServer(ClosesAtExit):
    """Answers and sends as Motive does: unicast to who asks and keeps asking, or multicast on `group`."""

    def __init__(
        self, scene: NatNetScene, version: Version = (3, 0), *, multicast: bool = False, faults: FaultInjection = GOOD, port: int = 0
    ) -> None:  # fmt: skip
        self.scene, self._version, self._multicast = scene, version, multicast
        self.injector = FaultInjector(faults)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", port))
        self._socket.settimeout(0.002)
        self._socket.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton("127.0.0.1"))
        self.port = int(self._socket.getsockname()[1])
        self.data_port = _free_port() if multicast else protocol.DATA_PORT
        self._clients: dict[tuple[str, int], float] = {}
        self.changed, self.paused = False, False
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="simulated NatNet", daemon=True)
        self._thread.start()

    @property
    def info(self) -> ServerInfo:
        return ServerInfo("Motive", (3, 1, 0, 0), self._version, TICK_HZ, self.data_port, self._multicast)

    def _work(self) -> None:
        began, result = time.monotonic(), 0
        while not self._stop.is_set():
            self._hear()
            due = int((time.monotonic() - began) * self.scene.rate_hz)
            for number in range(result, due):
                self._send(number)
            result = max(due, result)

    def _hear(self) -> None:
        try:
            data, who = self._socket.recvfrom(4096)
            kind, payload = protocol.opened(data)
        except (TimeoutError, OSError, NatNetError):
            return
        answers = {
            protocol.CONNECT: (protocol.SERVER_INFO, protocol.build_server_info(self.info)),
            protocol.DISCOVERY: (protocol.SERVER_INFO, protocol.build_server_info(self.info)),
            protocol.REQUEST_MODELS: (protocol.MODELS, build_models(self.scene.models, self._version)),
            protocol.ECHO_REQUEST: (protocol.ECHO, payload[:8] + (0).to_bytes(8, "little")),
        }
        if kind == protocol.CONNECT or who in self._clients:
            self._clients[who] = time.monotonic()
        if kind in answers:
            self._socket.sendto(protocol.message(*answers[kind]), who)

    def _send(self, number: int) -> None:
        if self.paused:
            return
        frame = self.scene.frame(number)
        frame.flags |= protocol.MODELS_CHANGED if self.changed else 0
        packet = protocol.message(protocol.FRAME, build_frame(frame, self._version))
        now = time.monotonic()
        to = (
            [(protocol.GROUP, self.data_port)]
            if self._multicast
            else [c for c, at in self._clients.items() if now - at < FORGETS_S]
        )
        for one in self.injector.spoil([packet], number / self.scene.rate_hz):
            for who in to:
                self._socket.sendto(one, who)
        self.changed = False

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("", 0))
        return int(one.getsockname()[1])


def scene_of(source: NatNet) -> NatNetScene:
    """A scene that has what a source names."""
    bodies = dict(enumerate((n for n in source.bodies if ":" not in n), 1))
    models = NatNetModels(bodies=bodies)
    for name in source.markers:
        body, _, marker = name.partition(":")
        number = next((i for i, n in models.bodies.items() if n == body), len(models.bodies) + 1)
        models.bodies[number] = body
        names = models.markers.setdefault(number, [])
        names += [str(i + 1) for i in range(len(names), int(marker))] if marker.isdigit() else [marker]
    for name in (n for n in source.bodies if ":" in n):
        skeleton, _, bone = name.partition(":")
        number = next((i for i, (n, _) in models.skeletons.items() if n == skeleton), 100 + len(models.skeletons))
        bones = models.skeletons.setdefault(number, (skeleton, {}))[1]
        bones[len(bones) + 1] = (bone, 0)
    for name in source.analog:
        device, _, channel = name.partition(":")
        kind, _, number_of = device.partition(" ")
        names = models.analog.setdefault((kind, int(number_of)), [])
        names += [str(i + 1) for i in range(len(names), int(channel))] if channel.isdigit() else [channel]
    return NatNetScene(source.rate_hz, models, source.analog_samples)


@contextmanager
def simulated(source: NatNet) -> Iterator[NatNet]:
    """What `--simulate` puts in its place."""
    with NatNetServer(scene_of(source), (4, 1)) as server:
        yield replace(source, server="127.0.0.1", port=server.port, local="127.0.0.1")
