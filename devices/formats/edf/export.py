"""Signals and events as EDF+ or BDF+, and a recording as a BIDS study of motion and EMG."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.formats.exporter import Export, Exporter, Written
from kinegraph.devices.formats.whole_streams import Gathered, GriddedStream, events_of, gather, on_grids
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.system.atomic_file import complete, private_folder
from kinegraph.stream.text.safe_text import say

LONGEST_RECORD_S = 60
MAX_LETTERS = 60
"""Of a subject or a task in the names of BIDS files."""
FIRST_YEAR, LAST_YEAR = 1985, 2084
VOLTAGES = ("V", "mV", "uV")


def _edf(wanted: Export) -> list[Written]:
    return _biosignals(wanted, wide=False)


def _bdf(wanted: Export) -> list[Written]:
    return _biosignals(wanted, wide=True)


def _biosignals(wanted: Export, *, wide: bool) -> list[Written]:
    wanted.refuse_existing(wanted.place)
    private_folder(wanted.place.parent)
    streams = gather(wanted)
    signals = [one for one in streams if one.spec.is_signal and one.spec.rate_hz and len(one.time)]
    if not signals:
        raise RecordingError("an EDF file holds signals of a regular rate; there is nothing of that kind")
    with complete(wanted.place) as draft:
        _write(draft, signals, [one for one in streams if one.spec.is_event], wanted, wide=wide)
    for one in streams:
        if one not in signals and not one.spec.is_event:
            say(f"{one.name}: left out (it is not a signal of a regular rate)", err=True)
    return [(one.name, wanted.place, len(one.time)) for one in streams if one in signals or one.spec.is_event]


def _write(path: Path, signals: Sequence[Gathered], events: list[Gathered], wanted: Export, *, wide: bool) -> float:
    """Write the file and return its highest rate."""
    import edfio

    grids = on_grids(signals, resample=wanted.resample)
    start = min(grid.start for grid in grids)
    record_s, rates = _record(grids)
    length = max((grid.start - start) / NS + len(grid.data) / rate for grid, rate in zip(grids, rates, strict=True))
    records = max(1, int(np.ceil(length / record_s - 1e-6)))
    made: list[Any] = []
    notes = [
        edfio.EdfAnnotation((onset - start) / NS, None if n is None else n / NS, f"{side} {text}".strip())
        for onset, n, text, side in events_of(events)
    ]
    kind = edfio.BdfSignal if wide else edfio.EdfSignal
    for grid, rate in zip(grids, rates, strict=True):
        one, data = grid.stream, grid.data
        count = round(records * record_s * rate)
        shift = round((grid.start - start) * rate / NS)
        for k, label in enumerate(one.labels):
            values = np.full(count, np.nan)
            values[shift : shift + len(data)] = data[: count - shift, k]
            notes += _gaps(edfio, values, rate, label)
            made.append(
                kind(
                    np.nan_to_num(values),
                    rate,
                    label=_ascii(label, 16),
                    physical_dimension=_ascii(_unit(one, k), 8),
                    physical_range=_range(values),
                )
            )
    moment = datetime.fromtimestamp(start / NS, UTC).replace(tzinfo=None)
    dated = FIRST_YEAR <= moment.year <= LAST_YEAR
    facts = wanted.recording.header.get("session") or {}
    whole = edfio.Bdf if wide else edfio.Edf
    whole(
        made,
        patient=edfio.Patient(code=_ascii(str(facts.get("subject", "X")).replace(" ", "_"), 40) or "X"),
        recording=edfio.Recording(startdate=moment.date() if dated else None, equipment_code="kinegraph"),
        starttime=moment.time() if dated else None,
        data_record_duration=record_s,
        annotations=sorted(note for note in notes if note.onset >= 0),
    ).write(path)
    return max(rates)


def _record(grids: Sequence[GriddedStream]) -> tuple[float, list[float]]:
    """Seconds to a record, and the rates that come of it: every rate has a whole number of samples in it. Raises RecordingError.

    The nominal rates decide about whole seconds, of which the shortest are taken. Where a rate was fitted, a record is a little shorter or
    longer, in the eight places that the header has; then the shortest that round no sample by a tenth of a period.
    """
    nominal = [grid.stream.nominal_hz for grid in grids]
    share = grids[0].rate_hz / nominal[0]
    found: list[tuple[float, float, list[float]]] = []
    for seconds in range(1, LONGEST_RECORD_S + 1):
        counts = [round(rate * seconds) for rate in nominal]
        if any(abs(rate * seconds - count) >= 1e-3 for rate, count in zip(nominal, counts, strict=True)):
            continue
        if share == 1.0:
            return seconds, nominal
        record_s = float(f"{seconds / share:.8f}"[:8])
        rates = [count / record_s for count in counts]
        moved = max(len(g.data) * abs(rate / g.rate_hz - 1) for g, rate in zip(grids, rates, strict=True))
        found.append((max(moved, 0.1), record_s, rates))
    if not found:
        listed = ", ".join(f"{rate:g}" for rate in sorted(set(nominal)))
        raise RecordingError(
            f"EDF has whole numbers of samples in records of up to {LONGEST_RECORD_S} s, which rates of {listed} Hz do not give: resample"
        )
    _, record_s, rates = min(found)
    return record_s, rates


def _range(values: Samples) -> tuple[float, float]:
    """A physical range that holds every value, in numbers that an EDF header's eight places can show."""
    peak = float(np.nanmax(np.abs(values), initial=0.0)) or 1.0
    digits = 10.0 ** (np.floor(np.log10(peak)) - 3)
    steps = np.ceil(peak / digits)
    while (most := float(f"{steps * digits:.5g}")) < peak:
        steps += 1
    return -most, most


