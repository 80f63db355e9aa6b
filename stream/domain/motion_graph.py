"""A motion graph as it is stored: stretches of recorded poses (nodes), and where one may go over into another (edges).

Made by `kinegraph motion train graph`, walked by operators.synthesis.Synthesis. Placements on the floor are a turn about the vertical y and
a shift in x and z: a point p goes to (x cos + z sin, y, -x sin + z cos) + (shift x, 0, shift z).
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.domain.skeleton import JointTree

KIND = "graph"
TRANSITION = -1
"""The cluster of a stretch that is no repetition."""
UNIT = 1e-3
"""A quaternion may be so far from length 1."""


@dataclass(frozen=True, slots=True)
class MotionGraph:
    """
    tree       the skeleton; rate_hz: of all poses; names: of the clusters; blend: frames on either side of an edge's middle, at most
    poses      (n, 3 + 4 j); contacts (n, 2): whether the left and the right foot stand; take (n,): frames of one number follow one another
    first, last, cluster, mirrored, core   (k,) per node: its frames first..last-1; number of its cluster, -1: a transition; whether it is a
               mirror image; whether it lies in the strongly connected core
    source, target, leave, enter, turn, shift (m, 2), distance   per edge, ordered by source: from the frame `leave` of a node to the
               frame `enter` of another, placed by `turn` and `shift` (m); distance of the point clouds, m: 0, and
               leave == enter, where the recording goes on by itself
    """

    tree: JointTree
    rate_hz: float
    names: tuple[str, ...]
    blend: int
    poses: Samples
    contacts: Array
    take: Times
    first: Times
    last: Times
    cluster: Times
    mirrored: Array
    core: Array
    source: Times
    target: Times
    leave: Times
    enter: Times
    turn: Samples
    shift: Samples
    distance: Samples

    @property
    def natural(self) -> Array:
        """(m,) whether an edge is the recording's own way on."""
        return np.asarray((self.leave == self.enter) & (self.distance == 0.0))

    def name_of(self, node: int) -> str:
        """What a node's cluster is called."""
        return self.names[self.cluster[node]] if self.cluster[node] >= 0 else "transition"

    def write(self, path: Path, header: dict[str, Any]) -> None:
        """Write it as a model. Raises OSError."""
        facts = {
            "skeleton": self.tree.facts(),
            "rate_hz": self.rate_hz,
            "clusters": list(self.names),
            "blend": self.blend,
        }
        arrays = {name: getattr(self, name) for name in ARRAYS}
        arrays["poses"] = self.poses.astype(np.float32)
        write_model(path, KIND, {**header, **facts}, arrays)

    @staticmethod
    def read(path: Path) -> MotionGraph:
        """Read one, and refuse what does not hang together. Raises ModelError."""
        model = read_model(path, KIND)
        try:
            tree = JointTree.from_facts(model.header["skeleton"])
            rate_hz, blend = float(model.header["rate_hz"]), int(model.header["blend"])
            names = tuple(str(name) for name in model.header["clusters"])
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise ModelError(f"{path}: the header does not describe a motion graph ({error})") from None
        poses = model.array("poses", (None, tree.width))
        kinds = {
            "contacts": np.bool_,
            "mirrored": np.bool_,
            "core": np.bool_,
            "turn": np.float64,
            "distance": np.float64,
        }
        n, k, m = len(poses), *(len(model.array(name, (None,), np.int64)) for name in ("first", "source"))
        sizes: dict[str, tuple[int, ...]] = {"contacts": (n, 2), "take": (n,), "shift": (m, 2)}
        sizes |= dict.fromkeys(("first", "last", "cluster", "mirrored", "core"), (k,))
        found: dict[str, Any] = {
            name: model.array(name, sizes.get(name, (m,)), np.float64 if name == "shift" else kinds.get(name, np.int64))
            for name in ARRAYS
            if name != "poses"
        }
        made = MotionGraph(tree, rate_hz, names, blend, poses, **found)
        if wrong := _wrong(made):
            raise ModelError(f"{path}: {wrong}; train it again")
        return made


ARRAYS = tuple(f.name for f in fields(MotionGraph) if f.name not in ("tree", "rate_hz", "names", "blend"))


def _wrong(g: MotionGraph) -> str:
    """What does not hang together in a graph; "": nothing."""
    n, k, b = len(g.poses), len(g.first), g.blend
    if not (0.0 < g.rate_hz <= 1000.0 and 2 <= b <= 100 and n and k and len(g.source)):
        return "a motion graph has a rate, a blend, frames, nodes and edges"
    if not (np.all(g.first >= 0) and np.all(g.first < g.last) and np.all(g.last <= n)):
        return "a node lies outside of the frames"
    if np.any(g.cluster < -1) or np.any(g.cluster >= len(g.names)):
        return "a node names a cluster that is not there"
    if not all(np.all((ends >= 0) & (ends < k)) for ends in (g.source, g.target)) or np.any(np.diff(g.source) < 0):
        return "an edge names a node that is not there, or edges are not in the order of their nodes"
    if any(np.any((at < 0) | (at > n)) for at in (g.leave, g.enter)):
        return "an edge names frames that are not there"
    steps = np.where(g.natural, 0, b)
    low, high = np.minimum(g.leave, g.enter) - steps, np.maximum(g.leave, g.enter) + steps
    if np.any(low < 0) or np.any(high >= n + g.natural):
        return "an edge needs frames that are not there"
    for at in (g.leave, g.enter):
        if np.any(g.take[at - steps] != g.take[np.minimum(at + steps, n - 1)]):
            return "an edge needs frames beyond the end of a recording"
    lengths = np.linalg.norm(g.poses[:, 3:].reshape(n, -1, 4), axis=2)
    return "" if np.all(np.abs(lengths - 1.0) < UNIT) else "a pose holds quaternions of another length than 1"


def edges_from(model: MotionGraph) -> Times:
    """(k + 1,) where each node's edges begin in the arrays of edges."""
    return np.asarray(np.searchsorted(model.source, np.arange(len(model.first) + 1)), np.int64)
