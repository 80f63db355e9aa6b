"""`python -m bench.angles`: joint angles beside OpenSim's inverse kinematics on the same markers; Markdown.

`--pose2sim FOLDER`: where the package `pose2sim` (BSD-3) was unpacked: its model, its bony landmarks on that model, its four videos. The
recordings are files of KINEGRAPH_DATA (`files/c3d`). Needs the package `opensim` (Apache-2.0); without it there is no table. `--camera`:
one camera beside OpenSim on what four cameras triangulate; needs `kinegraph files fetch camera-models`.

OpenSim's model is scaled to the recording (pelvis by the spines, and as wide as the laboratory's own hips are apart; thigh, shank and foot
by their length), its markers are moved to where a first solution finds them on average, as a static trial would move them, and it is solved
again, with the package's weights, subtalar joint and toes locked. `RMS`: as both give it. `in its axes`: minus what operators.angles reads
off the model when all its coordinates are 0: two frames on one bone differ by a constant. `offset`: minus the mean difference.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench import one_camera as camera
from kinegraph.operators.angles.joint_angles import JointAngles
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.domain.axes import Axes

Markers = dict[str, np.ndarray]
"""By place on the body: (n, 3) in m, x forwards, y up, z to the right."""

BONES = {"KNE": ("femur", "knee"), "KNM": ("femur", "mknee"), "ANK": ("tibia", "ankle"), "ANM": ("tibia", "mankle"),
         "HEE": ("calcn", "calc"), "TOE": ("calcn", "toe")}  # fmt: skip
"""By place: the model's bone, and what the package calls the landmark."""
LANDMARKS = {
    **{f"{s}{k}": (f"{'L' if s == 'L' else 'r'}_{name}_study", f"{bone}_{s.lower()}") for k, (bone, name) in BONES.items() for s in "LR"},
    **{f"{s}{k}": (f"{'L' if s == 'L' else 'r'}.{k}S_study", "pelvis") for k in ("ASI", "PSI") for s in "LR"},
}  # fmt: skip
"""By place: the package's landmark, and its bone."""
SACRUM = (-0.154, 0.025, 0.0)
"""Between the package's back spines, on the model's pelvis."""
WEIGHTS = {"ASI": 25.0, "PSI": 25.0, "ACR": 25.0, "HEE": 60.0}
"""The package's weights; 30 elsewhere."""
HIPS_APART = 0.15452
"""The model's own (m)."""

RECORDINGS: dict[str, tuple[str, dict[str, str], tuple[int, int, int], tuple[str, str]]] = {
    "walk, inner and outer markers, 250 Hz": (
        "walking5.c3d",
        {
            "LKNE": "LLFC", "LKNM": "LMFC", "LANK": "LLMAL", "LANM": "LMMAL", "LHEE": "LCAL", "LTOE": "LMT2",
            "RKNE": "RLFC", "RKNM": "RMFC", "RANK": "RLMAL", "RANM": "RMMAL", "RHEE": "RCAL", "RTOE": "RMT2",
        },
        (-1, 3, 2), ("LHJC", "RHJC"),
    ),
    "walk, inner and outer markers, 100 Hz": (
        "gait_bmc.c3d",
        {"SACR": "VSAC", "LKNM": "LKNE 2", "LANM": "LANK 2", "RKNM": "RKNE 2", "RANM": "RANK 2"},
        (-1, 3, 2), ("", ""),
    ),
    "run, outer markers only, 250 Hz": (
        "events_8plates.c3d",
        {"LKNE": "LLEPI", "LANK": "LLMAL", "LHEE": "LHEEL", "RKNE": "RLEPI", "RANK": "RLMAL", "RHEE": "RHEEL"},
        (2, 3, 1), ("", ""),
    ),
}  # fmt: skip
"""File; markers with other names; the axes that are forwards, up and right (1 to 3, negative: the other way); hips."""
ROWS: tuple[tuple[str, str, float], ...] = (
    ("Pelvis.tilt", "pelvis_tilt", -1.0), ("Hip.flexion", "hip_flexion", 1.0), ("Knee.flexion", "knee_angle", 1.0),
    ("Ankle.flexion", "ankle_angle", 1.0), ("Pelvis.obliquity", "pelvis_list", 1.0), ("Pelvis.rotation", "pelvis_rotation", 1.0),
    ("Hip.adduction", "hip_adduction", 1.0), ("Hip.rotation", "hip_rotation", 1.0),
)  # fmt: skip
"""Ours, the model's coordinate, and the sign between them; the sagittal ones first."""


