"""Every kind of device, live: how old its newest sample is at an operator of a recorded session, and what is lost; BrainFlow beside.

    python -m bench.sources

Each simulated device speaks its protocol in the session's own process, as `--simulate` has it, so that it costs the session some of its
time. A Cyton is measured from the moment at which its board makes a packet, in a process of its own, which the packet itself holds: to an
operator, to BrainFlow's buffer as a user asks for it, and to a bare loop.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from bench.report import Section, short, whole
from kinegraph.devices.cyton.protocol import uv_per_count
from kinegraph.stream.chunk import Chunk, Specs
from kinegraph.stream.operator import Operator
from kinegraph.stream.system.clock import SessionClock

HOUSE = Path(__file__).resolve().parent.parent
WARM_S = 3.0
"""What comes before is left out: clocks settle, connections are made."""
OSC = "{name: a, address: /a, rate_hz: 100, arguments: [{name: x}, {name: y}, {name: z}, {role: counter}]}"
FRAME = "{name: f, sync: '', rate_hz: 100, fields: [{type: u32, role: counter}, {type: f32, name: a}, {type: f32, name: b}]}"
SOURCES = {
    "Cyton, 250 Hz": "devices.cyton.Cyton, port: COM1",
    "BITalino, 1000 Hz": "devices.bitalino.Bitalino, port: COM1, channels: [{input: A1, sensor: emg}]",
    "Shimmer3, 204.8 Hz": "devices.shimmer.Shimmer, port: COM1, sensors: [emg]",
    "MTi, 100 Hz": "devices.mti.Mti, port: COM1",
    "Trigno, 2000 Hz": "devices.trigno.Trigno, port: tcp://127.0.0.1:50040, sensors: [{sensor: 1, name: TA}]",
    "lines of text, 500 Hz": "devices.lines.AsciiLines, port: COM1, columns: [us, a, b], time: us, rate_hz: 500",
    "declared frames (WT901), 100 Hz": "witmotion",
    "declared USB reports, 250 Hz": "dualsense",
    "Lab Streaming Layer, 2000 Hz": "lsl_emg",
    "OSC, 100 Hz, 25 ms read at once": f"devices.osc.OscInlet, streams: [{OSC}]",
    "OSC, 100 Hz, as it comes": f"devices.osc.OscInlet, gather_s: 0, streams: [{OSC}]",
    "declared datagrams, 100 Hz, 25 ms read at once": f"devices.frames.Binary, port: 'udp://127.0.0.1:9000', frames: [{FRAME}]",
    "declared datagrams, 100 Hz, as they come": f"devices.frames.Binary, port: 'udp://127.0.0.1:9000', gather_s: 0, frames: [{FRAME}]",
    "Polar H10, ECG": "devices.polar.Polar, device: Polar H10",
    "Movella DOT": "devices.dot.MovellaDot, device: Movella DOT",
    "Ganglion, 200 Hz": "devices.ganglion.Ganglion, device: Ganglion",
    "NatNet, 120 Hz": "devices.natnet.NatNet, bodies: [Shank]",
    "Qualisys, 100 Hz": "devices.qualisys.Qualisys, markers: [ankle, knee]",
    "BrainFlow's synthetic board, 250 Hz": "devices.brainflow.BrainflowBoard, board: SYNTHETIC_BOARD",
}
"""By label: a source, or the shipped graph that begins with it."""

BOARD = """
import os, pty, select, sys, time, tty
from kinegraph.devices.cyton.protocol import packet
from kinegraph.devices.cyton.simulator import SimulatedCyton
every = int(sys.argv[1])
master, slave = pty.openpty()
tty.setraw(slave)
print(os.ttyname(slave), flush=True)
board = SimulatedCyton().brain()
sending, number, due, made = False, 0, 0.0, b""
while True:
    if select.select([master], [], [], max(0.0, due - time.monotonic()) if sending else 0.05)[0]:
        for byte in os.read(master, 4096):
            command = bytes([byte])
            if command == b"b": sending, due = True, time.monotonic()
            elif command == b"s": sending = False
            elif answer := board.receive(command): os.write(master, answer)
    if sending and time.monotonic() >= due:
        due += 1 / 250
        us = time.monotonic_ns() // 1000
        made += packet(number % 256, [us & 0x7FFFFF, us >> 23 & 0x7FFFFF, number & 0x7FFFFF, 0, 0, 0, 0, 0])
        number += 1
        if number % every == 0:
            os.write(master, made)
            made = b""
