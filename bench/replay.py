"""Ten hours of the EMG session from a file: how many times real time, and whether memory grows.

The recording is made here: ten minutes of the simulated walk through the treadmill's own code, in its 10 ms chunks, recorded as a session
records them (the input log; 13 muscles, contacts, force), then repeated with later stamps until the hours are full. Where two pieces
meet the walk jumps, which costs one odd cycle in ten minutes. `python -m bench.replay FILE` replays in a process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median

import numpy as np

from bench.report import Goal, Section
from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.stream.chunk import NS, Chunk
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recorder, Recording
from kinegraph.stream.recording.format.layout import COLUMNS, HEAD
from kinegraph.stream.recording.write.file_segments import FileSegments

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "configs" / "treadmill_emg.yaml"
PIECE_S = 600.0
SAVE_BYTES = 4 << 20


@dataclass(slots=True)
class Writing:
    """A source's way into a recording, without a session."""

    recorder: Recorder
    numbers: dict[str, int]
    sequence: int = 0
    stopped: bool = False
    lasts: dict[str, int] = field(default_factory=dict)

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        self.recorder.write(self.numbers[output], chunk, chunk.until, self.sequence)
        self.sequence += 1

    def now(self) -> int:
        return 10**9 * NS

    def wait(self, seconds: float) -> bool:
        return False

    def ready(self) -> None: ...

    def listen(self, timeout_s: float) -> str | None:
        return None

    def identify(self, device: str, **facts: str | float) -> None: ...

    def problem(self, kind: str, count: int = 1) -> None: ...

    again = False

    def tell(self, kind: str, **facts: str | float) -> None: ...

    def device_clock(self, **facts: float) -> None: ...


def make(path: Path, hours: float, piece_s: float) -> None:
    """A recording of `hours` at `path`."""
    treadmill = Treadmill(duration_s=piece_s, realtime=False)
    piece = path.with_name("piece.mcap")
    header = {"graph": CONFIG.read_text(encoding="utf-8")}
    with Recorder(piece, header, RecordingOptions(), wait=True) as recorder:
        specs = treadmill.specs()
        numbers = {name: recorder.add_stream(f"treadmill.{name}", spec, "input") for name, spec in specs.items()}
        treadmill.read(Writing(recorder, numbers))
    with Recording.open(piece) as recording:
        _repeat(recording, path, header, round(hours * 3600 / piece_s), round(piece_s * NS))
    piece.unlink()


def _repeat(recording: Recording, path: Path, header: dict[str, str], times: int, step_ns: int) -> None:
    """The recording `times` times, one after the other, each piece `step_ns` later than the one before."""
    tape = FileSegments(path, 0, header, RecordingOptions())
    numbers = {name: tape.declare(name, s.spec, s.role) for name, s in recording.streams.items()}
    sequences, batches = recording.last_sequence + 1, 0
    for turn in range(times):
        start, waiting, last = batches, 0, -1
        for part in recording.parts:
            for name, batch, body, *_ in part.messages(set(numbers)):
                moved = _moved(body, turn * step_ns, turn * sequences, turn * recording.streams[name].samples)
                arrival = int(np.frombuffer(moved, "<i8", COLUMNS, HEAD.size)[3])
                batches = start + batch
                if batch != last and waiting > SAVE_BYTES:
                    tape.save(sync=False)
                    waiting = 0
                last = batch
                tape.add(numbers[name], arrival, arrival, batches, moved)
                waiting += len(moved)
        batches += 1
    tape.save(sync=False)
    tape.finish()


def _moved(body: memoryview, later_ns: int, sequences: int, samples: int) -> bytes:
    """A message of chunks that came `later_ns` later."""
    chunks, n, first = HEAD.unpack_from(body)
    rows = np.frombuffer(body, "<i8", chunks * COLUMNS, HEAD.size).reshape(chunks, COLUMNS)
    stamps = np.frombuffer(body, "<i8", n, HEAD.size + rows.nbytes)
    rest = body[HEAD.size + rows.nbytes + stamps.nbytes :]
    head = HEAD.pack(chunks, n, first + samples)
    later = np.array([0, later_ns, 0, later_ns, sequences])
    return b"".join([head, (rows + later).tobytes(), (stamps + later_ns).tobytes(), rest])


def replay(hours: float, piece_s: float = PIECE_S) -> Section:
    """Make the recording in a temporary folder, and replay it."""
    with tempfile.TemporaryDirectory(prefix="kinegraph-bench-") as folder:
        path = Path(folder) / "long"
        path.mkdir()
        began = time.monotonic()
        make(path, hours, piece_s)
        made_s = time.monotonic() - began
        size = sum(file.stat().st_size for file in path.iterdir())
        command = [sys.executable, "-m", "bench.replay", str(path)]
        done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    result = json.loads(done.stdout.splitlines()[-1])
    return _section(result, hours, size, made_s)


def _section(result: dict[str, list[float]], hours: float, size: int, made_s: float) -> Section:
    seconds, took, rss = (np.array(result[name]) for name in ("session_s", "wall_s", "rss_kb"))
    pace = seconds[-1] / took[-1]
    after = seconds >= min(3600.0, seconds[-1] / 10)
    growth = float(np.polyfit(seconds[after] / 3600, rss[after], 1)[0]) if after.sum() > 1 else 0.0
    section = Section(f"Replay of {hours:g} hours of {CONFIG.name} from a file of {size / 1e9:.2g} GB")
    section.notes = [
        f"{took[-1]:.0f} s: {pace:.0f} times real time. Memory after the first hour {rss[after][0] / 1024:.0f} MB, at the end "
        f"{rss[-1] / 1024:.0f} MB, median {median(rss[after]) / 1024:.0f} MB; a line through it rises by {growth:.0f} KiB per hour. "
        f"The recording is ten minutes of the simulated walk, repeated with later stamps (made in {made_s:.0f} s)."
    ]
    section.goals = [
        Goal("replay of the EMG session", pace, 300.0, "times real time", least=True),
        Goal("growth of memory after the first hour", growth, 100.0, "KiB per hour"),
    ]
    return section


def main() -> None:
    """Replay the file that is named; print a line of JSON."""
    recording = Recording.open(Path(sys.argv[1]))
    graph = load(CONFIG, recorded={name: s.spec for name, s in recording.streams.items()})
    rows: dict[str, list[float]] = {"session_s": [], "wall_s": [], "rss_kb": []}
    run = Replay(graph, recording)
    began = time.monotonic()

    def note(done_s: float) -> None:
        rows["session_s"].append(done_s)
        rows["wall_s"].append(time.monotonic() - began)
        rows["rss_kb"].append(int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1024)

    run.run(note)
    print(json.dumps(rows))


if __name__ == "__main__":
    main()
