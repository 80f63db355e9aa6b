"""Sleep or wake, epoch by epoch: at once as provisional, and once more, when all that it depends on is known, as final."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from kinegraph.operators.inputs.channels import names_of, the_channel
from kinegraph.operators.sleep.epoch_scores import EpochScores
from kinegraph.operators.sleep.methods import MethodName, rule
from kinegraph.operators.sleep.rescoring import REACH_MIN
from kinegraph.operators.sleep.scored_input import calibration_for, epoch_length
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Specs, StreamSpec
from kinegraph.stream.data.require import numeric, regular
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

EPOCH = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("state", "U7"),
        ("score", "<f8"),
        ("activity", "<f8"),
        ("final", "?"),
        ("rescored", "?"),
    ]
)
"""One epoch's score; `activity` is what was scored (counts, or motion), NaN where nothing was seen."""

REASONED = np.dtype(
    [
        *((name, EPOCH[name]) for name in EPOCH.names or ()),
        ("cause", "U8"),
        ("mover", "<i8"),
        ("weight", "<f8"),
        ("adds", "<f8"),
        ("rule", "U14"),
    ]
)
"""An epoch's score with its reason; see `SleepScorer`. Recordings of older versions hold EPOCH."""


Rows: TypeAlias = list[tuple[Any, ...]]


@dataclass(slots=True)
class ScorerState:
    """
    silent   how many epochs went by without a sample
    calibrated, gain, offset  whether and how motion becomes counts
    sleeper  the sleeper; crowded: whether the newest reported epoch had a second body
    """

    scores: EpochScores
    channel: int
    max_silent: int
    silent: int
    lost: int
    calibrated: bool
    gain: float
    offset: float
    sleeper: str
    crowded: bool


