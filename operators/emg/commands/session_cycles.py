"""The accepted cycles of a recorded session, as they stood at its end, and the mixtures of their peaks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.operators.contacts.limbs import limbs_of
from kinegraph.operators.cycles.cycle import MAXIMUM, POINTS, is_closed
from kinegraph.operators.cycles.review import JUDGED
from kinegraph.operators.emg.mixtures.emg_model import made_alike
from kinegraph.operators.emg.mixtures.operator import PeakMixtures, muscle_groups
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.reference import ReferenceFit, References
from kinegraph.stream.batch.sessions import StoredSession, name_of, open_session
from kinegraph.stream.chunk import Array, Samples, StreamSpec
from kinegraph.stream.errors import KinegraphError

MAX_CYCLES = 500
OTHER_SPEED = 0.1


@dataclass(frozen=True, slots=True)
class SessionCycles:
    """Accepted cycles of one leg.

    label      the session's name, and which cycles (the node) where it has several;  subject: as recorded
    curves     (k, 100, m), NaN where a muscle does not count in a cycle;  maxima: their peaks
    alike      what sessions must have in common to be compared
    durations_s (k,)   how long each cycle took
    limb       their limb, if the session has several;  channels: as recorded (L_TA); `muscles` are their muscles (TA)
    stages (k,)   the stage of each cycle, "" outside stages;  stage: that of all of them, "" if they differ
    """

    label: str
    subject: str
    spec: StreamSpec
    numbers: Array
    curves: Samples
    maxima: Array
    alike: dict[str, Any]
    durations_s: Samples
    stages: Array
    limb: str = ""
    channels: tuple[str, ...] = ()
    stage: str = ""

    @property
    def muscles(self) -> tuple[str, ...]:
        return self.spec.channels

    def window(self) -> PeakWindow:
        """The cycles as the operators keep them, numbered from 0."""
        window = PeakWindow.empty(max(len(self.curves), 1), len(self.muscles))
        peaks = self.maxima.copy()
        order = {int(number): k for k, number in enumerate(self.numbers)}
        keep = np.array([int(number) in order for number in peaks["number"]], bool)
        peaks = peaks[keep]
        peaks["number"] = [order[int(number)] for number in peaks["number"]]
        window.note_peaks(peaks)
        for k, curve in enumerate(self.curves):
            window.accept(k, curve)
        return window

    def references(self, mixer: PeakMixtures, pairs: int, size: int) -> tuple[References, list[str]]:
        """Every muscle's mixture of these cycles, with its limit from `pairs` of `size` random cycles and the rest, and their names."""
        group, names = muscle_groups(self.muscles, mixer.joint)
        window, made = self.window(), References.empty(len(group))
        slots = window.latest(MAX_CYCLES)
        fit = ReferenceFit.empty(len(slots), group.shape[1], pairs)
        for which, members in enumerate(group):
            size_here = min(size, len(slots) // 2)
            while not fit.go_on(window, slots, members[members >= 0], which, size_here, made, mixer.fitting()):
                pass
        return made, names


def read_sessions(path: Path, node: str = "") -> list[SessionCycles]:
    """The cycles of each leg in a recording, or a batch's job: of all nodes, or of `node`, a node or a limb. Raises KinegraphError."""
    with open_session(path) as recording:
        nodes = [
            name.removesuffix(".closed")
            for name, stream in recording.streams.items()
            if name.endswith(".closed") and is_closed(stream.spec.dtype)
        ]
        nodes = [name for name in nodes if {f"{name}.cycles", f"{name}.maxima"} <= set(recording.streams)]
        legs = [(name, limb) for name in nodes for limb in limbs_of(recording.stream(f"{name}.cycles").spec) or ("",)]
        if node:
            legs = [leg for leg in legs if node in leg]
        if not legs:
            of = f" of node {node!r}" if node else ""
            raise KinegraphError(
                f"{path}: there are no cycles{of}; record closed, cycles and maxima of operators.cycles.cycles.Cycles"
            )
        return [_read(recording, path, name, limb, len(nodes) > 1) for name, limb in legs]


def _read(recording: StoredSession, path: Path, node: str, limb: str, several: bool) -> SessionCycles:
    spec = recording.stream(f"{node}.cycles").spec
    _, closed = recording.read(f"{node}.closed")
    _, curves = recording.read(f"{node}.cycles")
    _, maxima = recording.read(f"{node}.maxima")
    if maxima.dtype != MAXIMUM or curves.ndim != 3 or curves.shape[1] != POINTS:
        raise KinegraphError(f"{path}: the cycles of {node!r} were recorded by another version")
    accepted = closed["number"][closed["rejected"] == ""]
    final = {int(row["number"]): str(row["rejected"]) for row in closed}
    curves = curves.copy()
    used = np.array([final[int(number)] == "" for number in accepted], bool)
    for name, stream in recording.streams.items():
        if stream.spec.dtype == JUDGED:
            _leave_out(recording.read(name)[1], accepted, curves, spec)
    about = recording.header.get("session") or {}
    label = " ".join([name_of(recording), *([node] if several else []), *([limb] if limb else [])])
    units = spec.units[0] if len(spec.units) == 1 else ""
    alike = {**made_alike({**spec.meta, "height_unit": units}), "cut at": "touch-down"}
    took = {int(row["number"]): float(row["duration_s"]) for row in closed}
    seconds = np.array([took[int(number)] for number in accepted[used]])
    whole = SessionCycles(
        label, str(about.get("subject", "")), spec, accepted[used], curves[used], maxima, alike, seconds,
        _stages(recording, accepted[used]),
    )  # fmt: skip
    return _of_limb(whole, limb, closed) if limb else whole


def _stages(recording: StoredSession, numbers: Array) -> Array:
    """The stage of each cycle (k,), from the recorded events; "" if they do not name it."""
    stage = {
        int(row["number"]): str(row["stage"])
        for name, stream in recording.streams.items()
        if is_closed(stream.spec.dtype) and "stage" in (stream.spec.dtype.names or ())
        for row in recording.read(name)[1]
    }
    return np.array([stage.get(int(number), "") for number in numbers], "<U32")


def _of_limb(both: SessionCycles, limb: str, closed: Array) -> SessionCycles:
    """One limb's cycles and channels, under the muscles' own names, so that they can stand beside another limb's."""
    spec, muscles = both.spec, dict(both.spec.meta.get("muscles") or {})
    mine = limbs_of(spec)[limb]
    places = np.array([spec.channels.index(name) for name in mine])
    names = [str(muscles.get(name, name)) for name in mine]
    here = np.isin(both.numbers, closed["number"][closed["limb"] == limb])
    maxima = both.maxima[np.isin(both.maxima["muscle"], places)].copy()
    maxima["muscle"] = np.array([np.flatnonzero(places == place)[0] for place in maxima["muscle"]], np.int64)
    maxima["name"] = np.array(names)[maxima["muscle"]]
    own = spec.derive(shape=(POINTS, len(names)), channels=tuple(names), units=tuple(spec.units[:1]))
    return replace(
        both,
        spec=own,
        numbers=both.numbers[here],
        curves=both.curves[here][:, :, places],
        durations_s=both.durations_s[here],
        stages=both.stages[here],
        maxima=maxima,
        limb=limb,
        channels=mine,
    )


def _leave_out(judged: Array, numbers: Array, curves: Samples, spec: StreamSpec) -> None:
    """What the review left out is NaN in its cycle; of two verdicts the later counts."""
    final = {(int(row["number"]), str(row["name"])): bool(row["used"]) for row in judged}
    for (number, name), used in final.items():
        if not used and name in spec.channels:
            curves[numbers == number, :, spec.channels.index(name)] = np.nan


def check_alike(sessions: list[SessionCycles]) -> None:
    """Raise KinegraphError where sessions were not normalised, filtered or measured alike."""
    first = sessions[0]
    for other in sessions[1:]:
        for what, value in first.alike.items():
            if other.alike[what] != value:
                raise KinegraphError(
                    f"{first.label} and {other.label} cannot be compared: {what} {value!r} against {other.alike[what]!r}; "
                    "replay one of them with the other's"
                )


def joined(sessions: list[SessionCycles]) -> SessionCycles:
    """All cycles of sessions with the same muscles as one, at most the latest 500. Raises KinegraphError."""
    first = sessions[0]
    for other in sessions[1:]:
        if other.muscles != first.muscles:
            raise KinegraphError(
                f"{first.label} has the muscles {', '.join(first.muscles)}, {other.label} {', '.join(other.muscles)}; "
                "--node chooses one leg's cycles"
            )
    numbers, maxima, since = [], [], 0
    for session in sessions:
        peaks = session.maxima.copy()
        peaks["number"] += since
        maxima.append(peaks)
        numbers.append(session.numbers + since)
        since = max(int(part.max()) for part in (numbers[-1], peaks["number"], np.array([since])) if len(part)) + 1
    label = " + ".join(session.label for session in sessions)
    curves, seconds, stages = (
        np.concatenate([getattr(s, part) for s in sessions])[-MAX_CYCLES:]
        for part in ("curves", "durations_s", "stages")
    )
    every = np.concatenate(numbers)[-MAX_CYCLES:]
    peaks = np.concatenate(maxima)
    return replace(first, label=label, numbers=every, curves=curves, maxima=peaks, durations_s=seconds, stages=stages)


def other_speeds(sessions: list[SessionCycles]) -> list[str]:
    """Warnings for sessions with cycle durations more than a tenth off the first's: the speed may differ."""
    took = [float(np.median(session.durations_s)) if len(session.durations_s) else np.nan for session in sessions]
    return [
        f"{session.label}: cycles of {mine:.2f} s, {mine / took[0]:.2f} times those of {sessions[0].label}; "
        "what differs may be the speed"
        for session, mine in zip(sessions[1:], took[1:], strict=True)
        if abs(mine / took[0] - 1.0) > OTHER_SPEED
    ]
