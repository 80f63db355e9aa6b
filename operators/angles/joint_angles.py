"""Angles of pelvis, trunk, hips, knees, ankles, shoulders and elbows from markers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.angles.frames import (
    FOOT,
    FOREARM,
    PELVIS,
    SEGMENTS,
    SHANK,
    THIGH,
    THORAX,
    UPPER_ARM,
    frames_of,
)
from kinegraph.operators.angles.marker_sets import PLACE, PLACES, find_places
from kinegraph.operators.inputs.directions import axes_of
from kinegraph.operators.inputs.marker_columns import marker_columns, marker_metres, marker_names
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.domain.axes import BODY, Up
from kinegraph.stream.errors import InputError
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

LABORATORY = SEGMENTS
"""The laboratory itself as a segment."""
ZXY, YXY = 0, 1
JOINTS: tuple[tuple[str, int, int, int, tuple[str, str, str], tuple[float, float, float]], ...] = (
    ("Pelvis", LABORATORY, PELVIS, ZXY, ("tilt", "obliquity", "rotation"), (-1.0, 1.0, 1.0)),
    ("Trunk", PELVIS, THORAX, ZXY, ("flexion", "lateral", "rotation"), (-1.0, 1.0, 1.0)),
    *(
        row
        for side, name, mirror in ((0, "L", -1.0), (1, "R", 1.0))
        for row in (
            (f"{name}Hip", PELVIS, THIGH + side, ZXY, ("flexion", "adduction", "rotation"), (1.0, mirror, mirror)),
            (f"{name}Knee", THIGH + side, SHANK + side, ZXY, ("flexion", "adduction", "rotation"), (-1.0, mirror, mirror)),
            (f"{name}Ankle", SHANK + side, FOOT + side, ZXY, ("flexion", "", "rotation"), (1.0, mirror, mirror)),
            (f"{name}Arm", THORAX, UPPER_ARM + side, YXY, ("plane", "elevation", "rotation"), (mirror, 1.0, mirror)),
            (f"{name}Elbow", UPPER_ARM + side, FOREARM + side, ZXY, ("flexion", "", ""), (1.0, mirror, mirror)),
        )
    ),
)  # fmt: skip
"""Of each joint: its name, the segment that is fixed and the one that moves, the order of turns, what the three angles are called ("":
these markers do not show it), and their signs: as clinicians count them, alike on both sides."""
CHANNELS = tuple(f"{joint}.{angle}" if angle else "" for joint, *_, angles, _ in JOINTS for angle in angles)
_PAIRS = np.array([row[1:4] for row in JOINTS])
_SIGNS = np.array([row[5] for row in JOINTS])


@kernel
def angles_of(
    x: Samples,
    columns: NDArray[np.int64],
    turn: Samples,
    sizes: Samples,
    pairs: NDArray[np.int64],
    signs: Samples,
    before: Samples,
    heading: Samples,
    out: Samples,
) -> None:
    """Angles (n, 3 joints) in degrees into `out`, from markers `x` (n, width) laid flat.

    columns  (37,)   where each place's x stands; -1: it has no marker
    turn     (3, 3)  from the input's numbers to metres in the laboratory's axes (x forwards, y up, z to the right)
    sizes    (3,)    from outer markers to the middle of knee, ankle and elbow (m)
    before   (3 joints,)  the newest angles, so that none leaps by 360 degrees; NaN at first
    heading  (1,)    degrees that the pelvis's rotation is counted from; NaN: by the nearest axis that it faces first
    """
    places, frames = np.empty((columns.shape[0], 3)), np.empty((SEGMENTS + 1, 3, 3))
    for i in range(x.shape[0]):
        for k in range(columns.shape[0]):
            for c in range(3):
                places[k, c] = math.nan
            at = columns[k]
            if at >= 0 and not (x[i, at] == 0.0 and x[i, at + 1] == 0.0 and x[i, at + 2] == 0.0):
                for c in range(3):
                    places[k, c] = turn[c, 0] * x[i, at] + turn[c, 1] * x[i, at + 1] + turn[c, 2] * x[i, at + 2]
        frames_of(places, sizes[0], sizes[1], sizes[2], frames[:SEGMENTS])
        facing = math.degrees(math.atan2(-frames[PELVIS, 0, 2], frames[PELVIS, 0, 0]))
        if heading[0] != heading[0] and facing == facing:
            heading[0] = 90.0 * round(facing / 90.0)
        ahead = math.radians(heading[0])
        frames[SEGMENTS, :] = 0.0
        frames[SEGMENTS, 0, 0] = frames[SEGMENTS, 2, 2] = math.cos(ahead)
        frames[SEGMENTS, 0, 2], frames[SEGMENTS, 2, 0] = -math.sin(ahead), math.sin(ahead)
        frames[SEGMENTS, 1, 1] = 1.0
        for j in range(pairs.shape[0]):
            _between(
                frames[pairs[j, 0]],
                frames[pairs[j, 1]],
                pairs[j, 2],
                before[3 * j : 3 * j + 3],
                signs[j],
                out[i, 3 * j : 3 * j + 3],
            )


@kernel
def _between(fixed: Samples, moving: Samples, order: int, before: Samples, signs: Samples, out: Samples) -> None:
    """Three angles (degrees) of `moving` seen from `fixed`, both (3, 3) with axes as rows, near those `before`."""
    m = np.empty((3, 3))  # columns: the moving axes seen from the fixed frame
    for r in range(3):
        for c in range(3):
            m[r, c] = fixed[r, 0] * moving[c, 0] + fixed[r, 1] * moving[c, 1] + fixed[r, 2] * moving[c, 2]
    if order == 0:  # about z, x', y''
        out[0] = math.atan2(-m[0, 1], m[1, 1])
        out[1] = math.asin(min(max(m[2, 1], -1.0), 1.0))
        out[2] = math.atan2(-m[2, 0], m[2, 2])
    else:  # about y, x', y'': how far it is raised, and in which plane
        raised = math.acos(min(max(m[1, 1], -1.0), 1.0))
        out[0], out[1], out[2] = math.atan2(m[0, 1], m[2, 1]), raised, math.atan2(m[1, 0], -m[1, 2])
    for k in range(3):
        out[k] = signs[k] * math.degrees(out[k])
        if out[k] == out[k]:
            if before[k] == before[k]:
                out[k] += 360.0 * round((before[k] - out[k]) / 360.0)
            before[k] = out[k]


@dataclass(slots=True)
class JointAnglesState:
    """
    columns  (37,)      where each place's x stands in a sample laid flat; -1: no marker
    turn     (3, 3)     to metres in the laboratory's axes
    sizes    (3,)       from outer markers to the middle of knee, ankle and elbow (m)
    kept     (c,)       which of all angles are given
    before   (36,)      the newest angles (degrees); NaN: none yet
    heading  (1,)       which way is forward (degrees from the usual axis); NaN: as the pelvis faces first
    """

    columns: Times
    turn: Samples
    sizes: Samples
    kept: Times
    before: Samples
    heading: Samples


@dataclass(frozen=True, slots=True)
class JointAngles(Operator[JointAnglesState]):
    """Markers (points, 3) in; angles of the joints between them out, in degrees: a signal with channels "LKnee.flexion" and so on.

    Joint coordinate systems of the ISB (Wu 2002, 2005; Grood and Suntay 1983), hips by Harrington (2007). Signs are those of clinics and
    alike on both sides: flexion, dorsiflexion, adduction and internal rotation are positive; pelvis and trunk lean forwards, are lower on
    the right, and turn to the left at positive angles. Markers are found by the names of Plug-in-Gait, OpenSim's examples and our own
    poses, or by `markers` ({LKNE: my marker}). An inner marker at a knee, ankle or elbow gives its axis; else a wand does (THI, TIB), with
    the joint's width; else the axis is that of the pelvis, and angles out of the sagittal plane are nominal. No delay. A marker that is
    missing, or exactly 0, 0, 0, gives NaN for the joints that need it. No angle leaps by 360 degrees while its markers are seen. The
    pelvis's rotation is counted from the axis that the input declares to be forward; where it declares no such axis, from the one that it
    faces first.

    >>> given, made = tried(JointAngles)
    >>> made.shape[1], np.abs(made[0, :3]).round().tolist()  # standing: tilt, obliquity and rotation
    (19, [0.0, 0.0, 0.0])
    """

    inputs = {"in": Input(rows=True)}
    references: ClassVar[str] = "Wu 2002, 2005 (ISB); Grood and Suntay 1983; Harrington 2007; Davis 1991"

    markers: Mapping[str, str] | None = param(None, help="place: marker, where names do not say it")
    up: Up | None = param(None, help="the input's axis that points up; left out: as the input declares, else z")
    unit: str = param("", help="m, cm or mm; left out: as the input says")
    knee_width_m: float = param(
        0.10, least=0.0, most=0.25, help="across the knee, without markers; 0: the marker is in the joint"
    )
    ankle_width_m: float = param(0.07, least=0.0, most=0.2, help="across the ankle; 0: the marker is in the joint")
    elbow_width_m: float = param(0.07, least=0.0, most=0.2, help="across the elbow; 0: the marker is in the joint")
    marker_m: float = param(0.014, least=0.0, most=0.05, help="the markers' diameter")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        names = marker_names(spec)
        if not names:
            raise InputError("in", spec.describe(), "markers (points, 3) with names")
        found = find_places(names, self.markers)
        columns = np.full(len(PLACES), -1)
        scale = 1.0
        for place, marker in found.items():
            at = marker_columns(spec, marker, "markers")
            if at != (at[0], at[0] + 1, at[0] + 2):
                raise InputError("in", spec.describe(), "x, y and z of each marker side by side, in this order")
            columns[PLACE[place]], scale = at[0], marker_metres(spec, at, self.unit)
        own = names == list(spec.channels) and "left_hip" in names  # of our poses: markers are the joints themselves
        sizes = np.zeros(3) if own else (self._widths() + self.marker_m) / 2.0
        kept = self._kept(columns)
        if not len(kept):
            raise InputError(
                "in",
                f"markers {', '.join(names[:12])}",
                "at least a pelvis (LASI, RASI and LPSI, RPSI or SACR; or both hips)",
            )
        axes = axes_of(spec, self.up, "z")
        order, signs = axes.to(BODY)
        heading = np.array([0.0 if axes.forward else np.nan])
        turn = np.zeros((3, 3))  # BODY is left, up, front; the laboratory's axes are front, up, right
        for row, body, sign in ((0, 2, 1.0), (1, 1, 1.0), (2, 0, -1.0)):
            turn[row, order[body]] = sign * signs[body] * scale
        self.set_state(JointAnglesState(columns, turn, sizes, kept, np.full(3 * len(JOINTS), np.nan), heading))
        return {
            "out": StreamSpec(
                (len(kept),), rate_hz=spec.rate_hz, channels=tuple(CHANNELS[k] for k in kept.tolist()), units=("deg",),
                settling_s=spec.settling_s,
            )
        }  # fmt: skip

    def _widths(self) -> Samples:
        return np.array([self.knee_width_m, self.ankle_width_m, self.elbow_width_m])

    def _kept(self, columns: Times) -> Times:
        """The angles that these markers can give: those of a body whose markers lie anywhere."""
        places = np.random.default_rng(3).normal(size=(len(PLACES), 3))
        places[columns < 0] = np.nan
        frames = np.empty((SEGMENTS + 1, 3, 3))
        frames[LABORATORY] = np.eye(3)
        frames_of(places, 0.0, 0.0, 0.0, frames[:SEGMENTS])
        there = np.asarray(np.isfinite(frames).all(axis=(1, 2)))
        seen = np.repeat([there[row[1]] and there[row[2]] for row in JOINTS], 3)
        return np.flatnonzero(seen & np.array([bool(name) for name in CHANNELS]))

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        made = np.empty((len(chunk), 3 * len(JOINTS)))
        angles_of(chunk.data, s.columns, s.turn, s.sizes, _PAIRS, _SIGNS, s.before, s.heading, made)
        return Chunk(chunk.time, np.ascontiguousarray(made[:, s.kept]), chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        n, names = 80, tuple(STANDING)
        body = np.array(list(STANDING.values()))
        data = np.repeat(body[None], n, 0)
        swing = np.sin(np.arange(n) / 8.0)
        for k, name in enumerate(names):
            if name[1:] in ("ANK", "HEE", "TOE"):
                data[:, k, 1] += (0.1 if name[0] == "L" else -0.1) * swing
        data[30:34, 5] = np.nan
        data[50:52, 8] = 0.0
        spec = StreamSpec((len(names), 3), rate_hz=100.0, channels=names, units=("m",))
        flat = StreamSpec(
            (3 * len(names),),
            rate_hz=None,
            channels=tuple(f"{name}_{c}" for name in names for c in "xyz"),
            units=("mm",),
        )
        return [
            Case(cls(), {"in": (spec, grid(100.0, n), data)}, least=80),
            Case(cls(knee_width_m=0.0), {"in": (flat, grid(90.0, n), 1000.0 * data.reshape(n, -1))}, least=80),
        ]


STANDING: dict[str, tuple[float, float, float]] = {
    "LASI": (-0.12, 0.10, 1.0), "RASI": (0.12, 0.10, 1.0), "LPSI": (-0.05, -0.08, 1.0), "RPSI": (0.05, -0.08, 1.0),
    "LKNE": (-0.157, 0.045, 0.5), "RKNE": (0.157, 0.045, 0.5), "LANK": (-0.142, 0.045, 0.09), "RANK": (0.142, 0.045, 0.09),
    "LHEE": (-0.1, 0.0, 0.05), "RHEE": (0.1, 0.0, 0.05), "LTOE": (-0.1, 0.2, 0.05), "RTOE": (0.1, 0.2, 0.05),
}  # fmt: skip
"""Somebody who stands: x to the right, y forwards, z up (m)."""
