"""`python -m bench.emg_faults`: faults of EMG sessions in a simulated walk: what notices them, when, and what the numbers become.

45 s of walking, four muscles of the right leg, contacts from the force under both feet (the left belt's is there for its cross-talk). Each
fault is put into the arrays, 15 s after the start unless it says otherwise. "Change" is that of the highest point of a muscle's mean curve
against the walk without the fault, of the muscle that changes most: of all cycles, and of those that `CycleReview` leaves in. "Noticed" is
the first alarm after the fault began; or else what the report says at the end: a channel's verdict, or cycles that were left out.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from devices.simulators.treadmill import Treadmill
from devices.simulators.treadmill.faults import Fault, Faults
from operators.emg.channel_watch import ChannelWatch
from operators.emg.electrode_watch import ElectrodeWatch
from operators.emg.envelope import Envelope
from operators.emg.quality import SignalQuality
from operators.gait.cycle_watch import CycleWatch
from operators.gait.cycles import Cycles
from operators.gait.ensemble import CycleEnsemble
from operators.gait.force import ForceContacts
from operators.gait.pattern_watch import PatternWatch
from operators.gait.review import CycleReview
from stream.chunk import FOREVER, NS, Chunk, Samples, StreamSpec
from stream.engine.merge import Merge

MUSCLES = ("RF", "BF", "TA", "SO")
SECONDS, FROM_S = 45, 15
RATE = 1000
TA, SO = 2, 3
Stream: TypeAlias = tuple[StreamSpec, Any, Any]


@dataclass
class Walk:
    """The arrays of a walk: EMG (n, 4) in uV, forces (n, 2) in N, right and left; which samples of the EMG arrived (n,)."""

    emg: Samples
    force: Samples
    here: Any
    late: Any = field(default_factory=lambda: slice(FROM_S * RATE, None))

    def copy(self) -> Walk:
        return Walk(self.emg.copy(), self.force.copy(), self.here.copy())


def walk() -> Walk:
    """The walk without a fault."""
    both, n = Treadmill(muscles=MUSCLES, legs="both").both(), SECONDS * RATE
    emg, force = both.read(0, n)
    return Walk(emg[:, len(MUSCLES) :], force[:, ::-1].copy(), np.ones(n, bool))


def simulated(kind: Any, size_uv: float = 200.0, share: float = 1.0, for_s: float = 15.0) -> Callable[[Walk], None]:
    """A fault of the simulator, in TA."""

    def put(w: Walk) -> None:
        signal = Treadmill(muscles=MUSCLES).signal()
        muscle = "" if kind == "lost" else "TA"
        faults = Faults((Fault(kind, muscle, FROM_S, for_s, size_uv, share),), signal)
        for at in range(0, len(w.emg), 200):
            faults.spoil(at, w.emg[at : at + 200])
        w.here &= faults.arrived(0, len(w.emg))

    return put


def changed(change: Callable[[Walk, Any], None], begin_s: int = FROM_S, end_s: int = SECONDS) -> Callable[[Walk], None]:
    """A fault that is a change of the arrays between two times."""
    return lambda w: change(w, slice(begin_s * RATE, end_s * RATE))


def _nan(w: Walk, at: Any) -> None:
    w.emg[at, TA] = np.nan


def _swap(w: Walk, at: Any) -> None:
    w.emg[at, [TA, SO]] = 0  # replaced below, for the shape of a slice with a list
    w.emg[at] = walk().emg[at][:, [0, 1, SO, TA]]


def _twice(w: Walk, at: Any) -> None:
    w.emg[at, SO] = w.emg[at, TA]


def _bridge(w: Walk, at: Any) -> None:
    w.emg[at, SO] = 0.9 * w.emg[at, TA] + 0.1 * w.emg[at, SO]


def _gain(factor: float) -> Callable[[Walk, Any], None]:
    def change(w: Walk, at: Any) -> None:
        w.emg[at, TA] *= factor

    return change


def _offset(uv: float) -> Callable[[Walk, Any], None]:
    def change(w: Walk, at: Any) -> None:
        w.emg[at, TA] += uv

    return change


def _plate(change: Callable[[Samples, Samples, Samples], Samples]) -> Callable[[Walk, Any], None]:
    """A change of the right plate: of its load, the other's, and seconds since the fault began."""

    def put(w: Walk, at: Any) -> None:
        load = w.force[at, 0]
        w.force[at, 0] = change(load, w.force[at, 1], np.arange(len(load)) / RATE)

    return put


def _noise(newtons: float) -> Callable[[Samples, Samples, Samples], Samples]:
    return lambda load, _, t: load + newtons * np.random.default_rng(1).standard_normal(len(t))


