"""A simulated treadmill session: thirteen muscles of the right leg, the foot's contacts, and the force under it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.people.treadmill.both_legs import LEGS, BothLegs, plates
from kinegraph.devices.people.treadmill.faults import Fault, Faults
from kinegraph.devices.people.treadmill.signal import BURSTS, NAMES, Indices, Signal, Walker
from kinegraph.devices.simulation.paced import PacedSource
from kinegraph.stream.chunk import NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import ParameterError, nearest
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed

CONTACT = np.dtype([("onset", "<i8")])
LIMB_CONTACT = np.dtype([("onset", "<i8"), ("limb", "<U16")])


@dataclass(frozen=True, slots=True)
class BeltSpeed:
    """The belt runs at another speed from a moment on."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    from_s: float = param(least=0.0, help="when, counted from the first sample")
    speed_m_s: float = param(above=0.0, most=3.0, help="how fast")


@dataclass(frozen=True, slots=True)
class Treadmill(PacedSource):
    """Someone walks on a treadmill, with surface EMG on the right leg, a footswitch and a force plate.

    emg         (muscles,) float64, uV, at `rate_hz`: noise with a muscle's spectrum, louder and softer with the gait's phase
    touchdown   events: the right foot's first contact with the belt; `onset` is an EMG sample's stamp
    liftoff     events: the right foot leaves the belt
    force       (1,) float64, N, at `rate_hz`: vertical ground reaction force under the right foot

    With `legs: both` there are two of each muscle (L_TA, R_TA), contacts have a field `limb`, and there are two belts (Fz_left, Fz_right),
    with plates that may drift and cross-talk. The right leg's samples are those of the right leg alone.

    Sample i is the same whenever, wherever and in whatever chunks it is made (given the seed, and numpy's stream of normal numbers,
    which has not changed since 1.17). Stamps are `start` (or the session's time when reading begins) plus i / `rate_hz`. Lost packets
    leave gaps in `emg` alone: contacts and force come by other wires.
    """

    outputs: ClassVar[tuple[str, ...]] = ("emg", "touchdown", "liftoff", "force")

    muscles: tuple[str, ...] = param(tuple(BURSTS), help=", ".join(f"{short}: {long}" for short, long in NAMES.items()))
    rate_hz: float = param(1000.0, least=200, most=10000, help="samples per second of EMG and force")
    legs: Literal["right", "both"] = param("right", help="one leg, or two legs and two belts")
    left_share: float = param(
        1.0, above=0, most=10, help="with both legs: how large the left's muscles are beside the right's"
    )
    plate_drift_n_per_min: float = param(0.0, help="both belts' plates drift by this much")
    cross_talk_pct: float = param(0.0, least=0, most=50, help="how much of the other belt's load a belt shows")
    cadence_per_min: float = param(
        57.0, least=20, most=120, help="strides per minute (a stride: right touch-down to the next)"
    )
    stance_percent: float = param(
        63.0, least=30, most=80, help="the share of a cycle in which the foot is on the ground"
    )
    speeds: tuple[BeltSpeed, ...] = param(
        (),
        help="the belt's speeds, e.g. [{from_s: 60, speed_m_s: 1.5}]; cadence and stance follow; 1.2 m/s before the first",
    )
    jitter_percent: float = param(2.0, least=0, most=5, help="standard deviation of a cycle's duration")
    noise_uv: float = param(2.0, least=0, help="baseline noise of every channel, rms")
    seed: int = param(0, least=0, help="another seed, another walk")
    chunk_ms: float = param(10.0, above=0, most=1000, help="how much arrives at a time")
    start: str = param("", help="stamp of the first sample, e.g. 2026-01-31T09:00:00Z; left out: when reading begins")
    faults: tuple[Fault, ...] = param((), help="what goes wrong, and when")

    @property
    def chunk_s(self) -> float:
        return self.chunk_ms / 1000

    def specs(self) -> Specs:
        for muscle in [*self.muscles, *(f.muscle for f in self.faults if f.muscle and self.legs == "right")]:
            if muscle not in BURSTS:
                raise ParameterError("muscles", muscle, f"a known muscle; {nearest(muscle, BURSTS)}")
        if not self.muscles or len(set(self.muscles)) != len(self.muscles):
            raise ParameterError("muscles", list(self.muscles), "a list of at least one muscle, each named once")
        for fault in self.faults:
            if fault.muscle and fault.muscle not in self._channels():
                raise ParameterError(
                    "faults", fault.muscle, f"one of this node's muscles: {', '.join(self._channels())}"
                )
        begins = [one.from_s for one in self.speeds]
        if begins != sorted(set(begins)):
            raise ParameterError("speeds", begins, "in order of from_s, each moment once")
        self._start_ns(0)
        if self.legs == "both":
            return self._both_specs()
        walk = {"side": "right", "simulated": True}
        sites = {short: f"{NAMES[short]}, right" for short in self.muscles}
        contact = StreamSpec((), CONTACT, units=("ns",), meta=walk)
        return {
            "emg": StreamSpec(
                (len(self.muscles),),
                rate_hz=self.rate_hz,
                channels=self.muscles,
                units=("uV",),
                meta={**walk, "sites": sites},
            ),
            "touchdown": contact,
            "liftoff": contact,
            "force": StreamSpec((1,), rate_hz=self.rate_hz, channels=("Fz",), units=("N",), meta=walk),
        }

    def rehearsals(self) -> dict[str, dict[str, Any]]:
        """What can be tried with it: in words, and by which parameters."""
        fallen = {"kind": "flat", "muscle": self._channels()[0], "from_s": 10, "for_s": 10}
        return {
            f"the electrode of {fallen['muscle']} falls off after 10 s, and is taped again 10 s later": {
                "faults": [fallen]
            }
        }

    def _channels(self) -> tuple[str, ...]:
        """The EMG channels' names."""
        if self.legs == "right":
            return self.muscles
        return tuple(f"{prefix}{muscle}" for prefix in LEGS.values() for muscle in self.muscles)

    def _both_specs(self) -> Specs:
        channels, walk = self._channels(), {"simulated": True}
        sites = {f"{p}{short}": f"{NAMES[short]}, {side}" for side, p in LEGS.items() for short in self.muscles}
        contact = StreamSpec((), LIMB_CONTACT, units=("ns", ""), meta={**walk, "limb_names": list(LEGS)})
        return {
            "emg": StreamSpec(
                (len(channels),), rate_hz=self.rate_hz, channels=channels, units=("uV",), meta={**walk, "sites": sites}
            ),
            "touchdown": contact,
            "liftoff": contact,
            "force": StreamSpec((2,), rate_hz=self.rate_hz, channels=("Fz_left", "Fz_right"), units=("N",), meta=walk),
        }

    def both(self) -> BothLegs:
        """What is being simulated with `legs: both`, without faults."""
        return BothLegs(self.signal().walker, self.left_share)

    def signal(self) -> Signal:
        """What is being simulated; its `gait.cycles` and `envelope` are the truth that results can be held against."""
        return Signal(
            Walker(
                self.muscles,
                self.rate_hz,
                self.cadence_per_min,
                self.stance_percent,
                self.jitter_percent,
                self.noise_uv,
                self.seed,
                speeds=tuple((one.from_s, one.speed_m_s) for one in self.speeds),
            )
        )

    def read(self, feed: Feed) -> None:
        signal: Signal | BothLegs
        if self.legs == "both":
            signal = self.both()
            faults = signal.spoil(self.faults)
        else:
            signal = self.signal()
            faults = Faults(self.faults, signal)
            signal.spoil = faults.spoil
        anchor = self._start_ns(feed.now())
        begun = feed.now()
        feed.ready()
        last = round(self.duration_s * self.rate_hz) if self.duration_s else None
        start = lost = number = 0
        while not feed.stopped and start != last:
            number += 1
            stop = max(start + 1, round(number * self.chunk_ms * self.rate_hz / 1000))
            stop = stop if last is None else min(stop, last)
            if self.realtime and self._sleep(feed, begun, faults.stalled_until(stop)):
                return
            lost = self._emit(feed, signal, faults, anchor, (start, stop), lost)
            start = stop

    def _sleep(self, feed: Feed, begun: int, due_s: float) -> bool:
        """Wait until a sample has come; returns whether to stop instead. A stall without end waits in steps, to stay stoppable."""
        while (rest := due_s - (feed.now() - begun) / NS) > 0:
            if feed.wait(min(rest, 1.0)):
                return True
        return False

    def _emit(
        self, feed: Feed, signal: Signal | BothLegs, faults: Faults, anchor: int, span: tuple[int, int], lost: int
    ) -> int:
        """Emit one chunk of every output; returns how many samples were lost at its end."""
        start, stop = span
        index = np.arange(start, stop)
        time = self._stamps(anchor, index)
        until = int(time[-1])
        for kind in ("touchdown", "liftoff"):
            onset, events = self._contacts(signal, kind, anchor, span)
            feed.emit(Chunk(onset, events, until), kind)
        emg, force = signal.read(start, stop)
        if self.legs == "both":
            force = plates(force, index / self.rate_hz, self.plate_drift_n_per_min, self.cross_talk_pct)
        feed.emit(Chunk(time, force, until), "force")
        return _emit_what_arrived(feed, faults, start, Chunk(time, emg, until, lost))

    def _contacts(
        self, signal: Signal | BothLegs, kind: str, anchor: int, span: tuple[int, int]
    ) -> tuple[Times, NDArray[np.void]]:
        """Stamps and events of one kind of contact."""
        if isinstance(signal, BothLegs):
            index, sides = signal.contacts(kind, *span)
            events = np.zeros(len(index), LIMB_CONTACT)
            events["limb"] = sides
        else:
            index = getattr(signal.gait, f"{kind}s")(*span)
            events = np.zeros(len(index), CONTACT)
        onset = self._stamps(anchor, index)
        events["onset"] = onset
        return onset, events

    def _stamps(self, anchor: int, index: Indices) -> Times:
        return anchor + np.round(index * (NS / self.rate_hz)).astype(np.int64) if len(index) else index

    def _start_ns(self, now: int) -> int:
        if not self.start:
            return now
        try:
            at = datetime.fromisoformat(self.start)
        except ValueError:
            raise ParameterError("start", self.start, "a time such as 2026-01-31T09:00:00Z") from None
        at = at if at.tzinfo else at.replace(tzinfo=UTC)
        whole = math.floor(at.timestamp())
        return whole * NS + at.microsecond * 1000


