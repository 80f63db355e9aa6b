"""Serial devices: bytes to samples, how soon a read returns, what a whole source costs; BrainFlow's acquisition beside ours.

    python -m bench.devices

Everything that waits runs in turn with what it is compared to, in one run. The other end of every pseudo-terminal is a process of its own.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import select
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from bench.report import Goal, Section, short, whole
from kinegraph.devices.cyton import protocol as cyton
from kinegraph.devices.frames.decoder import FrameDecoder
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.lines import protocol as ascii_lines
from kinegraph.devices.transport.transport import connect
from kinegraph.stream.graph.reading.load import load

HOUSE = Path(__file__).resolve().parent.parent
PACKET = 33
PACKETS_HZ = 250

WRITER = """
import os, pty, sys, time, tty
rate, count = float(sys.argv[1]), int(sys.argv[2])
master, slave = pty.openpty()
tty.setraw(slave)
print(os.ttyname(slave), flush=True)
for line in sys.stdin:
    due = time.monotonic()
    for _ in range(count):
        due += 1 / rate
        while (rest := due - time.monotonic()) > 0:
            time.sleep(rest)
        os.write(master, time.monotonic_ns().to_bytes(8, "little") + bytes(25))
"""
"""Writes packets of 33 bytes that hold the moment of writing, once for every line that it is given."""

OURS = """
import sys, threading, time
from kinegraph.devices.cyton.source import Cyton
class Feed:
    stopped, again, samples, problems = False, False, 0, 0
    now = staticmethod(time.time_ns)
    def emit(self, chunk, output="out"): self.samples += len(chunk) if output == "emg" else 0
    def problem(self, kind, count=1): self.problems += count
    def wait(self, seconds): time.sleep(seconds)
    def identify(self, device, **facts): pass
    def device_clock(self, **facts): pass
feed = Feed()
threading.Thread(target=Cyton(sys.argv[1]).read, args=(feed,), daemon=True).start()
while not feed.samples: time.sleep(0.01)
first, cpu = feed.samples, time.process_time()
time.sleep(float(sys.argv[2]))
print(__import__("json").dumps([time.process_time() - cpu, feed.samples - first, feed.problems]))
"""

RECORDED = """
import json, pathlib, sys, tempfile, threading, time
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load_text
graph = load_text(f"nodes: {{board: {{use: devices.cyton.Cyton, port: {sys.argv[1]!r}}}}}")
with tempfile.TemporaryDirectory() as folder:
    session = Session(graph, pathlib.Path(folder, "s"))
    threading.Thread(target=session.run, daemon=True).start()
    def came(): return session.table.get("board.emg", {}).get("samples", 0)
    while not came(): time.sleep(0.01)
    first, cpu = came(), time.process_time()
    time.sleep(float(sys.argv[2]))
    spent, more = time.process_time() - cpu, came() - first
    lost = session.table["board.emg"].get("lost", 0)
    session.stop()
print(json.dumps([spent, more, lost]))
"""

BARE = """
import json, sys, tempfile, threading, time
import numpy as np, serial
scale = 4.5 / 24 / (2**23 - 1) * 1e6
def read(port, file):
    global samples
    buffer = b""
    while True:
        buffer += port.read(max(1, port.in_waiting))
        while (at := buffer.find(0xA0)) >= 0 and len(buffer) - at >= 33:
            packet = buffer[at : at + 33]
            if packet[32] & 0xF0 != 0xC0:
                buffer = buffer[at + 1 :]
                continue
            row = [int.from_bytes(packet[i : i + 3], "big", signed=True) * scale for i in range(2, 26, 3)]
            file.write(np.array([time.time(), *row]).tobytes())
            samples, buffer = samples + 1, buffer[at + 33 :]
samples = 0
with serial.Serial(sys.argv[1], 115200, timeout=1) as port, tempfile.TemporaryFile() as file:
    port.write(b"v")
    time.sleep(1)
    port.reset_input_buffer()
    port.write(b"b")
    threading.Thread(target=read, args=(port, file), daemon=True).start()
    while not samples: time.sleep(0.01)
    first, cpu = samples, time.process_time()
    time.sleep(float(sys.argv[2]))
    print(json.dumps([time.process_time() - cpu, samples - first, 0]), flush=True)
    import os; os._exit(0)
"""
"""What somebody writes who needs only numbers: pyserial, each packet's microvolts and its arrival into a file. No stamps, no losses."""

