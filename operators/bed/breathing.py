"""How fast a sleeper breathes, from the rise and fall of the chest; with a confidence, and with how often it is known at all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np

from kinegraph.operators.bed.bed_events import BED
from kinegraph.operators.bed.breath_cells import LEAST_CELLS, LOWEST, BreathCells
from kinegraph.operators.bed.breath_wave import BreathWave
from kinegraph.operators.bed.frames.regions import REGION, block_of, region_spec, sleepers_of, take
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times, add_lost
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
        ("error", "<f8"),
        ("amplitude", "<f8"),
        ("regularity", "<f8"),
        ("pauses", "<f8"),
        ("paused_s", "<f8"),
    ]
)
"""A sleeper's breath in an epoch; see `Breathing`."""
UNEVEN, MIN_IRREGULAR, USUALLY = 0.3, 0.15, 0.2
"""How much of the rate its interval grows with what of the wave is not regular, of which there is at least MIN_IRREGULAR, and USUALLY where
it is not known: from uneven breath in rooms of chosen seeds."""
NIGHT_NS = 4 * 3600 * NS
"""After this long out of bed, coverage is counted from zero."""

Rows = list[tuple[Any, ...]]
Waves = list[tuple[int, int, Samples]]
"""Ticks, how many were missed before each, and what the chests (k,) do in it."""


@dataclass(slots=True)
class BreathingState:
    """
    regions    (k, 4)  in blocks; no rows: not known
    cells      the newest depths of the frame's cells; wave: the chest's movement in them
    epoch      start of the open epoch (ns); NEVER: none
    there, changed  (k,) whether each sleeper is in bed (with `bed`; else always), and when that became so or ended (ns)
    spoilt     (k,)  whether a sleeper was out of bed at any time in the open epoch
    epochs, known  (k,)  epochs in bed of this night, and those with a rate
    emitted    number of the newest tick whose wave was emitted; NEVER: no tick yet
    lost       what the next emission says is missing before it
    """

    sleepers: list[str]
    block: int
    epoch_ns: int
    regions: Times
    cells: BreathCells
    wave: BreathWave
    epoch: int
    there: Times
    changed: Times
    spoilt: Times
    epochs: Times
    known: Times
    emitted: int
    lost: int


