"""Where and how high a muscle is active in the cycle: Gaussian mixtures of activation peaks, refitted with every cycle (thesis 6.2.4)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import ClassVar

import numpy as np

from kinegraph.operators.contacts.limbs import limbs_of
from kinegraph.operators.cycles.cycle import MAXIMUM, Closing, Expected, check_named_cycles, some_cycles
from kinegraph.operators.emg.mixtures.events import MIXTURE, MIXTURE_UNITS, MODE, WHEN, mode_units
from kinegraph.operators.emg.mixtures.peak_window import PeakWindow
from kinegraph.operators.emg.mixtures.refit import UNKNOWN, Fitting, Refit, highest_apart
from kinegraph.stream.chunk import FOREVER, NEVER, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError, nearest
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param


@dataclass(slots=True)
class MixturesState:
    """
    window    the latest cycles;  refit: the mixture that is being fitted
    group (g, w)   the muscles of each mixture, -1 where there are fewer;  due (g,): 1 where the newest cycle is still to be fitted
    limb (g,) the limb of each mixture;  job: the mixture that `refit` computes, or -1;  turn: where the search for the next begins
    closed (l,)    the event of each limb's newest cycle;  of (1,): of that which `refit` is about
    spread    whether there is a `pace`;  reported: the newest `until` that was emitted
    """

    expected: Expected
    window: PeakWindow
    refit: Refit
    group: Times
    due: Times
    limb: Times
    job: int
    turn: int
    closed: Array
    of: Array
    names: list[str]
    spread: bool
    reported: int


@dataclass(frozen=True, slots=True)
class PeakMixtures(Operator[MixturesState]):
    """Every cycle's local maxima in, after each accepted cycle a mixture of those of the last `cycles` per muscle out.

    maxima           of `operators.cycles.cycles.Cycles`
    closed, cycles   of the same, or of `operators.cycles.review.CycleReview`: which cycles count, and which muscles in them
    pace             a regular signal, such as the envelope: with each of its samples one mixture is swept 24 times, so that no sample waits
                     for all of them. Without it a cycle's mixtures are made at once, as the cycle comes

    mixture          one event per accepted cycle and muscle (`MIXTURE`), not known ones with the reason
    modes            one event per mode (`MODE`), the highest first

    A peak is a point (% of the cycle, height). Mariscotti's peaks of the mean curve give the number of modes, k-means along the cycle
    begins them, EM fits them with full covariances. Distances along the cycle are circular: the density is a normal one wrapped around the
    cycle, of which one turn to either side counts (`circular: false`: a plain mixture, as in the thesis and scikit-learn). Modes closer
    than `merge_nats` (symmetric Kullback-Leibler divergence, thesis 6.4.1) are one. A mode's spread is never less than `min_pct` along
    the cycle and `min_height` of the mean curve's peak in height: their squares are added to its variances.

    Only activity counts: a peak that reaches `rest_sd` standard deviations above rest (the quietest tenth of the mean curve), and `of_peak`
    of the way from rest to the mean curve's peak, as a burst of `operators.cycles.statistics.bursts.CycleBursts` does. With both 0 every
    peak counts, as in the thesis.

    Not known: below `fewest_cycles` ("too few cycles"), where the mean curve's peak is less than `contrast` times its median ("no burst": a
    muscle that is silent, or always active), below three peaks, or where fewer than three are activity ("rest"). A second event in
    `closed` of one of the latest 64 cycles takes it out, or puts it back, from the next refit on. `joint` makes one mixture of several
    channels, named after them ("GM+GL").
    Of several limbs (`operators.cycles.limb_cycles.LimbCycles`), each one's muscles are fitted after its own cycles.

    Stamps: the cycle's, or that of the sample of `pace` at which the mixture was done. A cycle that comes while another's mixtures are
    not all done replaces it: those that were not done are next fitted with both.

    >>> given, made = tried(PeakMixtures)
    >>> len(given["maxima"]), made["mixture"][["number", "name", "modes"]][-1].item()
    (1877, (24, 'GM', 11))
    """

    inputs = {"maxima": Input(), "closed": Input(), "cycles": Input(trigger=True), "pace": Input(optional=True)}
    outputs: ClassVar[tuple[str, ...]] = ("mixture", "modes")

    cycles: int = param(20, least=2, most=500, help="how many of the latest cycles")
    fewest_cycles: int = param(5, least=2, help="how many cycles a mixture needs")
    joint: tuple[tuple[str, ...], ...] = param((), help="channels that make one mixture together, e.g. [[GM, GL]]")
    circular: bool = param(True, help="whether 100 % of a cycle is 0 % of the next")
    width: int = param(3, least=1, most=25, help="Mariscotti's w: points of the running mean, odd")
    passes: int = param(3, least=0, most=10, help="Mariscotti's z: how often it runs")
    min_depth: float = param(0.1, least=0.0, below=1.0, help="a peak's second difference, as a share of the deepest")
    merge_nats: float = param(0.5, least=0.0, help="modes that diverge less are one; 0: never")
    tolerance: float = param(1e-4, above=0.0, help="EM ends when a peak's mean log-likelihood gains less")
    max_sweeps: int = param(200, least=1, most=10000, help="EM ends after at most this many sweeps")
    min_pct: float = param(1.0, above=0.0, help="the least spread of a mode along the cycle, in %")
    min_height: float = param(0.05, above=0.0, help="and in height, as a share of the mean curve's peak")
    contrast: float = param(1.5, least=1.0, help="a mean curve with a lower peak over its median has no burst")
    rest_sd: float = param(3.0, least=0.0, help="standard deviations above rest from which a peak is activity")
    of_peak: float = param(0.15, least=0.0, below=1.0, help="and from this part of the mean curve's rise above rest on")

    def fitting(self) -> Fitting:
        return Fitting(
            self.width, self.passes, self.min_depth, self.circular, self.tolerance, self.max_sweeps,
            self.merge_nats, self.min_pct, self.min_height, self.contrast, self.fewest_cycles, self.rest_sd, self.of_peak,
        )  # fmt: skip

    def open(self, specs: Specs) -> Specs:
        spec = check_named_cycles(specs)
        if specs["maxima"].dtype != MAXIMUM:
            raise InputError("maxima", specs["maxima"].describe(), "`maxima` of operators.cycles.cycles.Cycles")
        if "pace" in specs and specs["pace"].rate_hz is None:
            raise InputError("pace", specs["pace"].describe(), "a signal at a regular rate")
        if self.width % 2 == 0:
            raise ParameterError("width", self.width, "an odd number")
        if self.fewest_cycles > self.cycles:
            raise ParameterError("fewest_cycles", self.fewest_cycles, f"at most cycles ({self.cycles})")
        group, names = muscle_groups(spec.channels, self.joint)
        limb, limbs = limb_of_groups(spec, group, names)
        nothing = np.zeros(1, specs["closed"].dtype)
        refit = Refit.empty(self.cycles, group.shape[1])
        rate_hz = specs["pace"].rate_hz if "pace" in specs else None
        late_s = (len(group) + 1) * refit.most_calls(self.max_sweeps) / rate_hz if rate_hz else 0.0
        self.set_state(
            MixturesState(
                Expected.empty(specs["closed"].dtype), PeakWindow.empty(self.cycles, spec.shape[1], limbs),
                refit,
                group, np.zeros(len(group), np.int64), limb, -1, 0, nothing.repeat(limbs), nothing, names, "pace" in specs, NEVER,
            ),
            decision_s=dict.fromkeys(self.outputs, late_s),
        )  # fmt: skip
        unit = spec.units[0] if len(spec.units) == 1 else ""
        meta = {
            **spec.meta, "muscles": names, "height_unit": unit, "cycles": self.cycles,
            "fitting": asdict(self.fitting()), "joint": [list(together) for together in self.joint],
        }  # fmt: skip
        return {
            "mixture": StreamSpec((), MIXTURE, units=MIXTURE_UNITS, meta=meta),
            "modes": StreamSpec((), MODE, units=mode_units(unit), meta=meta),
        }

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s, made = self.state, list[tuple[int, Array]]()
        if port == "maxima":
            s.window.note_peaks(chunk.data)
        elif port == "closed":
            s.expected.note(chunk)
            for row in chunk.data:
                s.window.reject(int(row["number"]))
        elif port == "cycles":
            for stamp, closed, curve in s.expected.matched(chunk):
                self._take(closed, curve)
                if not s.spread:
                    made += [(stamp, row) for row in self._all()]
        else:
            for stamp in chunk.time.tolist():
                if not self._waiting():
                    break  # nothing is due before the next cycle
                if (row := self._step()) is not None:
                    made.append((stamp, row))
        until = s.reported if chunk.until == FOREVER and self._waiting() else chunk.until
        s.reported = max(s.reported, *(stamp for stamp, _ in made), until) if made else max(s.reported, until)
        return self._emitted(made, until, -1 if chunk.lost and port != "pace" else 0)

    def close(self) -> list[tuple[str, Chunk]]:
        """The mixtures of the last cycle that are not done."""
        stamp = self.state.reported + 1
        return self._emitted([(stamp, row) for row in self._all()] if self._waiting() else [], FOREVER, 0)

    @classmethod
    def warm_up_cases(cls) -> list[Case]:
        closed_cycles = some_cycles(8, 2, 5)
        inputs = {"maxima": some_maxima(closed_cycles), **closed_cycles}
        return [Case(cls(cycles=4, fewest_cycles=4, contrast=1.0, max_sweeps=8), inputs)]

    @classmethod
    def cases(cls) -> list[Case]:
        closed_cycles = some_cycles(24, 3, 5)
        inputs = {"maxima": some_maxima(closed_cycles), **closed_cycles}
        last = int(closed_cycles["closed"][1][-1])
        pace = (StreamSpec((1,), rate_hz=60.0), grid(60.0, int(last / 1e9 * 60)), np.zeros((int(last / 1e9 * 60), 1)))
        return [
            Case(cls(cycles=8, contrast=1.2), inputs, least=40),
            Case(
                cls(cycles=6, joint=(("TA", "GM"),), circular=False, contrast=1.2), {**inputs, "pace": pace}, least=30
            ),
        ]

    def _take(self, closed: Array, curve: Array) -> None:
        s = self.state
        s.window.accept(number := int(closed["number"][0]), curve)
        limb = s.window.limb(number)
        s.closed[limb] = closed[0]
        s.due[s.limb == limb] = 1

    def _waiting(self) -> bool:
        return self.state.job >= 0 or bool(self.state.due.any())

    def _all(self) -> list[Array]:
        rows = []
        while self._waiting():
            if (row := self._step()) is not None:
                rows.append(row)
        return rows

    def _step(self) -> Array | None:
        """A piece of work: the mixture under way goes on, or the next begins. The event (1,) of one that is done."""
        s, how = self.state, self.fitting()
        if s.job < 0:
            due = np.flatnonzero(np.roll(s.due, -s.turn))
            if not len(due):
                return None
            s.job = int((due[0] + s.turn) % len(s.due))
            limb = int(s.limb[s.job])
            s.due[s.job], s.turn, s.of = 0, (s.job + 1) % len(s.due), s.closed[limb : limb + 1].copy()
            s.refit.begin(s.window, s.window.latest(self.cycles, limb), self._muscles(s.job), how)
        if not s.refit.go_on(how):
            return None
        row = mixture_row(s.refit, s.of, s.job, s.names[s.job])
        s.job = -1
        return row

    def _muscles(self, group: int) -> Times:
        members: Times = self.state.group[group]
        return members[members >= 0]

    def _emitted(self, made: list[tuple[int, Array]], until: int, lost: int) -> list[tuple[str, Chunk]]:
        stamps = np.array([stamp for stamp, _ in made], np.int64)
        rows = np.concatenate([np.empty(0, MIXTURE), *(row for _, row in made)])
        return [
            ("mixture", Chunk(stamps, rows, until, lost)),
            ("modes", Chunk(stamps.repeat(rows["modes"]), modes_of(rows), until, lost)),
        ]


def muscle_groups(channels: tuple[str, ...], joint: tuple[tuple[str, ...], ...]) -> tuple[Times, list[str]]:
    """The channels of each mixture (g, w), -1 where there are fewer, and its name: the joint ones first. Raises ParameterError."""
    taken = [name for names in joint for name in names]
    for name in taken:
        if name not in channels:
            raise ParameterError("joint", name, f"a channel of `cycles`; {nearest(name, channels)}")
        if taken.count(name) > 1:
            raise ParameterError("joint", name, "each channel once")
    groups = [list(names) for names in joint if names] + [[name] for name in channels if name not in taken]
    table = np.full((len(groups), max(len(names) for names in groups)), -1)
    for row, names in zip(table, groups, strict=True):
        row[: len(names)] = [channels.index(name) for name in names]
    return table, ["+".join(names)[:16] for names in groups]


def limb_of_groups(spec: StreamSpec, group: Times, names: list[str]) -> tuple[Times, int]:
    """The limb of each mixture (g,), and the number of limbs. Raises ParameterError."""
    limbs = list(limbs_of(spec).values()) or [spec.channels]
    owner = np.array([next(i for i, mine in enumerate(limbs) if name in mine) for name in spec.channels])
    for row, name in zip(group, names, strict=True):
        if len(set(owner[row[row >= 0]].tolist())) > 1:
            raise ParameterError("joint", name, "channels of one limb: another's cycles are cut elsewhere")
    return owner[group[:, 0]], len(limbs)


def mixture_row(refit: Refit, closed: Array, muscle: int, name: str) -> Array:
    """The event (1,) of a mixture that is done."""
    row = np.zeros(1, MIXTURE)
    for field in ("onset", "end", "number"):
        row[field] = closed[field]
    row["muscle"], row["name"], row["cycles"], row["peaks"] = muscle, name, refit.cycles, refit.count
    row["unknown"], row["sweeps"], row["settled"] = UNKNOWN[refit.unknown], refit.sweeps, refit.settled
    k = row["modes"][0] = 0 if refit.unknown else refit.modes
    row["likelihood"] = refit.before if k else np.nan
    row["apart_pct"] = highest_apart(refit.means, k)
    for field, part in (("weight", refit.weights), ("mean", refit.means), ("covariance", refit.covariances)):
        row[field] = np.nan
        row[field][0, :k] = part[:k]
    return row


def modes_of(rows: Array) -> Array:
    """The modes of these mixtures, one event each."""
    made = np.zeros(int(rows["modes"].sum()), MODE)
    which = np.arange(len(rows)).repeat(rows["modes"])
    mode = np.arange(len(made)) - (rows["modes"].cumsum() - rows["modes"])[which]
    for field, *_ in WHEN:
        made[field] = rows[field][which]
    made["mode"], made["modes"], made["weight"] = mode, rows["modes"][which], rows["weight"][which, mode]
    made["place_pct"], made["height"] = rows["mean"][which, mode].T
    place, both, height = rows["covariance"][which, mode].T
    made["sd_pct"], made["sd_height"] = np.sqrt(place), np.sqrt(height)
    made["correlation"] = both / np.sqrt(place * height)
    return made


def some_maxima(inputs: dict[str, tuple[StreamSpec, Array, Array]]) -> tuple[StreamSpec, Array, Array]:
    """The local maxima of made-up cycles, for trying operators on."""
    spec, _, curves = inputs["cycles"]
    _, closed_at, closed = inputs["closed"]
    made, when, seen = [], [], set[int]()
    accepted = [(t, row) for t, row in zip(closed_at.tolist(), closed, strict=True) if not row["rejected"]]
    for (stamp, row), curve in zip(accepted, curves, strict=True):
        if int(row["number"]) in seen:
            continue
        seen.add(int(row["number"]))
        wide = np.concatenate([curve[-1:], curve, curve[:1]])
        closing = Closing(stamp, int(row["onset"]), int(row["end"]), int(row["number"]), 60.0, "", wide)
        made.append(closing.maxima(list(spec.channels)))
        when += [stamp] * len(made[-1])
    return StreamSpec((), MAXIMUM, units=("ns", "", "", "", "%", "")), np.array(when), np.concatenate(made)
