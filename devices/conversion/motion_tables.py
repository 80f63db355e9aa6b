"""Markers, analogue channels and events as C3D; markers as OpenSim's .trc, a signal as its .mot or .sto."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from kinegraph.devices.formats.exporter import Export, Exporter, Written
from kinegraph.devices.formats.whole_streams import Gathered, GriddedStream, events_of, gather, on_grids, the_one
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.domain.axes import BODY, USUAL_FORWARD, Axes
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.system.atomic_file import complete, private_folder
from kinegraph.stream.system.extras import optional
from kinegraph.stream.text.safe_text import say

MAX_FRAMES = 65_535
MAX_EVENTS = 255
NEAR = 1e-6
CONTACTS = {"touchdown": "Foot Strike", "liftoff": "Foot Off"}
"""What other programs call the events of a foot."""
PLANES = {
    "flexion": 0, "tilt": 0, "plane": 0, "adduction": 1, "obliquity": 1, "lateral": 1, "elevation": 1, "rotation": 2,
}  # fmt: skip
"""Which of a joint's three numbers an angle is."""


def _c3d(wanted: Export) -> list[Written]:
    ezc3d = optional("ezc3d", "a C3D file", "pip install ezc3d (for ARM there is no wheel)", RecordingError)

    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    streams = gather(wanted)
    markers = [one for one in streams if one.is_markers and one.spec.rate_hz]
    signals = [one for one in streams if one.spec.is_signal and one.spec.rate_hz and len(one.time)]
    if not markers and not signals:
        raise RecordingError("a C3D file holds markers and signals of a regular rate; there is nothing of that kind")
    shown = [the_one(markers, "a C3D file", "markers")] if markers else []
    grids = on_grids([*shown, *signals], resample=wanted.resample)
    frame_rate, start, points = (grids[0].rate_hz, grids[0].start, grids[0].data) if shown else _no_points(grids)
    angles = [
        grid for grid in grids[len(shown) :] if _is_angles(grid) and abs(grid.rate_hz - frame_rate) < NEAR * frame_rate
    ]
    made = ezc3d.c3d()
    made["parameters"]["POINT"]["RATE"]["value"] = [frame_rate]
    frames = points.shape[0]
    if frames > MAX_FRAMES:
        raise RecordingError(f"{frames} frames: a C3D file counts {MAX_FRAMES}; export parts of the recording")
    labels = markers[0].labels if markers else []
    made["parameters"]["POINT"]["LABELS"]["value"] = labels
    made["parameters"]["POINT"]["UNITS"]["value"] = [markers[0].spec.units[0] or "mm"] if markers else ["mm"]
    if markers and (axes := Axes.of(markers[0].spec)):
        if axes.left_handed:
            points, axes = _turned(points, axes), BODY
        for name, way in (("X_SCREEN", axes.forward or USUAL_FORWARD[axes.up]), ("Y_SCREEN", axes.up)):
            made.add_parameter("POINT", name, [f"+{way}".upper().replace("+-", "-")])
    if angles:
        points, labels = _with_angles(made, points, labels, angles, start)
    held = np.ones((4, len(labels), frames))
    held[:3] = points.transpose(2, 1, 0) if labels else 0.0
    made["data"]["points"] = held
    made["data"]["meta_points"]["residuals"] = np.where(np.isnan(held[:3]).any(axis=0), -1.0, 0.0)[None]
    analogs = [grid for grid in grids[len(shown) :] if all(grid is not one for one in angles)]
    _analogs(made, analogs, frame_rate, start, frames)
    _c3d_events(made, streams, start)
    with complete(wanted.place) as draft, TemporaryDirectory() as folder:
        made.write(str(copy := Path(folder, "made.c3d")))
        draft.write_bytes(copy.read_bytes())
    taken = [*markers, *signals, *(one for one in streams if one.spec.is_event)]
    return [(one.name, wanted.place, len(one.time)) for one in taken]


def _is_angles(grid: GriddedStream) -> bool:
    """Angles of joints, as operators.angles names them: "LKnee.flexion"."""
    return grid.stream.spec.units == ("deg",) and all(
        label.rpartition(".")[2] in PLANES for label in grid.stream.labels
    )


