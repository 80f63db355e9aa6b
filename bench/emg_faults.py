"""`python -m bench.emg_faults`: faults of EMG sessions in a simulated walk: what notices them, when, and what the numbers become.

45 s of walking, four muscles of the right leg, contacts from the force under both feet (the left belt's is there for its cross-talk). Each
fault is put into the arrays, 15 s after the start unless it says otherwise. The number is the one that it changes most of each muscle's
peak and means (cycle, stance, swing), stance and cadence, averaged over all cycles, and over those that `CycleReview` leaves in.
"Noticed" is the first alarm after the fault began; or else what the report says at the end: a channel's verdict, or cycles left out.
`python -m bench.emg_real_faults` does the same to recordings of real walks.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from bench.emg_session import HEAD, Outcome, analysed, drive, table_row
from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.devices.people.treadmill.faults import Fault, Faults
from kinegraph.operators.contacts.force import ForceContacts
from kinegraph.stream.chunk import NS, Samples, StreamSpec

MUSCLES = ("RF", "BF", "TA", "SO")
SECONDS, FROM_S = 45, 15
RATE = 1000
TA, SO = 2, 3


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


def _from_plate(w: Walk, at: Any) -> None:
    """The left belt's cable in the right belt's socket."""
    w.force[at] = w.force[at][:, ::-1].copy()


def _late(seconds: float) -> Callable[[Walk, Any], None]:
    """The plate's signal comes later."""

    def put(w: Walk, at: Any) -> None:
        w.force[at] = np.roll(w.force, round(seconds * RATE), axis=0)[at]

    return put


def _other_leg(w: Walk, at: Any) -> None:
    """The electrodes are on the other leg."""
    both = Treadmill(muscles=MUSCLES, legs="both").both()
    w.emg[at] = both.read(0, SECONDS * RATE)[0][at, : len(MUSCLES)]


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
    "the other belt taken for this leg's": changed(_from_plate, 0),
    "the other belt from 15 s on": changed(_from_plate),
    "electrodes on the other leg": changed(_other_leg, 0),
    "TA and SO swapped from the start": changed(_swap, 0),
    "contacts 20 ms late": changed(_late(0.02)),
    "contacts 20 ms late from the start": changed(_late(0.02), 0),
    "person stands for 8 s": changed(_pause, FROM_S, FROM_S + 8),
}

FROM_THE_START = (
    "plate +30 N", "plate -30 N", "plate drifts 60 N", "5 % of the other belt", "plate noise of 15 N rms", "plate noise of 60 N rms",
    "plate in kN, taken for N",
    "contacts 20 ms late from the start",
    "the other belt taken for this leg's", "electrodes on the other leg", "TA and SO swapped from the start",
)  # fmt: skip


def analysed_walk(w: Walk) -> Outcome:
    """The walk through the session's operators; contacts from the force."""
    time = np.arange(len(w.emg)) * (NS // RATE)
    emg = (StreamSpec((4,), rate_hz=float(RATE), channels=MUSCLES, units=("uV",)), time[w.here], w.emg[w.here])
    force = (StreamSpec((2,), rate_hz=float(RATE), channels=("right", "left"), units=("N",)), time, w.force)
    return analysed(emg, drive(ForceContacts(channels=("right",), other=("left",)), {"in": force}), w.here)


def table(names: list[str]) -> list[tuple[str, ...]]:
    """The rows of these faults, after that of the walk without one."""
    sound = walk()
    whole = analysed_walk(sound)
    rows = [table_row("none", 0.0, whole, whole)]
    for name in names:
        w = sound.copy()
        FAULTS[name](w)
        begin_s = 22 if "22 s" in name else 0 if name in FROM_THE_START else FROM_S
        rows.append(table_row(name, begin_s, analysed_walk(w), whole))
        print(rows[-1], file=sys.stderr, flush=True)
    return rows


def main() -> None:
    print(HEAD)
    for row in table(sys.argv[1:] or list(FAULTS)):
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
