"""From sequences of normalised poses a map of them: PCA, self-organising map, places and errors of all (thesis, 5.3.3)."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.operators.maps.pose_map.commands.gather import GatheredPoses, known
from kinegraph.operators.maps.pose_map.commands.marker_table import MarkerTable
from kinegraph.operators.maps.pose_map.som_kernel import place_all_poses, train_cells
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.pose_map import LARGEST, MISSING, MotionIndex, PoseSequence
from kinegraph.stream.errors import KinegraphError

BLOCK = 16_384
LEARNED = 100_000
"""The grid learns from at most this many poses, drawn evenly."""
STEPS = 100_000
"""Steps of learning."""
ENOUGH = 0.5
"""A marker that fewer poses of a sequence know is left out of the map."""
STILL_M = 1e-6
"""Poses with a spread (rms) below this are all the same."""


def build_index(
    table: MarkerTable, gathered: list[GatheredPoses], rate_hz: float, rows: int, columns: int, seed: int
) -> MotionIndex:
    """The map of all sequences. Raises KinegraphError where there is nothing to be mapped."""
    markers = tuple(table.markers)
    if not gathered:
        raise KinegraphError("no sequence of two poses or more in these recordings")
    used = used_markers(markers, gathered)
    poses, step = quantised(gathered)
    features = (3 * used[:, None] + np.arange(3)).ravel()
    mean, axes, spread, explained = principal_plane(poses, features, step)
    codes = first_codes(mean, axes, spread, rows, columns)
    learn(codes, columns, sample_of(poses, features, step), seed)
    cell, som, error, torn = placed(poses, features, step, codes, columns)
    good = cell >= 0
    pca = np.zeros((len(poses), 2), np.float32)
    for i in range(0, len(poses), BLOCK):
        x = rows_of(poses[i : i + BLOCK], features, step)
        pca[i : i + BLOCK] = np.nan_to_num((x - mean) @ axes.T)
    quantiles = np.quantile(error[good], np.linspace(0.0, 1.0, 1024))
    order = np.searchsorted(np.sort(error[good]), error[good], side="right") / good.sum()
    rank = np.zeros(len(poses), np.uint16)
    rank[good] = np.round(order * 65535).astype(np.uint16)
    ends = np.cumsum([len(g.poses) for g in gathered])
    number = {marker: k for k, marker in enumerate(markers)}
    return MotionIndex(
        markers=markers,
        bones=np.array([(number[a], number[b]) for a, b in table.bones], np.int64).reshape(-1, 2),
        unit="m",
        rate_hz=rate_hz,
        sequences=tuple(
            PoseSequence(g.name, int(e) - len(g.poses), int(e), g.start_s, g.rate_hz, g.facts, g.missing)
            for g, e in zip(gathered, ends, strict=True)
        ),
        used=used, step=step, poses=poses, pca=pca, mean=mean, axes=axes, explained=explained, columns=columns, codes=codes,
        cell=cell.astype(np.int16), som=som, rank=rank, errors=quantiles, quantisation=float(error[good].mean()),
        topographic=torn / int(good.sum()),
    )  # fmt: skip


def used_markers(markers: tuple[str, ...], gathered: list[GatheredPoses]) -> Times:
    """The numbers of the markers that every sequence knows in at least half of its poses."""
    least = np.min([known(g.poses) for g in gathered], axis=0)
    used = np.flatnonzero(least >= ENOUGH)
    if not len(used):
        worst = min(gathered, key=lambda g: float(known(g.poses).mean()))
        raise KinegraphError(f"no marker is known in all sequences; {worst.name} has the fewest")
    return used


def quantised(gathered: list[GatheredPoses]) -> tuple[Array, float]:
    """All poses (n, 3 m) as whole steps, and the step (m)."""
    largest = max(float(np.nanmax(np.abs(g.poses), initial=0.0)) for g in gathered)
    step = max(largest, 1e-3) / LARGEST
    made = np.empty((sum(len(g.poses) for g in gathered), gathered[0].poses.shape[1]), np.int16)
    at = 0
    for g in gathered:
        found = g.poses
        for i in range(0, len(found), BLOCK):
            part = np.round(found[i : i + BLOCK] / step)
            made[at + i : at + i + len(part)] = np.where(np.isfinite(part), part, MISSING)
        at += len(found)
    return made, step


def rows_of(poses: Array, features: Times, step: float) -> Samples:
    """(k, w) float64; NaN where not known."""
    found = poses[:, features]
    return np.where(found == MISSING, np.nan, found * step)


def principal_plane(poses: Array, features: Times, step: float) -> tuple[Samples, Samples, Samples, Samples]:
    """The mean (w,) of all whole poses, their first two principal axes (2, w), the deviations along these, the shares explained."""
    count, total, square = 0, np.zeros(len(features)), np.zeros((len(features), len(features)))
    for i in range(0, len(poses), BLOCK):
        x = rows_of(poses[i : i + BLOCK], features, step)
        x = x[np.isfinite(x).all(axis=1)]
        count += len(x)
        total += x.sum(axis=0)
        square += x.T @ x
    if count < 2:
        raise KinegraphError(f"{count} poses know all markers that the map is made of; name fewer by --markers")
    mean = total / count
    values, vectors = np.linalg.eigh(square / count - np.outer(mean, mean))
    axes = vectors[:, ::-1][:, :2].T.copy()
    axes *= np.sign(axes[np.arange(2), np.abs(axes).argmax(axis=1)])[:, None]
    variance = np.maximum(values[::-1][:2], 0.0)
    whole = float(np.maximum(values, 0.0).sum())
    if whole < STILL_M**2:
        raise KinegraphError("all poses are the same; there is nothing to be mapped")
    return mean, axes, np.sqrt(variance), variance / whole


def first_codes(mean: Samples, axes: Samples, spread: Samples, rows: int, columns: int) -> Samples:
    """Cells spread evenly over the principal plane, two deviations to either side."""
    across, down = np.meshgrid(np.linspace(-2, 2, columns), np.linspace(-2, 2, rows))
    places = np.stack([across.ravel() * spread[0], down.ravel() * spread[1]], 1)
    return np.ascontiguousarray(mean + places @ axes)


def sample_of(poses: Array, features: Times, step: float) -> Samples:
    """Poses that the grid learns from."""
    every = max(1, math.ceil(len(poses) / LEARNED))
    x = rows_of(poses[::every], features, step)
    return np.ascontiguousarray(x[np.isfinite(x).all(axis=1)])


def learn(codes: Samples, columns: int, x: Samples, seed: int) -> None:
    """Train the cells on poses `x` (k, w)."""
    radius = max(1.0, max(columns, len(codes) // columns) / 3)
    random = np.array([1 + seed % 2_000_000_000], np.int64)
    by_feature = np.ascontiguousarray(codes.T)
    train_cells(x, by_feature, columns, STEPS, radius, random, np.zeros(2, np.int64), np.zeros(2))
    codes[:] = by_feature.T


def placed(
    poses: Array, features: Times, step: float, codes: Samples, columns: int
) -> tuple[Times, Array, Samples, int]:
    """Of all poses: nearest cell, place between cells (0 if unknown), distance; how many have torn neighbours."""
    n = len(poses)
    cell, som, error = np.empty(n, np.int64), np.empty((n, 2), np.float32), np.empty(n)
    torn, by_feature, found = 0, np.ascontiguousarray(codes.T), np.zeros(2, np.int64)
    for i in range(0, n, BLOCK):
        x = np.ascontiguousarray(rows_of(poses[i : i + BLOCK], features, step))
        place = np.empty((len(x), 2))
        end = i + len(x)
        torn += place_all_poses(x, by_feature, columns, found, np.zeros(2), cell[i:end], place, error[i:end])
        som[i:end] = np.nan_to_num(place)
    return cell, som, error, torn
