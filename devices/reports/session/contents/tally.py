"""What a session's report needs to remember of the streams it hears: bounded, whatever the session's length, and plain arrays."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.reports.session.contents import each_burst
from kinegraph.devices.reports.session.contents.cycle_store import CycleStore
from kinegraph.devices.reports.session.contents.groups import Groups
from kinegraph.devices.reports.session.contents.peaks import Peaks
from kinegraph.devices.reports.session.contents.remarks import Remarks
from kinegraph.devices.reports.session.contents.revisions import ACCEPTED, Revisable
from kinegraph.devices.reports.session.contents.running import Choice, Running
from kinegraph.stream.chunk import Array, Chunk, Samples, Specs, StreamSpec, Times, add_lost

REJECTION = np.dtype([("onset", "<i8"), ("duration_s", "<f8"), ("reason", "<U32")])
NOTICED = np.dtype([("onset", "<i8"), ("over", "<i8"), ("port", "<U16"), ("subject", "<U16"), ("what", "<U64")])
"""An alarm: since when, until when (0: it lasts), with whom, and what."""
LISTED = 200
"""At most this many rejected cycles are listed, and single curves kept."""
GAIT = ("cadence", "duration_s", "stance_pct")
UNSEEN = -1


ALARM_PORTS = ("electrodes", "contacts", "changes", "channels", "patterns", "timing", "markers")
"""The inputs that bring alarms."""


@dataclass(slots=True)
class Tally:
    """
    started, ended   first and last stamp seen (ns); -1: not yet
    accepted         how many cycles
    reasons, counts  why cycles were rejected, and how often each
    rejections       (200,) the first of them
    gait             (3,) cadence, duration and stance of accepted cycles
    curve            (100, m) of accepted cycles
    single           some of them
    fields           per number of a muscle in a cycle: (m,)
    overall          (fields, m) the latest numbers of each muscle over all cycles
    repeatable       per muscle, the likeness of its cycles
    flags, remarks   per muscle, the electrode's flag over the whole session, and why
    windows          (2, m) how many windows were judged, and how many of them were not good; trouble: why the latest was not
    pairs            (p,) the latest co-contraction over all cycles; pair_names
    recent           the latest cycles, which may be reported again; revised: how often one was
    alarms           (200,) the first alarms; alarmed: how many in all
    heard            (ports, 3) samples, gaps, samples lost (-1: not known) per port
    groups           the same by limb and by stage;  peaks: mixtures of activation peaks
    typed            what a person typed during the session
    each_burst       every burst of the latest cycles;  frequencies: each cycle's median frequency;  slopes (m,): the latest, %/min
    norms            (2, 100, m) normative bands, low and high; NaN where unknown
    """

    started: int
    ended: int
    accepted: int
    reasons: list[str]
    counts: list[int]
    rejections: Array
    gait: Running
    curve: Running
    single: Choice
    fields: list[Running]
    overall: Samples
    repeatable: list[str]
    flags: list[str]
    remarks: list[str]
    windows: Times
    trouble: list[str]
    pairs: list[float]
    pair_names: list[str]
    recent: Revisable
    revised: int
    alarms: Array
    alarmed: int
    heard: Times
    groups: Groups
    peaks: Peaks
    typed: Remarks
    each_burst: CycleStore
    frequencies: CycleStore
    slopes: Samples
    norms: Samples

    @property
    def rejected(self) -> int:
        return sum(self.counts)


def numbers(spec: StreamSpec | None) -> list[str]:
    """The fields of a muscle's events that hold measurements."""
    if spec is None:
        return []
    return [name for name in spec.channels if spec.dtype[name].kind == "f"]


