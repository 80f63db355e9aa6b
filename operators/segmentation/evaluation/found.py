"""What a segmentation found: activities and primitives from a recording that holds them, or from a table."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from kinegraph.operators.segmentation.evaluation.truth import LONGEST_TRANSITION_S
from kinegraph.stream.batch.sessions import StoredSession, open_session
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.data.tables import read_csv
from kinegraph.stream.errors import KinegraphError, nearest

ACTIVITY = {"onset", "end", "activity", "repeats"}
PRIMITIVE = {"onset", "end", "activity", "repetition", "cluster"}
MERGE = {"cluster", "into"}


@dataclass(slots=True)
class Found:
    """Segments in order, seconds from the recording's start; every end is the next one's start where nothing lies between.

    activities  (n, 2)   start and end; `transition` (n,): a short stretch between two others
    primitives  (m, 2)   start and end; `cluster` (m,), or -1; `repetition` (m,), 0: no repetition; `second` (m,): the second step of
                         the same repetition as the one before
    features, time       what was segmented, if it was recorded: (frames, width), (frames,)
    own                  of stacked features, the first column of offset 0, and the one after its last
    radius               in which neighbours were looked for, in the features' unit; NaN: not known
    """

    activities: Samples
    transition: Array
    primitives: Samples
    cluster: Array
    repetition: Array
    features: Samples = field(default_factory=lambda: np.empty((0, 0)))
    time: Samples = field(default_factory=lambda: np.empty(0))
    own: tuple[int, int] = (0, 0)
    radius: float = np.nan
    second: Array | None = None

    def repetitions(self) -> Samples:
        """Start and end of each repetition (k, 2); a left and a right step are one."""
        within = self.repetition > 0
        spans = self.primitives[within]
        if self.second is None or not len(spans):
            return spans
        first = np.flatnonzero(~self.second[within])
        return np.stack([spans[first, 0], spans[np.append(first[1:] - 1, len(spans) - 1), 1]], 1)

    def boundaries(self) -> Samples:
        """Where activities meet. A transition or rest between two counts once, in its middle; both its ends, where it is as long as an
        annotated one that is something of its own; at an end of the recording not at all."""
        made: list[float] = []
        for (_, end), (start, _) in pairwise(self.activities[~self.transition]):
            made += [end, start] if start - end > LONGEST_TRANSITION_S else [(end + start) / 2.0]
        return np.array(made)

    def cuts(self) -> Samples:
        """The borders of all units, activities and primitives, without the first start and the last end."""
        edges = np.unique(np.concatenate([self.activities.ravel(), self.primitives.ravel()]))
        return edges[1:-1]


def read_found(path: Path, node: str = "", features: str = "") -> Found:
    """A segmentation from a recording of its outputs, or from a CSV table.

    node      the node whose outputs these are, if there are several
    features  the stream that was segmented, for the picture
    A table has start_s and end_s of every primitive, and perhaps activity (numbers that change where one ends), cluster and repetition.
    Raises KinegraphError.
    """
    if path.suffix.lower() in (".csv", ".tsv", ".txt"):
        return _table(path)
    with open_session(path) as recording:
        zero = recording.begin_of_inputs
        activity = _events(recording, ACTIVITY, node, needed=True)
        primitive = _events(recording, PRIMITIVE, node, needed=True)
        merges = _events(recording, MERGE, node)
        radii = _events(recording, {"radius"}, node)
        made = Found(
            _spans(activity, zero),
            activity["transition"] if "transition" in (activity.dtype.names or ()) else np.zeros(len(activity), bool),
            _spans(primitive, zero),
            merged(primitive["cluster"], zip(merges["cluster"], merges["into"], strict=True) if len(merges) else ()),
            primitive["repetition"].astype(np.int64),
            second=second_steps(primitive),
        )
        if features:
            made.time, made.features, made.own = _signal(recording, features, zero)
            if len(radii):
                made.radius = float(radii["radius"][-1]) * np.sqrt(made.features.shape[1])
    return made


def second_steps(primitive: Array) -> Array | None:
    """Which primitives are the second step of the same repetition as the one before; None without sides."""
    if "side" not in (primitive.dtype.names or ()):
        return None
    second = np.zeros(len(primitive), bool)
    before, after = primitive[:-1], primitive[1:]
    second[1:] = (after["side"] > 0) & (before["side"] == 3 - after["side"])
    for name in ("activity", "repetition"):
        second[1:] &= before[name] == after[name]
    return second


def merged(cluster: Array, merges: Iterable[tuple[int, int]]) -> Array:
    """Cluster numbers as they are once all merges, in order, are done."""
    made = cluster.astype(np.int64)
    for old, into in merges:
        made[made == old] = into
    return made


def _events(recording: StoredSession, fields: set[str], node: str, *, needed: bool = False) -> Array:
    """The events of the only stream that has these fields (of this node); an empty array without one."""
    names = [
        name
        for name, stream in recording.streams.items()
        if fields <= set(stream.spec.dtype.names or ())
        and (not node or name.rpartition(".")[0] == node or name == node)
    ]
    names = [name for name in names if "name" not in (recording.streams[name].spec.dtype.names or ())]
    if fields == {"radius"}:
        names = [name for name in names if not {"onset", "frame"} & set(recording.streams[name].spec.dtype.names or ())]
    if len(names) > 1:
        raise KinegraphError(f"{recording.path}: {', '.join(names)} all hold segments; choose one with --node")
    if not names:
        if needed:
            known = sorted({name.rpartition(".")[0] for name in recording.streams})
            hint = nearest(node, known) if node else "name the segmentation's outputs under `record` in the graph"
            raise KinegraphError(f"{recording.path}: no stream holds {' and '.join(sorted(fields))}; {hint}")
        return np.empty(0, [(name, "<i8") for name in sorted(fields)])
    return recording.read(names[0])[1]


def _spans(events: Array, zero: int) -> Samples:
    """Start and end in seconds; an end is the next start where that is the next frame's."""
    start, end = events["onset"].astype(np.int64), events["end"].astype(np.int64)
    if len(start) > 1:
        near = start[1:] - end[:-1] < NS // 4
        end[:-1][near] = start[1:][near]
    return np.stack([start - zero, end - zero], 1) / NS


