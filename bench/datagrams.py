"""What a frame of motion capture and a packet of a belt cost, from bytes to stamped chunks, beside bare parsing and other clients.

    python -m bench.datagrams

CPU time of one thread, all in one run, so that a loaded machine changes the figures but hardly their ratios.
"""

from __future__ import annotations

import asyncio
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from devices.binary import Binary
from devices.ble.link import Notification
from devices.ble.polar import Polar, PolarReading
from devices.clocks.rate_check import Policy
from devices.frame_reading import FrameReading
from devices.natnet import NatNet, NatNetReading
from devices.osc import OscInlet, OscReading
from devices.protocols import natnet, polar_pmd
from devices.protocols.declared import Frame
from devices.protocols.natnet import ServerInfo
from devices.protocols.natnet_build import build_frame, build_models
from devices.protocols.osc import read_osc
from devices.protocols.osc_write import bundles, floats
from devices.protocols.packet_decoder import PacketDecoder
from devices.protocols.polar_pmd import PmdDecoder
from devices.simulators.natnet import MODELS, TICK_HZ, NatNetScene
from devices.simulators.polar import PolarBelt
from stream.graph.load import load_text
from tests.support.device_feed import Kept

N = 4000
ROUNDS = 5


def cpu_us(work: Callable[[int], object], n: int = 0) -> float:
    """CPU time of one call in us: the best of some rounds."""
    n = n or N
    best = float("inf")
    for _ in range(ROUNDS):
        began = time.process_time()
        for i in range(n):
            work(i)
        best = min(best, (time.process_time() - began) / n * 1e6)
    return best


class Clocked(Kept):
    """A feed that keeps nothing, and in which frames come at their pace."""

    at = 1_700_000_000_000_000_000

    def emit(self, chunk: Any, output: str = "out") -> None: ...

    def now(self) -> int:
        return self.at


class BareFrame:
    """What somebody writes who needs the bodies, bones and markers of one scene: every number of a frame read once, into arrays."""

    count, point, body, marker = (struct.Struct(f"<{form}") for form in ("i", "3f", "i8fh", "i3ffhf"))

    def read(self, data: bytes) -> tuple[int, float, np.ndarray, np.ndarray, np.ndarray]:
        at = 4
        (number,) = self.count.unpack_from(data, 0)
        (sets,) = self.count.unpack_from(data, at)
        at += 4
        for _ in range(sets):
            at = data.index(b"\0", at) + 1
            (n,) = self.count.unpack_from(data, at)
            list(self.point.iter_unpack(data[at + 4 : at + 4 + 12 * n]))
            at += 4 + 12 * n
        (n,) = self.count.unpack_from(data, at)
        at += 4 + 12 * n
        bodies, at = self.bodies(data, at)
        (skeletons,) = self.count.unpack_from(data, at)
        at += 4
        for _ in range(skeletons):
            bones, at = self.bodies(data, at + 4)
            bodies += bones
        (n,) = self.count.unpack_from(data, at)
        markers = list(self.marker.iter_unpack(data[at + 4 : at + 4 + 26 * n]))
        (time_s,) = struct.unpack_from("<d", data, len(data) - 38)
        positions = np.array([body[1:4] for body in bodies])
        return number, time_s, positions, np.array([body[4:8] for body in bodies]), np.array([m[1:4] for m in markers])

    def bodies(self, data: bytes, at: int) -> tuple[list[tuple[float, ...]], int]:
        (n,) = self.count.unpack_from(data, at)
        end = at + 4 + 38 * n
        return list(self.body.iter_unpack(data[at + 4 : end])), end


def natnet_figures() -> dict[str, float]:
    """us a frame: a skeleton of two bones, a body, three markers, a plate."""
    scene = NatNetScene()
    frames = [build_frame(scene.frame(i), (3, 1)) for i in range(N * ROUNDS)]
    info = ServerInfo("Motive", (3, 0, 0, 0), (3, 1), TICK_HZ)
    source = NatNet(bodies=("Shank", "Fred:Hips"), markers=("Shank:1", "Shank:2", "Shank:3"))
    link: Any = None
    reading, feed = NatNetReading(source, info, link), Clocked()
    reading.take(natnet.MODELS, build_models(MODELS, (3, 1)), feed.at, feed)
    at = iter(range(N * ROUNDS))

    def ours(_: int) -> None:
        i = next(at)
        reading.take(natnet.FRAME, frames[i], feed.at + round(i * 1e9 / 120), feed)

    bare = BareFrame()
    made = {
        "source": cpu_us(ours),
        "bare loop": cpu_us(lambda i: bare.read(frames[i])),
        "parser alone": cpu_us(lambda i: natnet.frame(frames[i], (3, 1))),
    }
    try:
        from natnet.data_frame import DataFrame
        from natnet.packet_buffer import PacketBuffer
        from natnet.version import Version
    except ImportError:
        return made
    version = Version(3, 1)
    return made | {
        "natnet (PyPI), parsing alone": cpu_us(lambda i: DataFrame.read_from_buffer(PacketBuffer(frames[i]), version))
    }