def recorded(path: Path, names: Mapping[str, str], axes: Sequence[int]) -> tuple[float, Markers, Markers]:
    """Rate, the places' markers of the longest stretch that has all of them, and all markers there by the file's names."""
    import ezc3d

    file = ezc3d.c3d(str(path))
    labels: list[str] = []
    for label in file["parameters"]["POINT"]["LABELS"]["value"]:
        labels.append(f"{label} 2" if label in labels else label)
    points = 0.001 * file["data"]["points"][:3].transpose(1, 2, 0)
    points[(points == 0).all(2)] = np.nan
    by_name = {
        name: np.stack([np.sign(a) * points[k][:, abs(a) - 1] for a in axes], 1) for k, name in enumerate(labels)
    }
    taken = {
        place: by_name[names.get(place, place)] for place in (*LANDMARKS, "SACR") if names.get(place, place) in by_name
    }
    whole = np.isfinite(np.concatenate(list(taken.values()), 1)).all(1)
    edges = np.flatnonzero(np.diff(np.r_[0, whole, 0]))
    first, end = max(zip(edges[::2], edges[1::2], strict=True), key=lambda part: part[1] - part[0])
    rate = float(file["parameters"]["POINT"]["RATE"]["value"][0])
    return rate, {k: v[first:end] for k, v in taken.items()}, {k: v[first:end] for k, v in by_name.items()}


def ours(rate: float, markers: Markers) -> tuple[dict[str, np.ndarray], float]:
    """Angles by channel, and seconds a frame."""
    spec = StreamSpec(
        (len(markers), 3), rate_hz=rate, channels=tuple(markers), units=("m",), meta={"axes": Axes("y", "x").facts()}
    )
    operator = JointAngles()
    channels = operator.open({"in": spec})["out"].channels
    data = np.ascontiguousarray(np.stack(list(markers.values()), 1).reshape(len(next(iter(markers.values()))), -1))
    times = np.arange(len(data)) * round(NS / rate)
    began = time.perf_counter()
    made = operator.process("in", Chunk(times, data, int(times[-1]))).data
    return dict(zip(channels, made.T, strict=True)), (time.perf_counter() - began) / len(data)


