"""Activity by epochs from the change of depth frames: how long a sleeper moved, above what the frames' own noise does."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from kinegraph.operators.bed.bed_events import BED, IN, UNKNOWN
from kinegraph.operators.bed.frames.view import VIEW, check_view
from kinegraph.operators.bed.sleeper_activity import ActivityLimits, SleeperActivity
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.require import numeric, regular
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

EPOCH_SEEN = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("sleeper", "U16"),
        ("moved_s", "<f8"),
        ("seen", "<f8"),
        ("bed", "U7"),
        ("crosstalk", "<f8"),
        ("threshold", "<f8"),
        ("why", "U8"),
    ]
)
"""What was seen of a sleeper in an epoch; see `Activity`."""

Rows = list[tuple[Any, ...]]


@kernel
def collect(x: Samples, time: Times, begin: int, slot_ns: int, sums: Samples, counts: Samples) -> None:
    """Add the samples `x` (n, k) to the slots (s, k) of the epoch that began at `begin`; what is not finite, or older, was not seen."""
    for i in range(x.shape[0]):
        if time[i] < begin:  # only out of order could it come; there is no slot before the first
            continue
        slot = min((time[i] - begin) // slot_ns, sums.shape[0] - 1)
        for k in range(x.shape[1]):
            if abs(x[i, k]) < math.inf:
                sums[slot, k] += x[i, k]
                counts[slot, k] += 1.0


@dataclass(slots=True)
class EpochSlots:
    """sums, counts (slots, k) of the open epoch: change, and frames; far_sums, far_counts: of the change over twice the time."""

    sums: Samples
    counts: Samples
    far_sums: Samples
    far_counts: Samples

    @staticmethod
    def empty(slots: int, k: int) -> EpochSlots:
        return EpochSlots(*(np.zeros((slots, k)) for _ in range(4)))

    def averages(self) -> tuple[Samples, Samples]:
        """Of both (slots, k); NaN: not seen."""
        with np.errstate(invalid="ignore"):
            return self.sums / self.counts, self.far_sums / self.far_counts

    def clear(self) -> None:
        for held in (self.sums, self.counts, self.far_sums, self.far_counts):
            held[:] = 0.0


@dataclass(slots=True)
class ActivityState:
    """
    begin           start of the open epoch (ns); NEVER before the first. silent: number of past epochs without a frame
    expected        number of frames expected in an epoch
    sleepers        where they are, and what is known of the noise
    lost            what the next emission says is missing before it
    """

    sleepers: SleeperActivity
    epoch_ns: int
    begin: int
    silent: int
    max_silent: int
    expected: float
    slots: EpochSlots
    lost: int


@dataclass(frozen=True, slots=True)
class Activity(Operator[ActivityState]):
    """The change N(t) of every sleeper's region in (`motion`), and where the sleepers are (`bed`); activity per epoch out.

    out     (sleepers,) float64: share of the time seen with movement; 0 below `min_s` of movement; 1 where the sleeper was out of bed
            throughout (being up is being awake); NaN where less than `min_seen` was seen, noise is not known yet, or, with `bed`
            connected, the bed's state is unknown. Stamped with the epoch's start; goes straight into
            operators.sleep.scorer.SleepScorer
    epochs  per epoch and sleeper: onset, end; moved_s: time with movement; seen: share of the frames; bed: in, out or unknown, at its
            end; crosstalk: share of the movement during which another sleeper's region moved at least `crosstalk_ratio` times more, so
            that it may have been theirs, and counts as not seen; threshold (mm); why the epoch cannot be judged, where it cannot:
            `camera` (it was moved, and the noise is learned again), `dark`, `unseen`, `light` (more noise, and no movement), `body` (a
            second one moves, or the sleeper: two in a region, or nearly all of it crosstalk), `still` and `region` (see
            operators.bed.presence.Presence), `learning` (too little is known of stillness)

    Movement is where N, averaged over `smooth_s`, exceeds the threshold: what N is in the stillest quarter of the newest 60 epochs with
    this sleeper in bed, plus `sigmas` times its own scatter there (breath counts as scatter), and at least `min_rise` of it. So it is
    calibrated on the frames as they come, simplified and noisy; before there are 4 such epochs it is not known. It is never above
    3 times what N is over the empty bed, so that an evening without any stillness is not taken for noise, unless for ten minutes it has
    been as steady as only noise is. After a jump of the view all noise is learned again.

    With `far` connected (the change over twice the time), a rise as steady as noise, for 12 s and more, that does not grow with the time
    is no movement: nothing is displaced, depths have become noisier, as by a light. It counts as not seen, until three quarters of those
    epochs have it. (Trembling faster than the looks follow each other would pass for it, were it as steady.)

    A silence up to `reset_gap_s` gives epochs of NaN; beyond it everything starts again. Delay: one epoch.

    >>> given, made = tried(Activity)
    >>> given["motion"].shape, made["epochs"][["sleeper", "bed", "moved_s"]][-1].item()
    ((600, 2), ('right', 'unknown', 0.0))
    """

    inputs = {
        "view": Input(optional=True),
        "bed": Input(optional=True),
        "far": Input(optional=True),
        "motion": Input(trigger=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("out", "epochs")

    epoch_s: float = param(
        30.0, above=0.0, most=3600.0, help="length of an epoch; epochs begin at whole multiples of it since 1970"
    )
    smooth_s: float = param(0.5, above=0.0, help="movement is judged on averages of this length")
    sigmas: float = param(6.0, above=0.0, help="how far above the noise movement begins: lower is more sensitive")
    min_rise: float = param(0.05, least=0.0, help="and how far at least, as a share of the noise")
    min_s: float = param(1.0, least=0.0, help="less movement in an epoch counts as 0")
    min_seen: float = param(0.5, above=0.0, most=1.0, help="share of the frames that must have been seen")
    crosstalk_ratio: float = param(3.0, above=1.0, help="how much stronger another's movement must be to be suspected")
    reset_gap_s: float = reset_gap(43_200.0, "a longer silence is not filled with unknown epochs")

    def open(self, specs: Specs) -> Specs:
        spec = specs["motion"]
        numeric(spec, "motion")
        rate_hz = regular(spec, "motion")
        if not spec.is_signal or not spec.channels:
            raise InputError(
                "motion", spec.describe(), "a channel for each sleeper, as operators.bed.motion.Motion gives"
            )
        check_view(specs)
        if "bed" in specs and specs["bed"].dtype != BED:
            raise InputError("bed", specs["bed"].describe(), "the output of operators.bed.presence.Presence")
        if "far" in specs and (specs["far"].shape, specs["far"].channels) != (spec.shape, spec.channels):
            raise InputError("far", specs["far"].describe(), "the output far of operators.bed.motion.Motion")
        if self.epoch_s * rate_hz < 4:
            raise ParameterError("epoch_s", self.epoch_s, f"at least {4 / rate_hz:g} (four frames)")
        slot_s = max(self.smooth_s, 1 / rate_hz)
        slots = max(1, round(self.epoch_s / slot_s))
        epoch_ns = round(self.epoch_s * NS)
        unasked = UNKNOWN if "bed" in specs else IN
        limits = ActivityLimits(self.sigmas, self.min_rise, self.min_s, self.min_seen, self.crosstalk_ratio, unasked)
        self.set_state(
            ActivityState(
                SleeperActivity.unknown(list(spec.channels), limits, -(-epoch_ns // slots)), epoch_ns, NEVER, 0,
                int(self.reset_gap_s * NS) // epoch_ns, self.epoch_s * rate_hz, EpochSlots.empty(slots, len(spec.channels)), 0,
            ),
            delay_s=self.epoch_s,
            decision_s={"epochs": 1 / rate_hz},
        )  # fmt: skip
        settling = max(s.settling_s for s in specs.values())
        meta = {**spec.meta, "measure": "share of the time with movement", "epoch_s": self.epoch_s}
        out = spec.derive(
            dtype=np.dtype(np.float64), rate_hz=1 / self.epoch_s, units=("",), meta=meta, settling_s=settling
        )
        units = ("ns", "ns", "", "s", "", "", "", spec.units[0], "")
        return {"out": out, "epochs": StreamSpec((), EPOCH_SEEN, units=units, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        made: Rows = []
        if port == "bed":
            for event, time in zip(chunk.data, chunk.time.tolist(), strict=True):
                self._pass(time - 1, made)
                throughout = s.begin != NEVER and int(event["onset"]) <= s.begin
                s.sleepers.move(str(event["sleeper"]), str(event["state"]), str(event["why"]), throughout)
            chunk = Chunk(chunk.time, chunk.data, chunk.until)
        elif port == "view":
            for event, time in zip(chunk.data, chunk.time.tolist(), strict=True):
                self._pass(time - 1, made)
                s.sleepers.look(str(event["what"]))
            chunk = Chunk(chunk.time, chunk.data, chunk.until)
        elif port == "far":
            emitted, made = self._motion(chunk, s.slots.far_sums, s.slots.far_counts, lost=0)
        elif len(chunk.time):
            emitted, made = self._motion(chunk, s.slots.sums, s.slots.counts, chunk.lost)
        if chunk.until == FOREVER:
            self._end(made)
        elif self._pass(chunk.until, made):
            emitted += self._chunks(made, chunk.until)
            made, s.lost = [], -1
        return [*emitted, *self._chunks(made, chunk.until)]

    def close(self) -> list[tuple[str, Chunk]]:
        made: Rows = []
        self._end(made)
        return self._chunks(made, FOREVER)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(16)
        motion = random.normal(0.6, 0.01, (600, 2))
        motion[200:230, 0] += 0.5
        motion[205:215, 1] += 0.1
        motion[400:410] = np.nan
        time = grid(10.0, 600)
        bed = np.zeros(5, BED)
        bed["onset"] = time[[5, 6, 300, 350, 500]]
        bed["sleeper"] = ["left", "right", "left", "left", "right"]
        bed["state"] = ["in", "in", "out", "in", "unknown"]
        spec = StreamSpec((2,), rate_hz=10.0, channels=("left", "right"), units=("mm",))
        events = StreamSpec((), BED, meta={"sleepers": ["left", "right"]})
        inputs = {"bed": (events, bed["onset"], bed), "motion": (spec, time, motion)}
        view = np.array(
            [(time[220], "moved", 8.0, 0.0), (time[420], "dark", 0.0, 0.0), (time[460], "steady", 0.0, 0.0)], VIEW
        )
        seen = (StreamSpec((), VIEW), view["onset"].copy(), view)
        return [
            Case(cls(epoch_s=2.0, reset_gap_s=30.0), inputs, least=29 * 3),
            Case(cls(epoch_s=2.0, reset_gap_s=30.0), {"view": seen, **inputs}, least=29 * 3),
            Case(cls(epoch_s=2.0, reset_gap_s=30.0), {"far": (spec, time, motion + 0.01), **inputs}, least=29 * 3),
            Case(cls(epoch_s=3.0, min_s=0.0, reset_gap_s=60.0), {"motion": inputs["motion"]}, least=19 * 3),
        ]

    def _motion(self, chunk: Chunk, sums: Samples, counts: Samples, lost: int) -> tuple[list[tuple[str, Chunk]], Rows]:
        """Take the samples of a chunk into `sums` and `counts`; what is emitted before its gap, and what it leads to."""
        s = self.state
        time, x = chunk.time, np.ascontiguousarray(chunk.data, np.float64)
        emitted: list[tuple[str, Chunk]] = []
        made: Rows = []
        start = 0
        while start < len(time):
            t = int(time[start])
            again = self._pass(t - 1, made)
            if again or (lost and not start and (made or not s.lost)):
                emitted += self._chunks(made, t - 1)
                made, s.lost = [], -1
            if s.begin == NEVER:
                s.begin = t // s.epoch_ns * s.epoch_ns
                s.sleepers.begin()
            stop = int(np.searchsorted(time, s.begin + s.epoch_ns))
            collect(x[start:stop], time[start:stop], s.begin, s.sleepers.slot_ns, sums, counts)
            s.silent = 0
            start = stop
        return emitted, made

    def _pass(self, until: int, made: Rows) -> bool:
        """Close every epoch that is over by `until`; whether the silence has become too long to go on."""
        s = self.state
        while s.begin != NEVER and until >= s.begin + s.epoch_ns - 1:
            if not s.slots.counts.any():
                s.silent += 1
            if s.silent > s.max_silent:
                self._forget()
                return True
            self._epoch(made)
        return False

    def _end(self, made: Rows) -> None:
        if self.state.begin != NEVER and self.state.slots.counts.any():
            self._epoch(made)
        self._forget()

    def _forget(self) -> None:
        self.state.begin, self.state.silent = NEVER, 0
        self.state.sleepers.forget()

    def _epoch(self, made: Rows) -> None:
        """Close the open epoch and open the next one."""
        s = self.state
        seen = s.slots.counts.sum(axis=0) / s.expected
        made += s.sleepers.end(s.begin, s.begin + s.epoch_ns, *s.slots.averages(), seen)
        s.slots.clear()
        s.begin += s.epoch_ns

    def _chunks(self, made: Rows, until: int) -> list[tuple[str, Chunk]]:
        s = self.state
        lost, s.lost = s.lost, 0
        k = len(s.sleepers.sleepers)
        events = np.array([event for _, event in made], EPOCH_SEEN)
        data = np.array([activity for activity, _ in made]).reshape(len(made) // k, k)
        promise = (until + 1) // s.epoch_ns * s.epoch_ns - 1 if NEVER < until < FOREVER else until
        return [
            ("out", Chunk(events["onset"][::k].copy(), data, promise, lost)),
            ("epochs", Chunk(events["end"] - 1, events, until, lost)),
        ]
