"""`python -m bench.emg_real_faults`: faults put into recordings of real walks: what notices them, when, and what the numbers become.

`KINEGRAPH_DATA` names the folder of recordings. Columns as of `bench.emg_faults`. Two walks:

treadmill    five of 13 muscles, contacts of the right foot as they came with the recording. It has five cycles; these are walked nine
             times over, joined at a touch-down by 20 ms of cross-fade, so that there are 45: real signals, but no more variety than
             five cycles have. The faults begin 15 s after the start, in TA; contacts are reported 30 ms after they happened.
overground   one walk through a laboratory as it was recorded (13 s), left leg, contacts from markers; faults in the middle of it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.emg_session import HEAD, Outcome, analysed, drive, table_row
from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.devices.people.treadmill.faults import Fault, Faults
from kinegraph.operators.contacts.contacts import CONTACT
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.operators.monitors.marker_watch import MarkerWatch
from kinegraph.stream.chunk import NS, Samples, StreamSpec

RATE, FROM_S, TIMES, FADE = 1000, 15, 9, 20
MUSCLES = ("VM", "BF", "TA", "GM", "SO")
TA, SO = 2, 4
LATE = 30_000_000
WALK, TRIAL, MIDDLE_S = "emg_epfl_S3_FLOAT", "T_02", 6
LTOE, LHIP, RTOE = 3, 0, 7


@dataclass
class Treading:
    """emg (n, 5) in uV, which samples arrived (n,), touch-downs and lift-offs in s."""

    emg: Samples
    here: Any
    down: Samples
    up: Samples


def treading() -> Treading:
    """The treadmill walk, its five cycles nine times over."""
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "emg" / "emg_santuz_tw12.npz") as z:
        names = z["names"].tolist()
        raw = z["emg_uV"][:, [names.index(name) for name in MUSCLES]].astype(float)
        down, up = z["touchdown_s"] - z["t_s"][0], z["liftoff_s"] - z["t_s"][0]
    a, b = round(down[0] * RATE), round(down[-1] * RATE)
    fade = np.linspace(0, 1, FADE)[:, None]
    piece = raw[a:b].copy()
    piece[-FADE:] = (1 - fade) * piece[-FADE:] + fade * raw[a - FADE : a]
    length = (b - a) / RATE
    emg = np.concatenate([raw[:a], *([piece] * TIMES), raw[b:]])
    downs = np.concatenate([down[:-1] + k * length for k in range(TIMES)] + [[down[0] + TIMES * length]])
    ups = np.concatenate([up[up < down[-1]] + k * length for k in range(TIMES)])
    return Treading(emg, np.ones(len(emg), bool), downs, ups)


def simulated(kind: Any, size_uv: float = 200.0, share: float = 1.0, for_s: float = 15.0) -> Callable[[Treading], None]:
    """A fault of the simulator, in the real TA."""

    def put(w: Treading) -> None:
        signal = Treadmill(muscles=("TA",)).signal()
        faults = Faults((Fault(kind, "" if kind == "lost" else "TA", FROM_S, for_s, size_uv, share),), signal)
        for at in range(0, len(w.emg), 200):
            part = w.emg[at : at + 200, TA : TA + 1].copy()
            faults.spoil(at, part)
            w.emg[at : at + 200, TA : TA + 1] = part
        w.here &= faults.arrived(0, len(w.emg))

    return put


def signal(change: Callable[[Samples], Samples], of: int = TA) -> Callable[[Treading], None]:
    """A muscle's signal changed from 15 s on, given all muscles'."""

    def put(w: Treading) -> None:
        w.emg[FROM_S * RATE :, of] = change(w.emg[FROM_S * RATE :].copy())

    return put


def _swap(w: Treading) -> None:
    w.emg[FROM_S * RATE :, [TA, SO]] = w.emg[FROM_S * RATE :, [SO, TA]]


def _nan(w: Treading) -> None:
    w.emg[FROM_S * RATE : (FROM_S + 5) * RATE, TA] = np.nan


def _two_off(w: Treading) -> None:
    w.emg[FROM_S * RATE :, [TA, SO]] = 0.0


def _late(w: Treading) -> Any:
    return w.down >= FROM_S


def _missed(every: int) -> Callable[[Treading], None]:
    def put(w: Treading) -> None:
        w.down = w.down[~_late(w) | (np.arange(len(w.down)) % every > 0)]

    return put


def _missed_early(w: Treading) -> None:
    w.down = np.delete(w.down, 2)


def _false(w: Treading) -> None:
    swings = w.up[w.up >= FROM_S] + 0.2
    w.down = np.sort(np.concatenate([w.down, swings]))


def _stop(w: Treading) -> None:
    w.down, w.up = w.down[~_late(w)], w.up[w.up < FROM_S]


def _no_lifts(w: Treading) -> None:
    w.up = w.up[w.up < FROM_S]


def _short_stance(w: Treading) -> None:
    """The foot is reported to leave the ground at 8 % of the cycle."""
    period = np.diff(w.down).mean()
    w.up = np.sort(np.where(w.up >= FROM_S, w.down[np.searchsorted(w.down, w.up) - 1] + 0.08 * period, w.up))


def _jitter(seconds: float) -> Callable[[Treading], None]:
    def put(w: Treading) -> None:
        w.down = np.where(_late(w), w.down + np.random.default_rng(3).normal(0, seconds, len(w.down)), w.down)

    return put


def _shifted(seconds: float) -> Callable[[Treading], None]:
    def put(w: Treading) -> None:
        w.down, w.up = (np.where(t >= FROM_S, t + seconds, t) for t in (w.down, w.up))

    return put


def _always_late(w: Treading) -> None:
    w.down, w.up = w.down + 0.02, w.up + 0.02


def _other_leg(w: Treading) -> None:
    """The contacts are the other leg's: half a cycle later, from the start."""
    half = np.diff(w.down).mean() / 2
    w.down, w.up = w.down + half, w.up + half


