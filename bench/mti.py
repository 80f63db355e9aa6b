"""Xsens MTi at 2000 measurements a second: what share of a core it takes, the decoder alone and the whole source.

    python -m bench.mti

The simulated sensor on the pseudo-terminal is a process of its own; the one on USB shares ours, of which only the source's own thread is
counted there (pyusb and the simulated bus below it included).
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from bench.report import Goal, Section, short, whole
from kinegraph.devices.mti import xbus
from kinegraph.devices.mti.simulator import MtiModel
from kinegraph.devices.mti.simulator import SimulatedMti as Simulated
from kinegraph.devices.mti.source import Mti
from kinegraph.stream.chunk import Chunk

RATE_HZ = 2000
MOST_PERCENT = 3.0


class Idle:
    """A feed that counts."""

    def __init__(self) -> None:
        self.samples = self.problems = 0
        self.stopped = False

    now = staticmethod(time.time_ns)

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.samples += len(chunk) if output == "imu" else 0

    def identify(self, device: str, **facts: str | float) -> None: ...

    def problem(self, kind: str, count: int = 1) -> None:
        self.problems += count

    again = False

    def tell(self, kind: str, **facts: str | float) -> None: ...

    def device_clock(self, **facts: float) -> None: ...

    def wait(self, seconds: float) -> bool:
        time.sleep(seconds)
        return self.stopped

    def ready(self) -> None: ...

    def listen(self, timeout_s: float) -> str | None: ...


def packets(seconds: float) -> list[bytes]:
    """Measurements as the sensor sends them."""
    brain = MtiModel()
    outputs = Mti("usb://2639", rate_hz=RATE_HZ, high_rate=True).wanted
    brain.receive(xbus.message(xbus.GO_TO_CONFIG))
    brain.receive(xbus.message(xbus.OUTPUT_CONFIGURATION, xbus.configuration(outputs)))
    return brain.packets(0, round(seconds * RATE_HZ))


def bytes_to_samples(seconds: float, rounds: int) -> Section:
    """The decoder alone, by how many measurements come in a read."""
    section = Section(
        "MTi at 2000 Hz, bytes to samples: share of a core", ["measurements a read", "percent", "times its rate"]
    )
    made = packets(seconds)
    for together in (1, 2, 5, 10, 20, 100):
        pieces = [b"".join(made[i : i + together]) for i in range(0, len(made), together)]
        percent = min(_percent(pieces, len(made)) for _ in range(rounds))
        section.rows.append([str(together), short(percent), short(100 / percent)])
        if together == 10:
            section.goals.append(
                Goal("MTi at 2000 Hz, 10 a read: bytes to samples", percent, MOST_PERCENT, "% of a core")
            )
    return section


def _percent(pieces: list[bytes], n: int) -> float:
    decoder, seen = xbus.XbusDecoder(), 0
    began = time.thread_time()
    for piece in pieces:
        for run in decoder.feed(piece).runs:
            run.integers(xbus.PACKET_COUNTER)
            run.integers(xbus.SAMPLE_TIME_FINE)
            run.columns((xbus.ACCELERATION_HR, xbus.RATE_OF_TURN_HR))
            seen += len(run)
    took = time.thread_time() - began
    assert seen == n
    return 100 * took / (n / RATE_HZ)


def whole_source(seconds: float) -> Section:
    """The source's own thread: transport, decoder, clock, chunks."""
    section = Section(
        "MTi at 2000 Hz, the whole source: share of a core", ["", "percent", "samples lost or bad", "samples a read"]
    )
    for name, served, gather_s in (
        ("pseudo-terminal, 10 ms gathered (default)", _in_a_process, None),
        ("pseudo-terminal, as they come", _in_a_process, 0.0),
        ("simulated USB, 10 ms gathered (default)", Simulated().on_usb, None),
    ):
        with served() as address:
            percent, problems, together = _watch(
                Mti(address, rate_hz=RATE_HZ, high_rate=True, baud=2_000_000, gather_s=gather_s), seconds
            )
        section.rows.append([name, short(percent), str(problems), short(together)])
    return section


@contextmanager
def _in_a_process() -> Iterator[str]:
    command = [sys.executable, "-m", "kinegraph", "dev", "simulate", "mti"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout
        try:
            yield process.stdout.readline().strip()
        finally:
            process.terminate()


def _watch(source: Mti, seconds: float) -> tuple[float, int, float]:
    """Percent of a core, problems, samples per chunk."""
    feed, spent = _Timed(), []

    def work() -> None:
        source.read(feed)
        spent.append(feed.cpu_s())

    thread = threading.Thread(target=work)
    thread.start()
    while feed.samples < RATE_HZ // 2:
        time.sleep(0.05)
    feed.begin()
    time.sleep(seconds)
    feed.stopped = True
    thread.join()
    return 100 * spent[0] / (feed.counted / RATE_HZ), feed.problems, feed.counted / max(1, feed.chunks)


class _Timed(Idle):
    """Knows what its thread has spent since `begin` (as seen at the next chunk)."""

    def __init__(self) -> None:
        super().__init__()
        self._begun, self._from, self.counted, self.chunks = False, 0.0, 0, 0

    def begin(self) -> None:
        self._begun = True

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        super().emit(chunk, output)
        if self._begun and output == "imu":
            self._from = self._from or time.thread_time()
            self.counted += len(chunk)
            self.chunks += 1

    def cpu_s(self) -> float:
        return time.thread_time() - self._from


def sections(seconds: float, rounds: int) -> list[Section]:
    """Every table of this file."""
    return [bytes_to_samples(seconds, rounds), whole_source(seconds)]


def main(say: Callable[[str], None] = print) -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.mti", description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, help="how long each source is watched")
    given = parser.parse_args()
    say(whole(sections(given.seconds, 5), ""))


if __name__ == "__main__":
    main()