"""
"""A board with the time of each packet (us) and its number in the first channels; some packets at a time are written."""
BURST = 4
"""This many packets fall into the 16 ms after which the chip of its dongle hands over what has come, as it is set when it is bought."""


@dataclass(slots=True)
class Nothing:
    """No state."""


@dataclass(frozen=True, slots=True)
class NewestAge(Operator[Nothing]):
    """Notes how old the newest sample of each chunk is by its stamp."""

    clock: ClassVar[SessionClock | None] = None
    ages: ClassVar[list[int]] = []

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        if self.clock and len(chunk.time):
            self.ages.append(self.clock.now() - int(chunk.time[-1]))


@dataclass(frozen=True, slots=True)
class PacketAge(Operator[Nothing]):
    """Notes how long ago each packet of the board that says so was written."""

    ages: ClassVar[list[int]] = []
    numbers: ClassVar[list[int]] = []

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing())
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> None:
        for row in chunk.data:
            age_us, number = read(row[:3])
            self.ages.append(age_us * 1000)
            self.numbers.append(number)


def read(uv: Any) -> tuple[int, int]:
    """How long ago (us) a packet was written, and its number, by its first channels (3,)."""
    low, high, number = (round(float(v) / uv_per_count(24)) for v in uv)
    return time.monotonic_ns() // 1000 - (low | high << 23), number


BARE = """
import json, sys, time, serial
ages, numbers, buffer, end, cpu = [], [], b"", time.monotonic() + float(sys.argv[2]), 0.0
with serial.Serial(sys.argv[1], 115200, timeout=1) as port:
    port.write(b"v")
    time.sleep(1)
    port.reset_input_buffer()
    port.write(b"b")
    while (now := time.monotonic()) < end:
        if not cpu and now > end - float(sys.argv[2]) + 3:
            cpu, since = time.process_time(), now
        buffer += port.read(max(1, port.in_waiting))
        while (at := buffer.find(0xA0)) >= 0 and len(buffer) - at >= 33:
            packet = buffer[at : at + 33]
            if packet[32] & 0xF0 != 0xC0:
                buffer = buffer[at + 1 :]
                continue
            low, high, number = (int.from_bytes(packet[i : i + 3], "big") for i in (2, 5, 8))
            ages.append(time.monotonic_ns() - (low | high << 23) * 1000)
            numbers.append(number)
            buffer = buffer[at + 33 :]
print(json.dumps([ages, numbers, (time.process_time() - cpu) / (time.monotonic() - since)]))
"""

THEIRS = """
import json, sys, time
from bench.sources import read
from brainflow.board_shim import BoardShim, BrainFlowInputParams
BoardShim.disable_board_logger()
given = BrainFlowInputParams()
given.serial_port = sys.argv[1]
board = BoardShim(0, given)
board.prepare_session()
board.start_stream()
ages, numbers, end, cpu = [], [], time.monotonic() + float(sys.argv[2]), 0.0
while (now := time.monotonic()) < end:
    if not cpu and now > end - float(sys.argv[2]) + 3:
        cpu, since = time.process_time(), now
    for row in board.get_board_data()[1:4].T:
        age_us, number = read(row)
        ages.append(age_us * 1000)
        numbers.append(number)
    time.sleep(0.001)
print(json.dumps([ages, numbers, (time.process_time() - cpu) / (time.monotonic() - since)]))
board.stop_stream()
board.release_session()
"""
"""As its users read it, once in a millisecond."""


def ours(port: str, seconds: float) -> tuple[list[int], list[int], float]:
    """Ages (ns) and numbers of the board's packets at an operator of a recorded session, and its share of a processor."""
    from bench import sources as module

    nodes = (
        f"{{board: {{use: devices.cyton.Cyton, port: {port}}}, aged: {{use: bench.sources.PacketAge, from: board}}}}"
    )
    began: list[float] = []
    timer = threading.Timer(WARM_S, lambda: began.extend((time.process_time(), time.monotonic())))
    timer.start()
    _session(f"nodes: {nodes}", seconds, simulate=False)
    cpu, since = began
    share = (time.process_time() - cpu) / (time.monotonic() - since)
    return module.PacketAge.ages, module.PacketAge.numbers, share