def _with_angles(
    made: Any, points: Samples, labels: list[str], angles: list[GriddedStream], start: int
) -> tuple[Samples, list[str]]:
    """Points (n, m, 3) with angles beside the markers, as laboratories' programs write them: one point LKneeAngles of three degrees."""
    joints = list(dict.fromkeys(label.rpartition(".")[0] for grid in angles for label in grid.stream.labels))
    added = np.zeros((len(points), len(joints), 3))
    for grid in angles:
        into, of = _overlap(grid, start, len(points))
        for k, label in enumerate(grid.stream.labels):
            joint, _, angle = label.rpartition(".")
            part = added[:, joints.index(joint), PLANES[angle]]
            part[:] = np.nan
            part[into] = grid.data[of, k]
    names = [f"{joint}Angles" for joint in joints]
    made.add_parameter("POINT", "ANGLES", names)
    made.add_parameter("POINT", "ANGLE_UNITS", ["deg"])
    made["parameters"]["POINT"]["LABELS"]["value"] = [*labels, *names]
    return np.concatenate([points, added], axis=1), [*labels, *names]


def _overlap(grid: GriddedStream, start: int, count: int) -> tuple[slice, slice]:
    """The samples of `count` from `start` on that the grid has, and where it has them; both are empty if it has none of them."""
    shift = round((grid.start - start) * grid.rate_hz / NS)
    first = min(max(0, shift), count)
    end = max(first, min(count, shift + len(grid.data)))
    if end == first:
        say(f"{grid.stream.name}: no sample is within the time of the file's frames; the file holds no value of it")
    return slice(first, end), slice(first - shift, end - shift)


