"""Motion matching: recorded motion played frame by frame, with transitions to the frames that lead where one wants to go (Clavet 2016)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from kinegraph.operators.neighbours.index import Index
from kinegraph.operators.synthesis.blend_kernel import placed
from kinegraph.operators.synthesis.matching_kernel import (
    FEATURES,
    MIN_FRAMES,
    TRACK,
    add_offset,
    begin_offset,
    describe,
    describe_all,
    heading_of,
    room_for_offset,
    track_all,
    unlike,
    wish,
)
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.domain.humanoid import BONES
from kinegraph.stream.domain.motion_graph import MotionGraph
from kinegraph.stream.domain.skeleton import JointTree, joints_of

ANKLES = np.array([BONES.index("LeftFoot"), BONES.index("RightFoot")])
EVERY_S = 0.25
"""A transition is looked for this often."""
HALF_LIFE_S = 0.1
"""The offset of a transition takes so long to halve."""
PLAYED_S = 0.3
"""A frame is entered only if its take lasts this much longer."""
MOVES_M_S = 0.5
"""Who is slower does not walk."""
OTHER_GAIT = 3.0
"""What a frame of another gait than is wanted costs, as distance of features: more than a turn on the spot, less than walking away."""

OPEN = 1 << 60
"""The last frame of a take that is not over yet."""

Nearest: TypeAlias = Callable[[Samples], int]
"""The frame with the features that are nearest to these; -1: there is no frame."""


@dataclass(slots=True)
class PlayedMotion:
    """
    The newest frames of humanoid poses, in a ring of n; frames are numbered from 0 on.

    poses (n, w), tracks (n, TRACK), last (n,)   each frame, what is matched of it, and the last frame of its take, or OPEN
    count                                        how many frames there were
    """

    poses: Samples
    tracks: Samples
    last: Times
    count: int = 0

    @staticmethod
    def empty(frames: int, width: int) -> PlayedMotion:
        return PlayedMotion(np.zeros((frames, width)), np.zeros((frames, TRACK)), np.full(frames, -1))

    @staticmethod
    def of(tree: JointTree, poses: Samples, take: Array) -> PlayedMotion:
        """Whole recordings; frames of one number in `take` (n,) follow one another."""
        made = PlayedMotion.empty(len(poses), tree.width)
        made.poses[:], made.count = poses, len(poses)
        track_all(made.poses, joints_of(tree, made.poses)[1], ANKLES, made.tracks)
        ends = np.append(np.flatnonzero(np.diff(take)), len(take) - 1)
        made.last[:] = ends[np.searchsorted(ends, np.arange(len(take)))]
        return made

    def add(self, pose: Samples, joints: Samples) -> None:
        """The next frame of the take that is open, with its joints (j, 3)."""
        at = self.count % len(self.poses)
        self.poses[at], self.last[at] = pose, OPEN
        track_all(pose[None], joints[None], ANKLES, self.tracks[at : at + 1])
        self.count += 1

    def end_take(self) -> None:
        """The next frame does not follow the last one."""
        self.last[self.last == OPEN] = self.count - 1

    def features(self, first: int, end: int, rate_hz: float) -> Samples:
        """(end - first, FEATURES); NaN for frames that cannot be entered: too near to the start or the end of a take."""
        out = np.empty((end - first, FEATURES))
        describe_all(self.tracks, self.last, first, rate_hz, PLAYED_S, out)
        return out

    def walking_speed(self, rate_hz: float, frames: Array | None = None) -> float:
        """m/s: the median over the frames (or `frames` (n,) of them) that move at all; `MOVES_M_S` if there are no such frames."""
        second = round(rate_hz)
        first = np.arange(max(0, min(self.count, len(self.poses)) - second))
        first = first[self.last[first] == self.last[first + second]]
        first = first if frames is None else first[frames[first]]
        speed = np.linalg.norm((self.tracks[first + second] - self.tracks[first])[:, [0, 2]], axis=1)
        return float(np.median(speed[speed > MOVES_M_S])) if (speed > MOVES_M_S).any() else MOVES_M_S


@dataclass(slots=True)
class Played:
    """
    Where motion is played from, and how it is placed on the floor.

    place (3,)            turn and shift (x, z) of what is played
    off, change (1 + j, 3)  the offset of the last transition, which decays, and how it changes a frame
    shown (2, w)          the last two poses that were shown
    frame, since          the frame that was shown last, -1: not yet; how many frames ago the last search was
    """

    place: Samples
    off: Samples
    change: Samples
    shown: Samples
    new: Samples
    room: Samples
    features: Samples
    frame: int = -1
    since: int = 0

    @staticmethod
    def empty(joints: int) -> Played:
        width = 3 + 4 * joints
        off, change, room = room_for_offset(joints)
        two = np.zeros((2, width))
        return Played(np.zeros(3), off, change, two, two.copy(), room, np.zeros((3, FEATURES)))

    def enter(self, motion: PlayedMotion, frame: int) -> None:
        """Continue after `frame`, which takes the place of the pose that was shown last, from now on."""
        n = len(motion.poses)
        here, shown = motion.poses[frame % n], self.shown[1]
        turn = heading_of(shown) - heading_of(here)
        cos, sin = np.cos(turn), np.sin(turn)
        self.place[:] = turn, shown[0] - (here[0] * cos + here[2] * sin), shown[2] - (here[2] * cos - here[0] * sin)
        before = frame - 1 if motion.last[(frame - 1) % n] == motion.last[frame % n] else frame
        placed(motion.poses[before % n], self.place, self.new[0])
        placed(here, self.place, self.new[1])
        begin_offset(self.shown, self.new, self.off, self.change, self.room)
        self.frame = frame

    def show(self, pose: Samples) -> None:
        """Note a pose as shown."""
        self.shown[0], self.shown[1] = self.shown[1], pose

    def step(self, motion: PlayedMotion, rate_hz: float, ahead: Ahead, nearest: Nearest, out: Samples) -> bool:
        """The next pose into `out` (w,), not yet noted as shown; whether it is that of a transition.

        `nearest` is asked every `EVERY_S`, and at the end of a take.
        """
        n = len(motion.poses)
        last = int(motion.last[self.frame % n])
        ends, jumps = self.frame >= last, False
        self.since += 1
        if ends or self.since >= EVERY_S * rate_hz:
            current, wanted, found = self.features
            describe(motion.tracks, self.frame, last, rate_hz, current)
            wanted[:] = current
            wish(ahead.path, ahead.length, ahead.along, ahead.speed_m_s, self.shown[1], wanted)
            other = nearest(wanted)
            if other >= 0 and abs(other - self.frame) >= MIN_FRAMES:
                describe(motion.tracks, other, int(motion.last[other % n]), rate_hz, found)
                jumps = ends or unlike(found, wanted) < unlike(current, wanted)
            if jumps:
                self.enter(motion, other)
            self.since = 0
        self.frame += jumps or not ends
        placed(motion.poses[self.frame % n], self.place, out)
        add_offset(out, self.off, self.change, HALF_LIFE_S * rate_hz, self.room)
        return jumps


@dataclass(frozen=True, slots=True)
class Ahead:
    """A way on the floor (p, 2), how far along it each point is (p,), how far along one is, and how fast one goes."""

    path: Samples
    length: Samples
    along: float
    speed_m_s: float


class Matching:
    """The frames of a motion graph in a neighbour index. `gait`: the number of a cluster that is preferred, -1: none is.

    node (n,)      the node that each frame is of, -1: of no node
    joins (n,)     whether a walk on the graph may continue at a frame: in the core, with time for a way on
    """

    def __init__(self, graph: MotionGraph, gait: int = -1) -> None:
        self.motion = PlayedMotion.of(graph.tree, graph.poses, graph.take)
        self.rate_hz = graph.rate_hz
        n = len(graph.poses)
        self.node, self.joins = np.full(n, -1), np.zeros(n, np.bool_)
        leaves = np.full(len(graph.first), -1)
        inner = graph.core[graph.source] & graph.core[graph.target]
        np.maximum.at(leaves, graph.source[inner], graph.leave[inner])
        for k, (first, last) in enumerate(zip(graph.first.tolist(), graph.last.tolist(), strict=True)):
            self.node[first:last] = k
            self.joins[first : min(last, int(leaves[k])) - graph.blend - MIN_FRAMES] = graph.core[k]
        mine = np.ones(n, np.bool_) if gait < 0 else np.isin(self.node, np.flatnonzero(graph.cluster == gait))
        self.speed_m_s = self.motion.walking_speed(graph.rate_hz, mine)
        self.features = np.column_stack([self.motion.features(0, n, graph.rate_hz), np.where(mine, 0.0, OTHER_GAIT)])
        self._index = Index(FEATURES + 1, n, most=1)
        self._index.follow(self.features, 0)
        self._asked = np.zeros(FEATURES + 1)

    def nearest(self, features: Samples) -> int:
        self._asked[:FEATURES] = features
        found, _ = self._index.nearest(1, self._asked, band=-1)
        return int(found[0]) if len(found) else -1

    def rejoined(self, frame: int) -> int:
        """The frame at which the graph is walked on: this one, or the one most like it where that is possible."""
        if self.joins[frame]:
            return frame
        describe(self.motion.tracks, frame, int(self.motion.last[frame]), self.rate_hz, self._asked[:FEATURES])
        can = np.flatnonzero(self.joins & np.isfinite(self.features[:, 0]))
        if not len(can):
            can = np.flatnonzero(self.joins)
            return int(can[0])
        return int(can[((self.features[can, :FEATURES] - self._asked[:FEATURES]) ** 2).sum(axis=1).argmin()])
