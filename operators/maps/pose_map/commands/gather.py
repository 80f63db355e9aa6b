"""Sequences of normalised poses out of recordings: of any marker set, unit and rate, brought to one."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.operators.features.normalised_pose import NormalisedPose, normalise_pose
from kinegraph.operators.features.pose import point_names
from kinegraph.operators.maps.pose_map.commands.marker_table import MarkerTable, own_table
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec, Times
from kinegraph.stream.domain.axes import BODY
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording import Recording

METRES = {"m": 1.0, "cm": 0.01, "mm": 0.001, "dm": 0.1, "in": 0.0254}
LONGEST_GAP_S = 0.2
"""Poses are interpolated over a gap no longer than this; a longer one ends a sequence."""


@dataclass(frozen=True, slots=True)
class GatheredPoses:
    """Poses (n, 3 m) float32 in m, one after the other at the map's rate; the rest as in stream.domain.pose_map.PoseSequence."""

    name: str
    poses: Array
    start_s: float
    rate_hz: float
    facts: dict[str, str]
    missing: tuple[str, ...]


@dataclass(slots=True)
class PoseReading:
    """Reads recordings one after the other.

    table    which markers there are; None: those of the first recording
    """

    rate_hz: float
    table: MarkerTable | None
    origin: str = ""
    ahead: str = ""

    def read(self, path: Path) -> list[GatheredPoses]:
        """All sequences of a recording. Raises KinegraphError for one without sequences."""
        made: list[GatheredPoses] = []
        with Recording.open(path) as opened:
            facts = {str(k)[:60]: str(v)[:200] for k, v in (opened.header.get("session") or {}).items()}
            found = one_of_each([name for name, s in opened.streams.items() if is_motion(s.spec)], opened)
            for name in found:
                time, rows = opened.read(name)
                label = path.stem if len(found) == 1 else f"{path.stem} {name}"
                made += self._sequences(f"{path}: {name}", label, opened.streams[name].spec, time, rows, facts)
        if not found:
            raise KinegraphError(f"{path}: no stream of markers or poses; `kinegraph info {path}` lists what it holds")
        return made

    def _sequences(
        self, where: str, label: str, spec: StreamSpec, time: Times, rows: Array, facts: dict[str, str]
    ) -> list[GatheredPoses]:
        points, data, parents = as_points(where, spec, rows)
        try:
            table = self.table = self.table or own_table(points.channels, parents, self.origin, self.ahead)
            poses = self._normalised(where, table, points, data)
        except KinegraphError as error:
            raise error if str(error).startswith(where) else KinegraphError(f"{where}: {error}") from None
        missing = tuple(m for m in table.markers if m not in table.found(points.channels))
        runs = list(pieces(time, poses, self.rate_hz))
        many = len(runs) > 1
        rate = spec.rate_hz or (len(time) - 1) * NS / max(1, int(time[-1] - time[0])) if len(time) > 1 else 0.0
        return [
            GatheredPoses(
                f"{label} ({k + 1})" if many else label, run, (begin - int(time[0])) / NS, float(rate), facts, missing
            )
            for k, (begin, run) in enumerate(runs)
        ]

    @staticmethod
    def _normalised(where: str, table: MarkerTable, points: StreamSpec, data: Array) -> Array:
        found = table.found(point_names(points))
        for key, marker in (("origin", table.origin), ("ahead", table.ahead)):
            if marker not in found:
                raise KinegraphError(
                    f"{where}: {key}: the recording has no {marker!r}, by which poses are placed and turned"
                )
        named = {marker: found.get(marker, ("?",)) for marker in table.markers}
        operator = NormalisedPose(table.origin, table.ahead, named, table.up)
        s = operator.begin(points)
        made = np.empty((len(data), 3 * len(named)), np.float32)
        for i in range(0, len(data), 8192):
            part = np.ascontiguousarray(data[i : i + 8192], np.float64).reshape(-1, 3 * points.shape[0])
            out = np.empty((len(part), made.shape[1]))
            normalise_pose(part, s.columns, s.parts, s.vertical, s.sign, s.heading, s.work, out)
            made[i : i + 8192] = out * METRES[points.units[0]]
        return made


def one_of_each(names: list[str], recording: Recording) -> list[str]:
    """Drops the poses of a node or file with recorded positions: they are the same motion once more."""
    placed = [name for name in names if not _is_pose(recording.streams[name].spec)]

    def again(name: str) -> bool:
        of = name.rpartition(".")[0] or name
        return name not in placed and any(other == of or other.startswith(f"{of}.") for other in placed)

    return [name for name in names if not again(name)]


def is_motion(spec: StreamSpec) -> bool:
    """Whether a stream holds markers or poses: not a mesh, not depth."""
    if "mesh" in spec.meta or spec.is_event:
        return False
    return "skeleton" in spec.meta or (len(spec.shape) == 2 and spec.shape[1] == 3 and spec.shape[0] > 1)


def _is_pose(spec: StreamSpec) -> bool:
    return "skeleton" in spec.meta and spec.is_signal


def as_points(where: str, spec: StreamSpec, rows: Array) -> tuple[StreamSpec, Array, list[int] | None]:
    """Points (n, p, 3) with names and a length's unit; of a skeleton its joints, and their parents."""
    if "skeleton" in spec.meta:
        tree = JointTree.of(spec, where)
        joints = np.empty((len(rows), len(tree.joints), 3), np.float32)
        for i in range(0, len(rows), 8192):
            joints[i : i + 8192] = joints_of(tree, np.asarray(rows[i : i + 8192], np.float64))[1]
        shape = (len(tree.joints), 3)
        return (
            StreamSpec(shape, rate_hz=spec.rate_hz, channels=tree.joints, units=("m",), meta={"axes": BODY.facts()}),
            joints,
            tree.parents.tolist(),
        )
    if len(set(spec.units)) != 1 or spec.units[0] not in METRES:
        raise KinegraphError(f"{where}: its unit is {spec.units[0]!r}; a map needs lengths in {', '.join(METRES)}")
    return spec, rows, None


def pieces(time: Times, poses: Array, rate_hz: float) -> Iterator[tuple[int, Array]]:
    """Poses (n, w) at any stamps as runs at `rate_hz`, linear between the two nearest; no run reaches across a long gap."""
    if len(time) < 2:
        return
    breaks = np.flatnonzero(np.diff(time) > max(LONGEST_GAP_S, 1.5 / rate_hz) * NS) + 1
    for t, p in zip(np.split(time, breaks), np.split(poses, breaks), strict=True):
        if len(t) < 2 or t[-1] - t[0] < NS / rate_hz:
            continue
        count = int((t[-1] - t[0]) * rate_hz / NS + 1e-6) + 1
        at = (np.arange(count) / rate_hz).clip(max=(t[-1] - t[0]) / NS)
        was = (t - t[0]) / NS
        k = np.searchsorted(was, at - 1e-9, side="right").clip(1, len(was) - 1)
        width = np.maximum(was[k] - was[k - 1], 1e-12)
        w = ((at - was[k - 1]) / width).astype(np.float32)[:, None]
        exact = np.where(w > 0.9999, p[k], np.where(w < 0.0001, p[k - 1], p[k - 1] + w * (p[k] - p[k - 1])))
        yield int(t[0]), exact


def known(poses: Array) -> Samples:
    """(m,) which share of poses each marker is known in."""
    seen = np.isfinite(poses.reshape(len(poses), -1, 3)).all(axis=2)
    return np.asarray(seen.mean(axis=0))
