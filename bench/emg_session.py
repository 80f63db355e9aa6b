"""What a session's operators say of a walk: numbers of all cycles and of those left in, alarms and verdicts; for `bench.emg_faults`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.cycles.review import CycleReview
from kinegraph.operators.cycles.statistics.operator import CycleStatistics
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.operators.monitors.channel_watch import ChannelWatch
from kinegraph.operators.monitors.cycle_watch import CycleWatch
from kinegraph.operators.monitors.electrode_watch import ElectrodeWatch
from kinegraph.operators.monitors.pattern_watch import PatternWatch
from kinegraph.operators.monitors.timing_watch import TimingWatch
from kinegraph.stream.chunk import FOREVER, NS, Chunk
from kinegraph.stream.engine.flow.merge import Merge

Stream: TypeAlias = tuple[Any, Any, Any]
"""Spec, stamps, samples."""
Numbers: TypeAlias = dict[tuple[str, str], float]
"""(Name, quantity): its mean over the cycles."""
OF_A_MUSCLE = {"peak": "peak", "mean": "mean", "mean_stance": "mean in stance", "mean_swing": "mean in swing"}
HANGING, MUCH_PCT = ("mean in stance", "mean in swing"), 10.0
"""What contacts that are off change, and from what change on the report marks it."""
OF_A_CYCLE = {"stance_pct": "stance (%)", "cadence": "cadence (1/min)"}


def drive(operator: Any, inputs: dict[str, Stream], lost: Any = None) -> dict[str, Stream]:
    """An operator over whole streams, in chunks of 500; `lost`: which samples of the only input arrived."""
    specs = {port: given[0] for port, given in inputs.items()}
    outputs = operator.open(specs)
    merge, pieces = Merge(specs), []
    for port, (spec, time, data) in inputs.items():
        edges = [*range(0, len(time), 500), len(time)]
        if lost is not None:
            edges = sorted({*edges, *(np.flatnonzero(np.diff(time) > 1.5 * spec.period_ns) + 1).tolist()})
        for a, b in pairwise(edges):
            gap = a and lost is not None and time[a] - time[a - 1] > 1.5 * spec.period_ns
            until = int(time[b]) - 1 if b < len(time) else int(time[b - 1])
            pieces.append((port, Chunk(time[a:b], data[a:b], until, -1 if gap else 0)))
    pieces.sort(key=lambda piece: piece[1].time[0])
    pieces += [(port, Chunk(given[1][:0], given[2][:0], FOREVER)) for port, given in inputs.items()]
    found: dict[str, list[Chunk]] = {name: [] for name in outputs}
    for port, chunk in pieces:
        for name, piece in merge.push(port, chunk) if len(specs) > 1 else [(port, chunk)]:
            made = operator.process(name, piece)
            for output, out in [(next(iter(outputs)), made)] if isinstance(made, Chunk) else made or ():
                found[output].append(out)
    return {
        name: (outputs[name], np.concatenate([c.time for c in cs]), np.concatenate([c.data for c in cs]))
        for name, cs in found.items()
    }


@dataclass
class Outcome:
    """Numbers of all cycles, and of those left in; alarms (s, name, kind); good cycles; what the report says at the end; by how much (%)
    each muscle's means in stance and swing depend on contacts."""

    every: Numbers
    left_in: Numbers
    alarms: list[tuple[float, str, str]]
    cycles: int
    remarks: list[str]
    hang: dict[str, float]


