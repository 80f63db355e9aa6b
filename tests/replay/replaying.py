"""What the files of this folder share: arrays made streams, and plain signal processing by scipy to hold the graphs against."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import butter, sosfilt, sosfiltfilt, welch

import kinegraph as kg
from kinegraph.devices.people.bedroom import Bedroom, Extras, prepare
from kinegraph.devices.people.night import NightPlan, plan
from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.recording.series import write_recording
from tests.support.real import real_arrays

ONSET = np.dtype([("onset", "<i8")])


def signal(
    data: Array,
    rate_hz: float | None,
    channels: Iterable[str] = (),
    units: Sequence[str] = (),
    *,
    time_s: Array | None = None,
    start_s: float = 0.0,
    **meta: Any,
) -> kg.Series:
    """Samples (n, ...) as a stream; stamps are `time_s`, or run evenly from `start_s`."""
    seconds = start_s + np.arange(len(data)) / (rate_hz or 1.0) if time_s is None else time_s
    data = np.ascontiguousarray(data, data.dtype if data.dtype == np.uint16 else np.float64)
    spec = kg.StreamSpec(data.shape[1:], data.dtype, rate_hz, tuple(channels), tuple(units) or ("",), meta=meta)
    return kg.Series("", spec, np.round(seconds * NS).astype(np.int64), data)


def events(seconds: Sequence[float] | Array, **meta: Any) -> kg.Series:
    """Moments as a stream of events, each stamped when it happens."""
    onset = np.round(np.asarray(seconds, float) * NS).astype(np.int64)
    return kg.Series("", kg.StreamSpec((), ONSET, units=("ns",), meta=meta), onset, onset.view(ONSET))


def footswitch(touchdown_s: Array, liftoff_s: Array, rate_hz: float, until_s: float, start_s: float = 0.0) -> Array:
    """What a switch under the foot shows at an even rate (n, 1): 1 from each touch-down to the next lift-off."""
    seconds = start_s + np.arange(int((until_s - start_s) * rate_hz)) / rate_hz
    down, up = np.searchsorted(touchdown_s, seconds, "right"), np.searchsorted(liftoff_s, seconds, "right")
    first = np.searchsorted(liftoff_s, touchdown_s[0])
    return (down > up - first).astype(float)[:, None]


def cycles_last_as_long_as_the_files(cycles: kg.Series, touchdown_s: Array, within_s: float) -> None:
    """Every cycle that was reported ends where the file's own touch-downs say; none is missed behind the first two."""
    accepted = cycles.data[cycles.data["rejected"] == ""]
    onsets = accepted["onset"] / NS
    nearest = np.abs(onsets[:, None] - touchdown_s).min(axis=1)
    assert nearest.max() < within_s
    strides = np.diff(touchdown_s)[np.abs(onsets[:, None] - touchdown_s[:-1]).argmin(axis=1)]
    np.testing.assert_allclose(accepted["duration_s"], strides, atol=2 * within_s)
    assert len(accepted) >= len(touchdown_s) - 3


def emg_envelope(emg: Array, rate_hz: float, cutoff_hz: float = 20.0) -> Array:
    """The textbook envelope of raw EMG (n, c): high-pass 20 Hz, rectify, low-pass; both filters forth and back."""
    high = butter(2, 20.0, "highpass", fs=rate_hz, output="sos")
    low = butter(4, cutoff_hz, fs=rate_hz, output="sos")
    return np.asarray(sosfiltfilt(low, np.abs(sosfiltfilt(high, emg, axis=0)), axis=0))


def highpassed(emg: Array, rate_hz: float) -> Array:
    """Raw EMG (n, c) without the electrodes' offset: a Butterworth high-pass of 20 Hz, fourth order, once."""
    return np.asarray(sosfilt(butter(4, 20.0, "highpass", fs=rate_hz, output="sos"), emg, axis=0))


def at(series: kg.Series, seconds: Array, values: Array) -> Array:
    """A reference `values` (n, c) at `seconds`, read at a stream's own stamps."""
    own = series.time / NS
    return np.stack([np.interp(own, seconds, column) for column in np.reshape(values, (len(values), -1)).T], axis=1)


WALKING, TURNING = 2, 3


@cache
def pocket_walks(person: str) -> tuple[Array, Array, Array]:
    """The trials of somebody with a phone in the pocket, joined: s (n,), accelerations and turning rates (n, 6), labels (n,).

    In each trial the person sits, stands up, walks 3 m, turns, walks back and sits down; each sample's label says which (GeoTec; CC BY).
    """
    file, end = real_arrays(f"steps/imu_geotec_{person}.npz"), 0.0
    parts = []
    for trial in sorted(key.removesuffix("_imu") for key in file if key.startswith("sp_") and key.endswith("_imu")):
        seconds = (file[f"{trial}_t_ms"] - file[f"{trial}_t_ms"][0]) / 1e3 + end
        parts.append((seconds, file[f"{trial}_imu"].astype(float), file[f"{trial}_label"]))
        end = seconds[-1] + 0.01
    seconds, imu, labels = (np.concatenate(column) for column in zip(*parts, strict=True))
    return seconds, imu, labels