def _gaps(edfio: Any, values: Samples, rate: float, label: str) -> list[Any]:
    """An annotation for every stretch of samples that are missing, at which the file holds zeros."""
    bad = np.concatenate([[False], np.isnan(values), [False]])
    starts, ends = np.flatnonzero(~bad[:-1] & bad[1:]), np.flatnonzero(bad[:-1] & ~bad[1:])
    return [
        edfio.EdfAnnotation(a / rate, (b - a) / rate, f"missing {label}")
        for a, b in zip(starts.tolist(), ends.tolist(), strict=True)
    ]


def _unit(one: Gathered, k: int) -> str:
    return one.spec.units[0] if len(one.spec.units) == 1 else one.spec.units[k]


def _ascii(text: str, most: int) -> str:
    return "".join(c if c.isascii() and c.isprintable() else "_" for c in text)[:most].strip()


def _bids(wanted: Export) -> list[Written]:
    """dataset_description.json, participants.tsv, sub-S/motion and sub-S/emg, as far as there is something for them."""
    if wanted.place.is_file():
        raise RecordingError(f"--out {wanted.place}: is a file; name the study's folder")
    facts = wanted.recording.header.get("session") or {}
    subject = re.sub(r"[^A-Za-z0-9]", "", str(facts.get("subject", "")))[:MAX_LETTERS] or "01"
    task = re.sub(r"[^A-Za-z0-9]", "", str(facts.get("task", "")))[:MAX_LETTERS] or "recording"
    stem = f"sub-{subject}_task-{task}"
    folder = wanted.place / f"sub-{subject}"
    streams = gather(wanted)
    markers = [one for one in streams if one.is_markers and one.spec.rate_hz and len(one.time)]
    emg = [
        one
        for one in streams
        if one.spec.is_signal
        and (one.spec.rate_hz or 0) >= 100
        and len(one.time)
        and set(one.spec.units) <= set(VOLTAGES)
    ]
    if not markers and not emg:
        raise RecordingError(
            "a BIDS study of motion or EMG takes markers, or signals in V, mV or uV; there is nothing of that kind"
        )
    events = [one for one in streams if one.spec.is_event]
    written: list[Written] = []
    for number, one in enumerate(markers):
        tracking = "kinegraph" if len(markers) == 1 else f"kinegraph{number + 1}"
        path = folder / "motion" / f"{stem}_tracksys-{tracking}_motion.tsv"
        wanted.refuse_existing(path)
        _motion(path, on_grids([one], resample=wanted.resample)[0], task, tracking, events)
        written.append((one.name, path, len(one.time)))
    if emg:
        path = folder / "emg" / f"{stem}_emg.edf"
        wanted.refuse_existing(path)
        private_folder(path.parent)
        with complete(path) as draft:
            rate = _write(draft, emg, events, wanted, wide=False)
        _emg_sidecars(path, emg, task, events, rate)
        written += [(one.name, path, len(one.time)) for one in emg]
    _study(wanted, subject, facts)
    for one in streams:
        if one not in markers and one not in emg and not one.spec.is_event:
            say(f"{one.name}: left out (neither markers nor EMG)", err=True)
    return written