def analysed(
    emg: Stream, feet: dict[str, Stream], here: Any = None, max_noise: float = 0.0, beside: Sequence[Stream] = ()
) -> Outcome:
    """A walk through the session's operators. `emg`: of one leg; `feet`: its touch-downs and lift-offs; `here`: which samples arrived;
    `beside`: alarms about what the feet were found by."""
    quality = drive(SignalQuality(max_noise=max_noise), {"in": emg}, here)["out"]
    envelope = drive(Envelope(), {"in": emg}, here)["out"]
    cycles = drive(Cycles(), {"signal": envelope, **feet})
    both = {name: cycles[name] for name in ("closed", "cycles")}
    kept = drive(CycleReview(), {"quality": quality, **both})
    left = {name: kept[name] for name in ("closed", "cycles")}
    watched = [
        drive(ElectrodeWatch(), {"in": quality})["out"],
        drive(ChannelWatch(), {"in": emg}, here)["out"],
        drive(CycleWatch(), {"signal": envelope, "closed": cycles["closed"]})["out"],
        drive(PatternWatch(), left)["out"],
        drive(TimingWatch(), left)["out"],
        *beside,
    ]
    alarms = [
        (stamp / NS, str(row["subject"]), str(row["what"]))
        for _, stamps, rows in watched
        for stamp, row in zip(stamps.tolist(), rows, strict=True)
        if row["state"] == "on"
    ]
    last = len(emg[0].channels)
    remarks = [f"{r['name']} {r['session_flag']}" for r in quality[2][-last:] if r["session_flag"] != "good"]
    judged = {(int(row["number"]), str(row["name"])): int(row["used"]) for row in kept["judged"][2]}
    out = sum(used == 0 for used in judged.values())
    remarks += [f"{out} cycles of a muscle left out"] if out else []
    closed = {int(row["number"]): str(row["rejected"]) for row in left["closed"][2]}
    rejected = [reason for reason in closed.values() if reason]
    remarks += [f"{len(rejected)} cycles rejected: {', '.join(sorted(set(rejected)))}"] if rejected else []
    rows = drive(CycleStatistics(), left)["out"][2]
    hang = {name: _mean(rows["contact_pct"][rows["name"] == name]) for name in left["cycles"][0].channels}
    return Outcome(_numbers(both), _numbers(left), sorted(alarms), len(closed) - len(rejected), remarks, hang)


def _numbers(streams: dict[str, Stream]) -> Numbers:
    """Means over the accepted cycles; a cycle that was reported again counts as it was last."""
    closed = {int(row["number"]): row for row in streams["closed"][2]}
    good = [row for row in closed.values() if not row["rejected"]]
    result = next(iter(drive(CycleStatistics(), streams).values()))[2]
    rows = {(int(row["number"]), str(row["name"])): row for row in result if not closed[int(row["number"])]["rejected"]}
    made = {("", name): _mean(row[field] for row in good) for field, name in OF_A_CYCLE.items()}
    for muscle in streams["cycles"][0].channels:
        mine = [row for (_, name), row in rows.items() if name == muscle]
        made.update({(muscle, name): _mean(row[field] for row in mine) for field, name in OF_A_MUSCLE.items()})
    return made


def _mean(values: Iterable[float]) -> float:
    known = np.array([float(v) for v in values])
    known = known[np.isfinite(known)]
    return float(known.mean()) if len(known) else np.nan


def table_row(name: str, begin_s: float, now: Outcome, whole: Outcome) -> tuple[str, ...]:
    """What noticed a fault, after how long; the number that it changed most, without it and with it (all cycles, those left in); cycles."""
    known = {(who, what) for _, who, what in whole.alarms}
    first = next(((t, who, what) for t, who, what in now.alarms if t >= begin_s and (who, what) not in known), None)
    noticed = (
        f"{first[1]}: {first[2]}"
        if first
        else "; ".join(s for s in now.remarks if s not in whole.remarks) or ("-" if now is whole else "not")
    )
    after = f"{first[0] - begin_s:.1f} s" if first else "at the end" if noticed not in ("-", "not") else "-"
    changes = {
        key: max(_change(now.every[key], before), _change(now.left_in[key], before))
        for key, before in whole.every.items()
    }
    key = max(changes, key=lambda k: changes[k])
    if noticed == "not" and key[1] in HANGING and now.hang[key[0]] > MUCH_PCT and changes[key] > MUCH_PCT / 100:
        noticed, after = f"{key[0]}: marked, {now.hang[key[0]]:.0f} % for 20 ms", "at the end"
    cells = (_told(made[key], whole.every[key]) for made in (now.every, now.left_in))
    return name, noticed, after, " ".join(key).strip(), f"{whole.every[key]:.3g}", *cells, str(now.cycles)


def _change(now: float, before: float) -> float:
    return abs(now / before - 1) if np.isfinite(now) and np.isfinite(before) and before else 0.0


def _told(now: float, before: float) -> str:
    return f"{now:.3g} ({100 * (now / before - 1):+.0f} %)" if np.isfinite(now) else "none"


HEAD = """\
| fault | noticed by | after | number | without | with, all cycles | with, those left in | cycles |
|---|---|---|---|---|---|---|---|"""
