"""What a frame of motion capture and a packet of a belt cost, from bytes to stamped chunks, beside bare parsing and other clients; and what
a whole source of datagrams costs as they come.

    python -m bench.datagrams

CPU time of one thread, all in one run, so that a loaded machine changes the figures but hardly their ratios. Whole sources are processes of
their own, which take turns with a bare loop.
"""

from __future__ import annotations

import asyncio
import json
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.clocks.rate_check import Policy
from kinegraph.devices.frames.declared import Frame
from kinegraph.devices.frames.packet_decoder import PacketDecoder
from kinegraph.devices.frames.reading import FrameReading
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.natnet import protocol as natnet
from kinegraph.devices.natnet.build import build_frame, build_models
from kinegraph.devices.natnet.protocol import ServerInfo
from kinegraph.devices.natnet.simulator import MODELS, TICK_HZ, NatNetScene
from kinegraph.devices.natnet.source import NatNet, NatNetReading
from kinegraph.devices.osc.inlet import OscInlet, OscReading
from kinegraph.devices.osc.protocol import OscReader
from kinegraph.devices.osc.writer import bundles, floats
from kinegraph.devices.polar import protocol as polar_pmd
from kinegraph.devices.polar.protocol import PmdDecoder
from kinegraph.devices.polar.simulator import PolarBelt
from kinegraph.devices.polar.source import Polar, PolarReading
from kinegraph.devices.transport.ble_link import Notification
from kinegraph.stream.graph.reading.load import load_text
from tests.support.device_feed import Kept, free_udp_port

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
    belt.receive(polar_pmd.CONTROL, polar_pmd.start(polar_pmd.ECG, rate=130, resolution=14))
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
  udp: {use: devices.frames.Binary, port: "udp://127.0.0.1:9998", frames: [{name: f, sync: "", rate_hz: 100, fields: [{type: u32,
    role: counter}, {type: f32, name: a}, {type: f32, name: b}, {type: f32, name: c}]}]}
"""


def declared_figures() -> dict[str, float]:
    """us a datagram of a counter and three numbers: as an OSC message, and as a declared frame."""
    graph = load_text(GRAPH)
    inlet, binary = graph.nodes["osc"].part, graph.nodes["udp"].part
    assert isinstance(inlet, OscInlet) and isinstance(binary, Binary)
    osc, reader, feed = OscReading(inlet, inlet.streams[0]), OscReader(), Clocked()
    frames = FrameReading(DatagramFrames(binary), PacketDecoder(binary.layouts()))
    messages = [next(iter(bundles([floats("/a", [1.0, 2.0, 3.0, float(i)])]))) for i in range(N * ROUNDS)]
    packets = [struct.pack("<I3f", i, 1.0, 2.0, 3.0) for i in range(N * ROUNDS)]
    first, second, begun = iter(range(N * ROUNDS)), iter(range(N * ROUNDS)), feed.at

    def message(_: int) -> None:
        i = next(first)
        for _, arguments in reader.read(messages[i]):
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


BARE = """
import json, socket, struct, sys, tempfile, threading, time
import numpy as np
kind, port, seconds = sys.argv[1], int(sys.argv[2]), float(sys.argv[3])
def read(link, file):
    global came
    while True:
        data = link.recv(65536)
        row = struct.unpack(">4f", data[-16:]) if kind == "osc" else struct.unpack("<I3f", data)
        file.write(np.array([time.time(), *row]).tobytes())
        came += 1
came = 0
with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, tempfile.TemporaryFile() as file:
    link.bind(("127.0.0.1", port))
    threading.Thread(target=read, args=(link, file), daemon=True).start()
    while not came: time.sleep(0.01)
    time.sleep(float(sys.argv[4]))
    first, cpu = came, time.process_time()
    time.sleep(seconds)
    print(json.dumps([time.process_time() - cpu, came - first]), flush=True)
    import os; os._exit(0)
"""
"""What somebody writes who needs only numbers: each datagram's, and its arrival, into a file. No stamps, no losses."""

SOURCE = """
import json, os, sys, threading, time
from bench.datagrams import GRAPH
from kinegraph.stream.graph.reading.load import load_text
class Feed:
    stopped, again, samples = False, False, 0
    now = staticmethod(time.time_ns)
    def emit(self, chunk, output="out"): self.samples += len(chunk) if output != "timing" else 0
    def ready(self): pass
    def problem(self, kind, count=1): raise SystemExit(kind)
    def device_clock(self, **facts): pass
feed = Feed()
source = load_text(GRAPH.replace("9999", sys.argv[2]).replace("9998", sys.argv[2])).nodes[sys.argv[1]].part
source.prepare()
threading.Thread(target=source.unopened().read, args=(feed,), daemon=True).start()
while not feed.samples: time.sleep(0.01)
time.sleep(float(sys.argv[4]))
first, cpu = feed.samples, time.process_time()
time.sleep(float(sys.argv[3]))
print(json.dumps([time.process_time() - cpu, feed.samples - first]), flush=True)
os._exit(0)
"""


def sending(port: int, kind: str, hz: float, stop: threading.Event) -> None:
    """Datagrams of a counter and three numbers to a port of this machine, until stopped."""
    due, i = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        while not stop.wait(max(0.0, due - time.monotonic())):
            packet = struct.pack("<I3f", i, 1.0, 2.0, 3.0)
            message = next(iter(bundles([floats("/a", [1.0, 2.0, 3.0, float(i)])])))
            link.sendto(message if kind == "osc" else packet, ("127.0.0.1", port))
            due, i = due + 1 / hz, i + 1


def whole_sources(rounds: int = 3, seconds: float = 8.0, hz: float = 100.0, after: float = 11.0) -> dict[str, float]:
    """CPU time (us) a datagram of whole sources as datagrams come, and of bare loops that write the numbers to a file.

    `after` the first seconds, in which sources check what was declared.
    """
    found: dict[str, list[float]] = {}
    for _ in range(rounds):
        for kind in ("osc", "udp"):
            for name, program in (("bare loop", BARE), ("source", SOURCE)):
                port, stop = free_udp_port(), threading.Event()
                sender = threading.Thread(target=sending, args=(port, kind, hz, stop), daemon=True)
                sender.start()
                done = subprocess.run(
                    [sys.executable, "-c", program, kind, str(port), str(seconds), str(after)],
                    capture_output=True, text=True, check=True,
                )  # fmt: skip
                stop.set()
                sender.join()
                spent, came = json.loads(done.stdout.splitlines()[-1])
                found.setdefault(f"{kind}, {name}", []).append(spent / came * 1e6)
    return {name: float(np.median(us)) for name, us in found.items()}


def main() -> None:
    for title, figures in (
        ("NatNet, us a frame", natnet_figures()),
        ("Polar ECG, us a frame of 73 samples", polar_figures()),
        ("a counter and three numbers, us a datagram", declared_figures()),
        ("a whole source at 100 datagrams a second, receiving and all, us a datagram", whole_sources()),
    ):
        print(title)
        for name, us in figures.items():
            print(f"  {name:32} {us:8.1f}")


if __name__ == "__main__":
    main()