def _no_points(signals: list[GriddedStream]) -> tuple[float, int, Samples]:
    """Frames for signals alone: as many samples to a frame as it takes to count the frames."""
    finest = max(signals, key=lambda grid: grid.rate_hz)
    per = -(-len(finest.data) // MAX_FRAMES)
    return finest.rate_hz / per, finest.start, np.zeros((-(-len(finest.data) // per), 0, 3))


def _analogs(made: object, signals: list[GriddedStream], frame_rate: float, start: int, frames: int) -> None:
    """All signals at the one rate that C3D has, which must be a multiple of the frames'; 0 where nothing was measured."""
    if not signals:
        return
    rates = {grid.rate_hz for grid in signals}
    per = round(max(rates) / frame_rate)
    if len(rates) > 1 or per < 1 or abs(max(rates) - per * frame_rate) > NEAR * max(rates):
        listed = ", ".join(f"{grid.stream.name} {grid.rate_hz:g} Hz" for grid in signals)
        raise RecordingError(
            f"a C3D file has one rate for signals, a multiple of the frames' {frame_rate:g} Hz; choose with --stream ({listed})"
        )
    data = np.zeros((1, sum(len(grid.stream.labels) for grid in signals), frames * per))
    labels: list[str] = []
    units: list[str] = []
    for grid in signals:
        one = grid.stream
        into, of = _overlap(grid, start, data.shape[2])
        data[0, len(labels) : len(labels) + len(one.labels), into] = np.nan_to_num(grid.data[of]).T
        labels += one.labels
        units += [one.spec.units[0]] * len(one.labels) if len(one.spec.units) == 1 else list(one.spec.units)
    parameters = made["parameters"]["ANALOG"]  # type: ignore[index]
    parameters["RATE"]["value"] = [frame_rate * per]
    parameters["LABELS"]["value"], parameters["UNITS"]["value"] = labels, units
    made["data"]["analogs"] = data  # type: ignore[index]


def _c3d_events(made: object, streams: list[Gathered], start: int) -> None:
    """Events, with the leg where they have one; numbers of single channels (a row each per cycle) are no events and would fill the list."""
    kept = [one for one in streams if not {"number", "name"} <= set(one.spec.dtype.names or ())]
    for onset, _, label, side in _by_limb(kept)[:MAX_EVENTS]:
        seconds = (onset - start) / NS
        plain = re.sub(rf"(?i)^{side}\s+", "", label) if side else label
        plain = CONTACTS.get(plain, plain) if side else plain
        time = [int(seconds // 60), seconds % 60]
        made.add_event(time=time, context=side.capitalize() or "General", label=plain)  # type: ignore[attr-defined]


def _by_limb(streams: list[Gathered]) -> list[tuple[int, int | None, str, str]]:
    """`events_of` these streams, those of both legs with the leg of each event."""
    parts = []
    for one in streams:
        limbs = one.data["limb"] if "limb" in (one.spec.dtype.names or ()) else None
        for limb in [None] if limbs is None else sorted(set(limbs.tolist())):
            mine = slice(None) if limb is None else limbs == limb
            part = replace(one, time=one.time[mine], data=one.data[mine])
            found = events_of([part])
            parts += [(*event[:3], limb) if limb in ("left", "right") else event for event in found]
    return sorted(parts, key=lambda event: event[0])


def _turned(points: Samples, axes: Axes) -> Samples:
    """Points (n, m, 3) with y up and z forward."""
    columns, signs = axes.to(BODY)
    return np.asarray(points[..., columns] * signs)


def _trc(wanted: Export) -> list[Written]:
    """OpenSim's markers have y up; where the stream declares its axes, they are turned to that."""
    one = the_one([s for s in gather(wanted) if s.is_markers], "a .trc file", "markers")
    grid = on_grids([one], resample=wanted.resample)[0]
    rate, start, points = grid.rate_hz, grid.start, grid.data
    if axes := Axes.of(one.spec):
        points = _turned(points, axes)
    labels = [re.sub(r"\s+", "_", label) for label in one.labels]
    unit = one.spec.units[0] or "m"
    lines = [
        f"PathFileType\t4\t(X/Y/Z)\t{wanted.place.name}",
        "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames",
        f"{rate:.10g}\t{rate:.10g}\t{len(points)}\t{len(labels)}\t{unit}\t{rate:.10g}\t1\t{len(points)}",
        "Frame#\tTime\t" + "\t\t\t".join(labels) + "\t\t",
        "\t\t" + "\t".join(f"{axis}{k + 1}" for k in range(len(labels)) for axis in "XYZ"),
        "",
    ]
    offset = (start - wanted.origin) / NS
    for i, row in enumerate(points.reshape(len(points), -1)):
        cells = "\t".join("" if np.isnan(value) else f"{value:.10g}" for value in row)
        lines.append(f"{i + 1}\t{offset + i / rate:.9g}\t{cells}")
    return _written(wanted, one, lines)


def _storage(wanted: Export) -> list[Written]:
    one = the_one([s for s in gather(wanted) if s.spec.is_signal], "a storage file", "numbers")
    labels = [re.sub(r"\s+", "_", label) for label in one.labels]
    degrees = "yes" if "deg" in one.spec.units else "no"
    seconds = (one.time - wanted.origin) / NS
    title = "Coordinates" if degrees == "yes" else Path(wanted.place).stem
    lines = [
        title,
        "version=1",
        f"nRows={len(one.time)}",
        f"nColumns={len(labels) + 1}",
        f"inDegrees={degrees}",
        "",
        "endheader",
    ]
    lines.append("\t".join(["time", *labels]))
    lines += [
        "\t".join([f"{t:.9g}", *("nan" if np.isnan(v) else f"{v:.10g}" for v in row)])
        for t, row in zip(seconds, one.data, strict=True)
    ]
    return _written(wanted, one, lines)


def _written(wanted: Export, one: Gathered, lines: list[str]) -> list[Written]:
    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    with complete(wanted.place) as draft:
        draft.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return [(one.name, wanted.place, len(one.time))]


C3D = Exporter("markers, signals of one rate and events", ".c3d", _c3d)
TRC = Exporter("markers for OpenSim", ".trc", _trc)
STO = Exporter("a signal for OpenSim", ".sto", _storage)
MOT = Exporter("a signal for OpenSim", ".mot", _storage)
