"""Where the avatar stands: the floor under its feet, its face to the front, from a second in which the person stood still."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.pose.limb_kernel import FOOT, HIPS, NECK, SIDE, THIGH
from kinegraph.operators.pose.motion_kernel import limit_turns, same_signs
from kinegraph.operators.pose.operator import NOTES
from kinegraph.operators.pose.rotation_kernel import from_axes, normalise
from kinegraph.stream.chunk import NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.domain.humanoid import BONES, NUMBERS
from kinegraph.stream.domain.skeleton import JointTree, multiply, turn
from kinegraph.stream.errors import InputError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

PROMPT = np.dtype([("onset", "<i8"), ("state", "<U10"), ("text", "<U80")])
"""What the person is asked to do, since `onset`: `state` is waiting, stand, follows, lost, upper, lying or gone."""
TEXTS = {
    "waiting": "step into view of the camera",
    "stand": "stand still for a second, facing the camera",
    "follows": "calibrated; the avatar follows you",
    "lost": "the avatar follows with usual bone lengths; it was not calibrated",
    "upper": "the upper body is followed; for the legs too, step back to 2 m or more",
    "lying": "lying or bent down: arms and legs are unsure until the trunk is upright",
    "gone": "nobody is seen: the avatar keeps its pose",
}
STATES = ("waiting", "stand", "follows", "lost", "gone", "upper", "lying")
WAITING, STAND, FOLLOWS, LOST, GONE, UPPER, LYING = range(7)
FOR_S = 1.0
"""Legs are given up, and a trunk is taken as lying, after this long; they come back at once."""
LEANS = 0.5
"""A trunk lies that rises by less than this share of its length: beyond 60 degrees."""
FOLLOWED, SEATED, AT_REST = range(3)
"""What legs do."""
LEG_BONES = [
    BONES.index(f"{side}{bone}") for side in ("Left", "Right") for bone in ("UpperLeg", "LowerLeg", "Foot", "Toes")
]
OTHERS = [b for b, bone in enumerate(BONES) if b not in LEG_BONES and bone != "Hips"]


class FootingNumbers:
    """
    asked    which of the states is on; -1: not yet
    since    since when (s) a person is in view without a calibration, or 0
    placed   whether it is known where the avatar stands; then the `floor`'s height, and the `scale` of the skeleton's legs by the person's
    last     the newest stamp in s
    legless  since when the legs are not seen, and `lies`, since when the trunk lies (s; 0: not now)
    """

    asked: int
    since: float
    placed: bool
    floor: float
    scale: float
    last: float
    legless: float
    lies: float


NUMBERS_OF_FOOTING = numbers_of(FootingNumbers)


@record
@dataclass(slots=True)
class FootingState(FootingNumbers):
    """
    numbers (1,)  see above        origin (3,), about (4,)  where the person stood, and the turn that makes them face the front
    turns, before (22, 4)  rotations in the world now and of the newest sample; local, was (22, 4)  those relative to parents
    joints, quality, newest  the newest of these inputs, and the newest pose that was given out
    """

    numbers: Array
    origin: Samples
    about: Samples
    turns: Samples
    before: Samples
    local: Samples
    was: Samples
    joints: Samples
    quality: Samples
    newest: Samples


@kernel
def stand_here(s: FootingState, pose: Samples, offsets: Samples, sole: float, work: Samples) -> None:
    """From a pose of someone who stands: where that is, how to turn to the front, where the floor is, and how long the legs are.

    `offsets` (22, 3) are those of the skeleton in the spec, with ankles `sole` above the floor at rest. `work` (3, 4).
    """
    joints, about = s.joints, s.about
    work[0, 0], work[0, 1], work[0, 2] = 1.0, 0.0, 0.0
    turn(pose[3:7], work[0, :3], work[1, :3])
    work[1, 1] = 0.0
    work[0, 0], work[0, 1] = 0.0, 1.0
    from_axes(work[1, :3], work[0, :3], about)
    for a in range(1, 4):
        about[a] = -about[a]
    legs, own, floor = 0.0, 0.0, math.inf
    for side in range(2):
        for bone in (THIGH + 1 + SIDE * side, FOOT + SIDE * side):
            legs += math.sqrt((offsets[bone] ** 2).sum())
            own += math.sqrt(((joints[bone] - joints[bone - 1]) ** 2).sum())
        floor = min(floor, joints[FOOT + SIDE * side, 1])
    s.scale = legs / own if own > 0.1 else 1.0
    s.floor = floor - sole / s.scale
    s.origin[:] = pose[:3]
    s.placed = True


@kernel
def footed(
    s: FootingState, pose: Samples, now: float, legs: int, turn_rad_s: float, offsets: Samples, parents: Times, work: Samples,
    out: Samples,
) -> None:  # fmt: skip
    """One pose (91,) as the avatar takes it, into `out`: at rest until it is known where it stands."""
    turns, before, local, was = s.turns, s.before, s.local, s.was
    dt = min(max(now - s.last, 0.002), 0.1)
    s.last = now
    if s.placed:
        for a in range(3):
            work[0, a] = (pose[a] - s.origin[a]) * s.scale
        turn(s.about, work[0, :3], out[:3])
        out[1] = (pose[1] - s.floor) * s.scale
        for b in range(parents.shape[0]):
            local[b] = pose[3 + 4 * b : 7 + 4 * b]
        multiply(s.about, pose[3:7], local[0])
    else:
        out[:3] = offsets[0]
        local[:], local[:, 0] = 0.0, 1.0
    if legs == AT_REST and s.placed:
        out[1] = offsets[0, 1]
    if legs != FOLLOWED:
        half = math.sqrt(0.5)
        for side in range(2):
            thigh = THIGH + SIDE * side
            local[thigh : thigh + 4], local[thigh : thigh + 4, 0] = 0.0, 1.0
            if legs == AT_REST:
                continue
            local[thigh, 0], local[thigh, 1] = half, -half
            local[thigh + 1, 0], local[thigh + 1, 1] = half, half
    for b in range(parents.shape[0]):
        normalise(local[b])
        if parents[b] < 0:
            turns[b] = local[b]
        else:
            multiply(turns[parents[b]], local[b], turns[b])
    limit_turns(before, was, parents, turn_rad_s * dt, turns, local, work)
    same_signs(was, local)
    before[:], was[:] = turns, local
    for b in range(parents.shape[0]):
        out[3 + 4 * b : 7 + 4 * b] = local[b]


class _Standing(Operator[FootingState]):
    """What stays as it is while samples come: the skeleton."""

    __slots__ = ("tree",)
    tree: JointTree


@dataclass(frozen=True, slots=True)
class Footing(_Standing):
    """What operators.pose.WholePose gives in; out comes the same pose on the avatar's own floor, facing its front.

    out     the pose: where the person stood while being calibrated is the middle, the floor under the feet at height 0, the front +z; the
            root moves in the skeleton's size, not the person's, so that feet stay on the floor
    prompt  an event whenever something else is asked of the person: to step into view, to stand still; and what became of it

    While only the upper body is seen, for a second or longer, as 1.3 m before a camera, the legs are at rest and the prompt asks
    to step back; it reports a trunk that lies, too.

    Until the calibration is done, or somebody has been seen for `uncalibrated_s` without one, the avatar stands at rest. With `seated` the
    legs are those of someone on a chair, whatever is seen of them. A pose that is not finite is the one before
    it. No bone turns faster than `turn_rad_s`, from the rest to the pose too.

    >>> given, made = tried(Footing)
    >>> given["pose"][-1, :3].round(2), made["out"][-1, :3].round(2)
    (array([-0.25,  0.88, -0.11]), array([-0.11,  0.88,  0.01]))
    """

    inputs = {"pose": Input(trigger=True), "joints": Input(), "quality": Input()}
    outputs: ClassVar[tuple[str, ...]] = ("out", "prompt")

    uncalibrated_s: float = param(
        3.0, above=0.0, help="so long after being seen first the avatar follows without a calibration"
    )
    seated: bool = param(False, help="the person sits: the legs are ignored")
    turn_rad_s: float = param(20.0, above=0.0, help="no bone turns faster")

    def open(self, specs: Specs) -> Specs:
        tree = JointTree.of(specs["pose"], "pose")
        wanted = (len(BONES) + len(NOTES),)
        if tree.joints != BONES:
            raise InputError("pose", specs["pose"].describe(), "the pose that operators.pose gives")
        if specs["joints"].shape != (len(BONES), 3) or specs["quality"].shape != wanted:
            raise InputError("joints", specs["joints"].describe(), "joints and quality of the node that gives the pose")
        still = np.tile([1.0, 0.0, 0.0, 0.0], (len(BONES), 1))
        numbers = np.zeros(1, NUMBERS_OF_FOOTING)
        numbers["asked"], numbers["scale"] = -1, 1.0
        self.set_state(
            FootingState(
                numbers, np.zeros(3), still[0].copy(), still.copy(), still.copy(), still.copy(), still.copy(),
                tree.at_rest.copy(), np.ones(wanted[0]), np.concatenate([tree.offsets[0], still.ravel()]),
            ),
            decision_s={"prompt": 0.0},
        )  # fmt: skip
        object.__setattr__(self, "tree", tree)
        return {"out": specs["pose"], "prompt": StreamSpec((), PROMPT, units=("ns", "", ""), meta={})}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        if port != "pose":
            if len(chunk):
                kept = s.joints if port == "joints" else s.quality
                for row in chunk.data:
                    np.copyto(kept, row, where=np.isfinite(row))
            return []
        out, prompts = np.empty(chunk.data.shape), list[Array]()
        for i, time in enumerate(chunk.time.tolist()):
            pose = np.asarray(chunk.data[i], np.float64)
            if not np.isfinite(pose).all():
                out[i] = s.newest
                continue
            prompts += self._ask(time, pose)
            footed(
                s,
                pose,
                time / NS,
                self._legs(time),
                self.turn_rad_s,
                self.tree.offsets,
                NUMBERS,
                np.zeros((8, 4)),
                out[i],
            )
            s.newest[:] = out[i]
        events = np.array(prompts, PROMPT)
        return [
            ("out", Chunk(chunk.time, out, chunk.until, chunk.lost)),
            ("prompt", Chunk(events["onset"].copy(), events, chunk.until, 0)),
        ]

    def _legs(self, time: int) -> int:
        """What the avatar's legs do."""
        since = self.state.legless
        return SEATED if self.seated else AT_REST if since and time / NS - since >= FOR_S else FOLLOWED

    def _notice(self, time: int, *, seen: bool) -> None:
        """Since when only the upper body is seen, and since when the trunk lies."""
        s = self.state
        way = s.joints[NECK] - s.joints[HIPS]
        lies = not s.quality[[HIPS, NECK]].any() and way[1] < LEANS * float(np.linalg.norm(way))
        upper = bool(s.quality[LEG_BONES].all()) and not s.quality[OTHERS].all()
        s.legless = (s.legless or time / NS) if upper and seen else 0.0
        s.lies = (s.lies or time / NS) if lies and seen else 0.0

    def _ask(self, time: int, pose: Samples) -> list[Array]:
        """What is asked of the person from this sample on, if that is something else than before; notes where the person stands."""
        s, bones = self.state, len(BONES)
        seen, calibrated = not s.quality[:bones].all(), s.quality[bones + 2] > 0.0
        if seen and not s.since:
            s.since = time / NS
        if not s.placed and seen and (calibrated or time / NS - s.since >= self.uncalibrated_s):
            sole = float(self.tree.at_rest[FOOT, 1])
            stand_here(s, pose, self.tree.offsets, sole, np.zeros((3, 4)))
        there, absent = (FOLLOWS if calibrated else LOST, GONE) if s.placed else (STAND, WAITING)
        self._notice(time, seen=seen)
        if s.placed and s.legless and not self.seated and time / NS - s.legless >= FOR_S:
            there = UPPER
        elif s.placed and s.lies and time / NS - s.lies >= FOR_S:
            there = LYING
        state = there if seen else absent
        if state == s.asked:
            return []
        s.asked = state
        return [np.array((time, STATES[state], TEXTS[STATES[state]]), PROMPT)]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        from kinegraph.stream.domain.humanoid import usual_body

        n, tree, random = 90, usual_body(), np.random.default_rng(7)
        poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (n, 1))
        poses[:, :3] += 0.01 * random.normal(size=(n, 3)).cumsum(axis=0)
        poses[30:, 3:] += 0.05 * random.normal(size=(n - 30, 4 * len(BONES))).cumsum(axis=0)
        turns = poses[:, 3:].reshape(n, -1, 4)
        turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
        joints = np.repeat(tree.at_rest[None], n, 0)
        quality = np.zeros((n, len(BONES) + len(NOTES)))
        quality[:10, : len(BONES)] = quality[60:70, : len(BONES)] = 1.0
        quality[35:, len(BONES) + 2] = 1.0
        times = grid(30.0, n)
        given = {
            "pose": (tree.spec(30.0), times, poses),
            "joints": (StreamSpec((len(BONES), 3), rate_hz=30.0, channels=BONES, units=("m",)), times, joints),
            "quality": (StreamSpec((quality.shape[1],), rate_hz=30.0), times, quality),
        }
        return [Case(cls(), given, least=n), Case(cls(seated=True, uncalibrated_s=0.1, turn_rad_s=5.0), given, least=n)]
