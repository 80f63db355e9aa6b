"""What the map's page draws of an index: points, densities, cells, and the poses and curves that are asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.devices.page.transfer.wire import encode
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.pose_map import MotionIndex

MAX_DRAWN = 50_000
"""This many poses are drawn; of more, those in between are shown as density."""
BINS = 96
"""Squares across and down of the density."""
BUNDLE = 5
"""Poses of a cell that are drawn beside its mean."""


def drawn(index: MotionIndex) -> Times:
    """The frames that are drawn: all, or evenly spaced ones."""
    return np.arange(0, len(index.poses), max(1, -(-len(index.poses) // MAX_DRAWN)))


def opening(index: MotionIndex, name: str) -> bytes:
    """The first message: what there is, but for the points."""
    frames = drawn(index)
    step = int(frames[1] - frames[0]) if len(frames) > 1 else 1
    return encode({
        "t": "hello", "v": 1, "mode": "map", "name": name, "markers": index.markers, "bones": index.bones.tolist(),
        "used": index.used.tolist(), "unit": index.unit, "rate_hz": index.rate_hz, "poses": len(index.poses), "step": step,
        "columns": index.columns, "rows": len(index.codes) // index.columns, "explained": index.explained.tolist(),
        "quantisation": index.quantisation, "topographic": index.topographic, "placeless": int((index.cell < 0).sum()),
        "sequences": [
            {
                "name": s.name, "first": s.first, "last": s.last, "start_s": s.start_s, "rate_hz": s.rate_hz, "facts": s.facts,
                "missing": s.missing, "variation": variation(index, s.first, s.last),
            }
            for s in index.sequences
        ],
    })  # fmt: skip


def variation(index: MotionIndex, first: int, last: int) -> list[float | None]:
    """(m,) of a sequence: each marker's rms distance from its mean place; None where it is not known."""
    step = max(1, (last - first) // 2000)
    found = index.frames(slice(first, last, step)).astype(np.float64)
    made = list[float | None]()
    for m in range(found.shape[1]):
        one = found[:, m][np.isfinite(found[:, m]).all(axis=1)]
        made.append(float(np.sqrt(((one - one.mean(axis=0)) ** 2).sum(axis=1).mean())) if len(one) else None)
    return made


def points(index: MotionIndex) -> bytes:
    """The poses that are drawn, and, where these are not all, the density of all (BINS x BINS, over the extent of the PCA)."""
    frames = drawn(index)
    frames = frames[index.cell[frames] >= 0]
    good = index.cell >= 0
    low, high = index.pca[good].min(axis=0), index.pca[good].max(axis=0)
    density = np.empty((0, 0), np.float32)
    if len(frames) < int(good.sum()):
        span = np.maximum(high - low, 1e-9)
        at = ((index.pca[good] - low) / span * (BINS - 1e-3)).astype(np.int64).clip(0, BINS - 1)
        density = np.bincount(at[:, 1] * BINS + at[:, 0], minlength=BINS * BINS).astype(np.float32).reshape(BINS, BINS)
    header = {"t": "points", "n": len(frames), "bins": len(density), "low": low.tolist(), "high": high.tolist()}
    return encode(
        header, frames.astype("<i4").tobytes(), index.pca[frames].astype("<f4").tobytes(),
        index.som[frames].astype("<f4").tobytes(), density.astype("<f4").tobytes(), index.rank[frames].astype("<u2").tobytes(),
    )  # fmt: skip


def cells(index: MotionIndex) -> bytes:
    """Per cell: how many poses of each sequence it has, its spread, its mean pose, and some of its poses (NaN where unknown)."""
    count, m, sequences = len(index.codes), len(index.markers), len(index.sequences)
    good = index.cell >= 0
    belongs = np.repeat(np.arange(sequences), [s.last - s.first for s in index.sequences])
    held = np.bincount(index.cell[good].astype(np.int64) * sequences + belongs[good], minlength=count * sequences)
    mean, bundle = np.full((count, m, 3), np.nan, np.float32), np.full((count, BUNDLE, m, 3), np.nan, np.float32)
    spread = np.zeros(count, np.float32)
    frames = drawn(index)
    order = frames[np.argsort(index.cell[frames], kind="stable")]
    edges = np.searchsorted(index.cell[order], np.arange(count + 1))
    for k in range(count):
        mine = order[edges[k] : edges[k + 1]]
        if len(mine):
            poses = index.frames(mine)
            mean[k] = np.where(np.isfinite(poses).any(axis=0), _mean(poses), np.nan)
            spread[k] = np.sqrt(np.nan_to_num(((poses - mean[k]) ** 2).sum(axis=2)).mean())
            some = poses[np.linspace(0, len(poses) - 1, min(BUNDLE, len(poses))).astype(int)]
            bundle[k, : len(some)] = some
    header = {"t": "cells", "cells": count, "sequences": sequences, "bundle": BUNDLE}
    parts = (held.astype("<u4"), spread.astype("<f4"), mean.astype("<f4"), bundle.astype("<f4"))
    return encode(header, *(part.tobytes() for part in parts))


def _mean(poses: Array) -> Samples:
    """The mean over those that know a coordinate, or 0."""
    known = np.isfinite(poses)
    return np.asarray(np.where(known, poses, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def poses_at(index: MotionIndex, numbers: list[int], ask: int) -> bytes:
    """These poses. Raises ValueError for an unknown number."""
    frames = np.array(numbers, np.int64)
    if len(frames) and not (frames.min() >= 0 and frames.max() < len(index.poses)):
        raise ValueError("there is no such pose")
    header: dict[str, Any] = {"t": "frames", "ask": ask, "numbers": numbers, "cell": index.cell[frames].tolist()}
    parts = (index.frames(frames), index.pca[frames], index.som[frames])
    return encode(header, *(part.astype("<f4").tobytes() for part in parts), index.rank[frames].astype("<u2").tobytes())


def curve_of(index: MotionIndex, sequence: int, count: int) -> bytes:
    """A sequence's poses at even times. Raises ValueError for an unknown sequence."""
    if not 0 <= sequence < len(index.sequences):
        raise ValueError("there is no such sequence")
    one = index.sequences[sequence]
    frames = np.unique(np.linspace(one.first, one.last - 1, min(count, one.last - one.first)).astype(np.int64))
    header = {"t": "curve", "s": sequence, "n": len(frames)}
    poses = index.frames(frames).astype("<f4").tobytes()
    return encode(header, frames.astype("<i4").tobytes(), poses, index.rank[frames].astype("<u2").tobytes())
