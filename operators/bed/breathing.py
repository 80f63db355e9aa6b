"""How fast a sleeper breathes, from the rise and fall of the chest; with a confidence, and with how often it is known at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.bed.bed_events import BED
from kinegraph.operators.bed.breath import gather, peak, powers, straighten, vary
from kinegraph.operators.bed.frames.regions import REGION, block_of, region_spec, sleepers_of, take
from kinegraph.operators.bed.frames.seconds import steep
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times, add_lost
from kinegraph.stream.data.require import regular
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

BREATH = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("sleeper", "U16"),
        ("rate", "<f8"),
        ("confidence", "<f8"),
        ("coverage", "<f8"),
    ]
)
"""A sleeper's breath in an epoch; see `Breathing`."""
FASTEST_TICK_HZ = 2.0
LOWEST, HIGHEST, STEP = 6.0, 40.0, 0.5
"""Breaths per minute that are looked for."""
BEST = 6
"""This many cells, those that vary most slowly, are taken for the chest."""
EDGE_MM = 150.0
"""So far apart are neighbouring cells where there is an edge: their means tremble, see `operators.bed.frames.seconds.steep`."""
NIGHT_NS = 4 * 3600 * NS
"""After this long out of bed, coverage is counted from zero."""

Rows = list[tuple[Any, ...]]


@dataclass(slots=True)
class BreathingState:
    """
    regions    (k, 4)  in blocks; no rows: not known
    size       of a cell in blocks; across: cells in a row of the frame
    ticks      (n, cells)  the newest depths (mm) of all cells, tick by tick, a ring; NaN: not measured
    tick       number of the open tick since 1970; NEVER before the first. sums, counts (cells,): of it
    epoch      start of the open epoch (ns); NEVER before the first
    there, changed  (k,) whether each sleeper is in bed (with `bed`; else always), and when that became so or ended (ns)
    spoilt     (k,)  whether a sleeper was out of bed at any time in the open epoch
    epochs, known  (k,)  epochs in bed of this night, and those with a rate
    cosines, sines (rates, n), rates (rates,): what is looked for
    lost       what the next emission says is missing before it
    """

    sleepers: list[str]
    block: int
    tick_ns: int
    epoch_ns: int
    size: int
    across: int
    regions: Times
    ticks: Samples
    tick: int
    sums: Samples
    counts: Samples
    epoch: int
    there: Times
    changed: Times
    spoilt: Times
    epochs: Times
    known: Times
    rates: Samples
    cosines: Samples
    sines: Samples
    lost: int