def evenly(seconds: Array, values: Array, rate_hz: float) -> tuple[Array, Array]:
    """Samples (n, c) with bursty stamps, as of a regular stream: its seconds and values."""
    even = np.arange(seconds[0], seconds[-1], 1 / rate_hz)
    return even, np.stack(
        [np.interp(even, seconds, column) for column in np.reshape(values, (len(values), -1)).T], axis=1
    )


def steps_per_s(person: str) -> float:
    """How often somebody steps while walking: where the spectrum of the acceleration's size has its peak."""
    seconds, imu, labels = pocket_walks(person)
    even, size = evenly(seconds, np.linalg.norm(imu[:, :3], axis=1), 100.0)
    size = size[labels[np.searchsorted(seconds, even)] == WALKING, 0]
    f, power = welch(size - size.mean(), 100.0, nperseg=400)
    band = (f > 1.2) & (f < 3.0)
    return float(f[band][power[band].argmax()])


CMU_NAMES = {"hip_center": "root", "spine": "lowerback", "shoulder_center": "lowerneck", "head": "head"} | {
    f"{part}_{side}": f"{side}{bone}"
    for side in "lr"
    for part, bone in {
        "shoulder": "clavicle", "elbow": "humerus", "wrist": "radius", "hand": "hand",
        "hip": "hipjoint", "knee": "femur", "ankle": "tibia", "foot": "toes",
    }.items()
}  # fmt: skip
"""Where CMU's bones end, by the names of a Kinect's joints and of markers."""


def cmu_joints(name: str, wanted: Iterable[str]) -> Array:
    """Some joints (frames, joints, 3) of a CMU sequence at 30 Hz, in m: x to the left, y up, z forwards."""
    file = real_arrays(f"segmentation/mocap6/{name}.npz")
    names = file["joint_names"].tolist()
    return np.asarray(file["joints_mm"][:, [names.index(CMU_NAMES[joint]) for joint in wanted]] / 1000.0)


NIGHT_HZ = 2.0


@cache
def bedroom_night(sleepers: int, first: int, epochs: int) -> tuple[Array, tuple[NightPlan, ...]]:
    """Depth frames of a simulated bedroom, and what happens in it, along epochs of a real hypnogram (Walch 2019; PhysioNet).

    The bed is empty for 3 min before and 2 min afterwards.
    """
    numbered = real_arrays("sleep/psg_hypnograms_walch2019.npz")["subj00_stage"][first : first + epochs]
    stages = tuple({0: "W", 1: "N1", 2: "N2", 3: "N3", 5: "R"}[int(stage)] for stage in numbered)
    plans = tuple(plan(stages, evening_s=180.0 + 40 * k, morning_s=120.0, exits=0, seed=k + 1) for k in range(sleepers))
    prepare()
    room = Bedroom(160, 120, plans, extras=Extras(pet=False, lamp=False, invalid=0.1), seed=1)
    frames = range(round(max(each.length_s for each in plans) * NIGHT_HZ))
    return np.array([room.frame(i, i / NIGHT_HZ) for i in frames]), plans


def recording(path: Path, streams: Mapping[str, kg.Series]) -> Path:
    """Write streams as a recording: what a graph needs that is fed by switches, too, which arrays cannot stand in for."""
    named = [replace(series, name=name) for name, series in streams.items()]
    write_recording(path, named, {"graph": "", "session": {}}, chunk_s=1.0)
    return path


def pressed(moments_s: Sequence[float], states: Sequence[bool]) -> kg.Series:
    """A switch: when it was put on or off."""
    states_of = np.array([(state,) for state in states], [("on", "?")])
    return kg.Series(
        "", kg.StreamSpec((), states_of.dtype), np.round(np.array(moments_s) * NS).astype(np.int64), states_of
    )


CAMERA_HZ = 30.0


@cache
def performance(seconds: float) -> tuple[Array, Array]:
    """A simulated performer before a depth camera, in a room that is empty at first: frames in mm, and where POINTS are in m."""
    performer, frames = RenderedPerformer(320, 200), range(round(seconds * CAMERA_HZ))
    depth = np.array([performer.frame(i, i / CAMERA_HZ) for i in frames])
    return depth, np.array([performer.joints(i / CAMERA_HZ) for i in frames])


def no_images(graph: kg.Graph, edge: str) -> kg.Series:
    """A camera without any grey image: what remains is depth."""
    spec = graph.specs[edge]
    return kg.Series("", spec, np.empty(0, np.int64), np.empty((0, *spec.shape), spec.dtype))


def period_s(joints: np.ndarray) -> float:
    """The lag of 0.5 to 4.5 s at which the wrists' and ankles' heights are most like themselves."""
    chosen = [k for k, name in enumerate(POINTS) if name.endswith(("wrist", "ankle"))]
    y = joints[:, chosen, 1] - joints[:, chosen, 1].mean(axis=0)
    lags = np.arange(round(0.5 * CAMERA_HZ), round(4.5 * CAMERA_HZ))
    return float(lags[np.argmax([(y[k:] * y[:-k]).sum() / (len(y) - k) for k in lags])] / CAMERA_HZ)