THEIRS = """
import json, sys, time
from brainflow.board_shim import BoardShim, BrainFlowInputParams
BoardShim.disable_board_logger()
given = BrainFlowInputParams()
given.serial_port = sys.argv[1]
board = BoardShim(0, given)
board.prepare_session()
board.start_stream()
while not board.get_board_data_count(): time.sleep(0.01)
first, cpu = board.get_board_data_count(), time.process_time()
time.sleep(float(sys.argv[2]))
print(json.dumps([time.process_time() - cpu, int(board.get_board_data_count() - first), 0]))
board.stop_stream()
board.release_session()
"""


def bytes_to_samples(seconds: float, rounds: int) -> Section:
    """How many times faster than the device each decoder turns bytes into samples in their units."""
    section = Section(
        "Bytes to samples, times the device's own rate, one core",
        ["device, rate", "one packet a read", "4096 bytes a read", "MB/s at 4096"],
    )
    for name, rate_hz, packets, decode in _decoders(seconds):
        data = b"".join(packets)
        least, most = 0.0, 0.0
        for _ in range(rounds):
            least = max(least, len(packets) / _took(decode, packets) / rate_hz)
            most = max(
                most, len(packets) / _took(decode, [data[i : i + 4096] for i in range(0, len(data), 4096)]) / rate_hz
            )
        section.rows.append(
            [
                f"{name}, {rate_hz:g} Hz",
                short(least),
                short(most),
                short(most * rate_hz * len(data) / len(packets) / 1e6),
            ]
        )
        if name == "Cyton":
            section.goals.append(Goal("Cyton: bytes to samples", most, 200, "times its rate", least=True))
            one = Goal("Cyton: bytes to samples, one packet a read", least, 200, "times its rate", least=True)
            section.goals.append(one)
    return section


def _took(decode: Callable[[list[bytes]], None], pieces: list[bytes]) -> float:
    began = time.perf_counter()
    decode(pieces)
    return time.perf_counter() - began


def _decoders(seconds: float) -> Iterator[tuple[str, float, list[bytes], Callable[[list[bytes]], None]]]:
    """Name, packets per second, packets, and what turns pieces of them into samples."""
    rng = np.random.default_rng(1)
    counts = rng.integers(-(2**23), 2**23, (round(250 * seconds), 8))
    uv = np.full(8, cyton.uv_per_count(24))

    def read_cyton(pieces: list[bytes]) -> None:
        decoder = cyton.CytonDecoder()
        for piece in pieces:
            frames = decoder.feed(piece)
            _ = frames.counts * uv

    yield "Cyton", 250.0, [cyton.packet(i, row) for i, row in enumerate(counts)], read_cyton

    source = load(HOUSE / "configs" / "witmotion.yaml").nodes["sensor"].part
    assert isinstance(source, Binary)
    layouts, brain = source.layouts(), BinaryModel(source)

    def read_binary(pieces: list[bytes]) -> None:
        decoder = FrameDecoder(layouts)
        for piece in pieces:
            for kind, frames in decoder.feed(piece).frames.items():
                layouts[kind].values(layouts[kind].table(bytes(frames)))

    turns = range(round(100 * seconds))
    yield (
        "WT901, declared, 4 frames",
        100.0,
        [b"".join(brain.frame(k, i) for k in range(4)) for i in turns],
        read_binary,
    )

    def read_lines(pieces: list[bytes]) -> None:
        decoder = ascii_lines.LineDecoder(("micros", "a", "b"))
        for piece in pieces:
            decoder.feed(piece)

    numbers = rng.integers(0, 1023, (round(500 * seconds), 2))
    yield (
        "lines of 3 columns",
        500.0,
        [f"{2000 * i},{a},{b}\r\n".encode() for i, (a, b) in enumerate(numbers)],
        read_lines,
    )


def read_latency(rounds: int, packets: int) -> Section:
    """From the write at one end of a pseudo-terminal to the bytes at the other, our transport and a bare loop in turn."""
    late: dict[str, list[int]] = {"bare": [], "ours": []}
    with _writer(packets) as (address, go):
        for turn in range(-1, rounds):
            for name, read in (("bare", _bare_reader(address)), ("ours", _our_reader(address))):
                with read as fetch:
                    go()
                    found = _arrivals(fetch, packets)
                late[name] += found if turn >= 0 else []
    section = Section(
        f"A read over a pseudo-terminal: {packets * rounds} packets of 33 bytes at 250 Hz",
        ["", "times bare", "p50 us", "p99 us"],
    )
    p50 = {name: float(np.percentile(found, 50)) for name, found in late.items()}
    labels = {"bare": "bare select and os.read", "ours": "**kinegraph's transport**"}
    for name, found in late.items():
        section.rows.append(
            [
                labels[name],
                short(p50[name] / p50["bare"]),
                short(p50[name] / 1e3),
                short(float(np.percentile(found, 99)) / 1e3),
            ]
        )
    section.goals = [
        Goal("read latency over a pseudo-terminal, p50 against a bare loop", p50["ours"] / p50["bare"], 1.5, "times")
    ]
    return section


