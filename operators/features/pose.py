"""Poses that can be compared: seen from the body, turned to the front, in centimetres (thesis 2.3.1 and 2.6.1: normalised poses)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.operators.features.skeleton import HIPS_AND_SHOULDERS, SETS, find_joints, pairs
from kinegraph.operators.inputs.directions import HELP, right_handed_up
from kinegraph.operators.inputs.lengths import CM, length_of
from kinegraph.operators.inputs.marker_columns import marker_columns
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.domain.axes import BODY, WAYS, Axes, Up, in_axes
from kinegraph.stream.errors import InputError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

FLAT = 0.2
"""Where the hips' distance is horizontal by less than this share, they tell no heading."""


class PoseNumbers:
    width: int
    cm: float
    up: int
    sign: float
    has_root: bool
    has_heading: bool
    body_cm: float
    learn: int
    frames: int
    total: float
    cos: float
    sin: float


@record
@dataclass(slots=True)
class PoseState(PoseNumbers):
    """
    columns  (p, 3)  columns of the points that make up joints
    parts    (j, 2)  which of these make up a joint: the root, the left and right side, the m points that come out, those of chains
    chains   (h, 2)  joints between which a bone lies, for the body's size
    work     (j, 3)  room for the joints of one frame
    width, cm        numbers of a sample; the input's unit in cm
    up, sign         the axis that points up (0 to 2), or, with -1, down
    learn            how many frames the body's size is taken from; frames, total: how many were, the sum of their sizes
    cos, sin         of the newest heading
    """

    numbers: Array
    columns: Times
    parts: Times
    chains: Times
    work: Samples


NUMBERS = numbers_of(PoseNumbers)


@kernel
def middle(x: Samples, columns: Times, first: int, last: int, up: int, sign: float, out: Samples) -> None:
    """The mean of points first..last-1 of `columns` (p, 3) in a sample `x` (width,), as (a, b, up), right-handed, into `out` (3,)."""
    a, b = (up + 1) % 3, (up + 2) % 3
    out[:] = 0.0
    for p in range(first, last):
        out[0] += x[columns[p, a]]
        out[1] += x[columns[p, b]] * sign
        out[2] += x[columns[p, up]] * sign
    out /= last - first


@kernel
def seen_from_body(s: PoseState, x: Samples, out: Samples) -> None:
    """Poses of the bodies `x` (n, width) into `out` (n, 3 m)."""
    parts, chains, work = s.parts, s.chains, s.work
    joints, m = parts.shape[0], out.shape[1] // 3
    for i in range(x.shape[0]):
        for j in range(joints):
            middle(x[i], s.columns, parts[j, 0], parts[j, 1], s.up, s.sign, work[j])
        known = True
        if s.has_heading:
            across, along = work[1, 0] - work[2, 0], work[1, 1] - work[2, 1]
            flat = math.sqrt(across * across + along * along)
            whole = math.sqrt(flat * flat + (work[1, 2] - work[2, 2]) ** 2)
            known = whole < math.inf
            if known and flat > FLAT * whole:
                s.cos, s.sin = across / flat, along / flat
        if not s.has_root:
            work[0] = 0.0
        scale = 1.0
        if s.body_cm > 0.0:
            size = 0.0
            for h in range(chains.shape[0]):
                bone = work[chains[h, 0]] - work[chains[h, 1]]
                size += math.sqrt(bone[0] * bone[0] + bone[1] * bone[1] + bone[2] * bone[2])
            if s.frames < s.learn and 0.0 < size < math.inf:
                s.frames += 1
                s.total += size
            scale = 2.0 * s.body_cm / (s.total / s.frames) if s.frames else math.nan
        for k in range(m):
            a = work[3 + k, 0] - work[0, 0]
            b = work[3 + k, 1] - work[0, 1]
            c = work[3 + k, 2] - work[0, 2]
            left = a * s.cos + b * s.sin
            front = a * s.sin - b * s.cos
            fine = known and abs(left) < math.inf and abs(c) < math.inf and abs(front) < math.inf
            out[i, 3 * k] = left * scale if fine else math.nan
            out[i, 3 * k + 1] = c * scale if fine else math.nan
            out[i, 3 * k + 2] = front * scale if fine else math.nan


