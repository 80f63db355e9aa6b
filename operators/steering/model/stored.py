"""A steering model as plain arrays, and back."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kinegraph.operators.steering.model.fit import Steering
from kinegraph.operators.steering.model.marker_frame import MarkerFrame
from kinegraph.operators.steering.model.part import Part
from kinegraph.operators.steering.model.pose_parameters import MarkerGraph
from kinegraph.operators.steering.model.regions import Regions
from kinegraph.operators.steering.model.regression import Learned
from kinegraph.operators.steering.model.settling import Settling, SoftShapes
from kinegraph.stream.chunk import Array
from kinegraph.stream.data.model_file import Model, ModelError
from kinegraph.stream.domain.mesh import Topology

KIND = "mesh"
MAKER = "motion train steering"
SETTLING = ("turns", "begins", "others", "own", "theirs", "weights", "spread", "solve")
FRAME = ("weights", "usual", "shares")
GRAPH = ("lead", "edges", "before", "lengths", "shares", "still")


def to_arrays(model: Steering, mesh: Topology, limbs: tuple[str, ...]) -> tuple[dict[str, Any], dict[str, Array]]:
    """The header and arrays of a model, for `stream.data.model_file.write_model`."""
    header = {
        "markers": list(model.markers),
        "parts": len(model.parts),
        "limbs": list(limbs),
        "name": mesh.name,
        "topology": mesh.hash,
    }
    arrays: dict[str, Array] = {
        "faces": mesh.faces,
        "vertices": model.vertices,
        "reference": model.reference,
        "count": np.array([mesh.vertices]),
        "usual": model.usual,
        "spread": model.spread,
    }
    if len(model.facing) or model.reach != 1.0:
        arrays |= {"facing": model.facing, "reach": np.array([model.reach])}
    if len(model.soft):
        arrays |= {"soft": model.soft, "most": np.array([model.most])}
    if model.graph:
        arrays |= {f"graph.{name}": getattr(model.graph, name) for name in GRAPH}
    if model.settling:
        arrays |= {f"settling.{name}": np.asarray(getattr(model.settling, name)) for name in SETTLING}
        soft = model.settling.shapes or SoftShapes(0.0, 0.0)
        arrays["settling.how"] = np.array([float(model.settling.greedy), model.settling.most, soft.beta, soft.marked])
    for k, part in enumerate(model.parts):
        if part.parent >= 0:
            arrays |= {f"{k}.parent": np.array([part.parent]), f"{k}.above": part.above, f"{k}.own": part.own}
        if part.frame:
            arrays |= {f"{k}.frame.{name}": getattr(part.frame, name) for name in FRAME}
        arrays |= {f"{k}.{name}": getattr(part, name) for name in ("vertices", "weights", "mean", "modes", "features")}
        arrays |= {f"{k}.{name}": getattr(part.learned, name) for name in ("centres", "scale")}
        arrays |= {
            f"{k}.ridge": part.learned.weights,
            f"{k}.usual": part.learned.mean,
            f"{k}.size": np.array(part.size),
        }
        arrays[f"{k}.scale"] = np.array([part.learned.scale])
    return header, arrays


def from_model(model: Model) -> tuple[Steering, Topology]:
    """The steering model and its mesh. Raises ModelError."""
    names = tuple(str(name) for name in model.header.get("markers", ()))
    count = int(model.array("count", (1,), np.int64)[0])
    try:
        mesh = Topology(count, model.array("faces", (None, 3), np.int32), str(model.header.get("name", "")))
    except ValueError as error:
        raise ModelError(f"{model.path}: {error}") from None
    vertices = model.array("vertices", (len(names),), np.int64)
    reference = model.array("reference", (None,), np.int64)
    if not isinstance(how_many := model.header.get("parts"), int):
        raise ModelError(f"{model.path}: does not say how many parts it has")
    graph = _graph(model, len(names)) if "graph.edges" in model.arrays else None
    parts = tuple(_part(model, k, len(names)) for k in range(how_many))
    _hanging(model, parts)
    if any(part.frame for part in parts) and (Regions.of(parts) is None or graph):
        raise ModelError(f"{model.path}: some of its regions do not move with its markers as the others do")
    facing, reach = np.zeros(0), 1.0
    if "facing" in model.arrays:
        facing, reach = model.array("facing", (None,)), float(model.array("reach", (1,))[0])
    if len(facing) not in (0, 4) or not 0.0 < reach < np.inf:
        raise ModelError(f"{model.path}: gives a wrong direction in which its mesh faces")
    soft, most = np.zeros((0, 0)), 0.0
    if "soft" in model.arrays:
        soft, most = model.array("soft", (count, len(names))), float(model.array("most", (1,))[0])
    numbers = [(vertices, count), (reference, len(names)), *((p.vertices, count) for p in parts)]
    numbers += [(facing[:2].astype(np.int64), len(names))]
    numbers += [(p.features, graph.width if graph else 3 * len(names)) for p in parts]
    if (
        not len(reference)
        or not parts
        or any(n.size and not (n.min() >= 0 and n.max() < limit) for n, limit in numbers)
    ):
        raise ModelError(f"{model.path}: refers to vertices or markers that do not exist")
    usual, spread = model.array("usual", (len(names), 3)), model.array("spread", (len(names), 3))
    settling = _settling(model, parts, len(names)) if "settling.own" in model.arrays else None
    return Steering(names, vertices, reference, parts, usual, spread, facing, reach, soft, most, graph, settling), mesh


def _settling(model: Model, parts: tuple[Part, ...], markers: int) -> Settling:
    """Raises ModelError where parts are held together that are not there."""
    p, k = len(parts), max(len(part.modes) for part in parts)
    others, begins = (
        model.array("settling.others", (None,), np.int64),
        model.array("settling.begins", (p + 1,), np.int64),
    )
    n = len(others)
    own, theirs = (model.array(f"settling.{name}", (n, 1 + k, 3)) for name in ("own", "theirs"))
    solve = np.zeros((0, 0, 0))
    if model.arrays["settling.solve"].size or not k:
        solve = model.array("settling.solve", (p, k, k))
    greedy, most, beta, marked = (float(one) for one in model.array("settling.how", (4,)))
    shapes = SoftShapes(beta, marked) if len(solve) else None
    if n and not (others.min() >= -markers and others.max() < p):
        raise ModelError(f"{model.path}: attaches parts to parts or markers that do not exist")
    if begins[0] or begins[-1] != n or (np.diff(begins) < 0).any():
        raise ModelError(f"{model.path}: the rows that hold its parts together do not fit")
    turns, weights = model.array("settling.turns", (p,), np.bool_), model.array("settling.weights", (n,))
    spread = model.array("settling.spread", (p, k))
    return Settling(bool(greedy), turns, begins, others, own, theirs, weights, spread, solve, most, shapes)


def _part(model: Model, k: int, markers: int) -> Part:
    vertices = model.array(f"{k}.vertices", (None,), np.int64)
    n = len(vertices)
    modes = model.array(f"{k}.modes", (None, 3 * n))
    features = model.array(f"{k}.features", (None,), np.int64)
    centres = model.array(f"{k}.centres", (None, len(features)))
    usual = model.array(f"{k}.usual", (9 + len(modes),))
    scale = float(model.array(f"{k}.scale", (1,))[0])
    rows = len(features) if scale < 0.0 else len(centres)
    learned = Learned(centres, model.array(f"{k}.ridge", (rows, len(usual))), usual, scale, 0.0, 0.0, 0.0)
    weights, mean = model.array(f"{k}.weights", (n,)), model.array(f"{k}.mean", (n, 3))
    part = Part(vertices, weights, mean, modes, 1.0, features, learned, frame=_frame(model, k, markers))
    if part.frame and (scale < 0.0 or not np.array_equal(features, np.arange(3 * markers))):
        raise ModelError(f"{model.path}: part {k} does not depend on the markers of its frame")
    if f"{k}.parent" not in model.arrays:
        return part
    parent = int(model.array(f"{k}.parent", (1,), np.int64)[0])
    above, own = model.array(f"{k}.above", (None, 3)), model.array(f"{k}.own", (1 + len(modes), 3))
    return replace(part, parent=parent, above=above, own=own)


def _frame(model: Model, k: int, markers: int) -> MarkerFrame | None:
    if f"{k}.frame.weights" not in model.arrays:
        return None
    weights, shares = (model.array(f"{k}.frame.{name}", (markers,)) for name in ("weights", "shares"))
    return MarkerFrame(weights, model.array(f"{k}.frame.usual", (markers, 3)), shares)


def _hanging(model: Model, parts: tuple[Part, ...]) -> None:
    """Raises ModelError where a part hangs from one that does not come before it, or from joints that are not there."""
    for k, part in enumerate(parts):
        if f"{k}.parent" in model.arrays and not (
            0 <= part.parent < k and len(part.above) == 1 + len(parts[part.parent].modes)
        ):
            raise ModelError(f"{model.path}: part {k} hangs from a part that does not fit")


def _graph(model: Model, markers: int) -> MarkerGraph:
    edges = model.array("graph.edges", (None, 2), np.int64)
    lead, before = model.array("graph.lead", (2,), np.int64), model.array("graph.before", (len(edges),), np.int64)
    lengths, shares, still = (model.array(f"graph.{name}", (len(edges),)) for name in ("lengths", "shares", "still"))
    inside = all(one.size == 0 or (one.min() >= 0 and one.max() < markers) for one in (edges, lead))
    if not (len(edges) and inside and (before < np.arange(len(edges))).all() and (before >= -1).all()):
        raise ModelError(f"{model.path}: its graph of markers refers to markers or edges that do not exist")
    return MarkerGraph(lead, edges, before, lengths, shares, still)