def _swapped_first(w: Treading) -> None:
    w.emg[:, [TA, SO]] = w.emg[:, [SO, TA]]


FAULTS: dict[str, Callable[[Treading], None]] = {
    "electrode off (flat)": simulated("flat"),
    "electrode off for 2 s": simulated("flat", for_s=2.0),
    "two electrodes off": _two_off,
    "hum of 20 uV": simulated("hum", 20.0),
    "hum of 50 uV": simulated("hum", 50.0),
    "hum of 300 uV": simulated("hum", 300.0),
    "noise of 30 uV rms": simulated("noise", 30.0),
    "noise of 100 uV rms": simulated("noise", 100.0),
    "clipping at 100 uV": simulated("clipping", 100.0),
    "cable artefacts of 2000 uV": simulated("artefacts", 2000.0),
    "muscle at half its size": simulated("weak", share=0.5),
    "muscle at a fifth of its size": simulated("weak", share=0.2),
    "a tenth of the packets lost": simulated("lost", share=0.1),
    "half of the packets lost": simulated("lost", share=0.5),
    "all packets lost for 3 s": simulated("lost", for_s=3.0),
    "NaN for 5 s": _nan,
    "SO's channel shows TA": signal(lambda x: x[:, TA], SO),
    "gel bridge, SO 90 % TA": signal(lambda x: 0.9 * x[:, TA] + 0.1 * x[:, SO], SO),
    "TA and SO swapped": _swap,
    "TA's polarity reversed": signal(lambda x: -x[:, TA]),
    "TA's gain doubled": signal(lambda x: 2.0 * x[:, TA]),
    "TA's gain times 1000": signal(lambda x: 1000.0 * x[:, TA]),
    "a third of SO in TA": signal(lambda x: x[:, TA] + 0.33 * x[:, SO]),
    "a third touch-down missed, before there is a median": _missed_early,
    "every other touch-down missed": _missed(2),
    "one touch-down in ten missed": _missed(10),
    "a false touch-down in every swing": _false,
    "contacts stop": _stop,
    "lift-offs stop": _no_lifts,
    "stance of 8 %": _short_stance,
    "touch-downs off by 20 ms": _jitter(0.02),
    "touch-downs off by 100 ms": _jitter(0.1),
    "contacts 100 ms late": _shifted(0.1),
    "contacts 20 ms late": _shifted(0.02),
    "contacts 20 ms early": _shifted(-0.02),
    "contacts 10 ms late": _shifted(0.01),
    "contacts 20 ms late from the start": _always_late,
    "the other leg's contacts from the start": _other_leg,
    "TA and SO swapped from the start": _swapped_first,
}


FROM_THE_START = (
    "contacts 20 ms late from the start",
    "the other leg's contacts from the start", "TA and SO swapped from the start", "overground: toes' markers swapped from the start",
)  # fmt: skip


@dataclass
class Striding:
    """emg (n, 4) in mV, markers (m, 8, 3) in mm at 100 Hz; which samples of both arrived."""

    emg: Samples
    markers: Samples
    here: Any
    seen: Any


def striding() -> Striding:
    with np.load(Path(os.environ["KINEGRAPH_DATA"]) / "emg" / f"{WALK}.npz") as z:
        emg, markers = z[f"{TRIAL}_emg"].astype(float), z[f"{TRIAL}_kin"].astype(float)
    return Striding(emg, markers, np.ones(len(emg), bool), np.ones(len(markers), bool))


def _marker(
    change: Callable[[Samples], Samples | float], for_s: float = 99.0, of: int = LTOE
) -> Callable[[Striding], None]:
    def put(w: Striding) -> None:
        at = slice(MIDDLE_S * 100, round((MIDDLE_S + for_s) * 100))
        w.markers[at, of] = change(w.markers[at].copy())

    return put


