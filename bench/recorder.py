"""What recording costs the graph's thread: every `write`, between pieces of work, while the recorder writes to the disk."""

from __future__ import annotations

import tempfile
from pathlib import Path
from time import perf_counter_ns

import numpy as np

from bench.report import Goal, Section, short
from bench.work import CHANNELS, RATE_HZ, kernel_steps, samples
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder
from kinegraph.stream.system.stalls import calm

CHUNK = 10


def recorder(chunks: int) -> Section:
    """`chunks` chunks of 10 samples x 16 channels, one after the other."""
    calm_ns = _calls(chunks, recording=False)
    ns = _calls(chunks, recording=True)
    us = ns / 1000
    section = Section(f"Recording: the graph thread's call per chunk (10 samples x 16 channels, {chunks} chunks)")
    section.notes = [
        f"p50 {short(float(np.percentile(us, 50)))} us, mean {short(float(us.mean()))} us, p99 {short(float(np.percentile(us, 99)))} us; "
        f"reading the clock, which is in these figures, takes {short(float(np.median(calm_ns)) / 1000)} us."
    ]
    section.goals = [
        Goal("recording a chunk, on the graph's thread (p50)", float(np.percentile(us, 50)), 2.0, "us"),
        Goal("recording a chunk, on the graph's thread (mean)", float(us.mean()), 2.0, "us"),
    ]
    return section


def _calls(chunks: int, *, recording: bool) -> np.ndarray:
    """ns of every call; without `recording`, of no call at all."""
    spec = StreamSpec((CHANNELS,), rate_hz=float(RATE_HZ), units=("uV",))
    x = samples(CHUNK)
    steps = kernel_steps()
    took = np.empty(chunks, np.int64)
    with tempfile.TemporaryDirectory() as folder:
        made = Recorder(Path(folder) / "session", {"graph": ""}, RecordingOptions())
        number = made.add_stream("device", spec, "input")
        stamps = NS + np.arange(CHUNK) * (NS // RATE_HZ)
        with calm():
            for i in range(chunks):
                chunk = Chunk(stamps + i * 5_000_000, x, NS + (i + 1) * 5_000_000)
                for step in steps[:2]:
                    x = step(x)
                x = chunk.data
                begin = perf_counter_ns()
                if recording:
                    made.write(number, chunk, chunk.until, i)
                took[i] = perf_counter_ns() - begin
        made.close()
    return took