def _every_other(load: Samples, _: Samples, t: Samples) -> Samples:
    """Every second stance is not seen."""
    down = load > 20
    steps = np.cumsum(np.diff(down.astype(int), prepend=0) > 0)
    return np.where(down & (steps % 2 == 0), 0.0, load)


def _kicks(load: Samples, _: Samples, t: Samples) -> Samples:
    """A bump of 60 ms and 80 N in the middle of each swing."""
    up = np.flatnonzero(np.diff((load > 20).astype(int)) < 0)
    bumps = load.copy()
    for at in up:
        bumps[at + 150 : at + 210] += 80.0
    return bumps


def _pause(w: Walk, at: Any) -> None:
    """The person stands."""
    w.force[at] = 350.0
    w.emg[at] = 2.0 * np.random.default_rng(2).standard_normal(w.emg[at].shape)


FAULTS: dict[str, Callable[[Walk], None]] = {
    "electrode off (flat)": simulated("flat"),
    "electrode off for 2 s": simulated("flat", for_s=2.0),
    "hum of 20 uV": simulated("hum", 20.0),
    "hum of 50 uV": simulated("hum", 50.0),
    "hum of 300 uV": simulated("hum", 300.0),
    "noise of 10 uV rms": simulated("noise", 10.0),
    "noise of 30 uV rms": simulated("noise", 30.0),
    "noise of 100 uV rms": simulated("noise", 100.0),
    "clipping at 100 uV": simulated("clipping", 100.0),
    "clipping at 50 uV": simulated("clipping", 50.0),
    "cable artefacts of 500 uV": simulated("artefacts", 500.0),
    "cable artefacts of 2000 uV": simulated("artefacts", 2000.0),
    "muscle at half its size": simulated("weak", share=0.5),
    "muscle at a fifth of its size": simulated("weak", share=0.2),
    "a tenth of the packets lost": simulated("lost", share=0.1),
    "half of the packets lost": simulated("lost", share=0.5),
    "all packets lost for 3 s": simulated("lost", for_s=3.0),
    "NaN for 5 s": changed(_nan, FROM_S, FROM_S + 5),
    "SO's channel shows TA": changed(_twice),
    "gel bridge, SO 90 % TA": changed(_bridge),
    "TA and SO swapped at 22 s": changed(_swap, 22),
    "TA's polarity reversed": changed(_gain(-1.0)),
    "TA's gain doubled": changed(_gain(2.0)),
    "TA's gain times 1000": changed(_gain(1000.0)),
    "offset of 5 mV": changed(_offset(5000.0)),
    "plate +30 N": changed(_plate(lambda load, _, t: load + 30), 0),
    "plate -30 N": changed(_plate(lambda load, _, t: load - 30), 0),
    "plate drifts 60 N": changed(_plate(lambda load, _, t: load + 60 * t / SECONDS), 0),
    "plate jumps 40 N": changed(_plate(lambda load, _, t: load + 40)),
    "5 % of the other belt": changed(_plate(lambda load, other, _: load + 0.05 * other), 0),
    "plate noise of 15 N rms": changed(_plate(_noise(15.0)), 0),
    "plate noise of 60 N rms": changed(_plate(_noise(60.0)), 0),
    "plate dead": changed(_plate(lambda load, _, t: 0 * load)),
    "plate stuck at 400 N": changed(_plate(lambda load, _, t: 0 * load + 400)),
    "every other contact not seen": changed(_plate(_every_other)),
    "a false contact in every swing": changed(_plate(_kicks)),
    "plate in kN, taken for N": changed(_plate(lambda load, _, t: load / 1000), 0),
    "person stands for 8 s": changed(_pause, FROM_S, FROM_S + 8),
}

FROM_THE_START = (
    "plate +30 N", "plate -30 N", "plate drifts 60 N", "5 % of the other belt", "plate noise of 15 N rms", "plate noise of 60 N rms",
    "plate in kN, taken for N",
)  # fmt: skip


def drive(operator: Any, inputs: dict[str, Stream], lost: Any = None) -> dict[str, Stream]:
    """An operator over whole streams, in chunks of 500; `lost`: which samples of the only input arrived."""
    specs = {port: given[0] for port, given in inputs.items()}
    outputs = operator.open(specs)
    merge, pieces = Merge(specs), []
    for port, (_, time, data) in inputs.items():
        edges = [*range(0, len(time), 500), len(time)]
        if lost is not None:
            edges = sorted({*edges, *(np.flatnonzero(np.diff(time) > 1.5 * NS / RATE) + 1).tolist()})
        for a, b in pairwise(edges):
            gap = a and lost is not None and time[a] - time[a - 1] > 1.5 * NS / RATE
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
    """peaks (m,) of the mean curves of all cycles, and of those left in; alarms (s, whose, what); cycles; what the report says."""

    all_peaks: Samples
    peaks: Samples
    alarms: list[tuple[float, str, str]]
    cycles: int
    said: list[str]


