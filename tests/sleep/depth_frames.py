"""Made-up depth frames, an operator fed with them as the engine would, and detail finer than a block."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.pictures import face
from kinegraph.operators.bed.frames.regions import REGION, region_spec
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec
from kinegraph.stream.laws.case_samples import tapes_of
from kinegraph.stream.laws.chunking import whole
from kinegraph.stream.laws.play import Player
from kinegraph.stream.operator import Case, Operator
from kinegraph.stream.source import Feed, Source

BLOCK = 8
META = {"simplified": {"block": BLOCK, "components": 1}}


def frames_spec(height: int, width: int, rate_hz: float = 30.0, *, simplified: bool = True) -> StreamSpec:
    meta = META if simplified else {}
    return StreamSpec((height, width), np.dtype(np.uint16), rate_hz, units=("mm",), meta=meta)


def blocks_spec(rows: int, columns: int, rate_hz: float = 5.0) -> StreamSpec:
    return StreamSpec((rows, columns), rate_hz=rate_hz, units=("mm",), meta=META)


def regions(time: int, **rectangles: tuple[int, int, int, int]) -> tuple[StreamSpec, Array, Array]:
    """Regions in pixels by sleeper, stamped `time`."""
    events = np.array([(time, name, *rectangle, False) for name, rectangle in rectangles.items()], REGION)
    return region_spec(tuple(rectangles), META), events["onset"].copy(), events


def play(operator: Operator[Any], **inputs: tuple[StreamSpec, Array, Array]) -> dict[str, Array]:
    """All samples that come out, by output. Longer steps of time in regular inputs are reported as gaps."""
    order = [name for name in type(operator).inputs if name in inputs]
    case = Case(operator, {name: inputs[name] for name in order})
    tapes = tapes_of(case)
    for tape in tapes.values():
        tape.lost[1:][np.diff(tape.time) > 1.5 * tape.spec.period_ns] = -1 if tape.spec.period_ns else 0
    outputs = Player(case).play(whole(tapes)).outputs
    return {name: output.data for name, output in outputs.items()}


def in_blocks(frame: Array, size: int = BLOCK) -> Array:
    """(..., height, width) as (..., rows, columns, size * size)."""
    *rest, height, width = frame.shape
    cut = frame.reshape(*rest, height // size, size, width // size, size)
    return np.swapaxes(cut, -2, -3).reshape(*rest, height // size, width // size, size * size)


def finer(frame: Array, size: int = BLOCK) -> float:
    """The energy of what a frame holds beside the level of each block."""
    cut = in_blocks(np.asarray(frame, float), size)
    return float(((cut - cut.mean(axis=-1, keepdims=True)) ** 2).sum())


@dataclass(frozen=True, slots=True)
class Faces(Source):
    """A camera that sees a face for two seconds, at 30 fps, four times as fast."""

    def specs(self) -> Specs:
        return {"out": frames_spec(48, 64, simplified=False)}

    def frames(self) -> Array:
        noise = np.random.default_rng(5).normal(0, 3, (60, 48, 64))
        return (2000.0 - face(48, 64, 24, 32) + noise).astype(np.uint16)

    def read(self, feed: Feed) -> None:
        start = feed.now()
        for k, frame in enumerate(self.frames()):
            if feed.wait(1 / 120):
                return
            stamp = start + round(k * NS / 30)
            feed.emit(Chunk(np.array([stamp]), frame[None].copy(), stamp))
