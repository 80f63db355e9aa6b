"""From markers on a body to the pose of its whole skeleton."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import ClassVar, Literal

import numpy as np

from kinegraph.operators.inputs.directions import HELP, axes_of
from kinegraph.operators.inputs.lengths import length_of, metres
from kinegraph.operators.pose.landmarks import BONE_OF, FROM_BONE, NAMES, PLACES, find_landmarks
from kinegraph.operators.pose.regions_kernel import REGIONS, Corrections, shown_by_region
from kinegraph.operators.pose.solve_kernel import GROUND, SIZE, Solver, solve
from kinegraph.operators.pose.upright import LEAST_S, MOST_S, RATE, SEEN, TOLD, tally_up, warn
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.model_file import Model, ModelError, read_model
from kinegraph.stream.domain.axes import BODY, in_axes
from kinegraph.stream.domain.humanoid import BONES, PARENTS, usual_body
from kinegraph.stream.domain.skeleton import JointTree, joints_of
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

MODELS = {"people": Path(__file__).with_name("people.npz")}
"""The models that come with kinegraph, by the word that stands for each in `model`; `python -m bench.pose_model` makes them."""
NOTES = ("left foot stands", "right foot stands", "calibrated", "outside")


@dataclass(slots=True)
class WholePoseState:
    """What is remembered from one sample to the next; see `Solver`, and for `tally` (15,) operators/pose/upright.py.

    sure  (points,)  how sure each point was at the stamp `at` (1,), up to 1
    """

    seen: Array
    trusts: Samples
    doubts: Samples
    marks: Samples
    before: Samples
    total: Samples
    offsets: Samples
    turns: Samples
    turns_before: Samples
    local: Samples
    local_before: Samples
    joints: Samples
    left: Samples
    memory: Samples
    feet: Samples
    followed: Samples
    speeds: Samples
    bends: Samples
    head: Samples
    eases: Samples
    flags: Samples
    unsure: Samples
    tally: Samples
    sure: Samples
    at: Times


@dataclass(frozen=True, slots=True)
class Regression:
    """What a model has learned, and the skeleton that it is for."""

    learned: Corrections
    tree: JointTree


class _Solving(Operator[WholePoseState]):
    """What stays as it is while samples come: the regression, the kernel's arrays, samples of standing that a calibration takes."""

    __slots__ = ("learned", "needed", "solver", "upward")
    learned: Regression
    solver: Solver
    needed: int
    upward: str