class Model:
    """OpenSim's model, and markers on it."""

    def __init__(self, opensim: Any, setup: Path) -> None:
        self.opensim, self.model = opensim, opensim.Model(str(setup / "Model_Pose2Sim_simple.osim"))
        for coordinate in self.model.updCoordinateSet():
            coordinate.setDefaultClamped(not coordinate.getName().startswith("pelvis"))
            if coordinate.getName().split("_")[0] in ("subtalar", "mtp"):
                coordinate.setDefaultLocked(True)

    def add(self, name: str, body: str, at: Sequence[float]) -> None:
        bone = self.model.getBodySet().get(body)
        self.model.addMarker(self.opensim.Marker(name, bone, self.opensim.Vec3(*at)))

    def standing(self) -> tuple[Markers, Any]:
        """The markers (1, 3) where the model's coordinates are all 0."""
        self.model.finalizeConnections()
        state = self.model.initSystem()
        for coordinate in self.model.getCoordinateSet():
            if not coordinate.getLocked(state):
                coordinate.setValue(state, 0.0, False)
        self.model.assemble(state)
        self.model.realizePosition(state)
        return {name: place[None] for name, place in self.places(state).items()}, state

    def places(self, state: Any) -> Markers:
        return {m.getName(): m.getLocationInGround(state).to_numpy() for m in self.model.getMarkerSet()}

    def scale(self, factors: Mapping[str, tuple[float, float, float]]) -> None:
        scales = self.opensim.ScaleSet()
        for body, by in factors.items():
            scale = self.opensim.Scale()
            scale.setSegmentName(body)
            scale.setScaleFactors(self.opensim.Vec3(*by))
            scale.setApply(True)
            scales.cloneAndAppend(scale)
        self.model.scale(self.model.initSystem(), scales, True)

    def solve(
        self, rate: float, markers: Markers, weights: Mapping[str, float], *, move: bool = False
    ) -> tuple[dict[str, np.ndarray], float, float]:
        """Coordinates (degrees), seconds a frame, how far the model's markers are from those recorded (m).

        `move`: the markers are then moved there, on average.
        """
        opensim, n = self.opensim, len(next(iter(markers.values())))
        table = opensim.TimeSeriesTableVec3()
        table.setColumnLabels(list(markers))
        for i in range(n):
            row = opensim.RowVectorVec3([opensim.Vec3(*m[i].tolist()) for m in markers.values()])
            table.appendRow(i / rate, row)
        table.addTableMetaDataString("DataRate", str(rate))
        table.addTableMetaDataString("Units", "m")
        weighed = opensim.SetMarkerWeights()
        for name in markers:
            weighed.cloneAndAppend(opensim.MarkerWeight(name, weights[name]))
        reference = opensim.MarkersReference(table, weighed)
        self.model.finalizeConnections()
        state = self.model.initSystem()
        solver = opensim.InverseKinematicsSolver(self.model, reference, opensim.SimTKArrayCoordinateReference(), 1000.0)
        solver.setAccuracy(1e-6)
        found = {c.getName(): np.empty(n) for c in self.model.getCoordinateSet()}
        local: Markers = {name: np.empty((n, 3)) for name in markers}
        spent, off = 0.0, []
        for i in range(n):
            state.setTime(i / rate)
            began = time.perf_counter()
            if i:
                solver.track(state)
            else:
                solver.assemble(state)
            spent += time.perf_counter() - began
            self.model.realizePosition(state)
            for coordinate in self.model.getCoordinateSet():
                found[coordinate.getName()][i] = np.degrees(coordinate.getValue(state))
            off += [np.linalg.norm(place - markers[name][i]) for name, place in self.places(state).items()]
            for marker in self.model.getMarkerSet() if move else ():
                ground, at = self.model.getGround(), opensim.Vec3(*markers[marker.getName()][i].tolist())
                seen = ground.findStationLocationInAnotherFrame(state, at, marker.getParentFrame())
                local[marker.getName()][i] = seen.to_numpy()
        for marker in self.model.updMarkerSet() if move else ():
            marker.set_location(opensim.Vec3(*np.nanmean(local[marker.getName()], axis=0).tolist()))
        return found, spent / n, float(np.nanmean(off))


def length(markers: Markers, a: str, b: str) -> float:
    return float(np.nanmean(np.linalg.norm(markers[a] - markers[b], axis=1)))


def knee(markers: Markers, side: str) -> np.ndarray:
    outer = markers[f"{side}KNE"]
    return np.asarray((outer + markers.get(f"{side}KNM", outer)) / 2)


def depth(markers: Markers) -> float:
    back = markers["SACR"] if "SACR" in markers else (markers["LPSI"] + markers["RPSI"]) / 2
    return float(np.linalg.norm((markers["LASI"] + markers["RASI"]) / 2 - back, axis=1).mean())