def _signal(recording: StoredSession, name: str, zero: int) -> tuple[Samples, Samples, tuple[int, int]]:
    spec = recording.stream(name).spec
    if spec.is_event or len(spec.shape) > 2:
        raise KinegraphError(f"{recording.path}: --features {name} is {spec.describe()}; it must be a signal")
    time, data = recording.read(name)
    if not len(time):
        raise KinegraphError(f"{recording.path}: --features {name} holds no samples")
    data = data.reshape(len(time), -1)
    stack = spec.meta.get("stack", {"offsets": [0], "features": data.shape[1]})
    first = stack["offsets"].index(0) * stack["features"] if 0 in stack["offsets"] else 0
    own = (first, first + stack["features"])
    return (time - zero) / NS, np.ascontiguousarray(data, np.float64), own


def _table(path: Path) -> Found:
    columns = read_csv(path)
    for name in ("start_s", "end_s"):
        if name not in columns:
            raise KinegraphError(f"{path}: line 1: there is no column {name}; {nearest(name, columns)}")
    spans = np.stack([columns["start_s"].data, columns["end_s"].data], 1)
    if not (spans[:, 0] < spans[:, 1]).all() or (spans[1:, 0] < spans[:-1, 1] - 1e-9).any() or not len(spans):
        raise KinegraphError(
            f"{path}: segments must be there, end after they start, and follow one another without overlaps"
        )
    n = len(spans)
    activity = columns["activity"].data if "activity" in columns else np.arange(n)
    firsts = np.flatnonzero(np.diff(activity, prepend=np.nan) != 0)
    lasts = np.append(firsts[1:] - 1, n - 1)
    return Found(
        np.stack([spans[firsts, 0], spans[lasts, 1]], 1),
        np.zeros(len(firsts), bool),
        spans,
        columns["cluster"].data.astype(np.int64) if "cluster" in columns else np.full(n, -1),
        columns["repetition"].data.astype(np.int64) if "repetition" in columns else np.ones(n, np.int64),
    )
