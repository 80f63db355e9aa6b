"""How far a muscle's activity has moved: its latest mixture against the session's first cycles, the other leg, and a stored reference."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeAlias

import numpy as np

from kinegraph.operators.cycles.cycle import MAXIMUM, Expected, check_named_cycles, some_cycles
from kinegraph.operators.emg.mixtures.distance import cauchy_schwarz
from kinegraph.operators.emg.mixtures.emg_model import read_references
from kinegraph.operators.emg.mixtures.events import MIXTURE, WHEN
from kinegraph.operators.emg.mixtures.first_references import FirstReferences
from kinegraph.operators.emg.mixtures.moved import FIRST, STORED, Alarm, Moved
from kinegraph.operators.emg.mixtures.operator import PeakMixtures, limb_of_groups, muscle_groups, some_maxima
from kinegraph.operators.emg.mixtures.pairs import limb_pairing, pairing
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.reference import ReferenceFit, References, student
from kinegraph.operators.emg.mixtures.refit import Fitting, Refit
from kinegraph.operators.monitors.stage_change import StageUnderWay
from kinegraph.stream.chunk import NS, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.domain.alarm import ALARM, ALARM_UNITS, OVER
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

DISTANCE = np.dtype(
    [
        *WHEN,
        ("from_first", "<f8"),
        ("limit", "<f8"),
        ("from_stored", "<f8"),
        ("stored_limit", "<f8"),
        ("from_other", "<f8"),
        ("full", "<f8"),
        ("noise", "<f8"),
        ("moved", "<U8"),
    ]
)
"""Cauchy-Schwarz divergences of a muscle's latest mixture; NaN: not known (yet). `full` and `noise` are the reference's own, to read the
others by. `moved` says from what it has moved away: "", "first", "stored" or "both"."""
DISTANCE_UNITS = ("ns", "ns", *("",) * 11)
Given: TypeAlias = tuple[StreamSpec, Array, Array]


@dataclass(slots=True)
class MixtureDriftState:
    """
    window    the latest cycles
    refit     the newest cycles' mixture, followed from a reference
    first, stored   the references of each mixture;  limb (g,): the limb of its muscles
    other (o,)      the other leg's latest mixtures;  pairing (g,): each one's counterpart among them, or -1
    fresh (g,)   mixtures since the last window that was judged
    moved        what has moved away, from which reference;  stage: of each limb
    """

    expected: Expected
    window: PeakWindow
    refit: Refit
    first: FirstReferences
    stored: References
    group: Times
    limb: Times
    other: Array
    pairing: Times
    fresh: Times
    moved: Moved
    stage: StageUnderWay
    names: list[str]
    spread: bool
    how: Fitting


@dataclass(frozen=True, slots=True)
class MixtureDrift(Operator[MixtureDriftState]):
    """A leg's cycles and mixtures in, how far they are from its reference out, and an alarm where one has moved away.

    mixture          of `operators.emg.mixtures.PeakMixtures`; maxima, closed, cycles: what it is made from; the reference is made from them
    other            the other leg's mixtures; counterparts have the same name, but for a leading or trailing L or R. Where `mixture` is of
                     two limbs (`operators.cycles.limb_cycles.LimbCycles`), they are each other's, and there is no `other`
    pace             as of PeakMixtures: the reference and its limit are made a step with each of its samples

    distance         one event per mixture (`DISTANCE`): divergence of the latest `cycles` from the mixture of the session's `first`
                     accepted ones, from that in the file `reference` (`kinegraph emg train-model`), of the mixture from the other leg's
    change           alarms: "on" when the divergence exceeds the limit in `windows` windows in a row, "over" when it keeps it as often

    The latest cycles' mixture is followed from the reference's: EM begins there, so it has the same modes, wherever they have gone. The
    limit is the 99th percentile of the divergences between a random part of the reference's own cycles, as large as a window, and the rest
    (`pairs` of them), followed alike. Only windows that share no cycle are judged, so one odd cycle is no change. The limit is not known
    before the first cycles are there and all pairs are fitted (`pace`: some 200 samples a muscle).

    A cycle that is taken back after the reference was made stays in it. Where `closed` has stages (`operators.cycles.stages.Stages`), the
    reference is that of the stage's `first` cycles: another stage, or a belt speed more than 0.1 m/s different, begins another, and
    ends an alarm. The stored reference stays.

    >>> given, made = tried(MixtureDrift)
    >>> len(given["mixture"]), made["distance"][["number", "name"]][-1].item()
    (42, (24, 'SO'))
    """

    inputs = {
        "maxima": Input(),
        "closed": Input(),
        "cycles": Input(trigger=True),
        "other": Input(optional=True),
        "mixture": Input(trigger=True),
        "pace": Input(trigger=True, optional=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("distance", "change")

    first: int = param(60, least=4, most=200, help="how many of the first accepted cycles are the session's reference")
    pairs: int = param(100, least=10, most=1000, help="pairs of random parts that the limit is taken from")
    cycles: int = param(3, least=2, most=200, help="how many of the latest cycles are compared with a reference")
    windows: int = param(3, least=1, most=100, help="how many windows in a row must exceed the limit")
    reference: str = param("", help="a stored reference; empty: only the session's own")

    def open(self, specs: Specs) -> Specs:
        spec = check_named_cycles(specs)
        mixture = specs["mixture"]
        if specs["maxima"].dtype != MAXIMUM:
            raise InputError("maxima", specs["maxima"].describe(), "`maxima` of operators.cycles.cycles.Cycles")
        for port in ("mixture", "other"):
            if port in specs and (specs[port].dtype != MIXTURE or "fitting" not in specs[port].meta):
                raise InputError(port, specs[port].describe(), "`mixture` of operators.emg.mixtures.PeakMixtures")
        how = fitting_of(mixture)
        if self.first < 2 * how.fewest_cycles:
            accepts = f"at least {2 * how.fewest_cycles}: twice the fewest_cycles of the mixtures"
            raise ParameterError("first", self.first, accepts)
        if self.cycles > self.first // 2:
            raise ParameterError("cycles", self.cycles, f"at most half of first ({self.first})")
        group, names = muscle_groups(spec.channels, tuple(map(tuple, mixture.meta["joint"])))
        limb, limbs = limb_of_groups(spec, group, names)
        others = list(specs["other"].meta["muscles"]) if "other" in specs else names if limbs > 1 else []
        if "other" in specs and limbs > 1:
            raise InputError(
                "other", specs["other"].describe(), "nothing: `mixture` is of several limbs, which are compared"
            )
        if "other" in specs and specs["other"].meta.get("height_unit") != mixture.meta.get("height_unit"):
            accepts = f"in {mixture.meta.get('height_unit')!r}, as `mixture` is"
            raise InputError("other", f"heights in {specs['other'].meta.get('height_unit')!r}", accepts)
        student(self.first / self.cycles - 1.0)  # designed here, not while samples come
        g = len(group)
        stored = read_references(Path(self.reference), mixture, names) if self.reference else References.empty(g)
        room, *held = (PeakWindow.empty(max(self.first, self.cycles), spec.shape[1], limbs) for _ in range(limbs + 1))
        pairs = limb_pairing(group, limb, spec) if limbs > 1 else pairing(names, others)
        self.set_state(
            MixtureDriftState(
                Expected.empty(specs["closed"].dtype),
                room, Refit.empty(self.cycles, group.shape[1]),
                FirstReferences.empty(g, held, self.first, ReferenceFit.empty(self.first, group.shape[1], self.pairs)), stored, group,
                limb, np.zeros(len(others), MIXTURE), pairs, np.zeros(g, np.int64), Moved.empty(g), StageUnderWay.empty(limbs), names,
                "pace" in specs, how,
            ),
            decision_s={"distance": 0.0},
        )  # fmt: skip
        return {
            "distance": StreamSpec((), DISTANCE, units=DISTANCE_UNITS, meta={**mixture.meta, "first": self.first}),
            "change": StreamSpec(
                (), ALARM, units=ALARM_UNITS, meta={**mixture.meta, "needs_cycles": self.first + 3 * self.cycles}
            ),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        stamps, rows = list[int](), list[Array]()
        alarms = list[tuple[int, Alarm]]()
        if port == "mixture":
            for k, stamp in enumerate(chunk.time.tolist()):
                stamps.append(stamp)
                if len(s.first.held) > 1:
                    self._remember(chunk.data[k : k + 1])
                rows.append(self._compare(stamp, chunk.data[k : k + 1], alarms))
        elif port == "other":
            self._remember(chunk.data)
        elif port == "pace":
            for _ in range(len(chunk)):
                if not self._step():
                    break  # nothing is due before the next cycle
        else:
            self._collect(port, chunk, alarms)
        lost = -1 if chunk.lost and port == "mixture" else 0
        when = np.array([stamp for stamp, _ in alarms], np.int64)
        data = np.concatenate([np.empty(0, DISTANCE), *rows])
        return [
            ("distance", Chunk(np.array(stamps, np.int64), data, chunk.until, lost)),
            ("change", Chunk(when, np.array([row for _, row in alarms], ALARM), chunk.until, lost)),
        ]

    @classmethod
    def cases(cls) -> list[Case]:
        inputs, other = _some_mixtures(24, PeakMixtures(cycles=6, fewest_cycles=2, contrast=1.1))
        last = int(other[1][-1] / NS * 200)
        pace = (StreamSpec((1,), rate_hz=200.0), grid(200.0, last), np.zeros((last, 1)))
        return [
            Case(cls(first=4, windows=1, cycles=2, pairs=10), {**inputs, "other": other, "pace": pace}, least=20),
            Case(cls(first=6, pairs=10), inputs, least=20),
        ]

    @classmethod
    def warm_up_cases(cls) -> list[Case]:
        inputs, other = _some_mixtures(10, PeakMixtures(cycles=4, fewest_cycles=2, contrast=1.0, max_sweeps=4))
        return [Case(cls(first=4, windows=1, cycles=2, pairs=10), {**inputs, "other": other})]

    def _collect(self, port: str, chunk: Chunk, alarms: list[tuple[int, Alarm]]) -> None:
        """Take a cycle in; when there are enough, the reference begins. Another stage has another reference."""
        s = self.state
        if port == "maxima":
            s.window.note_peaks(chunk.data)
        elif port == "closed":
            s.expected.note(chunk)
            for row in chunk.data:
                s.window.reject(int(row["number"]))
        else:
            for stamp, closed, curve in s.expected.matched(chunk):
                limb = s.window.limb(number := int(closed["number"][0]))
                if s.stage.begins(limb, closed[0]):
                    self._begin_again(stamp, limb, alarms)
                if not s.stage.holds(limb, number):
                    continue
                s.window.accept(number, curve)
                s.first.take(limb, s.window)
        while not s.spread and self._step():
            pass

    def _begin_again(self, stamp: int, limb: int, alarms: list[tuple[int, Alarm]]) -> None:
        """A limb's cycles so far are no reference for those to come."""
        s = self.state
        s.window.forget(limb)
        mixtures = np.flatnonzero(s.limb == limb).tolist()
        s.first.forget(limb, mixtures)
        for muscle in mixtures:
            s.fresh[muscle] = 0
            if s.moved.forget(FIRST, muscle):
                alarms.append((stamp, s.moved.alarm(FIRST, muscle, s.names[muscle], OVER, self.first)))

    def _step(self) -> bool:
        """A piece of work on the references; whether there was any."""
        s = self.state
        return s.first.step(s.group, s.limb, self.cycles, s.how)

    def _remember(self, rows: Array) -> None:
        """The other leg's latest mixtures."""
        for row in rows:
            self.state.other[int(row["muscle"])] = row

    def _compare(self, stamp: int, row: Array, alarms: list[tuple[int, Alarm]]) -> Array:
        s, muscle = self.state, int(row["muscle"][0])
        out = np.zeros(1, DISTANCE)
        for field, *_ in WHEN:
            out[field] = row[field]
        first, stored = (self._moved(known, muscle) for known in (s.first.known, s.stored))
        out["from_first"], out["limit"] = first, s.first.known.limit[muscle]
        out["from_stored"], out["stored_limit"] = stored, s.stored.limit[muscle]
        if (counterpart := int(s.pairing[muscle])) >= 0:
            out["from_other"] = _divergence(row[0], s.other[counterpart], s.how.turns)
        else:
            out["from_other"] = np.nan
        out["full"], out["noise"] = s.first.known.full[muscle], s.first.known.noise[muscle]
        s.fresh[muscle] += 1
        if s.fresh[muscle] >= self.cycles:
            s.fresh[muscle] = 0
            for kind, distance, known in ((FIRST, first, s.first.known), (STORED, stored, s.stored)):
                onset = int(row["onset"][0])
                if state := s.moved.judge(kind, muscle, distance, known.limit[muscle], onset, self.windows):
                    alarms.append((stamp, s.moved.alarm(kind, muscle, s.names[muscle], state, self.first)))
        out["moved"] = s.moved.from_which(muscle)
        return out

    def _moved(self, known: References, muscle: int) -> float:
        """How far the newest cycles' mixture, followed from a reference, is from it."""
        s = self.state
        if known.modes[muscle] <= 0:
            return np.nan
        group = s.group[muscle]
        latest = s.window.latest(self.cycles, int(s.limb[muscle]))
        s.refit.follow(s.window, latest, group[group >= 0], s.how, known.mixture(muscle))
        return known.distance(muscle, s.refit.mixture(), s.how.turns)