def _arrivals(fetch: Callable[[], bytes], packets: int) -> list[int]:
    """How long each packet was on its way (ns)."""
    late: list[int] = []
    buffer = b""
    while len(late) < packets:
        buffer += fetch()
        now = time.monotonic_ns()
        while len(buffer) >= PACKET:
            late.append(now - int.from_bytes(buffer[:8], "little"))
            buffer = buffer[PACKET:]
    return late


@contextmanager
def _writer(packets: int) -> Iterator[tuple[str, Callable[[], None]]]:
    """A process that writes packets on request."""
    command = [sys.executable, "-c", WRITER, str(PACKETS_HZ), str(packets)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdin and process.stdout
        address, stdin = process.stdout.readline().strip(), process.stdin

        def go() -> None:
            stdin.write("go\n")
            stdin.flush()

        try:
            yield address, go
        finally:
            stdin.close()


@contextmanager
def _bare_reader(address: str) -> Iterator[Callable[[], bytes]]:
    port = os.open(address, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    tty.setraw(port)

    def fetch() -> bytes:
        select.select([port], [], [], 1.0)
        try:
            return os.read(port, 65536)
        except BlockingIOError:
            return b""

    yield fetch
    os.close(port)


@contextmanager
def _our_reader(address: str) -> Iterator[Callable[[], bytes]]:
    with connect(address) as link:
        yield lambda: link.read(1.0)


def acquisition(rounds: int, seconds: float) -> Section:
    """The whole of a Cyton's acquisition at its own rate, in a process of its own: ours, and BrainFlow's compiled driver."""
    bare, recorded = "bare pyserial loop into a file", "**kinegraph, a session that records**"
    readers = {bare: BARE, "kinegraph's source": OURS, recorded: RECORDED}
    if importlib.util.find_spec("brainflow"):
        readers["BrainFlow's driver (compiled)"] = THEIRS
    cpu: dict[str, list[float]] = {name: [] for name in readers}
    samples: dict[str, int] = dict.fromkeys(readers, 0)
    failed = ""
    for _ in range(rounds):
        for name, program in readers.items():
            with _board() as address:
                done = subprocess.run(
                    [sys.executable, "-c", program, address, str(seconds)],
                    capture_output=True, text=True, check=program is not THEIRS, cwd=HOUSE,
                )  # fmt: skip
            if done.returncode:
                failed = done.stderr.strip().splitlines()[-1]
                continue
            spent, came, _ = json.loads(done.stdout.splitlines()[-1])
            cpu[name].append(100 * spent / seconds)
            samples[name] += came
    section = Section(
        f"A Cyton's whole acquisition, {rounds} x {seconds:g} s at 250 Hz",
        ["", "CPU % of a core", "times bare", "samples per second"],
    )
    share = {name: float(np.median(spent)) for name, spent in cpu.items() if spent}
    section.rows = [
        [name, short(share[name]), short(share[name] / share[bare]), short(samples[name] / rounds / seconds)]
        for name in share
    ]
    section.goals = [
        Goal("a Cyton, recorded, against a bare pyserial loop", share[recorded] / share[bare], 1.6, "times")
    ]
    if failed or len(readers) == 3:
        section.notes = [f"BrainFlow's driver failed: {failed}" if failed else "BrainFlow is not installed."]
    return section


@contextmanager
def _board() -> Iterator[str]:
    command = [sys.executable, "-m", "kinegraph", "dev", "simulate", "cyton"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=HOUSE) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def serial_devices(*, quick: bool = False) -> list[Section]:
    """Every table of this file."""
    if quick:
        return [bytes_to_samples(0.5, 1), read_latency(1, 10), acquisition(1, 0.3)]
    return [bytes_to_samples(60.0, 5), read_latency(6, 500), acquisition(3, 8.0)]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.devices", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny sizes: to see that it works, not for figures")
    given = parser.parse_args()
    print(
        whole(
            serial_devices(quick=given.quick),
            f"load average {os.getloadavg()[0]:.1f} at the start, {threading.active_count()} thread",
        )
    )


if __name__ == "__main__":
    main()