def nothing_yet(specs: Specs) -> Tally:
    """An empty tally for these inputs."""
    shape = specs["cycles"].shape
    statistics = specs.get("statistics")
    fields = [Running.of((shape[1],), 100.0 if name == "peak_pct" else 0.0) for name in numbers(statistics)]
    return Tally(
        started=UNSEEN,
        ended=UNSEEN,
        accepted=0,
        reasons=[],
        counts=[],
        rejections=np.zeros(LISTED, REJECTION),
        gait=Running.of((len(GAIT),)),
        curve=Running.of(shape),
        single=Choice.of(LISTED, shape),
        fields=fields,
        overall=np.full((len(numbers(specs.get("muscles"))), shape[1]), np.nan),
        repeatable=[""] * shape[1],
        flags=[""] * shape[1],
        remarks=[""] * shape[1],
        windows=np.zeros((2, shape[1]), np.int64),
        trouble=[""] * shape[1],
        pairs=[],
        pair_names=[],
        recent=Revisable.empty(len(GAIT), shape, len(fields)),
        revised=0,
        alarms=np.zeros(LISTED, NOTICED),
        alarmed=0,
        heard=np.zeros((len(specs), 3), np.int64),
        groups=Groups.empty(specs),
        peaks=Peaks(),
        typed=Remarks.empty(),
        each_burst=CycleStore.empty(len(each_burst.VALUES)),
        frequencies=CycleStore.empty(1),
        slopes=np.full(shape[1], np.nan),
        norms=np.full((2, *shape), np.nan),
    )


def add_chunk(tally: Tally, specs: Specs, port: str, chunk: Chunk) -> None:
    """Take a chunk from an input."""
    n = len(chunk)
    if not n:
        return
    if port == "annotations":
        for row in chunk.data:
            tally.typed.add(int(row["onset"]), str(row["text"]))
        return
    if tally.started == UNSEEN:
        tally.started = int(chunk.time[0])
    tally.ended = max(tally.ended, int(chunk.time[-1]))
    heard = tally.heard[list(specs).index(port)]
    heard[0] += n
    if chunk.lost:
        heard[1] += 1
        heard[2] = add_lost(int(heard[2]), chunk.lost)
    if port == "closed":
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            _take_out(tally, int(row["number"]))
            _closed(tally, row, stamp)
            tally.typed.closed(row)
    elif port == "cycles":
        for stamp, curve in zip(chunk.time.tolist(), chunk.data, strict=True):
            k = tally.recent.awaiting(stamp)
            if k is not None:
                tally.recent.curves[k] = curve
                tally.curve.add(curve)
                tally.groups.curve(k, curve)
                tally.single.add(curve, int(tally.recent.numbers[k]))
    elif port == "statistics":
        _statistics(tally, numbers(specs[port]), chunk.data)
    elif port == "muscles":
        for i, name in enumerate(numbers(specs[port])):
            tally.overall[i, chunk.data["muscle"]] = chunk.data[name]
        for row in chunk.data:
            tally.repeatable[int(row["muscle"])] = str(row["verdict"])
    elif port == "pairs":
        for row in chunk.data:
            _pair(tally, row)
    elif port in ALARM_PORTS:
        for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
            _alarm(tally, port, stamp, row)
    elif port in ("footfalls", "gait", "symmetry", "bursts", "active"):
        tally.groups.add(port, chunk.data)
    elif port == "each_burst":
        for row in chunk.data:
            tally.each_burst.add(
                int(row["number"]), int(row["muscle"]), [float(row[name]) for name in each_burst.VALUES]
            )
    elif port == "frequency":
        for row in chunk.data:
            _frequency(tally, row, specs["cycles"].channels)
    elif port in ("modes", "distance"):
        tally.peaks.add(port, chunk.data)
    elif port in ("low", "high"):
        tally.norms[int(port == "high")] = chunk.data[-1]
    elif port == "quality":
        for row in chunk.data:
            _quality(tally, row, specs["cycles"].channels)


def _closed(tally: Tally, row: Any, stamp: int) -> None:
    reason = str(row["rejected"])
    if not reason:
        k = tally.recent.note(row, stamp, ACCEPTED)
        tally.accepted += 1
        tally.recent.gait[k] = [row[name] for name in GAIT]
        tally.gait.add(tally.recent.gait[k])
        tally.groups.closed(k, row, tally.curve.mean.shape, len(tally.fields))
        return
    if tally.rejected < LISTED:
        tally.rejections[tally.rejected] = (row["onset"], row["duration_s"], reason)
    if reason not in tally.reasons:
        tally.reasons.append(reason)
        tally.counts.append(0)
    tally.recent.note(row, stamp, tally.reasons.index(reason))
    tally.counts[tally.reasons.index(reason)] += 1


