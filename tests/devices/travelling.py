"""Simulated senders and sources in a time of their own, which waiting moves on: hours pass as fast as they can be computed."""

from __future__ import annotations

import asyncio
import selectors
import time
from collections import deque
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.lsl.inlet import LslInlet
from kinegraph.devices.lsl.pull import Pull
from kinegraph.devices.lsl.simulator import Lsl, WalkPackets
from kinegraph.devices.natnet import protocol as natnet
from kinegraph.devices.natnet.build import build_frame, build_models
from kinegraph.devices.natnet.simulator import TICK_HZ, scene_of
from kinegraph.devices.oak.simulator import OakSimulator, RunningScene
from kinegraph.devices.osc.inlet import OscInlet
from kinegraph.devices.osc.simulator import OscModel
from kinegraph.devices.qualisys import protocol as qualisys
from kinegraph.devices.qualisys.simulator import QualisysServer
from kinegraph.devices.trigno import protocol as trigno
from kinegraph.devices.trigno.simulator import AUX_FRAME, EMG_FRAME, TrignoModel
from kinegraph.devices.usb.simulated_reports import DualSenseBrain
from kinegraph.stream.chunk import NS
from kinegraph.stream.source import Source
from tests.devices.scripted import BEGAN, Arriving

BOOTED_S = 1000.0
"""What the computer's monotonic clock shows at the beginning."""
STEP_S = 0.01
LATE_S = 0.003


class Travelling(Arriving):
    """A feed that stops after so many seconds of its own time."""

    def __init__(self, seconds: float, patch: pytest.MonkeyPatch) -> None:
        super().__init__()
        self.seconds, self.now_s = seconds, 0.0
        patch.setattr(time, "monotonic", lambda: BOOTED_S + self.now_s)
        patch.setattr(time, "sleep", self.go)
        self._late = np.random.default_rng(5)

    def go(self, seconds: float) -> None:
        """Let time pass."""
        self.now_s += seconds
        self.at = BEGAN + round(self.now_s * NS)
        if self.now_s > self.seconds:
            self.stop()

    def wait(self, seconds: float) -> bool:
        self.go(max(0.0, seconds))
        return self.stopped

    def packets(self, say: Callable[[float], list[Any]]) -> Iterator[Any]:
        """What is due, each a little late; None at the end of every step."""
        while not self.stopped:
            self.go(STEP_S)
            due = say(self.now_s)
            late = LATE_S * float(self._late.random())
            self.at = BEGAN + round((self.now_s + late) * NS)
            yield from due
            yield None