@dataclass(frozen=True, slots=True)
class Breathing(Operator[BreathingState]):
    """Mean depths of blocks in; per epoch and sleeper an event with the breath's rate, as far as it can be seen.

    rate        breaths per minute in the epoch; NaN where it is not known: the sleeper moved, was not in bed (with `bed` connected) or not
                seen, a pause is in it, or the confidence is below `min_confidence`
    confidence  0 to 1: how far the chest stands out of noise; noise alone seldom reaches one half
    coverage    share of the night's epochs in bed, up to this one, that have a rate; a night ends with 4 h out of bed
    error       half the width of the rate's 95 % interval (1/min); wider where breaths differ in length
    amplitude   lift of the chest's cells on average, from the 5th to the 95th percentile of the wave (mm)
    regularity  0 to 1: how much of the wave's power is at the rate and at its double
    pauses      how many times, ended in this epoch, no effort was seen for at least 10 s, and `paused_s`: how long in all; NaN while it is
                not known how far the chest usually moves. It is no apnoea: effort under a thick blanket may be too small to be seen

    wave  (sleepers,) mm, 4 times a second or with every frame: how far the chest's cells have risen above their mean of some seconds, once
          a first rate has shown where they are, to the epoch's end in which the sleeper leaves. Movement is in it, too

    Cells are looked at 4 times a second, or with every frame of a slower camera. Of each the spectrum is taken (no straight line, Hann
    window, pieces of about 30 s), and divided by its own median and by the colour that most cells share; the chest is those 12 cells of
    the region with the highest peaks, and the rate, from 6 to 45 per minute, is where they are highest together; breaths that differ in
    length are counted in the wave, which has their mean. An
    epoch in which a cell of the region goes faster than `still_mm_s`, and than its noise, has movement, and no rate. It raises no alarm.
    No delay: the event comes with the epoch's end.

    >>> given, made = tried(Breathing)
    >>> made["out"]["sleeper"].tolist()[:2], made["out"]["rate"].round(1)[:4]
    (['a', 'b'], array([ nan,  nan, 15.4,  nan]))
    """

    inputs = {"regions": Input(), "bed": Input(optional=True), "blocks": Input(trigger=True)}
    outputs: ClassVar[tuple[str, ...]] = ("out", "wave")

    epoch_s: float = param(30.0, least=10.0, most=300.0, help="length of an epoch, at whole multiples since 1970")
    cell_blocks: int = param(0, least=0, help="side of a cell in blocks; 0: about 27 cells in a row of the frame")
    still_mm_s: float = param(20.0, above=0.0, help="faster than this is movement, not breath")
    min_confidence: float = param(0.5, least=0.0, most=1.0, help="below this no rate is reported")

    def open(self, specs: Specs) -> Specs:
        spec = specs["blocks"]
        block = block_of(spec, "blocks")
        if "bed" in specs and specs["bed"].dtype != BED:
            raise InputError("bed", specs["bed"].describe(), "the output of operators.bed.presence.Presence")
        sleepers = sleepers_of(specs)
        rate_hz, k = regular(spec, "blocks"), len(sleepers)
        if 60 * rate_hz * 0.45 < 2 * LOWEST:
            raise InputError("blocks", spec.describe(), "at least 1 Hz: breath is not seen in fewer frames")
        cells = BreathCells.of(spec.shape, rate_hz, self.epoch_s, self.cell_blocks, self.still_mm_s)
        count = cells.ticks.shape[1]
        if count < LEAST_CELLS:
            raise ParameterError("cell_blocks", self.cell_blocks, f"smaller: the frame has only {count} such cells")
        self.set_state(
            BreathingState(
                list(sleepers), block, round(self.epoch_s * NS), np.zeros((k, 4), np.int64), cells,
                BreathWave.of(k, count, len(cells.ticks)), NEVER,
                np.full(k, int("bed" not in specs)), np.full(k, NEVER), np.zeros(k, np.int64), np.zeros(k, np.int64),
                np.zeros(k, np.int64), NEVER, 0,
            ),
            decision_s={"out": 0.0},
        )  # fmt: skip
        meta = {**spec.meta, "sleepers": list(sleepers), "epoch_s": self.epoch_s}
        units = ("ns", "ns", "", "1/min", "", "", "1/min", "mm", "", "", "s")
        own = {**spec.meta, "sleepers": list(sleepers)}
        settling = max(s.settling_s for s in specs.values())
        wave = StreamSpec(
            (k,), rate_hz=NS / cells.tick_ns, channels=sleepers, units=("mm",), meta=own, settling_s=settling
        )
        return {"out": StreamSpec((), BREATH, units=units, meta=meta), "wave": wave}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        made: Rows = []
        waves: Waves = []
        if port == "blocks":
            if chunk.lost:
                before = int(chunk.time[0]) - 1
                self._pass(before, made, waves)
                emitted.append(("out", self._chunk(made, before)))
                made, s.lost = [], add_lost(s.lost, chunk.lost)
            for i, time in enumerate(chunk.time.tolist()):
                self._frame(chunk.data[i], time, made, waves)
        elif len(chunk.time):
            for event, time in zip(chunk.data, chunk.time.tolist(), strict=True):
                self._pass(time - 1, made, waves)
                if port == "regions":
                    take(chunk.data, tuple(s.sleepers), s.regions, s.block)
                else:
                    self._moved_to(str(event["sleeper"]), str(event["state"]), time)
        self._pass(chunk.until, made, waves)
        return [*emitted, ("out", self._chunk(made, chunk.until)), *self._waves(waves, chunk.until)]

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

    def _frame(self, blocks: Samples, time: int, made: Rows, waves: Waves) -> None:
        s = self.state
        self._pass(time - 1, made, waves)
        if s.epoch == NEVER:
            s.epoch = time // s.epoch_ns * s.epoch_ns
            s.cells.forget()
            s.spoilt[:] = 1 - s.there
        tick = s.cells.tick
        s.cells.add(blocks, time)
        if tick not in (NEVER, s.cells.tick):
            self._ticked(tick, waves)

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

    def _pass(self, until: int, made: Rows, waves: Waves) -> None:
        """Close the epoch that is over by `until`."""
        s = self.state
        end = s.epoch + s.epoch_ns
        if s.epoch == NEVER or until < end - 1:
            return
        tick, tick_s = s.cells.tick, s.cells.tick_ns / NS
        breaths = s.cells.breaths(s.epoch, s.regions)
        if tick != NEVER:
            self._ticked(tick, waves)
        for k, breath in enumerate(breaths):
            breathes = not s.spoilt[k] and breath.confidence >= self.min_confidence
            seen = breathes and not s.wave.halts(k, tick_s)
            rate = s.wave.counted(k, breath.rate, breath.error, tick_s) if seen else math.nan
            confidence = 0.0 if s.spoilt[k] else breath.confidence
            amplitude, regular = s.wave.sized(k, rate, tick_s)
            if breathes:
                first = s.epoch // s.cells.tick_ns
                order = (first + np.arange(len(s.cells.ticks))) % len(s.cells.ticks)
                s.wave.learn(k, s.cells.ticks[order][:, breath.cells], breath.cells, breath.rate, tick_s)
            elif not s.there[k]:
                s.wave.forget(k)
            s.epochs[k] += not s.spoilt[k]
            s.known[k] += rate == rate
            coverage = float(s.known[k] / s.epochs[k]) if s.epochs[k] else 0.0
            paused = (float(s.wave.pauses[k]), float(s.wave.paused[k])) if s.wave.usual[k] else (math.nan, math.nan)
            error = interval(breath.error, rate, 1 - regular)
            made.append((s.epoch, end, s.sleepers[k], rate, confidence, coverage, error, amplitude, regular, *paused))
        s.wave.pauses[:], s.wave.paused[:] = 0, 0.0
        s.epoch = NEVER

    def _ticked(self, tick: int, waves: Waves) -> None:
        """A tick is over: its wave."""
        s = self.state
        if s.emitted != NEVER and tick <= s.emitted:
            return
        depth = s.cells.ticks[tick % len(s.cells.ticks)]
        wave = s.wave.add(depth, tick, s.cells.tick_ns / NS)
        waves.append((tick, 0 if s.emitted == NEVER else tick - s.emitted - 1, wave))
        s.emitted = tick

    def _waves(self, waves: Waves, until: int) -> list[tuple[str, Chunk]]:
        """Chunks of the wave, cut where ticks are missing; promised up to the tick that is open."""
        s, tick_ns = self.state, self.state.cells.tick_ns
        half = tick_ns // 2
        promise = until
        if NEVER < until < FOREVER:
            following = s.cells.tick if s.cells.tick != NEVER else max((until + 1) // tick_ns, s.emitted + 1)
            promise = min(until, following * tick_ns + half - 1)
        cuts = [i for i, (_, lost, _) in enumerate(waves) if lost and i]
        made = []
        for a, b in pairwise([0, *cuts, len(waves)]):
            part = waves[a:b]
            stamps = np.array([tick * tick_ns + half for tick, *_ in part], np.int64)
            data = np.array([wave for *_, wave in part]).reshape(len(part), len(s.sleepers))
            end = promise if b == len(waves) else int(stamps[-1])
            made.append(("wave", Chunk(stamps, data, end, part[0][1] if part else 0)))
        return made

    def _chunk(self, made: Rows, until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        out = np.array(made, BREATH)
        return Chunk(out["end"] - 1, out, until, lost)


def interval(error: float, rate: float, irregular: float) -> float:
    """Half of the interval of a rate that noise alone would know to `error`: breaths of different lengths have no one rate."""
    irregular = max(irregular, MIN_IRREGULAR) if irregular == irregular else USUALLY
    return math.hypot(error, UNEVEN * rate * irregular)