def analysed(w: Walk) -> Outcome:
    """The walk through the session's operators."""
    time = np.arange(len(w.emg)) * (NS // RATE)
    emg = (StreamSpec((4,), rate_hz=float(RATE), channels=MUSCLES, units=("uV",)), time[w.here], w.emg[w.here])
    force = (StreamSpec((2,), rate_hz=float(RATE), channels=("right", "left"), units=("N",)), time, w.force)
    feet = drive(ForceContacts(channels=("right",), other=("left",)), {"in": force})
    quality = drive(SignalQuality(), {"in": emg}, w.here)["out"]
    envelope = drive(Envelope(), {"in": emg}, w.here)["out"]
    cycles = drive(Cycles(), {"signal": envelope, **feet})
    both = {name: cycles[name] for name in ("closed", "cycles")}
    kept = drive(CycleReview(), {"quality": quality, **both})
    left = {name: kept[name] for name in ("closed", "cycles")}
    watched = [
        drive(ElectrodeWatch(), {"in": quality})["out"],
        drive(ChannelWatch(), {"in": emg}, w.here)["out"],
        drive(CycleWatch(), {"signal": envelope, "closed": cycles["closed"]})["out"],
        drive(PatternWatch(), both)["out"],
    ]
    alarms = [
        (stamp / NS, str(row["subject"]), str(row["what"]))
        for _, stamps, rows in watched
        for stamp, row in zip(stamps.tolist(), rows, strict=True)
        if row["state"] == "on"
    ]
    every, reviewed = (_peaks(streams) for streams in (both, left))
    closed = {int(row["number"]): str(row["rejected"]) for row in left["closed"][2]}
    said = [f"{r['name']} {r['session_flag']}" for r in quality[2][-4:] if r["session_flag"] != "good"]
    out = sum(int(row["used"] == 0) for row in kept["judged"][2])
    said += [f"{out} cycles of a muscle left out"] if out else []
    rejected = sum(bool(reason) for reason in closed.values())
    said += [f"{rejected} cycles rejected"] if rejected else []
    return Outcome(every, reviewed, sorted(alarms), len(closed) - rejected, said)


def _peaks(streams: dict[str, Stream]) -> Samples:
    """The highest point of each muscle's mean curve; NaN where there is none."""
    rows = drive(CycleEnsemble(), streams)["muscles"][2]
    return np.array([rows["peak"][rows["name"] == name][-1:].sum() if len(rows) else np.nan for name in MUSCLES])


def table(names: list[str]) -> list[tuple[str, str, str, str, str, int]]:
    """Rows of fault, what noticed it, after how long, change of all cycles, of those left in, and good cycles."""
    sound, whole = walk(), None
    whole = analysed(sound)
    rows = [("none", "-", "-", "0 %", "0 %", whole.cycles)]
    for name in names:
        w = sound.copy()
        FAULTS[name](w)
        now = analysed(w)
        begin = 22 if "22 s" in name else 0 if name in FROM_THE_START else FROM_S
        known = {(who, what) for _, who, what in whole.alarms}
        first = next(((t, who, what) for t, who, what in now.alarms if t >= begin and (who, what) not in known), None)
        noticed = f"{first[1]}: {first[2]}" if first else "; ".join(s for s in now.said if s not in whole.said) or "not"
        after = f"{first[0] - begin:.1f} s" if first else "at the end" if noticed != "not" else "-"
        rows.append(
            (name, noticed, after, _change(now.all_peaks, whole.peaks), _change(now.peaks, whole.peaks), now.cycles)
        )
        print(rows[-1], file=sys.stderr, flush=True)
    return rows


def _change(now: Samples, before: Samples) -> str:
    with np.errstate(invalid="ignore", divide="ignore"):
        part = 100 * (now / before - 1)
    if not np.isfinite(part).any() or not np.nansum(now):
        return "no curve"
    return f"{part[np.nanargmax(np.abs(part))]:+.0f} %"


def main() -> None:
    print("| fault | noticed by | after | change, all cycles | change, those left in | cycles |")
    print("|---|---|---|---|---|---|")
    for row in table(sys.argv[1:] or list(FAULTS)):
        print(f"| {' | '.join(map(str, row))} |", flush=True)


if __name__ == "__main__":
    main()
