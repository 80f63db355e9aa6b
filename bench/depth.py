"""Depth frames: what the adapter copies and takes, and what packing costs and saves beside zstd, LZ4 and PNG alone."""

from __future__ import annotations

import io
import tempfile
import tracemalloc
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from time import perf_counter_ns

import lz4.block
import numpy as np
import zstandard

from bench.report import Goal, Section, short
from kinegraph.devices.oak.adapter import Frames, Message
from kinegraph.devices.people.sleeper import Sleeper
from kinegraph.stream.chunk import Chunk, StreamSpec
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recorder
from kinegraph.stream.recording.format.packed import Packer, unpack

WIDTH, HEIGHT = 640, 480


def depth(rounds: int) -> Section:
    """`rounds` frames of 640 x 480 through each."""
    section = Section(f"Depth frames of {WIDTH} x {HEIGHT} ({rounds} rounds, medians)")
    frames = [Sleeper(WIDTH, HEIGHT).frame(k, k / 30) for k in range(4)]
    copies, us, bare = adapter(frames, rounds)
    section.notes = [
        f"Adapter, message to chunk: {short(us)} us and {copies:.2f} frames of fresh memory; a bare copy of a frame takes {short(bare)} us."
    ]
    section.goals = [Goal("copies of a frame in the depth adapter", round(copies, 2), 1.05, "")]
    for name, frame in (
        ("sleeper, 10 % flickering, noise 4 mm", frames[0]),
        ("smooth, in steps of disparity", smooth()),
    ):
        section.notes.append(f"{name}: " + "; ".join(codec(frame, rounds)) + ".")
    section.notes.append("In a recording, KB per frame: " + ", ".join(recorded(frames)) + ".")
    return section


def adapter(frames: list[np.ndarray], rounds: int) -> tuple[float, float, float]:
    """Frames of memory per frame; us per frame; us of one bare copy."""
    rows = [frame.view(np.uint8) for frame in frames]
    adapted = Frames(StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), 30.0), 0)
    number = iter(range(10**9))

    def take() -> None:
        k = next(number)
        adapted.take(Message(k, k, k * 1000, WIDTH, rows[k % len(rows)]), k * 1000)

    us, bare = median_us(take, rounds), median_us(lambda: frames[0].copy(), rounds)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    take()
    peak = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    return peak / frames[0].nbytes, us, bare


def codec(frame: np.ndarray, rounds: int) -> list[str]:
    """Ratio and ms per frame of every way to make a frame smaller without loss."""
    packer, data = Packer(), frame.tobytes()
    ways: dict[str, Callable[[], bytes]] = {
        "packed": lambda: packer.pack(0, 0, frame),
        "zstd 1": lambda: zstandard.ZstdCompressor(level=1).compress(data),
        "zstd 3": lambda: zstandard.ZstdCompressor(level=3).compress(data),
        "LZ4": lambda: lz4.block.compress(data),
    }
    if find_spec("PIL") is not None:
        ways["PNG"] = lambda: _png(frame)
    lines = [
        f"{name} {frame.nbytes / len(way()):.2f} in {short(median_us(way, rounds) / 1000)} ms"
        for name, way in ways.items()
    ]
    body = memoryview(packer.pack(0, 0, frame))
    return [*lines, f"unpacking {short(median_us(lambda: unpack(body), rounds) / 1000)} ms"]


def _png(frame: np.ndarray) -> bytes:
    from PIL import Image

    out = io.BytesIO()
    Image.fromarray(frame).save(out, "PNG")
    return out.getvalue()


def recorded(frames: list[np.ndarray]) -> list[str]:
    """What a frame takes on the disk, kept in each way."""
    spec = StreamSpec((HEIGHT, WIDTH), np.dtype(np.uint16), 30.0)
    times, sizes = grid(30.0, 60), []
    for kept in ("packed", "image", "outline"):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "one.mcap"
            options = RecordingOptions(frames="image" if kept == "image" else "packed")
            with Recorder(path, {}, options, wait=True) as recorder:
                number = recorder.add_stream("camera", spec, "input", outline=kept == "outline")
                for i, time in enumerate(times):
                    chunk = Chunk(times[i : i + 1], frames[i % len(frames)][None], int(time))
                    recorder.write(number, chunk, int(time), i)
            sizes.append(f"{kept} {short(path.stat().st_size / len(times) / 1000)}")
    return sizes


def smooth() -> np.ndarray:
    """A slanted wall as stereo sees it: depth in steps."""
    y, x = np.mgrid[0:HEIGHT, 0:WIDTH]
    disparity = np.round(315_000 / (1500 + 0.8 * x + 200 * np.sin(y / 60)) * 32) / 32
    return (315_000 / disparity).astype(np.uint16)


def median_us(work: Callable[[], object], rounds: int) -> float:
    """How long one call takes."""
    took = np.empty(rounds)
    for i in range(rounds):
        begin = perf_counter_ns()
        work()
        took[i] = perf_counter_ns() - begin
    return float(np.median(took)) / 1000


if __name__ == "__main__":
    print(depth(30).markdown())