def paced(source: Source, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    """A source that waits by the feed alone."""
    source.read(feed)


def in_place(source: Source, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    """What `--simulate` puts in its place, if that waits by the computer's clock in the thread that reads."""
    simulated = source.simulated()
    assert simulated is not None
    with simulated as one:
        one.read(feed)


def by_bluetooth(source: Source, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    """bleak and a simulated radio in an event loop that does not wait."""

    class Selector(selectors.SelectSelector):
        def select(self, timeout: float | None = None) -> Any:
            ready = super().select(0)
            if not ready and timeout:
                feed.go(timeout)
            return ready

    patch.setattr(asyncio.events, "new_event_loop", lambda: asyncio.SelectorEventLoop(Selector()))
    in_place(source, feed, patch)


class Link:
    """A connection that gives what a device sends, one piece a read; `answer` what it says to something written."""

    identity: dict[str, str] = {}
    address = "scripted"

    def __init__(
        self, feed: Travelling, say: Callable[[float], list[bytes]], answer: Callable[[bytes], bytes] = lambda _: b"", waits: bool = True
    ) -> None:  # fmt: skip
        self._packets, self._answer, self._waits = feed.packets(say), answer, waits
        self.pending = deque[bytes]()

    def read(self, timeout_s: float) -> bytes:
        if self.pending:
            return self.pending.popleft()
        return (next(self._packets, None) or b"") if self._waits else b""

    def write(self, data: bytes) -> None:
        if reply := self._answer(data):
            self.pending.append(reply)

    def close(self) -> None: ...

    def __enter__(self) -> Link:
        return self

    def __exit__(self, *_: object) -> None: ...


def by_datagrams(source: Source, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    assert isinstance(source, OscInlet)
    link = Link(feed, OscModel(source).say)
    patch.setattr("kinegraph.devices.osc.inlet.UdpTransport", lambda *_: link)
    source.read(feed)


def by_usb(source: Source, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    class Pipe(Link):
        def __init__(self, *_: object) -> None:
            super().__init__(feed, DualSenseBrain().say)

    patch.setattr("kinegraph.devices.usb.endpoint.Pipe", Pipe)
    source.read(feed)


def of_trigno(source: Source, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    model = TrignoModel()

    def say(seconds: float) -> list[bytes]:
        frames = model.say(seconds)
        aux.pending.extend(one for one in frames if len(one) == 4 * trigno.SENSORS * 3 * AUX_FRAME)
        return [one for one in frames if len(one) == 4 * trigno.SENSORS * EMG_FRAME]

    command, emg, aux = Link(feed, lambda _: [], model.receive), Link(feed, say), Link(feed, lambda _: [], waits=False)
    command.pending.append(trigno.command(trigno.BANNER.decode() + " 3.6.0"))
    links = {0: command, 1: emg, 2: aux}
    patch.setattr("kinegraph.devices.trigno.source.TcpTransport", lambda at: links[int(at.rpartition(":")[2]) - 50040])
    source.read(feed)


def of_natnet(source: Any, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    scene, version, sent = scene_of(source), (4, 1), 0

    def say(seconds: float) -> list[tuple[int, bytes]]:
        nonlocal sent
        first, sent = sent, int(seconds * scene.rate_hz)
        return [(natnet.FRAME, build_frame(scene.frame(i), version)) for i in range(first, sent)]

    packets = feed.packets(say)
    pending = deque([(natnet.MODELS, build_models(scene.models, version))])

    def fetch(_: object) -> list[tuple[int, bytes, int]]:
        one = pending.popleft() if pending else next(packets, None)
        return [(*one, feed.now())] if one else []

    link = SimpleNamespace(
        connect=lambda _: natnet.ServerInfo("Motive", (3, 1, 0, 0), version, TICK_HZ, 1511, False),
        fetch=fetch, send=lambda *_: None, keep_alive=lambda: None, close=lambda: None,
    )  # fmt: skip
    patch.setattr("kinegraph.devices.natnet.source.NatNetLink", lambda *_: link)
    source.read(feed)


def of_qualisys(source: Any, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    sent, began = 0, None
    with QualisysServer(
        source.markers, source.bodies, source.rate_hz, segments=source.segments,
        analog=tuple(name.rpartition(":")[2] for name in source.analog), analog_hz=source.analog_hz, unit=source.analog_unit,
    ) as server:  # fmt: skip

        def say(seconds: float) -> list[bytes]:
            nonlocal sent
            if began is None:
                return []
            first, sent = sent, int((seconds - began) * source.rate_hz)
            return [
                qualisys.packet(qualisys.DATA, qualisys.build_data(server.frame(number)))
                for number in range(first, sent)
            ]

        def answer(data: bytes) -> bytes:
            nonlocal began
            ((_, payload),) = qualisys.QualisysDecoder().feed(data)
            text = qualisys.text_of(payload).lower()
            if text.startswith("streamframes"):
                began = None if "stop" in text.split() else feed.now_s
                return b""
            return server.answer(text)

        link = Link(feed, say, answer)
        link.pending.append(qualisys.command("QTM RT Interface connected"))
        patch.setattr("kinegraph.devices.qualisys.source.TcpTransport", lambda *_: link)
        source.read(feed)


def by_lsl(source: Any, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    assert isinstance(source, LslInlet)
    walk, sent = WalkPackets(Lsl(channels=source.channels, rate_hz=source.rate_hz)), 0
    sent = int(BOOTED_S * source.rate_hz)

    def say(seconds: float) -> list[bytes]:
        nonlocal sent
        first, sent = sent, int((BOOTED_S + seconds) * source.rate_hz)
        return walk.say(first, sent)

    packets = feed.packets(say)

    def pull() -> tuple[Any, Any]:
        rows = np.frombuffer(next(packets, None) or b"", walk.row)
        return rows["values"], rows["stamp"]

    connection: Any = SimpleNamespace(
        lsl=SimpleNamespace(local_clock=time.monotonic), described=SimpleNamespace(name="simulated", host=""), pull=pull,
        correction=lambda: 0.0, uncertainty=lambda: 2e-4, has_our_clock=lambda _: True, has_reconnected=lambda: False,
    )  # fmt: skip
    Pull(connection, source.specs()["out"], feed, source.gap_s, source.latency_s, source.lost_after_s).run()


def of_oak(source: Any, feed: Travelling, patch: pytest.MonkeyPatch) -> None:
    """Without depthai's pipeline, whose threads wait by clocks of their own; its messages are real ones."""
    from kinegraph.devices.oak import source as oak
    from kinegraph.devices.oak.camera import Camera, CameraLink
    from kinegraph.devices.oak.library import library

    dai, link = library(), CameraLink()
    device = OakSimulator(
        width=source.width, height=source.height, fps=source.fps, imu_hz=source.imu_hz, image=source.image
    )
    patch.setattr(oak, "zero_ns", lambda *_: BEGAN - round(BOOTED_S * NS))
    with device.plugged_in() as camera:
        camera.began = time.monotonic()
        scene, queues = RunningScene(dai, camera, link), {name: deque[Any]() for name in ("depth", "imu", "image")}
        node = SimpleNamespace(**{name: SimpleNamespace(send=queue.append) for name, queue in queues.items()})

        def get(_: object) -> Any:
            if not queues["depth"]:
                feed.go(STEP_S)
                scene.step(node)
            return queues["depth"].popleft() if queues["depth"] else None

        def all_of(name: str) -> Any:
            found = list(queues[name])
            queues[name].clear()
            return found

        imu, image = (SimpleNamespace(tryGetAll=lambda name=name: all_of(name)) for name in ("imu", "image"))
        opened = Camera(SimpleNamespace(get=get), imu, image, identity={"id": "simulated"})
        oak._CameraReading(dai, source, opened, link, feed).run()