@dataclass(frozen=True, slots=True)
class Breathing(Operator[BreathingState]):
    """Mean depths of blocks in; per epoch and sleeper an event with the breath's rate, as far as it can be seen.

    rate        breaths per minute in the epoch; NaN where it is not known: the sleeper moved, was not in bed (with `bed` connected) or not
                seen, or the confidence is below `least_confidence`
    confidence  0 to 1: the share of the chest's power, from 6 to 40 breaths per minute, that lies about the rate
    coverage    share of the night's epochs in bed, up to this one, that have a rate; a night ends with 4 h out of bed

    The chest is those 6 cells of the region, off the edges, that vary most from second to second beyond their
    noise; the rate is where their spectra together are highest (2 Hz at most, no straight line, Hann window over the epoch). An epoch
    in which a cell of the region goes faster than `still_mm_s` has movement, and no rate. It finds no pauses of breath, and raises no
    alarm. No delay: the event comes with the epoch's end.

    >>> given, made = tried(Breathing)
    >>> made["sleeper"].tolist()[:2], made["rate"].round(1)[:4]
    (['a', 'b'], array([nan, nan, 15., nan]))
    """

    inputs = {"regions": Input(), "bed": Input(optional=True), "blocks": Input()}

    epoch_s: float = param(30.0, least=10.0, most=300.0, help="length of an epoch, at whole multiples since 1970")
    cell_blocks: int = param(0, least=0, help="side of a cell in blocks; 0: about 27 cells in a row of the frame")
    still_mm_s: float = param(20.0, above=0.0, help="faster than this is movement, not breath")
    least_confidence: float = param(0.5, least=0.0, most=1.0, help="below this no rate is reported")

    def open(self, specs: Specs) -> Specs:
        spec = specs["blocks"]
        block = block_of(spec, "blocks")
        if "bed" in specs and specs["bed"].dtype != BED:
            raise InputError("bed", specs["bed"].describe(), "the output of operators.bed.presence.Presence")
        sleepers = sleepers_of(specs)
        tick_ns = _tick_ns(regular(spec, "blocks"))
        tick_hz = NS / tick_ns
        if 60 * tick_hz * 0.45 < 2 * LOWEST:
            raise InputError("blocks", spec.describe(), "at least 1 Hz: breath is not seen in fewer frames")
        n, k = math.ceil(self.epoch_s * tick_hz), len(sleepers)
        size = self.cell_blocks or max(1, round(spec.shape[1] / 27))
        across = -(-spec.shape[1] // size)
        cells = -(-spec.shape[0] // size) * across
        rates = np.arange(LOWEST, min(HIGHEST, 60 * tick_hz * 0.45) + STEP / 2, STEP)
        if cells < BEST:
            raise ParameterError("cell_blocks", self.cell_blocks, f"smaller: the frame has only {cells} such cells")
        vary(np.zeros((1, 1)), 0, 1, np.empty((2, 1)))  # compiled now: made-up samples of the warm-up seldom breathe
        straighten(np.zeros(4), np.empty(4))
        powers(np.zeros(4), np.zeros((1, 4)), np.zeros((1, 4)), np.zeros(1))
        angles = 2 * np.pi * np.outer(rates / 60, np.arange(n) / tick_hz)
        self.set_state(
            BreathingState(
                list(sleepers), block, tick_ns, round(self.epoch_s * NS),
                size, across, np.zeros((k, 4), np.int64), np.full((n, cells), np.nan), NEVER,
                np.zeros(cells), np.zeros(cells), NEVER, np.full(k, int("bed" not in specs)), np.full(k, NEVER),
                np.zeros(k, np.int64), np.zeros(k, np.int64), np.zeros(k, np.int64), rates, np.cos(angles), np.sin(angles), 0,
            ),
            decision_s={"out": 0.0},
        )  # fmt: skip
        meta = {**spec.meta, "sleepers": list(sleepers), "epoch_s": self.epoch_s}
        return {"out": StreamSpec((), BREATH, units=("ns", "ns", "", "1/min", "", ""), meta=meta)}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        made: Rows = []
        if port == "blocks":
            if chunk.lost:
                before = int(chunk.time[0]) - 1
                self._pass(before, made)
                emitted.append(("out", self._chunk(made, before)))
                made, s.lost = [], add_lost(s.lost, chunk.lost)
            for i, time in enumerate(chunk.time.tolist()):
                self._frame(chunk.data[i], time, made)
        elif len(chunk.time):
            for event, time in zip(chunk.data, chunk.time.tolist(), strict=True):
                self._pass(time - 1, made)
                if port == "regions":
                    take(chunk.data, tuple(s.sleepers), s.regions, s.block)
                else:
                    self._moved_to(str(event["sleeper"]), str(event["state"]), time)
        self._pass(chunk.until, made)
        return [*emitted, ("out", self._chunk(made, chunk.until))]

    @classmethod
    def cases(cls) -> Sequence[Case]:
        random = np.random.default_rng(17)
        second = np.arange(400) / 8.0
        depth = np.full((400, 6, 8), 2000.0) + random.normal(0, 0.3, (400, 6, 8))
        depth[:, 1:4, 2:5] += 4.0 * np.sin(2 * np.pi * 0.25 * second)[:, None, None]
        depth[300:310, 2:5, 2:6] -= 60.0
        depth[random.random(depth.shape) < 0.05] = np.nan
        meta = {"simplified": {"block": 8, "components": 2}}
        time = grid(8.0, 400)
        regions = np.array([(time[2], "a", 0, 0, 48, 40, True), (time[2], "b", 0, 40, 48, 24, True)], REGION)
        bed = np.array([(time[3], "a", "in", 100.0, 0.3, ""), (time[350], "a", "out", 1.0, 0.0, "")], BED)
        inputs = {
            "regions": (region_spec(("a", "b"), meta), regions["onset"], regions),
            "bed": (StreamSpec((), BED), bed["onset"], bed),
            "blocks": (StreamSpec((6, 8), rate_hz=8.0, units=("mm",), meta=meta), time, depth),
        }
        without = {name: inputs[name] for name in ("regions", "blocks")}
        return [
            Case(cls(epoch_s=10.0, cell_blocks=1), inputs, least=8),
            Case(cls(epoch_s=12.5, cell_blocks=2), without, least=6),
        ]

    def _frame(self, blocks: Samples, time: int, made: Rows) -> None:
        s = self.state
        self._pass(time - 1, made)
        if s.epoch == NEVER:
            s.epoch = time // s.epoch_ns * s.epoch_ns
            s.ticks[:] = np.nan
            s.spoilt[:] = 1 - s.there
        tick = time // s.tick_ns
        if tick != s.tick:
            self._close_tick(tick)
            s.tick = tick
        gather(blocks, s.size, s.sums, s.counts)

    def _close_tick(self, following: int) -> None:
        """Keep the open tick; those before `following` that had no frame were not measured."""
        s = self.state
        n = len(s.ticks)
        if s.tick != NEVER:
            with np.errstate(invalid="ignore"):
                s.ticks[s.tick % n] = s.sums / s.counts
            for tick in range(max(s.tick + 1, following - n), following):
                s.ticks[tick % n] = np.nan
        s.sums[:] = 0.0
        s.counts[:] = 0.0
        s.tick = NEVER

    def _moved_to(self, sleeper: str, state: str, time: int) -> None:
        s = self.state
        if sleeper not in s.sleepers:
            return
        k, there = s.sleepers.index(sleeper), int(state == "in")
        if there and not s.there[k] and time - int(s.changed[k]) >= NIGHT_NS:
            s.epochs[k] = s.known[k] = 0
        if there != s.there[k]:
            s.changed[k] = time
        s.there[k] = there
        s.spoilt[k] = s.spoilt[k] or not there

    def _pass(self, until: int, made: Rows) -> None:
        """Close the epoch that is over by `until`."""
        s = self.state
        end = s.epoch + s.epoch_ns
        if s.epoch == NEVER or until < end - 1:
            return
        first = s.epoch // s.tick_ns
        stop = first + len(s.ticks)
        self._close_tick(stop)
        varying = np.empty((2, s.ticks.shape[1]))
        vary(s.ticks, first, stop, varying)
        finite = np.isfinite(s.ticks)
        with np.errstate(invalid="ignore"):
            depth = np.where(finite, s.ticks, 0.0).sum(axis=0) / finite.sum(axis=0)
        edges = steep(depth.reshape(-1, s.across), EDGE_MM).ravel()
        for k in range(len(s.sleepers)):
            rate, confidence = (math.nan, 0.0) if s.spoilt[k] else self._rate(k, varying, edges, first)
            rate = rate if confidence >= self.least_confidence else math.nan
            s.epochs[k] += not s.spoilt[k]
            s.known[k] += rate == rate
            coverage = float(s.known[k] / s.epochs[k]) if s.epochs[k] else 0.0
            made.append((s.epoch, end, s.sleepers[k], rate, confidence, coverage))
        s.epoch = NEVER

    def _rate(self, k: int, varying: Samples, edges: Array, first: int) -> tuple[float, float]:
        """The rate of a sleeper's breath in the ticks from `first` on, and the confidence."""
        s = self.state
        cells = _cells(s.regions[k], s.size, s.ticks.shape[1], s.across)
        cells = cells[np.isfinite(varying[0, cells]) & ~edges[cells]]
        if len(cells) < BEST or varying[1, cells].max() * NS / s.tick_ns > self.still_mm_s:
            return math.nan, 0.0
        chest = cells[np.argsort(-varying[0, cells], kind="stable")[:BEST]]
        power, straight = np.zeros(len(s.rates)), np.empty(len(s.ticks))
        rows = (first + np.arange(len(s.ticks))) % len(s.ticks)
        for cell in chest:
            if varying[0, cell] > 0:
                straighten(np.ascontiguousarray(s.ticks[rows, cell]), straight)
                powers(straight, s.cosines, s.sines, power)
        return peak(power, s.rates)

    def _chunk(self, made: Rows, until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        out = np.array(made, BREATH)
        return Chunk(out["end"] - 1, out, until, lost)


def _tick_ns(rate_hz: float) -> int:
    """How long a tick is: a frame, 0.5 s at least, so that the noise of many frames is averaged."""
    return round(NS / min(FASTEST_TICK_HZ, rate_hz))


def _cells(region: Times, size: int, count: int, across: int) -> Times:
    """Indices of the cells with their centre in a region of blocks; `across` cells in a row of the frame."""
    row, column, rows, columns = (int(v) for v in region)
    middles = (np.arange(count) // across * size + size / 2, np.arange(count) % across * size + size / 2)
    inside = (middles[0] >= row) & (middles[0] < row + rows) & (middles[1] >= column) & (middles[1] < column + columns)
    return np.flatnonzero(inside)