def _take_out(tally: Tally, number: int) -> None:
    """A cycle is about to be reported again: what was added up of it is taken out."""
    recent = tally.recent
    k = recent.find(number)
    if k is None:
        return
    tally.revised += 1
    tally.each_burst.forget(number)
    tally.frequencies.forget(number)
    reason = int(recent.reasons[k])
    if reason != ACCEPTED:
        listed = tally.rejections[: tally.rejected]
        left = listed[listed["onset"] != recent.onsets[k]]
        tally.rejections[: len(left)] = left
        tally.counts[reason] -= 1
        return
    tally.accepted -= 1
    tally.gait.remove(recent.gait[k])
    tally.groups.take_out(k, recent.gait[k], recent.curves[k], recent.fields[k])
    tally.curve.remove(recent.curves[k])
    tally.single.remove(number)
    for running, values in zip(tally.fields, recent.fields[k], strict=True):
        running.remove(values)


def _statistics(tally: Tally, names: list[str], rows: Array) -> None:
    """One row per cycle and muscle; every cycle's rows are added at once, field by field."""
    for number in dict.fromkeys(rows["number"].tolist()):
        here = rows[rows["number"] == number]
        k = tally.recent.find(number)
        for i, (name, running) in enumerate(zip(names, tally.fields, strict=True)):
            values = np.full(len(running.n), np.nan)
            values[here["muscle"]] = here[name]
            running.add(values)
            if k is not None:
                tally.recent.fields[k, i] = values
        if k is not None:
            tally.groups.numbers(k, tally.recent.fields[k])


def _frequency(tally: Tally, row: Any, muscles: tuple[str, ...]) -> None:
    """A muscle's median frequency in a cycle; one that is left out there does not count."""
    if row["name"] not in muscles:
        return
    i, k = muscles.index(str(row["name"])), tally.recent.find(int(row["number"]))
    if k is not None and np.isfinite(tally.recent.curves[k, 0, i]):
        tally.frequencies.add(int(row["number"]), i, [float(row["median_hz"])])
        tally.slopes[i] = row["slope_pct_per_min"]


def _alarm(tally: Tally, port: str, stamp: int, row: Any) -> None:
    """An alarm, or the end of the one about the same by the same operator."""
    kept = tally.alarms[: min(tally.alarmed, LISTED)]
    same = (kept["port"] == port) & (kept["subject"] == row["subject"])
    kept["over"][same & (kept["over"] == 0) & (row["state"] != "on")] = stamp
    if row["state"] == "on":
        if tally.alarmed < LISTED:
            tally.alarms[tally.alarmed] = (row["onset"], 0, port, row["subject"], row["what"])
        tally.alarmed += 1


def _pair(tally: Tally, row: Any) -> None:
    name = f"{row['first']} / {row['second']}"
    if name not in tally.pair_names:
        tally.pair_names.append(name)
        tally.pairs.append(float("nan"))
    tally.pairs[tally.pair_names.index(name)] = float(row["mean_pct"])


def _quality(tally: Tally, row: Any, muscles: tuple[str, ...]) -> None:
    if row["name"] not in muscles:
        return
    i = muscles.index(str(row["name"]))
    tally.flags[i], tally.remarks[i] = str(row["session_flag"]), str(row["session_reason"])
    tally.windows[0, i] += 1
    if row["flag"] != "good":
        tally.windows[1, i] += 1
        tally.trouble[i] = str(row["reason"])


def most_common(tally: Tally) -> list[tuple[str, int]]:
    """Reasons for rejection, the commonest first."""
    return [
        (reason, n) for reason, n in Counter(dict(zip(tally.reasons, tally.counts, strict=True))).most_common() if n
    ]