@dataclass(frozen=True, slots=True)
class SleepScorer(Operator[ScorerState]):
    """Epochs of activity in (one channel, stamped with their start), two events per epoch out: provisional, then final.

    onset, end  of the epoch (ns). state: sleep, wake, or unknown where the epoch, or too much around it, was not seen
    score       of the method (thesis, Cole-Kripke, Scripps, Oakley: more is wake; Sadeh: more is sleep); NaN where unknown
    final       false: at once, as if no movement were to follow. True: nothing can change it any more
    rescored    Webster's rules made wake of it
    cause       movement (the score reaches wake), still (it does not), rescored (`rule`); of unknown ones: unseen, gaps (too much around
                it was not seen), start (Oakley: too near the first)
    mover, weight, adds  onset of the epoch whose movement adds most to the score (0: there was no movement), its share of all weight that
                was seen (Sadeh: NaN, for it weighs no single epoch), and how much of the score it adds
    rule        of Webster: after 4 (10, 15) min, between 10 (20) min; see operators.sleep.rescoring

    Events are stamped with the epoch at which they were decided; a missing epoch is noticed three quarters of an epoch after it should
    have begun.
    The final score comes `future` epochs later (thesis 3, 90 s; Cole-Kripke 2; Scripps 2; Sadeh 5; Oakley 1 to 8); with `rescore`, up to
    30 min after that. Finals come in the order of the epochs.

    It estimates sleep and wake from movement: it is not validated against polysomnography, and quiet wakefulness is commonly scored as
    sleep. Not a medical device.

    The methods of counts take the wrist counts of their own device: unit "counts", and in the stream's meta `site: wrist` and `device:
    ami, actigraph or actiwatch`. Anything else, depth motion above all, they refuse, unless `calibration` names a file that says how it
    becomes such counts. `thesis` takes any movement: an epoch counts as active above `active_above`; its weights are a Gaussian about the
    epoch (sigma 2 epochs), summing to 1, wake from 0.3 on. The thesis gives neither number, and prints the comparison the wrong way round.

    Where a neighbour was not seen, its weight is left out of the sum and of the threshold, down to `min_seen` of all weight. What stands
    before the first epoch: zero counts for ActiLife's methods; what was seen otherwise; under Oakley the epoch is unknown (Actiware). After
    the last one no movement is assumed. A silence gives unknown epochs up to `reset_gap_s`; beyond, scoring starts again.

    With `seen` connected (the output epochs of operators.bed.activity.Activity), movement in the epoch before the first one with a second
    body (`body`) counts as not seen, unless that epoch is final: the other may have come then.

    >>> given, made = tried(SleepScorer)
    >>> given["in"][:3, 0].round(2), made["state"][made["final"]][:3].tolist()
    (array([90., 54., 40.]), ['wake', 'wake', 'wake'])
    """

    inputs = {"in": Input(trigger=True), "seen": Input(optional=True)}

    method: MethodName = param("thesis", help="the scorer; all but thesis take counts of their own device")
    threshold: float | None = param(None, help="in place of the method's own (Oakley: 20, 40, 80; thesis: 0.3)")
    active_above: float = param(0.0, least=0.0, help="thesis: an epoch with more than this has movement")
    sigma_epochs: float = param(2.0, above=0.0, help="thesis: the Gaussian's width, in epochs of 30 s")
    rescore: bool = param(False, help="Webster's rules: short sleep after long wake is wake")
    calibration: str = param("", help="a file that turns the input's motion into the method's counts")
    channel: str | int | None = param(None, help="name, or number from 0; may be left out if there is only one")
    min_seen: float = param(0.5, above=0.0, most=1.0, help="share of the method's weight that must have been seen")
    reset_gap_s: float = reset_gap(43_200.0, "a longer silence is not filled with unknown epochs")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        numeric(spec)
        epoch_s = 1 / regular(spec)
        if not spec.is_signal:
            raise InputError("in", spec.describe(), "a signal of activity per epoch")
        epoch_s = epoch_length(self.method, epoch_s)
        channel = the_channel(spec, self.channel)
        if "seen" in specs and not {"onset", "sleeper", "why"} <= set(specs["seen"].dtype.names or ()):
            raise InputError("seen", specs["seen"].describe(), "the output epochs of operators.bed.activity.Activity")
        given_unit = spec.unit_of(names_of(spec)[channel]) if spec.channels else spec.units[0]
        used = calibration_for(self.method, self.calibration, spec, given_unit, epoch_s)
        if self.method == "thesis" and self.threshold is not None and not 0 < self.threshold <= 1:
            raise ParameterError("threshold", self.threshold, "above 0 and at most 1 (the share of weight in movement)")
        made = rule(
            self.method,
            epoch_s,
            threshold=self.threshold,
            active_above=self.active_above,
            sigma_epochs=self.sigma_epochs,
            whole=self.method == "oakley",
        )
        reach = int(np.ceil(REACH_MIN * 60 / epoch_s)) + 2 if self.rescore else 0
        n = made.past + 1 + made.future + 2 * reach
        self.set_state(
            ScorerState(
                EpochScores.empty(made, self.rescore, self.min_seen, spec.period_ns, n), channel,
                int(self.reset_gap_s * NS) // spec.period_ns, 0, 0,
                used is not None, used.gain if used else 1.0, used.offset if used else 0.0,
                spec.channels[channel] if spec.channels else "", False,
            ),
            decision_s={"out": max(made.future + reach - 0.25, 0.0) * epoch_s},
        )  # fmt: skip
        meta = {
            **spec.meta,
            "method": self.method,
            "rescored": self.rescore,
            "threshold": made.limit,
            "calibration": used.name if used else "",
            "epoch_s": epoch_s,
        }
        unit = spec.units[channel % len(spec.units)]
        units = ("ns", "ns", "", "", unit, "", "", "", "ns", "", "", "")
        return {"out": StreamSpec((), REASONED, units=units, settling_s=spec.settling_s, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        made: Rows = []
        stamps: list[int] = []
        emitted: list[tuple[str, Chunk]] = []
        if port == "seen":
            for event, t in zip(chunk.data, chunk.time.tolist(), strict=True):
                self._missing(t - 1, made, stamps)
                self._crowd(str(event["sleeper"]), int(event["onset"]), str(event["why"]) == "body")
            if chunk.until == FOREVER:  # activity itself may go on
                return [("out", self._chunk(made, stamps, int(chunk.time[-1])))] if len(chunk.time) else []
            self._missing(chunk.until, made, stamps)
            return [("out", self._chunk(made, stamps, chunk.until))]
        x = np.asarray(chunk.data[:, s.channel], np.float64) if len(chunk.time) else np.empty(0)
        for k, t in enumerate(chunk.time.tolist()):
            self._missing(t - 1, made, stamps)
            if chunk.lost and k == 0:
                emitted.append(("out", self._chunk(made, stamps, t - 1)))
                made, stamps, s.lost = [], [], -1
            s.silent = 0
            self._epoch(t, value if abs(value := float(x[k])) < np.inf else np.nan, t, made, stamps)
        if chunk.until == FOREVER:
            self._finish(made, stamps)
        else:
            self._missing(chunk.until, made, stamps)
        return [*emitted, ("out", self._chunk(made, stamps, chunk.until))]

    def close(self) -> Chunk:
        made: Rows = []
        stamps: list[int] = []
        self._finish(made, stamps)
        return self._chunk(made, stamps, FOREVER)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(22)
        night = np.repeat(rng.random(12) < 0.4, 15)[:, None] * rng.gamma(1.0, 150.0, size=(180, 1)).round()
        inputs = {}
        for device, epoch_s in (("", 30.0), ("actigraph", 60.0), ("actiwatch", 30.0), ("ami", 60.0)):
            meta = {"device": device, "site": "wrist"} if device else {}
            spec = StreamSpec(
                (1,), rate_hz=1 / epoch_s, channels=("a",), units=("counts" if device else "mm",), meta=meta
            )
            inputs[device] = {"in": (spec, grid(1 / epoch_s, 180), night)}
        gap = 3600.0
        crowd = np.zeros(180, np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("why", "U8")]))
        crowd["onset"], crowd["sleeper"] = grid(1 / 30.0, 180), "a"
        crowd["why"][rng.random(180) < 0.3] = "body"
        seen = (StreamSpec((), crowd.dtype), crowd["onset"] + 30 * NS - 1, crowd)
        return [
            Case(cls(reset_gap_s=gap), inputs[""], least=360),
            Case(cls(reset_gap_s=gap), {**inputs[""], "seen": seen}, least=360),
            Case(cls("cole_kripke_actilife", rescore=True, reset_gap_s=gap), inputs["actigraph"], least=360),
            Case(cls("oakley", rescore=True, reset_gap_s=gap), inputs["actiwatch"], least=360),
            Case(cls("sadeh", reset_gap_s=gap), inputs["ami"], least=360),
        ]

    def _missing(self, until: int, made: Rows, stamps: list[int]) -> None:
        """Epochs that should have begun long enough before `until` and did not come: unknown; after too many, scoring ends."""
        s = self.state
        while s.scores.newest != NEVER and until >= (due := s.scores.newest + s.scores.epoch_ns * 7 // 4):
            s.silent += 1
            if s.silent > s.max_silent:
                self._finish(made, stamps)
            else:
                self._epoch(s.scores.newest + s.scores.epoch_ns, np.nan, due, made, stamps)

    def _epoch(self, onset: int, value: float, stamp: int, made: Rows, stamps: list[int]) -> None:
        """One more epoch: its provisional score, and the final ones of those that it settles."""
        s = self.state
        made.append(
            s.scores.add(onset, max(0.0, (value - s.offset) * s.gain) if s.calibrated and value == value else value)
        )
        while event := s.scores.final(ended=False):
            made.append(event)
        stamps += [stamp] * (len(made) - len(stamps))

    def _crowd(self, sleeper: str, onset: int, crowded: bool) -> None:
        """Note whether a sleeper's epoch has a second body: before the first such epoch, movement may be the other's."""
        s = self.state
        if sleeper != s.sleeper:
            return
        if crowded and not s.crowded:
            s.scores.distrust(onset - s.scores.epoch_ns)
        s.crowded = crowded

    def _finish(self, made: Rows, stamps: list[int]) -> None:
        """Nothing follows: all that waits gets its final score, and everything is forgotten."""
        s = self.state
        if s.scores.newest == NEVER:
            return
        s.scores.end()
        while event := s.scores.final(ended=True):
            made.append(event)
        stamps += [s.scores.newest + s.scores.epoch_ns * 7 // 4] * (len(made) - len(stamps))
        s.scores.forget()
        s.silent = 0

    def _chunk(self, made: Rows, stamps: list[int], until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        return Chunk(np.array(stamps, np.int64), np.array(made, REASONED), until, lost)