@dataclass(frozen=True, slots=True)
class WholePose(_Solving):
    """Markers of a body (points, 3) in; out comes the pose of a humanoid skeleton, at every sample, whatever the markers lack.

    confidence  how sure each of the points is, 0 to 1, at the same stamps: one below `least` is followed the more slowly the less sure it
                is, and its bones are flagged

    pose     root position and a quaternion for each of VRM's bones (stream/domain/skeleton.py, stream/domain/humanoid.py); never NaN
    joints   where the joints are with this body's bone lengths, (22, 3) m, y up
    quality  for each bone 1 while it is guessed, because a marker of its limb is not seen; whether the left and the right foot stand;
             whether the body has been calibrated; how far the sample lies from all poses of the training, in kernel widths

    Any five or more of head, neck, root, nose, ears, and left and right hip, knee, ankle, toe, shoulder, elbow, wrist, hand, under names
    that operators.features.pose knows. Without `model` the pose is that of geometry: trunk and limbs point at their markers, elbows and
    knees turn as they bend. A model (`kinegraph motion train pose`) corrects what markers do not show: how bones are turned about
    themselves, where joints without a marker are. Then limbs of two bones are laid onto their markers.

    Bone lengths are those of the first `calibrate_s` of standing still, left and right the same, and then never change. A marker that is
    not seen, or has leapt for less than three samples, is guessed: it moves with the trunk. A foot that is low and slow stands where it
    is until it is lifted. No bone turns faster than `turn_rad_s`. When nothing is seen the pose stays.

    No delay; with `follow_hz` bones lag by 1 / (pi follow_hz) at rest and where they are guessed, in motion by 10 to 25 ms.

    Two-bone limbs after Tolani 2000; 6-D rotations after Zhou 2019; the regression is relative to the geometric pose.

    >>> given, made = tried(WholePose)
    >>> given["in"][-1, 0].round(2), made["joints"][-1, 0].round(2)
    (array([0.11, 0.95, 0.04]), array([0.  , 0.94, 0.01]))
    """

    inputs = {"confidence": Input(optional=True), "in": Input(finite=True, trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("pose", "joints", "quality")
    model: Path | None = param(
        None,
        help="what `kinegraph motion train pose` has made, or `people`, for a camera's markers; left out: by geometry alone",
    )
    landmarks: Mapping[str, tuple[str, ...]] | None = param(None, help="landmark: [point, ...], where names do not say")
    up: Literal["y", "z", "-y"] | None = param(None, help=f"{HELP} y")
    calibrate_s: float = param(
        1.0, least=0.0, help="standing still for this long gives the bone lengths; 0: as in the model"
    )
    feet: bool = param(True, help="whether a foot that stands is kept where it is")
    turn_rad_s: float = param(20.0, above=0.0, help="no bone turns faster")
    follow_hz: float = param(
        0.0, least=0.0, help="for noisy markers: bones at rest follow with this cut-off, moving ones faster; 0: at once"
    )
    least: float = param(0.5, least=0.0, most=1.0, help="a point with less confidence is doubtful; 0: not given at all")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        unit = length_of(spec)
        found, columns = find_landmarks(spec, self.landmarks or {})
        model = MODELS.get(str(self.model), self.model)
        learned = regression_of(read_model(model, "pose")) if model else no_regression()
        if missing := [NAMES[k] for k in learned.learned.chosen if NAMES[k] not in found]:
            what = f"has no {missing[0]}, which {self.model} was trained for; it has {', '.join(found)}"
            raise ParameterError("model", str(self.model), f"a model for these markers: the input {what}")
        own = axes_of(spec, self.up, "y")
        axes, signs = own.to(BODY)
        size = metres(unit)
        points = spec.shape[0] if len(spec.shape) == 2 else spec.shape[0] // 3
        if (given := specs.get("confidence")) and given.shape != (points,):
            raise InputError("confidence", given.describe(), f"one number for each of the {points} points of `in`")
        state = start(learned.tree, points)
        state.tally[RATE] = spec.rate_hz or 30.0
        object.__setattr__(self, "learned", learned)
        object.__setattr__(self, "upward", own.up)
        object.__setattr__(self, "needed", round(self.calibrate_s * (spec.rate_hz or 30.0)))
        self.set_state(state)
        present = np.array([name in found for name in NAMES])
        self._bind(columns, np.array(axes), size * np.array(signs), present)
        meta = {"landmarks": {name: list(parts) for name, parts in found.items()}}
        settling_s = spec.settling_s + self.calibrate_s
        facts = learned.tree.facts()
        bones = [[parent, bone] for bone, parent in PARENTS.items() if parent]
        return {
            "pose": learned.tree.spec(spec.rate_hz, settling_s=settling_s, meta={**spec.meta, **meta}),
            "joints": StreamSpec(
                (len(BONES), 3), rate_hz=spec.rate_hz, channels=BONES, units=("m",), settling_s=settling_s,
                meta={**in_axes(spec, BODY), "skeleton": facts, "bones": bones},
            ),
            "quality": StreamSpec(
                (len(BONES) + len(NOTES),), rate_hz=spec.rate_hz, settling_s=settling_s,
                channels=(*(f"{bone} guessed" for bone in BONES), *NOTES), meta=spec.meta,
            ),
        }  # fmt: skip

    def _bind(self, columns: Times, axes: Times, signs: Samples, present: Array) -> None:
        """Gather what the kernel works on: the state's arrays, which stay the same ones, and what does not change."""
        r, m = self.learned, len(NAMES)
        state = {
            f.name: getattr(self.state, f.name) for f in fields(WholePoseState) if f.name not in ("tally", "sure", "at")
        }
        solver = Solver(
            columns=columns, axes=axes, signs=signs, present=present, hinted=np.zeros(m, np.bool_), surest=np.ones(m), counts=np.zeros(m),
            from_bone=FROM_BONE, bone_of=BONE_OF,
            usual=r.tree.offsets, parents=r.tree.parents, learned=r.learned, work=np.zeros((9, 4)), **state,
        )  # fmt: skip
        object.__setattr__(self, "solver", solver)

    def process(self, port: str, chunk: Chunk) -> Sequence[tuple[str, Chunk]]:
        state = self.state
        if port == "confidence":
            if len(chunk.time):
                given = chunk.data[-1]
                state.sure[:] = np.where((given > 0.0) & (given < self.least), given / max(self.least, 1e-9), 1.0)
                state.at[0] = chunk.time[-1]
            return []
        n, bones = len(chunk.time), len(BONES)
        sure = np.ones((n, len(state.sure)))
        sure[chunk.time == state.at[0]] = state.sure
        pose, joints, quality = np.empty((n, 3 + 4 * bones)), np.empty((n, bones, 3)), np.empty((n, bones + len(NOTES)))
        if n:
            solve(
                chunk.data, sure, chunk.time, self.solver, self.needed, self.feet, self.turn_rad_s, 2.0 * math.pi * self.follow_hz,
                pose, joints, quality,
            )  # fmt: skip
            self._watch(joints, quality)
        made = zip(self.outputs, (pose, joints, quality), strict=True)
        return [(name, Chunk(chunk.time, data, chunk.until, chunk.lost)) for name, data in made]

    def _watch(self, joints: Samples, quality: Samples) -> None:
        """Whether what points up is what is taken for it, in the first seconds."""
        tally = self.state.tally
        if tally[TOLD] or tally[SEEN] > MOST_S * tally[RATE]:
            return
        tally_up(joints, quality, tally)
        if tally[SEEN] >= LEAST_S * tally[RATE]:
            tally[TOLD] = float(warn(tally, self.solver.axes, self.solver.signs, self.upward))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        tree = usual_body()
        rng = np.random.default_rng(18)
        poses = np.tile(np.concatenate([tree.offsets[0], np.tile([1.0, 0.0, 0.0, 0.0], len(BONES))]), (120, 1))
        poses[40:, 3:] += 0.02 * rng.normal(size=(80, 4 * len(BONES))).cumsum(axis=0)
        quaternions = poses[:, 3:].reshape(120, -1, 4)
        quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
        _, joints = joints_of(tree, poses)
        marks = joints[:, BONE_OF[:13]]
        spec = StreamSpec((13, 3), rate_hz=30.0, channels=NAMES[:13], units=("m",))
        gone = marks.copy()
        gone[60:80, [4, 10]] = np.nan
        sure, trust = StreamSpec((13,), rate_hz=30.0, channels=NAMES[:13]), rng.uniform(0.3, 1.0, (120, 13))
        few = StreamSpec((5, 3), rate_hz=30.0, channels=tuple(NAMES[k] for k in (4, 5, 10, 11, 12)), units=("mm",))
        return [
            Case(cls(), {"in": (spec, grid(30.0, 120), marks)}, least=360),
            Case(cls(turn_rad_s=2.0), {"in": (spec, grid(30.0, 120), gone)}, least=360),
            Case(
                cls(follow_hz=1.3),
                {"confidence": (sure, grid(30.0, 120), trust), "in": (spec, grid(30.0, 120), marks)},
                least=360,
            ),
            Case(
                cls(calibrate_s=0.0, feet=False),
                {"in": (few, grid(30.0, 120), 1e3 * marks[:, [4, 5, 10, 11, 12]])},
                least=360,
            ),
        ]


def no_regression() -> Regression:
    """Geometry alone, on the usual body."""
    nothing, empty, none_of = np.empty((0, 0)), np.empty(0, np.int64), np.empty(0)
    shown = np.empty((0, 3), np.int64)
    return Regression(
        _room(empty, nothing, none_of, shown, nothing, empty, empty, nothing, nothing, none_of), usual_body()
    )


def start(tree: JointTree, points: int) -> WholePoseState:
    """A body at rest of which nothing has been seen; its stream has this number of `points`."""
    bones, m = len(BONES), len(PLACES)
    still = np.tile([1.0, 0.0, 0.0, 0.0], (bones, 1))
    memory = np.zeros(9)
    memory[SIZE], memory[GROUND] = 1.0, np.inf
    return WholePoseState(
        seen=np.zeros(m, np.bool_), trusts=np.ones(m), doubts=np.zeros(m),
        marks=np.zeros((m, 3)), before=np.zeros((m, 3)), total=np.zeros((m, 3)),
        offsets=tree.offsets.copy(), turns=still.copy(), turns_before=still.copy(), local=still.copy(), local_before=still.copy(),
        joints=tree.at_rest.copy(), left=np.array([1.0, 0.0, 0.0]), memory=memory, feet=np.zeros((2, 22)), followed=still.copy(),
        speeds=np.zeros((bones, 3)), bends=np.zeros((4, 4)), head=np.zeros(11), eases=np.zeros((m, 4)), flags=np.ones(bones),
        unsure=np.zeros(bones), tally=np.zeros(15), sure=np.ones(points), at=np.full(1, -1, np.int64),
    )  # fmt: skip


def regression_of(model: Model) -> Regression:
    """What a model of a pose says. Raises ModelError."""
    if "regional" not in model.arrays:
        raise ModelError(f"{model.path}: made by an earlier kinegraph; make it again: kinegraph motion train pose")
    chosen = model.array("landmarks", (None,), np.int64)
    if len(chosen) and not (chosen.min() >= 0 and chosen.max() < len(NAMES)):
        raise ModelError(f"{model.path}: names landmarks that do not exist")
    centres, mean = model.array("centres", (None, 3 * len(chosen))), model.array("mean", (6 * len(BONES) + 3,))
    shown, ends = shown_by_region(chosen)
    regional = model.array("regional", (len(centres), int(ends[-1])))
    basis = model.array("basis", (None, len(mean)))
    weights, scales = model.array("weights", (len(centres), len(basis))), model.array("scales", (1 + REGIONS,))
    ranks = model.array("ranks", (1 + REGIONS,), np.int64)
    if ranks[0] or ranks[-1] != len(basis) or (np.diff(ranks) < 0).any():
        raise ModelError(f"{model.path}: assigns its weights to wrong regions of the body")
    tree = JointTree(BONES, usual_body().parents, model.array("offsets", (len(BONES), 3)))
    return Regression(_room(chosen, centres, scales, shown, regional, ends, ranks, weights, basis, mean), tree)


def _room(
    chosen: Times, centres: Samples, scales: Samples, shown: Times, regional: Samples, ends: Times, ranks: Times, weights: Samples,
    basis: Samples, mean: Samples,
) -> Corrections:  # fmt: skip
    """These, and the room that the regression works in."""
    count = len(centres)
    room = (
        np.zeros(3 * len(chosen)),
        np.zeros(3 * len(shown)),
        np.zeros((2, count)),
        np.zeros(len(basis)),
        np.zeros(len(mean)),
    )
    centres, regional = np.ascontiguousarray(centres.T), np.ascontiguousarray(regional.T)
    return Corrections(chosen, centres, scales, shown, regional, ends, ranks, weights, basis, mean, *room)