def one(label: str, seconds: float) -> dict[str, Any]:
    """A source by its label: ages (ns) of its newest samples after the warm-up, how many samples came, how many were lost."""
    from bench import sources as module
    from kinegraph.stream.graph.reading.load import load

    what = SOURCES[label]
    if what.startswith("devices."):
        name, node = "device", f"{{use: {what}}}"
    else:
        source = load(HOUSE / "configs" / f"{what}.yaml").sources[0]
        name, node = source.name, json.dumps({"use": source.use, **source.given})
    graph = f"nodes: {{{name}: {node}, aged: {{use: bench.sources.NewestAge, from: {name}}}}}"
    table = _session(graph, seconds + WARM_S, simulate=True)
    first = next(edge for edge in table if edge.split(".")[0] == name)
    kept = module.NewestAge.ages[len(module.NewestAge.ages) * round(WARM_S) // round(WARM_S + seconds) :]
    return {"ages": kept, "samples": table[first]["samples"], "lost": table[first].get("lost", 0)}


def _session(text: str, seconds: float, *, simulate: bool) -> dict[str, Any]:
    """The session's last table of metrics."""
    from bench import sources as module
    from kinegraph.stream.cli.commands.run import simulated
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.graph.reading.load import load_text

    graph = load_text(text)
    with tempfile.TemporaryDirectory() as folder, simulated(graph) if simulate else _nothing():
        session = Session(graph, Path(folder) / "s", duration_s=seconds)
        module.NewestAge.clock = session.clock
        outcome = session.run()
        if outcome.error:
            raise outcome.error
        table: dict[str, Any] = session.table
        return table


@contextmanager
def _nothing() -> Iterator[None]:
    yield


def devices(seconds: float) -> Section:
    """Every source, one after the other, each in a process of its own."""
    section = Section(
        f"Every kind of device, simulated, {seconds:g} s each: how old its newest sample is at an operator of a recorded session",
        ["device", "p50 ms", "p95 ms", "p99 ms", "samples", "lost"],
    )
    for label in SOURCES:
        found = _asked("one", label, seconds)
        if isinstance(found, str):
            section.notes.append(f"{label}: {found}")
            continue
        section.rows.append([label, *_quantiles(found["ages"]), str(found["samples"]), str(found["lost"])])
    section.notes.append(
        "By the stamp, which is the earliest at which a packet can have come: packets of several samples are stamped back from their last. "
        "Bluetooth devices gather samples to packets before they send."
    )
    return section


def board(rounds: int, seconds: float, every: int = 1) -> Section:
    """From when a Cyton makes a packet to where its samples are used; `every` packets are written at once, and the readers take turns."""
    readers = {"bare pyserial loop": BARE, "**kinegraph, an operator of a recorded session**": ""}
    if importlib.util.find_spec("brainflow"):
        readers["BrainFlow, its buffer read once in a millisecond"] = THEIRS
    found: dict[str, list[int]] = {name: [] for name in readers}
    came, lost = dict.fromkeys(readers, 0), dict.fromkeys(readers, 0)
    cpu: dict[str, list[float]] = {name: [] for name in readers}
    written = "each packet written by itself" if every == 1 else f"{every} packets written at once"
    section = Section(
        f"A Cyton, from a packet to where it is used, {written}, {rounds} x {seconds:g} s at 250 Hz",
        ["", "p50, times bare", "p50 us", "p95 us", "p99 us", "CPU, times bare", "CPU %", "packets", "lost"],
    )
    for _ in range(rounds):
        for name, program in readers.items():
            with _board(every) as address:
                answer = _asked("board", address, seconds + WARM_S, program)
            if isinstance(answer, str):
                section.notes.append(f"{name}: {answer}")
                continue
            ages, numbers = (part[-round(seconds * 250) :] for part in answer[:2])
            cpu[name].append(100 * answer[2])
            found[name] += ages
            came[name] += len(numbers)
            lost[name] += int((np.diff(numbers) - 1).clip(0).sum())
    bare = float(np.percentile(found["bare pyserial loop"], 50))
    share = {name: float(np.median(spent)) for name, spent in cpu.items() if spent}
    for name, ages in found.items():
        if ages:
            us = [short(float(v) / 1e3) for v in np.percentile(ages, [50, 95, 99])]
            times = short(float(np.percentile(ages, 50)) / bare)
            costs = short(share[name] / share["bare pyserial loop"]), short(share[name])
            section.rows.append([name, times, *us, *costs, str(came[name]), str(lost[name])])
    return section


def _quantiles(ages: list[int]) -> list[str]:
    return [short(float(v) / 1e6) for v in np.percentile(ages, [50, 95, 99])] if ages else ["-"] * 3


def _asked(what: str, name: str, seconds: float, program: str = "") -> Any:
    """What a process of its own answers; its last words where it fails."""
    command = ["-c", program, name, str(seconds)] if program else ["-m", "bench.sources", what, name, str(seconds)]
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, cwd=HOUSE, check=False)
    if done.returncode:
        return (done.stderr.strip().splitlines() or [f"ended with {done.returncode}"])[-1]
    return json.loads(done.stdout.splitlines()[-1])


@contextmanager
def _board(every: int) -> Iterator[str]:
    with subprocess.Popen(
        [sys.executable, "-c", BOARD, str(every)], stdout=subprocess.PIPE, text=True, cwd=HOUSE
    ) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().strip()
        finally:
            process.kill()


def sections(*, quick: bool = False) -> list[Section]:
    """Every table of this file."""
    return [board(1, 0.5), devices(0.5)] if quick else [board(3, 10.0), board(3, 10.0, BURST), devices(8.0)]


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.sources", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="tiny sizes: to see that it works, not for figures")
    parser.add_argument("asked", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.asked:
        what, name, seconds = given.asked
        print(json.dumps(one(name, float(seconds)) if what == "one" else ours(name, float(seconds))), flush=True)
        os._exit(0)
    print(
        whole(sections(quick=given.quick), f"load average {os.getloadavg()[0]:.1f}, {threading.active_count()} thread")
    )


if __name__ == "__main__":
    main()