def _motion(path: Path, grid: GriddedStream, task: str, tracking: str, events: list[Gathered]) -> None:
    one, rate, start, points = grid.stream, grid.rate_hz, grid.start, grid.data
    flat = points.reshape(len(points), -1)
    rows = [["n/a" if np.isnan(value) else f"{value:.10g}" for value in row] for row in flat]
    _tsv(path, rows)
    stem = path.name.removesuffix("_motion.tsv")
    channels = [
        [f"{label}_{axis}", axis, "POS", label, one.spec.units[0] or "n/a"] for label in one.labels for axis in "xyz"
    ]
    _tsv(path.parent / f"{stem}_channels.tsv", [["name", "component", "type", "tracked_point", "units"], *channels])
    about = {
        "TaskName": task, "SamplingFrequency": rate, "TrackingSystemName": tracking, "MotionChannelCount": flat.shape[1],
        "POSChannelCount": flat.shape[1], "RecordingDuration": len(points) / rate, "RecordingType": "continuous",
        "TrackedPointsCount": len(one.labels), "MissingValues": "n/a", "SpatialAxes": "n/a",
    }  # fmt: skip
    _json(path.with_suffix(".json"), about)
    _events(path.parent / f"{stem.rpartition('_tracksys')[0]}_events.tsv", events, start)


def _emg_sidecars(path: Path, emg: Sequence[Gathered], task: str, events: list[Gathered], rate: float) -> None:
    stem = path.name.removesuffix("_emg.edf")
    rows = [[_ascii(label, 16), "EMG", _unit(one, k)] for one in emg for k, label in enumerate(one.labels)]
    _tsv(path.parent / f"{stem}_channels.tsv", [["name", "type", "units"], *rows])
    about = {
        "TaskName": task, "SamplingFrequency": rate, "EMGChannelCount": len(rows), "EMGReference": "n/a", "EMGPlacementScheme": "Other",
        "EMGPlacementSchemeDescription": "n/a", "PowerLineFrequency": "n/a", "SoftwareFilters": "n/a", "RecordingType": "continuous",
    }  # fmt: skip
    _json(path.with_suffix(".json"), about)
    start = min(int(one.time[0]) for one in emg)
    _events(path.parent / f"{stem}_events.tsv", events, start)


def _events(path: Path, events: list[Gathered], start: int) -> None:
    rows = [
        [f"{(t - start) / NS:.9g}", "n/a" if n is None else f"{n / NS:.9g}", f"{side} {text}".strip()]
        for t, n, text, side in events_of(events)
    ]
    if rows:
        _tsv(path, [["onset", "duration", "trial_type"], *rows])


def _study(wanted: Export, subject: str, facts: dict[str, Any]) -> None:
    description = wanted.place / "dataset_description.json"
    if not description.exists():
        _json(
            description,
            {
                "Name": wanted.recording.path.stem,
                "BIDSVersion": "1.11.1",
                "DatasetType": "raw",
                "GeneratedBy": [{"Name": "kinegraph"}],
            },
        )
    if not (readme := wanted.place / "README").exists():
        readme.write_text("Exported from recordings by kinegraph.\n", encoding="utf-8")
    people = wanted.place / "participants.tsv"
    lines = (
        people.read_text(encoding="utf-8").splitlines() if people.exists() else ["participant_id\tage\tsex\thandedness"]
    )
    heads = lines[0].split("\t")
    row = [f"sub-{subject}", *(str(facts.get(head, "n/a")) for head in heads[1:])]
    kept = [line for line in lines[1:] if line and line.split("\t")[0] != row[0]]
    _tsv(people, [heads, *(line.split("\t") for line in kept), row])


def _tsv(path: Path, rows: Sequence[Sequence[str]]) -> None:
    private_folder(path.parent)
    with complete(path) as draft:
        draft.write_text(
            "".join("\t".join(re.sub(r"[\t\r\n]", " ", cell) for cell in row) + "\n" for row in rows), encoding="utf-8"
        )


def _json(path: Path, about: dict[str, Any]) -> None:
    private_folder(path.parent)
    with complete(path) as draft:
        draft.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")


EDF = Exporter("signals and events", ".edf", _edf)
BDF = Exporter("signals in 24 bits, and events", ".bdf", _bdf)
BIDS = Exporter("a study of motion and EMG; a folder to which recordings can be added", "_bids", _bids)