@dataclass(frozen=True, slots=True)
class Pose(Operator[PoseState]):
    """Joints or markers (points, 3) in; out comes the pose: some points as seen from the body, x to its left, y up, z to its front, in cm.

    points   e15: ankles, head and wrists, 15 numbers, which the thesis's radii belong to; e30: also knees, elbows and neck; all
    joints   which points of the input make up a joint (their middle), where its names do not tell. Joints are root, neck, head, and ankle,
             knee, hip, wrist, elbow, shoulder with _l or _r. Names of the CMU and HDM05 recordings, of Plug-in Gait markers, of
             Kinect and of usual BVH files are known
    up       the input's axis that points up; left out: as the input declares, else y
    root     taken as the origin: the middle of the hips
    heading  turned away: from right to left hip is x. While the hips stand nearly above one another the last heading holds
    body_cm  scales every body so that thigh and shank together have this length; taken from the mean of the first `learn_s` of frames, and
             frozen then. 0: as it is

    The input's unit is m, cm or mm (without one it is taken for cm). No delay; any rate. A point that is not finite is NaN, and so is the
    whole pose where the root or the hips are. `meta["mirror"]` holds what operators.features.mirror.Mirror swaps.

    >>> given, made = tried(Pose)
    >>> given["in"][-1, 0].round(2), made[-1, :3].round(1)
    (array([ 1.48,  1.3 , -0.76]), array([ 208.3, -142.4,  -88.5]))
    """

    inputs = {"in": Input(rows=True)}
    points: Literal["e15", "e30", "all"] = param("e15", help="which points come out")
    joints: Mapping[str, tuple[str, ...]] | None = param(None, help="joint: [point, ...], where names do not tell")
    up: Up | None = param(None, help=f"{HELP} y")
    root: bool = param(True, help="positions from the root; false: as they are")
    heading: bool = param(True, help="turned to the front; false: as it is")
    body_cm: float = param(0.0, least=0.0, help="length of thigh and shank that bodies are scaled to; 0: as they are")
    learn_s: float = param(2.0, above=0.0, help="how long the body's own size is taken from")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        unit = length_of(spec)
        up = right_handed_up(spec, self.up, "y", WAYS)
        names = point_names(spec)
        body = tuple(f"{joint}_{side}" for joint in ("hip", "knee", "ankle") for side in "lr") if self.body_cm else ()
        shown = SETS.get(self.points, ())
        hips = ("hip_l", "hip_r") if self.heading else ()
        wanted = dict.fromkeys((*hips, *(("root",) if self.root else ()), *shown, *body))
        found = find_joints(names, wanted, self.joints or {}, HIPS_AND_SHOULDERS)
        if self.points == "all":
            shown = names
            found = {**found, **{name: (name,) for name in names if name not in found}}
        order = ["root" if self.root else shown[0], *(hips or (shown[0], shown[0])), *shown, *body]
        columns = [marker_columns(spec, name, "joints") for joint in order for name in found[joint]]
        ends = np.cumsum([len(found[joint]) for joint in order])
        legs = 3 + len(shown)
        bones = [(legs + k, legs + k + 2) for k in range(4)] if body else []
        state = PoseState(
            numbers=np.zeros((), NUMBERS),
            columns=np.array(columns, np.int64),
            parts=np.stack([ends - [len(found[joint]) for joint in order], ends], 1).astype(np.int64),
            chains=np.array(bones, np.int64).reshape(-1, 2),
            work=np.zeros((len(order), 3)),
        )
        state.width, state.cm, state.body_cm = int(np.prod(spec.shape)), CM[unit], self.body_cm
        state.up, state.sign = "xyz".index(up[-1]), -1.0 if up[0] == "-" else 1.0
        state.has_root, state.has_heading = self.root, self.heading
        state.learn = max(1, round(self.learn_s * (spec.rate_hz or 30.0)))
        state.cos, state.sin = (0.0, 1.0) if up[-1] == "y" else (1.0, 0.0)
        self.set_state(state)
        mirror = [[f"{a}.{axis}", f"{b}.{axis}"] for a, b in pairs(shown) for axis in "xyz"]
        facts = {
            "pose": {"points": self.points, "joints": {joint: list(found[joint]) for joint in dict.fromkeys(order)}},
            "mirror": {"swap": mirror, "negate": [f"{name}.x" for name in shown]},
        }
        return {
            "out": StreamSpec(
                (3 * len(shown),),
                rate_hz=spec.rate_hz,
                channels=tuple(f"{name}.{axis}" for name in shown for axis in "xyz"),
                units=("cm" if unit else "",),
                settling_s=spec.settling_s + (self.learn_s if self.body_cm else 0.0),
                meta={**in_axes(spec, BODY if self.heading else Axes("y")), **facts},
            )
        }

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        out = np.empty((len(chunk.time), 3 * (len(s.parts) - 3 - (6 if len(s.chains) else 0))))
        if len(chunk.time):
            seen_from_body(s, chunk.data * s.cm, out)
        return Chunk(chunk.time, out, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(30)
        names = (
            "hip_center",
            "head",
            *(f"{joint}_{side}" for joint in ("hip", "knee", "ankle", "wrist") for side in "lr"),
        )
        body = rng.normal(size=(len(names), 3)) + 0.05 * rng.normal(size=(150, len(names), 3)).cumsum(axis=0)
        spec = StreamSpec((len(names), 3), rate_hz=30.0, channels=names, units=("m",))
        return [
            Case(cls(), {"in": (spec, grid(30.0, 150), body)}, least=150),
            Case(cls(body_cm=80.0, up="-z", points="all"), {"in": (spec, grid(30.0, 150), body)}, least=150),
            Case(cls(root=False, heading=False), {"in": (spec, grid(30.0, 150), body)}, least=150),
        ]


def point_names(spec: StreamSpec) -> tuple[str, ...]:
    """Names of a stream's points; numbers for unnamed points. Raises InputError for a stream without points."""
    if len(spec.shape) == 2 and spec.shape[1] == 3:
        return spec.channels or tuple(map(str, range(spec.shape[0])))
    if spec.is_signal and spec.shape[0] % 3 == 0:
        return tuple(dict.fromkeys(name[:-1].rstrip("_ .:/-") for name in spec.channels if name[-1:] in "xyzXYZ"))
    raise InputError("in", spec.describe(), "points (points, 3), or a signal with x, y and z of each")