def rigid(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotation and move from points a (n, 3) to b."""
    u, _, v = np.linalg.svd((a - a.mean(0)).T @ (b - b.mean(0)))
    turn = v.T @ np.diag([1.0, 1.0, np.sign(np.linalg.det(v.T @ u.T))]) @ u.T
    return turn, b.mean(0) - turn @ a.mean(0)


def marked(opensim: Any, setup: Path, markers: Markers, hips_apart: float) -> Model:
    """The model, scaled to these markers and with these on it."""
    model = Model(opensim, setup)
    known = opensim.MarkerSet(str(setup / "Markers_LSTM.xml"))
    for place in markers:
        body = LANDMARKS[place][1] if place in LANDMARKS else "pelvis"
        at = known.get(LANDMARKS[place][0]).get_location().to_numpy() if place in LANDMARKS else SACRUM
        model.add(place, body, list(at))
    own, state = model.standing()
    deep = depth(markers) / depth(own)
    pelvis = np.array([deep, deep, hips_apart / HIPS_APART])
    factors = {"pelvis": pelvis}
    origin = model.model.getBodySet().get("pelvis").getPositionInGround(state).to_numpy()
    spines = [place for place in markers if place[1:] in ("ASI", "PSI", "ACR")]
    wide = np.array([deep, deep, length(markers, "LASI", "RASI") / length(own, "LASI", "RASI")])
    for side in "LR":
        joint = (
            model.model.getJointSet().get(f"hip_{side.lower()}").getParentFrame().getPositionInGround(state).to_numpy()
        )
        fits = [
            rigid((np.array([own[k][0] for k in spines]) - origin) * wide, np.array([markers[k][i] for k in spines]))
            for i in range(len(markers["LASI"]))
        ]
        hips = np.array([turn @ ((joint - origin) * pelvis) + move for turn, move in fits])
        thigh = np.linalg.norm(hips - knee(markers, side), axis=1).mean() / np.linalg.norm(joint - knee(own, side)[0])
        shank, foot = (
            length(markers, side + a, side + b) / length(own, side + a, side + b) for a, b in (("KNE", "ANK"), ("HEE", "TOE"))
        )  # fmt: skip
        by = {"femur": thigh, "tibia": shank, "talus": foot, "calcn": foot, "toes": foot}
        factors |= {f"{bone}_{side.lower()}": np.full(3, share) for bone, share in by.items()}
    model.scale({body: tuple(by.tolist()) for body, by in factors.items()})
    return model


def compare(opensim: Any, setup: Path, title: str, rate: float, markers: Markers, hips_apart: float) -> None:
    model = marked(opensim, setup, markers, hips_apart)
    weights = {place: WEIGHTS.get(place[1:], 30.0) for place in markers}
    model.solve(rate, markers, weights, move=True)
    theirs, seconds, off = model.solve(rate, markers, weights)
    ours(rate, markers)
    (here, own_seconds), (zero, _) = ours(rate, markers), ours(rate, model.standing()[0])
    print(f"\n{title}, {len(markers['LASI'])} frames; OpenSim's markers stay {100 * off:.1f} cm away; ", end="")
    print(f"{1e6 * own_seconds:.0f} us a frame here, {1e3 * seconds:.1f} ms by OpenSim\n")
    table(here, theirs, zero)


def table(here: Mapping[str, np.ndarray], theirs: Mapping[str, np.ndarray], zero: Mapping[str, np.ndarray]) -> None:
    """Both sides of the body count together; r is that of the worse side."""
    print("| angle | range | RMS degrees | in its axes | offset | r |\n|---|--:|--:|--:|--:|--:|")
    for name, coordinate, sign in ROWS:
        sides = (
            [(name, coordinate)]
            if name.startswith("Pelvis")
            else [(s.upper() + name, f"{coordinate}_{s}") for s in "lr"]
        )
        found = []
        for channel, joint in sides:
            a, b = here[channel], sign * theirs[joint]
            seen = np.isfinite(a)
            a, b = a[seen], b[seen]
            a = a - 360.0 * np.round(np.mean(a - b) / 360.0)
            constant = float(zero[channel][0]) if channel in zero else np.nan
            found.append(
                (
                    np.ptp(b),
                    np.mean((a - b) ** 2),
                    np.mean((a - b - constant) ** 2),
                    np.var(a - b),
                    np.corrcoef(a, b)[0, 1],
                )
            )
        spans, *squares, r = np.array(found).T
        rms = " | ".join(f"{np.sqrt(part.mean()):.1f}" for part in squares)
        print(f"| {name} | {spans.mean():.0f} | {rms} | {r.min():.3f} |")


NAMES = {
    "shoulder": ("torso", "Shoulder"),
    "hip": ("pelvis", "Hip"),
    "knee": ("femur", "Knee"),
    "ankle": ("tibia", "Ankle"),
}
"""Of the joints that one camera gives: the model's bone, and the package's name."""


def from_one_camera(opensim: Any, folder: Path, width: int, height_m: float) -> None:
    """Knee and hip flexion of each camera alone beside OpenSim on the joints that all four triangulate."""
    runs, _, truth, rate = camera.four_cameras(folder, width, height_m)
    wanted = [camera.JOINTS.index(f"{side}_{name}") for name in NAMES for side in ("left", "right")]
    labels = [f"{side}{NAMES[name][1]}" for name in NAMES for side in "LR"]
    truth = smoothed(truth)
    places = truth[:, wanted]
    ahead = places[:, :4].mean(1)[-1] - places[:, :4].mean(1)[0]
    turn = np.array([[ahead[0], ahead[1], 0.0], [0.0, 0.0, 0.0], [ahead[1], -ahead[0], 0.0]]) / np.hypot(*ahead[:2])
    turn[1, 2] = 1.0
    markers = dict(zip(labels, np.moveaxis(places @ turn.T, 1, 0), strict=True))
    model, known = (
        Model(opensim, folder / "OpenSim_Setup"),
        opensim.MarkerSet(str(folder / "OpenSim_Setup" / "Markers_BlazePose.xml")),
    )
    for label, (bone, _) in zip(labels, [NAMES[name] for name in NAMES for _ in "LR"], strict=True):
        body = f"{bone}_{label[0].lower()}" if bone in ("femur", "tibia") else bone
        model.add(label, body, list(known.get(label).get_location().to_numpy()))
    own, _ = model.standing()
    by = {"pelvis": ("LHip", "RHip"), "torso": ("LShoulder", "RShoulder")}
    factors = {body: length(markers, *pair) / length(own, *pair) for body, pair in by.items()}
    for side in "LR":
        for bone, (a, b) in {"femur": ("Hip", "Knee"), "tibia": ("Knee", "Ankle")}.items():
            factors[f"{bone}_{side.lower()}"] = length(markers, side + a, side + b) / length(own, side + a, side + b)
    model.scale({body: (by, by, by) for body, by in factors.items()})
    model.solve(rate, markers, dict.fromkeys(labels, 1.0), move=True)
    theirs, _, off = model.solve(rate, markers, dict.fromkeys(labels, 1.0))
    print(
        f"\none camera, {len(truth)} frames; OpenSim's markers stay {100 * off:.1f} cm away from the triangulated joints\n"
    )
    print(
        "| camera | knee flexion, RMS degrees | offset | r | hip flexion | offset | r |\n|---|--:|--:|--:|--:|--:|--:|"
    )
    seen = [("all four, operators.angles", camera.flexion(truth, Axes("z")))]
    seen += [(str(k + 1), camera.flexion(run[1][: len(truth), camera.MARKER])) for k, run in enumerate(runs)]
    for title, here in seen:
        cells = []
        for name, coordinate in (("Knee", "knee_angle"), ("Hip", "hip_flexion")):
            off_by = np.array([here[f"{s.upper()}{name}.flexion"] - theirs[f"{coordinate}_{s}"] for s in "lr"])
            r = min(pearson(here[f"{s.upper()}{name}.flexion"], theirs[f"{coordinate}_{s}"]) for s in "lr")
            cells += [
                f"{np.sqrt(np.nanmean(off_by**2)):.1f}",
                f"{np.sqrt(np.nanvar(off_by, axis=1).mean()):.1f}",
                f"{r:.2f}",
            ]
        print(f"| {title} | {' | '.join(cells)} |")


def smoothed(places: np.ndarray) -> np.ndarray:
    """Without gaps, and below 6 Hz at 60 Hz, as the package pose2sim does."""
    from scipy.signal import butter, sosfiltfilt

    flat = places.reshape(len(places), -1).copy()
    for column in flat.T:
        there = np.isfinite(column)
        column[~there] = np.interp(np.flatnonzero(~there), np.flatnonzero(there), column[there])
    return np.asarray(sosfiltfilt(butter(4, 6.0, fs=60.0, output="sos"), flat, axis=0).reshape(places.shape))


def pearson(a: np.ndarray, b: np.ndarray) -> float:
    there = np.isfinite(a) & np.isfinite(b)
    return float(np.corrcoef(a[there], b[there])[0, 1])


def main() -> None:
    given = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    given.add_argument("--pose2sim", type=Path, required=True)
    given.add_argument("--camera", action="store_true")
    given.add_argument("--width", type=int, default=544)
    given.add_argument("--height-m", type=float, default=1.75)
    chosen = given.parse_args()
    try:
        import opensim
    except ImportError:
        print("opensim is not installed: there is nothing to compare with (pip install opensim)")
        return
    opensim.Logger.setLevelString("Error")
    setup = chosen.pose2sim / "OpenSim_Setup"
    for title, (file, names, axes, hips) in RECORDINGS.items() if not chosen.camera else ():
        rate, markers, by_name = recorded(Path(os.environ["KINEGRAPH_DATA"]) / "files" / "c3d" / file, names, axes)
        spines = length(markers, "LASI", "RASI")
        apart = length(by_name, *hips) if hips[0] else 2 * (0.33 * spines + 0.0073)
        compare(opensim, setup, title, rate, markers, apart)
    if chosen.camera:
        from_one_camera(opensim, chosen.pose2sim, chosen.width, chosen.height_m)


if __name__ == "__main__":
    main()