def fitting_of(spec: StreamSpec) -> Fitting:
    """How the mixtures of this stream were fitted."""
    return Fitting(**spec.meta["fitting"])


def _some_mixtures(cycles: int, mixer: PeakMixtures) -> tuple[dict[str, Given], Given]:
    """Made-up cycles, their maxima and what `mixer` makes of them; and the other leg's mixtures, 3 % of the cycle later."""
    inputs = some_cycles(cycles, 2, 5)
    inputs = {"maxima": some_maxima(inputs), **inputs}
    spec = mixer.open({port: given[0] for port, given in inputs.items()})["mixture"]
    stamps, rows = _mixtures(mixer, inputs)
    other = rows.copy()
    other["mean"][:, :, 0] += 3.0
    return {**inputs, "mixture": (spec, stamps, rows)}, (spec, stamps, other)


def _mixtures(mixer: PeakMixtures, inputs: dict[str, Given]) -> tuple[Times, Array]:
    """What an opened operator makes of these cycles: stamps and events."""
    stamps, rows = list[Array](), list[Array]()
    order = sorted((int(t), k, port, i) for k, port in enumerate(inputs) for i, t in enumerate(inputs[port][1]))
    for stamp, _, port, i in order:
        _, time, data = inputs[port]
        for name, chunk in mixer.process(port, Chunk(time[i : i + 1], data[i : i + 1], stamp)):
            if name == "mixture" and len(chunk):
                stamps.append(chunk.time)
                rows.append(chunk.data)
    return np.concatenate(stamps), np.concatenate(rows)


def _divergence(one: np.void, other: np.void, turns: int) -> float:
    """Between the mixtures of two events; NaN where one has no modes."""
    first, second = (
        (row["weight"][:k].copy(), row["mean"][:k].copy(), row["covariance"][:k].copy())
        for row, k in ((one, int(one["modes"])), (other, int(other["modes"])))
    )
    return float(cauchy_schwarz(*first, *second, turns)) if len(first[0]) and len(second[0]) else np.nan