def polar_figures() -> dict[str, float]:
    """us a frame of 73 samples of ECG."""
    belt = PolarBelt()
    belt.hear(polar_pmd.CONTROL, polar_pmd.start(polar_pmd.ECG, rate=130, resolution=14))
    n = N // 4
    frames = [belt._frame(polar_pmd.ECG, 130, i, 73) for i in range(n * ROUNDS)]
    reading, feed = PolarReading(Polar(), PmdDecoder(), "belt"), Clocked()
    at = iter(range(n * ROUNDS))

    def ours(_: int) -> None:
        i = next(at)
        reading.take(Notification(polar_pmd.DATA, feed.at + round(i * 73e9 / 130), frames[i]), feed)

    def bare(i: int) -> list[int]:
        data = frames[i]
        struct.unpack_from("<Q", data, 1)
        return [int.from_bytes(data[a : a + 3], "little", signed=True) for a in range(10, len(data), 3)]

    made = {"source": cpu_us(ours, n), "bare loop": cpu_us(bare, n)}
    try:
        import bleakheart
    except ImportError:
        return made
    client: Any = None
    theirs = bleakheart.PolarMeasurementData(client, callback=lambda _: None)
    with asyncio.Runner() as runner:

        async def many() -> float:
            began = time.process_time()
            for frame in frames[:n]:
                await theirs._pmd_data_handler(None, bytearray(frame))
            return (time.process_time() - began) / n * 1e6

        return made | {"bleakheart": min(runner.run(many()) for _ in range(ROUNDS))}


GRAPH = """
nodes:
  osc: {use: devices.osc.OscInlet, port: 9999, streams: [{address: /a, name: a, rate_hz: 100, arguments: [{name: x}, {name: y}, {name: z},
    {role: counter}]}]}
  udp: {use: devices.binary.Binary, port: "udp://127.0.0.1:9998", frames: [{name: f, sync: "", rate_hz: 100, fields: [{type: u32,
    role: counter}, {type: f32, name: a}, {type: f32, name: b}, {type: f32, name: c}]}]}
"""


def declared_figures() -> dict[str, float]:
    """us a datagram of a counter and three numbers: as an OSC message, and as a declared frame."""
    graph = load_text(GRAPH)
    inlet, binary = graph.nodes["osc"].part, graph.nodes["udp"].part
    assert isinstance(inlet, OscInlet) and isinstance(binary, Binary)
    osc, feed = OscReading(inlet, inlet.streams[0]), Clocked()
    frames = FrameReading(DatagramFrames(binary), PacketDecoder(binary.layouts()))
    messages = [next(iter(bundles([floats("/a", [1.0, 2.0, 3.0, float(i)])]))) for i in range(N * ROUNDS)]
    packets = [struct.pack("<I3f", i, 1.0, 2.0, 3.0) for i in range(N * ROUNDS)]
    first, second, begun = iter(range(N * ROUNDS)), iter(range(N * ROUNDS)), feed.at

    def message(_: int) -> None:
        i = next(first)
        for _, arguments in read_osc(messages[i]):
            osc.take(arguments, begun + i * 10_000_000, 0, feed)

    def frame(_: int) -> None:
        i = next(second)
        feed.at = begun + i * 10_000_000
        frames.take(packets[i], feed)

    return {
        "OSC message": cpu_us(message),
        "declared frame": cpu_us(frame),
        "bare loop": cpu_us(lambda i: np.array(struct.unpack("<I3f", packets[i]))),
    }


@dataclass(frozen=True)
class DatagramFrames:
    """A source of declared frames, as its reading sees it."""

    of: Binary
    wraps_ns: int = 0
    hint: str = ""

    @property
    def port(self) -> str:
        return self.of.port

    @property
    def frames(self) -> tuple[Frame, ...]:
        return self.of.frames

    @property
    def latency_s(self) -> float:
        return self.of.latency_s

    @property
    def rate_mismatch(self) -> Policy:
        return self.of.rate_mismatch


def main() -> None:
    for title, figures in (
        ("NatNet, us a frame", natnet_figures()),
        ("Polar ECG, us a frame of 73 samples", polar_figures()),
        ("a counter and three numbers, us a datagram", declared_figures()),
    ):
        print(title)
        for name, us in figures.items():
            print(f"  {name:32} {us:8.1f}")


if __name__ == "__main__":
    main()