def _toes_swapped(w: Striding) -> None:
    w.markers[:, [LTOE, RTOE]] = w.markers[:, [RTOE, LTOE]]


def _muscle(change: Callable[[Samples], Samples | float], for_s: float = 99.0) -> Callable[[Striding], None]:
    def put(w: Striding) -> None:
        at = slice(MIDDLE_S * RATE, round((MIDDLE_S + for_s) * RATE))
        w.emg[at, 0] = change(w.emg[at].copy())

    return put


def _cameras_off(w: Striding) -> None:
    w.seen[MIDDLE_S * 100 : (MIDDLE_S + 3) * 100] = False


def _hum(x: Samples) -> Samples:
    return np.asarray(x[:, 0] + 0.05 * np.sin(2 * np.pi * 50 * np.arange(len(x)) / RATE))


OVERGROUND: dict[str, Callable[[Striding], None]] = {
    "overground: electrode off (LTA)": _muscle(lambda x: 0.0),
    "overground: hum of 50 uV": _muscle(_hum),
    "overground: LTA's gain times 1000": _muscle(lambda x: 1000 * x[:, 0]),
    "overground: LTA shows LMG": _muscle(lambda x: x[:, 1]),
    "overground: toe's marker unseen for 1 s": _marker(lambda x: np.nan, 1.0),
    "overground: toe's marker unseen from then on": _marker(lambda x: np.nan),
    "overground: toe's marker stands still": _marker(lambda x: x[0, LTOE]),
    "overground: hip's marker unseen from then on": _marker(lambda x: np.nan, of=LHIP),
    "overground: toe's marker trembles by 5 mm": _marker(lambda x: x[:, LTOE] + np.random.default_rng(4).normal(0, 5, x[:, LTOE].shape)),
    "overground: no frame for 3 s": _cameras_off,
    "overground: right toe's marker taken for the left": _marker(lambda x: x[:, RTOE]),
    "overground: toes' markers swapped from the start": _toes_swapped,
}  # fmt: skip


def analysed_treading(w: Treading) -> Outcome:
    time = np.arange(len(w.emg)) * (NS // RATE)
    spec = StreamSpec((len(MUSCLES),), rate_hz=float(RATE), channels=MUSCLES, units=("uV",))
    feet = {}
    for port, seconds in (("touchdown", w.down), ("liftoff", w.up)):
        onset = np.round(seconds * NS).astype(np.int64)
        feet[port] = (StreamSpec((), CONTACT, units=("ns",), meta={"side": "right"}), onset + LATE, onset.view(CONTACT))
    return analysed((spec, time[w.here], w.emg[w.here]), feet, None if w.here.all() else w.here)


def analysed_striding(w: Striding) -> Outcome:
    time, when = np.arange(len(w.emg)) * (NS // RATE), np.arange(len(w.markers)) * (NS // 100)
    emg = StreamSpec((2,), rate_hz=float(RATE), channels=("LTA", "LMG"), units=("mV",))
    names = ("LHIP", "LKNE", "LANK", "LTOE", "RHIP", "RKNE", "RANK", "RTOE")
    spec = StreamSpec((8, 3), rate_hz=100.0, channels=names, units=("mm",))
    finder = MarkerContacts(marker="LTOE", reference="LHIP", side="left")
    seen, lost = {"in": (spec, when[w.seen], w.markers[w.seen])}, None if w.seen.all() else w.seen
    watch = MarkerWatch(segments=(("LANK", "LTOE"), ("RANK", "RTOE")))
    alarms = drive(watch, seen, lost)["out"]
    return analysed((emg, time, w.emg[:, :2]), drive(finder, seen, lost), max_noise=0.02, beside=[alarms])


def table(names: list[str]) -> list[tuple[str, ...]]:
    """The rows of these faults, each walk's after that of the walk as it was recorded."""
    rows = []
    walks: tuple[tuple[str, Any, int, Any, Any], ...] = (
        ("none", FAULTS, FROM_S, treading, analysed_treading),
        ("overground: none", OVERGROUND, MIDDLE_S, striding, analysed_striding),
    )
    for title, faults, begin_s, sound, session in walks:
        mine = [name for name in names if name in faults]
        if not mine:
            continue
        whole = session(sound())
        rows.append(table_row(title, 0.0, whole, whole))
        for name in mine:
            w = sound()
            faults[name](w)
            since_s = 0.0 if "before" in name or name in FROM_THE_START else begin_s
            rows.append(table_row(name, since_s, session(w), whole))
            print(rows[-1], file=sys.stderr, flush=True)
    return rows


def main() -> None:
    print(HEAD)
    for row in table(sys.argv[1:] or [*FAULTS, *OVERGROUND]):
        print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
