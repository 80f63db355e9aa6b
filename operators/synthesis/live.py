"""A walk in motion that is recorded while it goes on: a motion graph grown live, walked live (thesis, chapter 10; Clavet 2016)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.neighbours.index import Index
from kinegraph.operators.neighbours.layout import IndexState, allocate
from kinegraph.operators.synthesis.blend_kernel import hold_feet, room_for
from kinegraph.operators.synthesis.goals import ARRIVED_M
from kinegraph.operators.synthesis.matching import PLAYED_S, Ahead, Played, PlayedMotion
from kinegraph.operators.synthesis.matching_kernel import FEATURES, nearest_ahead
from kinegraph.operators.synthesis.walker import LEGS
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.require import regular, samples_in
from kinegraph.stream.domain.humanoid import BONES, usual_body
from kinegraph.stream.domain.skeleton import JointTree, place_joints
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Emitted, Input, Operator, grid
from kinegraph.stream.params import param

TRANSITION = np.dtype([("onset", "<i8"), ("plays", "<i8"), ("ago_s", "<f8"), ("x_m", "<f8"), ("z_m", "<f8")])
ASKED = 8
"""Of this many nearest frames the first that is still kept is taken."""
STILL_M_S, LOW_M = 0.35, 0.07
"""A foot stands while its toes are slower than this, and no more than this above the lowest that they were."""
TOES = (BONES.index("LeftToes"), BONES.index("RightToes"))


@dataclass(slots=True)
class LiveWalkState:
    """
    motion, stamps (n,), stands (n, 2)   the newest frames, when they were, and which feet stood
    index, frames (n,)    those that can be entered; the frame of each by its number modulo n
    upto                  without stretches: frames before this one are in the index
    played, along         what is played, and how far along the path that is
    lowest (2,)           of the toes, m
    stood, spot, moved, lowered, turns, joints, room   of feet that are held (blend_kernel)
    toes (2, 3)           of the frame before
    newest                stamp of the newest frame
    """

    motion: PlayedMotion
    stamps: Times
    stands: Array
    index: IndexState
    frames: Times
    upto: int
    played: Played
    along: float
    lowest: Samples
    stood: Array
    spot: Samples
    moved: Samples
    lowered: Samples
    turns: Samples
    joints: Samples
    room: Samples
    toes: Samples
    newest: int


class _Walking(Operator[LiveWalkState]):
    """What does not change while samples come."""

    __slots__ = ("way",)
    way: tuple[JointTree, float, Samples, Samples, bool]


@dataclass(frozen=True, slots=True)
class LiveWalk(_Walking):
    """Poses of somebody who moves in; out comes a walk along a path: any frame may follow any other one that is like it.

    pose        (in) a humanoid pose; kept for `memory_s`   (out) the walk, a pose for each that comes in; until there is a frame to
                enter, the pose that came in; where a take has ended and no frame is left to enter, the pose is held
    node        events with onset and end (operators.maps.motion_graph.growing.GrowingGraph): only frames of these stretches are entered;
                left out: every frame, a second after it came
    transition  an event for each: which frame was entered, how old it was, and where

    Every quarter second the frame is looked for, exactly, by the neighbour index, that is most like the one that is shown (ankles, their
    velocities, the root's velocity) and with the next second most like the path (place and facing after 1/3, 2/3 and 1 s). What differs
    decays like a critically damped spring (inertialisation); a foot that stands stays. The path is closed, and walked again and again at
    `speed_m_s`. Of motion on the spot the walk stays on the spot.

    Source: thesis, chapter 10; Clavet 2016; Holden et al. 2020.

    >>> given, made = tried(LiveWalk)
    >>> len(given["pose"]), len(made["pose"]), len(made["transition"])
    (500, 500, 3)
    """

    inputs = {"node": Input(optional=True), "pose": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("pose", "transition")
    exemptions: ClassVar[dict[str, str]] = {
        "channels": "a pose is a whole: one with a bad number is left out",
        "nan": "the walk continues while a person is hidden",
    }

    path: tuple[tuple[float, float], ...] = param(
        ((0.0, 0.0), (0.0, 4.0), (4.0, 4.0), (4.0, 0.0)),
        help="corners x, z (m) of the way that is walked round and round",
    )
    speed_m_s: float = param(
        1.0, above=0.0, most=5.0, help="how fast the path is walked, where the motion is that fast"
    )
    memory_s: float = param(300.0, above=5.0, most=3600.0, help="how long motion is kept")

    def open(self, specs: Specs) -> Specs:
        spec = specs["pose"]
        tree = JointTree.of(spec, "pose")
        if tree.joints != BONES:
            raise InputError("pose", spec.describe(), "poses of the humanoid skeleton")
        if "node" in specs and not set(specs["node"].dtype.names or ()) >= {"onset", "end"}:
            raise InputError("node", specs["node"].describe(), "events with the fields onset and end")
        path = np.array([*self.path, *self.path[:1]], np.float64).reshape(-1, 2)
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        if length[-1] < 4 * ARRIVED_M:
            raise ParameterError("path", [list(p) for p in self.path], f"a way of {4 * ARRIVED_M:g} m or more")
        rate_hz = regular(spec)
        keep, joints = samples_in("memory_s", self.memory_s, rate_hz), len(BONES)
        turns, places, room = room_for(joints)
        self.set_state(
            LiveWalkState(
                PlayedMotion.empty(keep, tree.width), np.full(keep, NEVER), np.zeros((keep, 2), np.bool_), allocate(FEATURES, keep, ASKED),
                np.full(keep, -1), 2, Played.empty(joints), 0.0, np.full(2, np.inf), np.zeros(2, np.bool_), np.zeros((2, 3)),
                np.zeros((2, 3)), np.zeros(1), turns, places, room, np.zeros((2, 3)), NEVER,
            )
        )  # fmt: skip
        object.__setattr__(self, "way", (tree, rate_hz, path, length, "node" in specs))
        events = StreamSpec((), TRANSITION, units=("ns", "ns", "s", "m", "m"), meta={"synthesised": True})
        settling_s = max(one.settling_s for one in specs.values())
        return {"pose": tree.spec(rate_hz, meta={"synthesised": True}, settling_s=settling_s), "transition": events}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        if port == "node":
            for event in chunk.data:
                self._join(int(event["onset"]), int(event["end"]))
            return None
        out, jumps = np.empty((len(chunk), chunk.data.shape[1])), list[tuple[int, tuple[float, ...]]]()
        for row, stamp, made in zip(np.asarray(chunk.data, np.float64), chunk.time.tolist(), out, strict=True):
            self._take(row, stamp)
            if self._walk(row, made):
                s = self.state
                plays = int(s.stamps[s.played.frame % len(s.stamps)])
                jumps.append((stamp, (stamp, plays, (stamp - plays) / NS, made[0], made[2])))
        rows = np.array([row for _, row in jumps], TRANSITION)
        at = np.array([stamp for stamp, _ in jumps], np.int64)
        return [
            ("pose", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("transition", Chunk(at, rows, chunk.until, -1 if chunk.lost else 0)),
        ]

    def _take(self, pose: Samples, stamp: int) -> None:
        """Keep a pose that came in; one with a number that is not finite ends the take."""
        s, (tree, rate_hz, _, _, by_stretches) = self.state, self.way
        motion = s.motion
        if not np.isfinite(pose).all():
            motion.end_take()
            s.newest = NEVER
            return
        place_joints(pose, tree.parents, tree.offsets, s.turns, s.joints)
        toes = s.joints[TOES, :]
        follows = s.newest != NEVER and stamp - s.newest < 1.5 * NS / rate_hz
        if not follows:
            motion.end_take()
        at = motion.count % len(s.stamps)
        speed = np.linalg.norm(toes - s.toes, axis=1) * rate_hz if follows else np.full(2, np.inf)
        s.lowest[:] = np.minimum(s.lowest, toes[:, 1])
        s.stamps[at], s.stands[at] = stamp, (speed < STILL_M_S) & (toes[:, 1] < s.lowest + LOW_M)
        motion.add(pose, s.joints)
        s.toes[:], s.newest = toes, stamp
        if not by_stretches and motion.count - round(rate_hz) > s.upto:
            self._enter_frames(s.upto, motion.count - round(rate_hz))
            s.upto = motion.count - round(rate_hz)

    def _join(self, onset: int, end: int) -> None:
        """The frames of a stretch can be entered from now on, but for those of the last second."""
        s = self.state
        oldest = max(2, s.motion.count - len(s.stamps) + 2)
        known = s.stamps[np.arange(oldest, s.motion.count) % len(s.stamps)]
        first, last = (oldest + int(k) for k in np.searchsorted(known, [onset, end + 1]))
        self._enter_frames(first, min(last, s.motion.count - round(self.way[1])))

    def _enter_frames(self, first: int, end: int) -> None:
        s = self.state
        if end <= first:
            return
        index = Index.of(s.index)
        s.frames[(index.newest + 1 + np.arange(end - first)) % len(s.frames)] = np.arange(first, end)
        index.follow(s.motion.features(first, end, self.way[1]), 0)

    @property
    def _oldest(self) -> int:
        """Frames from this one on are kept for long enough yet to be entered."""
        return self.state.motion.count - len(self.state.stamps) + round((1.0 + PLAYED_S) * self.way[1])

    def _nearest(self, features: Samples) -> int:
        """The nearest frame that is kept for long enough yet; the newest one where those that are nearest have left."""
        s = self.state
        for number in Index.of(s.index).nearest(ASKED, features, band=-1)[0].tolist():
            if s.frames[number % len(s.frames)] >= self._oldest:
                return int(s.frames[number % len(s.frames)])
        return self._newest()

    def _newest(self) -> int:
        """The newest frame that can be entered; -1: there is no such frame."""
        s, index = self.state, Index.of(self.state.index)
        frames = s.frames[np.arange(index.first, index.newest + 1) % len(s.frames)]
        frames = frames[frames >= self._oldest]
        last = s.motion.last[frames % len(s.stamps)]
        follows = s.motion.last[(frames - 2) % len(s.stamps)] == last
        return int(frames[follows & (last - frames >= PLAYED_S * self.way[1])].max(initial=-1))

    def _walk(self, came: Samples, out: Samples) -> bool:
        """The next pose of the walk; whether a transition begins with it."""
        s, (tree, rate_hz, path, length, _) = self.state, self.way
        out[:] = came
        waits, left = s.played.frame < 0, s.played.frame <= s.motion.count - len(s.stamps)
        if waits or left:  # left: the frame that is held, because no frame could follow it, is overwritten
            if not waits:
                out[:] = s.played.shown[1]
            s.played.show(out)
            newest = self._newest()
            if newest < 0 or not np.isfinite(s.played.shown).all():
                return False
            s.played.enter(s.motion, newest)
            return True
        jumps = s.played.step(s.motion, rate_hz, Ahead(path, length, s.along, self.speed_m_s), self._nearest, out)
        hold_feet(
            out, s.stands[s.played.frame % len(s.stamps)], tree.parents, tree.offsets, LEGS, s.stood, s.spot, s.moved, s.lowered, s.turns,
            s.joints, s.room,
        )  # fmt: skip
        s.played.show(out)
        s.along = nearest_ahead(path, length, s.along, 1.0, out[0], out[2])[0]
        if length[-1] - s.along < ARRIVED_M:
            s.along = 0.0
        return jumps

    @classmethod
    def cases(cls) -> Sequence[Case]:
        tree = usual_body()
        turn = 2.0 * np.pi * np.arange(500) / 32
        poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (500, 1))
        poses[:, 1], poses[:, 2] = 0.95 + 0.02 * np.cos(2.0 * turn), np.arange(500) / 30.0
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            at = 3 + 4 * BONES.index(f"{side}UpperLeg")
            poses[:, at], poses[:, at + 1] = np.cos(0.2 * np.sin(turn)), sign * np.sin(0.2 * np.sin(turn))
        time = grid(30.0, 500)
        ends = time[120:480:40]
        rows = np.zeros(len(ends), [("onset", "<i8"), ("end", "<i8")])
        rows["onset"], rows["end"] = ends - 2 * NS, ends - NS
        events = StreamSpec((), rows.dtype, units=("ns", "ns"))
        inputs = {"pose": (tree.spec(30.0), time, poses)}
        return [
            Case(cls(memory_s=8.0), {**inputs, "node": (events, ends, rows)}, least=300),
            Case(cls(path=((0.0, 0.0), (0.0, 9.0)), memory_s=6.0), inputs, least=300),
        ]
