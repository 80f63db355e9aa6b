"""`kinegraph motion train graph`: from recordings of motion, a graph on which new motion is walked."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.maps.motion_graph.takes import Take
    from kinegraph.stream.chunk import Array, Samples
    from kinegraph.stream.domain.motion_graph import MotionGraph
    from kinegraph.stream.domain.skeleton import JointTree
    from kinegraph.stream.recording import Recording

PRIMITIVE = {"onset", "end", "activity", "repetition", "cluster"}


@dataclass(frozen=True, slots=True)
class ShownMotion:
    """A name for the cluster that most of these seconds of a recording belong to."""

    name: str
    first_s: float
    last_s: float


def graph(
    recordings: Annotated[list[File], typer.Argument(help="recordings that hold poses", metavar="RECORDING")],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("graph.npz"),
    within_cm: Annotated[
        float,
        typer.Option(min=0.1, max=100.0, help="so far may two poses' joints lie apart, rms, for a way between them"),
    ] = 12.0,
    blend_s: Annotated[float, typer.Option(min=0.16, max=0.5, help="how long a blend takes, at most")] = 0.37,
    rate_hz: Annotated[float, typer.Option(min=10.0, max=120.0, help="poses per second")] = 30.0,
    mirror: Annotated[bool, typer.Option(help="mirror images are nodes, too")] = True,
    called: Annotated[
        list[str] | None,
        typer.Option("--call", metavar="NAME=FROM-TO", help="what is done in these seconds of the first recording"),
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
) -> None:
    """Learn where recorded motion may go over into other recorded motion (thesis, chapter 10).

    kinegraph files import walk.bvh -o walk.mcap --unit walk=cm; kinegraph motion train graph walk.mcap --call walk=0-12 -o graph.npz

    Every stream of poses of a human is used (BVH and AMC files give one each), at the bone lengths of the first. Primitives are those that
    a recording holds (the output `primitive` of operators.segmentation.Segment); one without is segmented now. Synthesis walks it.
    """
    from kinegraph.operators.maps.motion_graph.build import build_graph
    from kinegraph.operators.maps.motion_graph.primitives import segmented

    if output.exists() and not overwrite:
        raise KinegraphError(f"{output}: exists; choose another --out, or replace it with --overwrite")
    shown = [read_shown(text) for text in called or ()]
    tree, takes = read_takes(recordings, rate_hz)
    bare = [k for k, take in enumerate(takes) if not len(take.spans)]
    if bare:
        say(f"segmenting {sum(len(takes[k].poses) for k in bare) / rate_hz:.0f} s of motion ...")
        above = 1 + max((int(take.cluster.max()) for take in takes if len(take.cluster)), default=-1)
        for k, made in zip(bare, segmented(tree, [takes[k] for k in bare], rate_hz), strict=True):
            cluster = made.cluster.copy()
            cluster[cluster >= 0] += above
            takes[k] = replace(made, cluster=cluster)
    named, names = name_clusters(takes, shown, rate_hz)
    blend = max(2, min(7, round((blend_s * rate_hz - 1) / 2)))
    made_graph = build_graph(tree, named, names, rate_hz, within_cm / 100, blend, mirror)
    try:
        made_graph.write(output, {"trained_on": [path.name for path in recordings], "within_cm": within_cm})
    except OSError as error:
        raise KinegraphError(f"{output}: cannot be written: {error.strerror or error}") from None
    report(output, made_graph, named)


def report(output: File, made: MotionGraph, takes: list[Take]) -> None:
    """What came out, for people."""
    import numpy as np

    from kinegraph.operators.maps.motion_graph.measures import measure

    m = measure(made)
    say(
        f"{output}: {m.nodes} nodes ({m.core} in the core), {m.edges} ways between them in {2 * made.blend + 1} frames, "
        f"{m.branching:.1f} ways on from a node; {100 * m.coverage:.0f} % of the motion is kept"
    )
    for c, name in enumerate(made.names):
        mine = made.cluster == c
        say(f"  {name}: {int((mine & made.core).sum())} of {int(mine.sum())} nodes")
    stray = made.cluster == -1
    say(f"  transitions: {int((stray & made.core).sum())} of {int(stray.sum())} nodes")
    if m.clusters > 1:
        say(f"from anywhere to another cluster: {m.reach_s[0]:.1f} s (median), {m.reach_s[1]:.1f} s (95 %)")
    begun = np.cumsum([0, *(len(take.poses) for take in takes)])
    for k in np.flatnonzero(~made.core & ~made.mirrored).tolist()[:20]:
        take = int(np.searchsorted(begun, made.first[k], side="right")) - 1
        first, last = ((int(f) - int(begun[take])) / made.rate_hz for f in (made.first[k], made.last[k]))
        why = "no way back" if (made.source == k).any() else "a dead end"
        say(f"  left out: {made.name_of(k)} of {takes[take].name}, {first:.1f} to {last:.1f} s: {why}")


def read_shown(text: str) -> ShownMotion:
    """ "walk=0-12.5". Raises KinegraphError."""
    name, _, span = text.partition("=")
    first, _, last = span.partition("-")
    try:
        made = ShownMotion(name.strip(), float(first), float(last))
    except ValueError:
        raise KinegraphError(f"--call {text!r}: must be NAME=FROM-TO in seconds, such as walk=0-12.5") from None
    if not (made.name.isidentifier() and len(made.name) <= 32 and 0.0 <= made.first_s < made.last_s < 1e6):
        raise KinegraphError(
            f"--call {text!r}: a name of letters and digits, 32 at most, then a second and a later one"
        )
    return made


def name_clusters(takes: list[Take], shown: list[ShownMotion], rate_hz: float) -> tuple[list[Take], list[str]]:
    """Takes with clusters renumbered from 0 without holes, and their names: the given ones, else A, B, ... in order.

    Clusters of one name are one. Raises KinegraphError where nothing repeats in the seconds given.
    """
    import numpy as np

    given: dict[int, str] = {}
    for one in shown:
        spans = takes[0].spans / rate_hz
        inside = np.clip(np.minimum(spans[:, 1], one.last_s) - np.maximum(spans[:, 0], one.first_s), 0.0, None)
        weights = {
            c: float(inside[takes[0].cluster == c].sum()) for c in np.unique(takes[0].cluster).tolist() if c >= 0
        }
        best = max(weights, key=lambda c: weights[c], default=-1)
        if best < 0 or weights[best] <= 0.0:
            raise KinegraphError(
                f"--call {one.name}={one.first_s:g}-{one.last_s:g}: nothing repeats in these seconds of {takes[0].name}"
            )
        if given.get(best, one.name) != one.name:
            raise KinegraphError(
                f"--call {one.name}: what is done there is the same as {given[best]!r}: one cluster has one name"
            )
        given[best] = one.name
    names: list[str] = []
    number: dict[int, int] = {}
    for c in sorted({int(c) for take in takes for c in take.cluster if c >= 0}):
        name = given.get(c, "")
        if not name:
            free = (f"{chr(65 + k % 26)}{k // 26 or ''}" for k in range(10_000))
            name = next(n for n in free if n not in names and n not in given.values())
        if name not in names:
            names.append(name)
        number[c] = names.index(name)
    made = [replace(take, cluster=np.array([number.get(int(c), -1) for c in take.cluster], np.int64)) for take in takes]
    return made, names


def read_takes(recordings: list[File], rate_hz: float) -> tuple[JointTree, list[Take]]:
    """All runs of poses in the recordings, on the symmetric skeleton of the first, and the primitives that they hold."""
    import numpy as np

    from kinegraph.operators.maps.motion_graph.primitives import spans_of
    from kinegraph.operators.maps.motion_graph.takes import Take, pieces, symmetric
    from kinegraph.stream.domain.humanoid import to_humanoid
    from kinegraph.stream.domain.skeleton import JointTree
    from kinegraph.stream.recording import Recording

    tree: JointTree | None = None
    takes: list[Take] = []
    for path in recordings:
        with Recording.open(path) as opened:
            primitive = _primitives(opened)
            for name, stream in opened.streams.items():
                if "skeleton" not in stream.spec.meta or len(stream.spec.shape) != 1:
                    continue
                time, rows = opened.read(name)
                for start, poses in pieces(time, np.asarray(rows, np.float64), rate_hz):
                    try:
                        body, made = to_humanoid(JointTree.of(stream.spec, name), poses)
                    except KinegraphError as error:
                        raise KinegraphError(f"{path}: {name}: {error}; a motion graph is of human poses") from None
                    tree = tree or symmetric(body)
                    made[:, :3] *= _leg(tree) / max(_leg(body), 1e-3)
                    empty = np.empty((0, 2), np.int64), np.empty(0, np.int64)
                    spans, cluster = spans_of(primitive, start, len(made), rate_hz) if len(primitive) else empty
                    takes.append(Take(f"{path.name}: {name}", start, made, spans, cluster))
                    say(f"{path}: {name}: {len(made) / rate_hz:.1f} s")
    if tree is None:
        raise KinegraphError(
            "no stream of poses in these recordings (or one pose only); "
            "`kinegraph files import` makes one of each BVH file, given its --unit"
        )
    return tree, takes


def _primitives(opened: Recording) -> Array:
    """A recording's primitives with their final clusters; empty without any."""
    import numpy as np

    def events(fields: set[str]) -> Array:
        found = [
            name
            for name, s in opened.streams.items()
            if fields <= set(s.spec.dtype.names or ()) and "name" not in (s.spec.dtype.names or ())
        ]
        if len(found) > 1:
            raise KinegraphError(
                f"{opened.path}: {', '.join(found)} all hold segments; train on a recording that holds one of them"
            )
        return np.asarray(opened.read(found[0])[1]) if found else np.empty(0, [(f, "<i8") for f in sorted(fields)])

    primitive, merges = events(PRIMITIVE).copy(), events({"cluster", "into"})
    for old, into in zip(merges["cluster"].tolist(), merges["into"].tolist(), strict=True):
        primitive["cluster"][primitive["cluster"] == old] = into
    return primitive


def _leg(tree: JointTree) -> float:
    """The length of a leg (m)."""
    import numpy as np

    from kinegraph.stream.domain.humanoid import BONES

    lengths: Samples = np.linalg.norm(tree.offsets, axis=1)
    return float(sum(lengths[BONES.index(f"Left{bone}")] for bone in ("LowerLeg", "Foot")))
