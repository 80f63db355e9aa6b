"""The motion graph that grows live, against the one that is built of whole takes."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.maps.motion_graph.build import Nodes, find_edges, strongest
from kinegraph.operators.maps.motion_graph.growing import EDGE, NODE, GrowingGraph
from kinegraph.stream.chunk import FOREVER, Array, Chunk, Samples, StreamSpec, grid
from kinegraph.stream.data.rows import taking
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.errors import KinegraphError
from tests.support.motion_made import CYCLE, RATE, TREE, walking, waving

SPEC = StreamSpec((len(BONES), 3), rate_hz=RATE, channels=BONES, units=("m",))
SPANS = np.dtype([("onset", "<i8"), ("end", "<i8"), ("cluster", "<i8")])
EVENTS = StreamSpec((), SPANS, units=("ns", "ns", ""))
HUMAN = {"left": "LeftUpperLeg", "right": "RightUpperLeg", "origin": "Hips", "within_cm": 10.0}
BLEND = 5


def grown(operator: GrowingGraph, joints: Samples, spans: list[tuple[int, int, int]]) -> tuple[Array, Array]:
    """Nodes and edges; each stretch (first frame, last, cluster) is reported a second after its end."""
    operator.open({"in": SPEC, "primitive": EVENTS})
    take = taking(operator, {"in": SPEC, "primitive": EVENTS})
    time, late = grid(RATE, len(joints)), round(RATE)
    events: dict[str, list[Array]] = {"node": [np.empty(0, NODE)], "edge": [np.empty(0, EDGE)]}
    emitted = []
    for i, stamp in enumerate(time):
        rows = [(time[a], time[b], c) for a, b, c in spans if min(b + late, len(time) - 1) == i]
        if rows:
            stamps = np.full(len(rows), stamp)
            emitted.append(operator.process("primitive", Chunk(stamps, np.array(rows, SPANS), int(stamp))))
        emitted.append(operator.process("in", take("in", Chunk(time[i : i + 1], joints[i : i + 1], int(stamp)))))
    emitted.append(operator.process("primitive", Chunk(time[:0], np.empty(0, SPANS), FOREVER)))
    emitted.append(operator.process("in", take("in", Chunk(time[:0], joints[:0], FOREVER))))
    for one in emitted:
        for name, chunk in one:  # type: ignore[union-attr]
            events[name].append(chunk.data)  # type: ignore[union-attr, index, arg-type]
    assert emitted[-1][0][1].until == FOREVER  # type: ignore[index, union-attr]
    return np.concatenate(events["node"]), np.concatenate(events["edge"])


def strides(count: int) -> list[tuple[int, int, int]]:
    return [(k * CYCLE, (k + 1) * CYCLE - 1, 0) for k in range(count)]


def test_it_finds_the_edges_that_a_built_graph_has() -> None:
    joints = joints_of(TREE, walking(6, np.radians(20), sway=0.1))[1]
    nodes, edges = grown(GrowingGraph(**HUMAN), joints, strides(6))  # type: ignore[arg-type]
    first = np.arange(6) * CYCLE
    bounds = np.zeros(6, np.int64), np.full(6, len(joints))
    whole = Nodes(first, first + CYCLE, np.zeros(6, np.int64), np.zeros(6, bool), *bounds)
    built = find_edges(joints, whole, 0.1, BLEND)
    theirs = {
        (a, b): row
        for a, b, *row in zip(built.source, built.target, built.leave, built.enter, built.placed, strict=True)
    }
    assert len(edges) == len(theirs) > 10
    frame = np.searchsorted(grid(RATE, len(joints)), np.stack([edges["leave"], edges["enter"]], 1))
    for edge, (leave, enter) in zip(edges, frame, strict=True):
        found_edge = theirs[edge["source"], edge["target"]]
        assert (leave, enter) == (found_edge[0], found_edge[1])
        np.testing.assert_allclose([edge[k] for k in ("turn", "x", "z", "distance")], found_edge[2], atol=1e-9)
    assert nodes["node"].tolist() == list(range(6)) and nodes["nodes"].tolist() == list(range(1, 7))
    core = strongest(whole, built).sum()
    assert nodes["core"][-1] == core >= 3
    assert nodes["core_s"][-1] == pytest.approx(core * (CYCLE - 1) / RATE, abs=1e-6)


def test_what_lies_between_is_a_transition_and_what_is_short_joins_the_next() -> None:
    joints = joints_of(TREE, walking(6))[1]
    spans = [(0, 31, 4), (64, 95, 4), (96, 101, 7), (102, 140, 5)]
    nodes, _ = grown(GrowingGraph(**HUMAN), joints, spans)  # type: ignore[arg-type]
    assert nodes["cluster"].tolist() == [4, -1, 4, 5]
    begins = np.searchsorted(grid(RATE, len(joints)), nodes["onset"])
    assert begins.tolist() == [0, 32, 64, 96]


def test_other_motion_has_no_edges_to_it_and_old_nodes_are_forgotten() -> None:
    walk, wave = joints_of(TREE, walking(3))[1], joints_of(TREE, waving(3))[1]
    wave[:, :, 0] += 5.0
    nodes, edges = grown(GrowingGraph(**{**HUMAN, "within_cm": 4.0}), np.concatenate([walk, wave]), strides(6))  # type: ignore[arg-type]
    across = (edges["source"] < 3) != (edges["target"] < 3)
    assert not (across & (edges["distance"] > 0)).any()
    assert {(s, t) for s, t in zip(edges["source"], edges["target"], strict=True) if s > 2 and t > 2}
    nodes, edges = grown(GrowingGraph(**HUMAN, max_nodes=2), joints_of(TREE, walking(6))[1], strides(6))  # type: ignore[arg-type]
    assert nodes["nodes"].tolist() == [1, 2, 2, 2, 2, 2]
    assert (np.abs(edges["source"] - edges["target"]) <= 1).all()


def test_no_window_reaches_across_a_gap_or_holds_a_missing_joint() -> None:
    joints = joints_of(TREE, walking(4))[1]
    joints[70, 3] = np.nan
    _, edges = grown(GrowingGraph(**HUMAN), joints, strides(4))  # type: ignore[arg-type]
    at = np.searchsorted(grid(RATE, len(joints)), np.stack([edges["leave"], edges["enter"]], 1))
    near = (np.abs(at - 70) < 2).any(axis=1) & (edges["distance"] > 0)
    assert len(edges) and not near.any()
    assert np.isfinite(edges["distance"]).all()


def test_what_cannot_be_grown_is_refused() -> None:
    with pytest.raises(KinegraphError, match="a joint of the input"):
        GrowingGraph(left="tail").open({"in": SPEC, "primitive": EVENTS})
    with pytest.raises(KinegraphError, match="events with the fields"):
        GrowingGraph(**HUMAN).open({"in": SPEC, "primitive": SPEC})  # type: ignore[arg-type]
    with pytest.raises(KinegraphError, match="named joints"):
        GrowingGraph(**HUMAN).open({"in": SPEC.derive(units=("V",)), "primitive": EVENTS})  # type: ignore[arg-type]
