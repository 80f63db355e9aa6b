"""An avatar walks, runs and jumps where it should, out of one recording."""

from __future__ import annotations

import socket
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.synthesis.source import NODE, Synthesis
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.domain.skeleton import joints_of
from kinegraph.stream.recording import Recording
from tests.support.athlete_made import record_athlete
from tests.support.command_line import Command, kinegraph
from tests.support.heard import Heard
from tests.support.motion_made import RATE

__all__ = ["kinegraph"]

LEAP_M = 0.3
"""Somebody who jumps has both feet so high."""


def pace(poses: Samples) -> float:
    """How fast the root goes over the floor, m/s, in the median."""
    return float(np.median(np.linalg.norm(np.diff(poses[:, [0, 2]], axis=0), axis=1)) * RATE)


def leaps(graph: MotionGraph, poses: Samples) -> bool:
    return bool(joints_of(graph.tree, poses)[1][:, :, 1].min(axis=1).max() > LEAP_M)


@pytest.fixture
def trained(kinegraph: Command) -> MotionGraph:
    """One recording, segmented and made into a graph by the command; the motions are shown by when they were done."""
    shown = record_athlete(Path("athlete.mcap"))
    calls = [word for name, first, last in shown for word in ("--call", f"{name}={first:.1f}-{last:.1f}")]
    code, out, wrong = kinegraph("motion", "train", "graph", "athlete.mcap", *calls, "-o", "graph.npz")
    assert code == 0, wrong
    assert "segmenting" in out
    return MotionGraph.read(Path("graph.npz"))


def test_it_does_what_it_is_told_in_turn(trained: MotionGraph, kinegraph: Command) -> None:
    """By a graph in YAML, out to an avatar by VMC: so many of each, in this order."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as avatar:
        avatar.bind(("127.0.0.1", 0))
        avatar.settimeout(10)
        Path("act.yaml").write_text(
            "nodes:\n"
            "  act: {use: operators.synthesis.Synthesis, model: graph.npz, realtime: false, order: [[walk, 3], [run, 4], [jump, 2]]}\n"
            f"  avatar: {{use: devices.osc.vmc_outlet.VmcOutlet, from: {{pose: act.pose}}, port: {avatar.getsockname()[1]}}}\n"
            "record: [act.pose, act.node]\n"
        )
        assert kinegraph("run", "act.yaml", "--view", "none", "-o", "act")[0] == 0
        assert b"/VMC/Ext/Bone/Pos" in avatar.recv(65536)
    with Recording.open(Path("act")) as opened:
        stamps, poses = opened.read("act.pose")
        nodes = opened.read("act.node")[1]
    done = during(stamps, poses, nodes)
    assert [name for name in done if name != "transition"] == ["walk", "run", "jump"], "in this order"
    assert 0.9 < pace(done["walk"]) < 1.5 and pace(done["run"]) > 2.3
    assert leaps(trained, done["jump"]) and not leaps(trained, done["walk"])


def during(stamps: Array, poses: Samples, nodes: Array) -> dict[str, Samples]:
    """The poses in nodes of each cluster, in the order in which clusters came first."""
    number = np.searchsorted(nodes["onset"], stamps, side="right") - 1
    names = nodes["cluster"][np.maximum(number, 0)]
    return {str(name): poses[names == name] for name in dict.fromkeys(nodes["cluster"].tolist())}


class Watcher(Heard):
    """A person who tells it to walk to one place, from there to run to another, and to jump there."""

    def __init__(self) -> None:
        super().__init__({}, most=1500)
        self.tells = [((0.0, 0.0), "walk 0 5"), ((0.0, 5.0), "run 5 12"), ((5.0, 12.0), "jump")]
        self.told_at: list[int] = []

    def listen(self, timeout_s: float) -> str | None:
        if not self.tells or not self.poses:
            return None
        place, word = self.tells[0]
        if np.hypot(self.poses[-1][0] - place[0], self.poses[-1][2] - place[1]) > 0.5:
            return None
        del self.tells[0]
        self.told_at.append(len(self.poses))
        return word


def test_it_goes_where_it_is_told_as_it_is_told(trained: MotionGraph) -> None:
    """By words typed while it moves."""
    feed = Watcher()
    Synthesis(model=Path("graph.npz"), then="wander").read(feed)  # type: ignore[arg-type]
    poses, nodes = np.array(feed.poses), np.array(feed.nodes, NODE)
    assert not feed.reports and len(feed.told_at) == 3, "each was done, so that the next could start"
    walks, runs, jumps = feed.told_at
    stamps = 1000 * NS + np.round(np.arange(len(poses)) * NS / RATE).astype(np.int64)
    names = nodes["cluster"][np.searchsorted(nodes["onset"], stamps, side="right") - 1]
    for a, b, name, slowest, fastest in ((walks, runs, "walk", 0.9, 1.5), (runs, jumps, "run", 2.3, 4.0)):
        begun = a + int(np.argmax(names[a:b] == name))
        which = names[begun:b] == name
        assert begun - a < 3 * RATE and which.mean() > 0.7, f"it goes there in a {name}, but for the way into it"
        assert slowest < pace(poses[begun:b][which]) < fastest
    assert not leaps(trained, poses[:jumps])
    first = jumps + int(np.argmax(names[jumps:] == "jump"))
    assert names[first] == "jump" and first - jumps < 3 * RATE, "within three seconds"
    assert leaps(trained, poses[first : first + 150])
    assert np.hypot(poses[first, 0] - 5.0, poses[first, 2] - 12.0) < 4.0, "where its run ends"