def _emit_what_arrived(feed: Feed, faults: Faults, start: int, chunk: Chunk) -> int:
    """Emit the runs of samples that were not lost, each with what was lost before it; returns what was lost at the end."""
    arrived = faults.arrived(start, start + len(chunk))
    if arrived.all():
        feed.emit(chunk, "emg")
        return 0
    edges = np.flatnonzero(np.diff(arrived, prepend=False, append=False))
    lost, at = chunk.lost, 0
    for first, stop in edges.reshape(-1, 2):
        piece = chunk.part(int(first), int(stop))
        feed.emit(Chunk(piece.time, piece.data, piece.until, lost + int(first) - at), "emg")
        lost, at = 0, int(stop)
    feed.problem("lost sample", int(np.count_nonzero(~arrived)))
    missing = len(chunk) - at
    if missing:
        feed.emit(Chunk(chunk.time[:0], chunk.data[:0], chunk.until), "emg")
    return lost + missing


def truth(treadmill: Treadmill, stop: int) -> tuple[Indices, Samples]:
    """What a perfect analysis of samples 0..stop-1 would find.

    Returns the whole cycles as rows (touch-down, lift-off, next touch-down), in samples, and the EMG's standard deviation (stop,
    muscles) in uV without noise.
    """
    signal = treadmill.signal()
    parts = [signal.envelope(np.arange(first, min(first + 1000, stop))) for first in range(0, stop, 1000)]
    return signal.gait.cycles(0, stop), np.concatenate(parts)
