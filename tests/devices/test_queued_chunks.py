"""Every output of every source, where the graph lags: chunks that queue enter together as they would have one by one."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec
from kinegraph.stream.graph.components import catalogue, kind_of
from kinegraph.stream.graph.reading.draft import parameters_of
from kinegraph.stream.params import build
from kinegraph.stream.source import Source
from tests.support.device_feed import Kept
from tests.support.queued import check_queued

CONFIGS = Path(__file__).resolve().parents[2] / "configs"
INPUTS = {"inputs": [{"input": "AIN0"}, {"input": "AIN1"}]}
EXAMPLES: dict[str, dict[str, Any]] = {
    "devices.analog.labjack.LabJack": INPUTS,
    "devices.analog.nidaq.NiDaq": INPUTS,
    "devices.brainflow.BrainflowBoard": {"board": "SYNTHETIC_BOARD"},
    "devices.natnet.NatNet": {"bodies": ["shank"], "markers": ["shank:1"], "analog": ["plate 1:Fz"]},
    "devices.osc.OscInlet": {
        "streams": [{"name": "acc", "address": "/acc", "arguments": [{"name": "x"}, {"name": "y"}]}]
    },
    "devices.qualisys.Qualisys": {
        "markers": ["ankle"],
        "bodies": ["shank"],
        "segments": ["Fred:Hips"],
        "analog": ["EMG 2"],
    },
    "stream.manual.Value": {"initial": 1.0},
}
"""Parameters of sources that no shipped graph uses, and that need some."""
FILES = {
    "devices.recorded.depth_clip.DepthClip",
    "devices.recorded.depthai_replay.DepthaiReplay",
    "devices.recorded.recorded_streams.RecordedStreams",
    "operators.synthesis.Synthesis",
    "devices.nats.StreamInlet",
}
"""A file or a server declares their streams."""
PLAYED = {"devices.cameras.video.Video"}
"""They play a file: tests/devices/test_video.py checks what they give."""
SOURCES = {use: part for use, part in catalogue()[0].items() if kind_of(part) == "source" and use not in FILES}
MOST_BYTES = 1 << 18
OWN_CHUNKS = 40


@cache
def examples() -> dict[str, dict[str, Any]]:
    """By class name, the parameters with which shipped graphs use it."""
    found = {use.rpartition(".")[2]: given for use, given in EXAMPLES.items()}
    for path in sorted(CONFIGS.glob("*.yaml")):
        for node in yaml.safe_load(path.read_text(encoding="utf-8")).get("nodes", {}).values():
            found.setdefault(str(node.get("use", "")).rpartition(".")[2], node)
    return found


def source_of(use: str) -> Source:
    part: Any = SOURCES[use]
    given = examples().get(use.rpartition(".")[2], {})
    made: Source = build(part, {name: given[name] for name in parameters_of(part) if name in given})
    return made


def laid_out(array: Array, layout: str) -> Array:
    """The same values in other memory."""
    if layout == "strided":
        wide = np.empty((len(array), 2, *array.shape[1:]), array.dtype)
        wide[:, 1] = array
        return wide[:, 1]
    if layout == "backwards":
        return np.ascontiguousarray(array[::-1])[::-1]
    if layout == "columns":
        return np.asfortranarray(array)
    if layout == "swapped":
        return array.astype(array.dtype.newbyteorder("S"))
    if layout == "frozen":
        array.flags.writeable = False
    return array


LAYOUTS = ("plain", "strided", "backwards", "columns", "swapped", "frozen")


def made_chunks(spec: StreamSpec, count: int) -> list[Chunk]:
    """Chunks of mixed lengths, layouts and byte orders, now and then after a loss."""
    random, end, chunks = np.random.default_rng(7), NS, []
    most = max(1, min(30, MOST_BYTES // (count * max(1, spec.sample_bytes))))
    for i in range(count):
        n = int(random.integers(1, most + 1))
        time = end + 1 + np.sort(random.integers(0, NS, n))
        end = int(time[-1])
        data = random.integers(0, 2, (n * spec.sample_bytes,), np.uint8).view(spec.dtype).reshape(n, *spec.shape)
        stamps, samples = LAYOUTS[i % 6], LAYOUTS[i // 6 % 6]
        chunks.append(Chunk(laid_out(time, stamps), laid_out(data, samples), end, 3 if i % 17 == 16 else 0))
    return chunks


@pytest.mark.parametrize("use", SOURCES)
def test_chunks_of_any_layout_that_queue_enter_as_they_would_one_by_one(use: str) -> None:
    if use == "devices.brainflow.BrainflowBoard":
        pytest.importorskip("brainflow")
    for spec in source_of(use).specs().values():
        check_queued(spec, made_chunks(spec, 40))


class Enough(Exception):
    """The feed has what it needs."""


class Few(Kept):
    """A feed that ends the source after some chunks."""

    def emit(self, chunk: Chunk, output: str = "out") -> None:
        super().emit(chunk, output)
        if len(self.chunks[output]) > OWN_CHUNKS:
            raise Enough


UNPACED = [use for use, part in SOURCES.items() if "realtime" in parameters_of(part) and use not in PLAYED]


@pytest.mark.parametrize("use", UNPACED)
def test_a_simulators_own_chunks_that_queue_enter_as_they_would_one_by_one(use: str) -> None:
    """With what sources of devices give, every test that reads one does the same (`tests.support.device_feed.reading`)."""
    source = replace(source_of(use), realtime=False)  # type: ignore[call-arg, type-var]
    feed, specs = Few(), source.specs()
    with suppress(Enough):
        source.read(feed)
    assert max(len(chunks) for chunks in feed.chunks.values()) > OWN_CHUNKS
    for output, chunks in feed.chunks.items():
        check_queued(specs[output], chunks)
