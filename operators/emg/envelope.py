"""EMG envelope: high-pass, rectify, thin out without aliasing, low-pass, with the delay taken off the stamps (thesis 6.2.2, 6.2.3)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from fractions import Fraction
from typing import Literal

import numpy as np

from kinegraph.operators.emg.envelope_kernel import NUMBERS, EnvelopeState, envelope, gap, stamp
from kinegraph.operators.emg.one_kind import refuse_mixed
from kinegraph.operators.emg.zero_phase import antialias_phases, highpass_reach, lowpass_phases
from kinegraph.operators.filters.iir import butterworth, steady_memory
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.design_cache import remembered
from kinegraph.stream.data.require import regular_signal
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Emitted, Operator, grid
from kinegraph.stream.params import param

BLOCK_S = 0.02
"""How much is filtered backwards at a time: twice as much costs 20 ms of look-ahead and saves a third of the work."""


@dataclass(slots=True)
class Filters:
    """What the parameters and the input's rate come to; see `EnvelopeState` for the shapes."""

    hp_sos: Samples
    hp_start: Samples
    ahead: int
    taps: Samples
    after: Times
    block: int
    lp_sos: Samples
    delay_s: float
    settling_s: float


@dataclass(frozen=True, slots=True)
class EnvelopeRun:
    """Samples start..stop-1 of a chunk, `lost` before them; `restarts`: the filters start again."""

    start: int
    stop: int
    lost: int
    restarts: bool


@dataclass(frozen=True, slots=True)
class Envelope(Operator[EnvelopeState]):
    """Raw EMG (channels,) in, its linear envelope out, at `rate_hz`, in the input's unit.

    The thesis rectifies, reduces the rate to 120 Hz behind an anti-alias filter, and low-passes (Butterworth, order 4, 20 Hz). Departures:
    - Offset and motion artefact are removed before rectifying, by a high-pass of `highpass_hz` (SENIAM: 10-20 Hz), since rectifying
      would turn them into activity for good. 0 leaves it out.
    - `phase: zero` (default) filters forwards and backwards: the high-pass on short overlapping blocks, the low-pass as a symmetric FIR
      filter of the squared response (`operators.emg.zero_phase`). Peaks stay where they are; the look-ahead is 0.23 s with the defaults.
      The low-pass is its own anti-alias filter: 76 dB down at 60 Hz.
    - `phase: causal` uses the Butterworth filters as they are, about 0.05 s behind; stamps are set back by the anti-alias filter's delay
      and by the low-pass's mean group delay below half its cut-off. One peak in ten then lies more than 1 % of a cycle off.

    Delay: declared by `delay_s`, subtracted from the stamps. The last `delay_s` of a stream lack their look-ahead and are not emitted.
    NaN or infinity: the last finite value of that channel replaces it; the outputs that cover it are NaN.
    A gap longer than `reset_gap_s` resets the filters, which take `settling_s` to settle; after a shorter one samples count as consecutive.

    >>> tone = 100 * np.sin(2 * np.pi * 80 * np.arange(2000) / 1000)  # the mean of |tone| is 63.7
    >>> float(Envelope()(tone, rate_hz=1000)[60].round(1))
    63.3
    """

    cutoff_hz: float = param(20.0, above=0.0, help="cut-off of the low-pass (each way)")
    order: int = param(4, least=1, most=10, help="of the low-pass (each way)")
    highpass_hz: float = param(20.0, least=0.0, help="cut-off of the high-pass before rectifying; 0: no high-pass")
    highpass_order: int = param(2, least=1, most=6, help="of the high-pass (each way)")
    rate_hz: float = param(120.0, least=0.0, help="rate of the envelope; 0: the input's")
    phase: Literal["zero", "causal"] = param(
        "zero", help="zero: peaks stay where they are; causal: sooner, peaks move a little"
    )
    reset_gap_s: float = reset_gap(0.05)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        rate_hz = regular_signal(spec)
        refuse_mixed(spec)
        up, down, rate = self._ratio(rate_hz)
        self._check(rate_hz, rate)
        filters = (self._zero if self.phase == "zero" else self._causal)(rate_hz, up, down, rate)
        n, waits, long = spec.shape[0], filters.ahead + filters.block, filters.taps.shape[1]
        ring = waits + long // 2 + down // up + 3
        state = EnvelopeState(
            numbers=np.zeros((), NUMBERS),
            after=filters.after,
            hp_sos=np.array(filters.hp_sos, order="C"),
            hp_start=np.array(filters.hp_start, order="C"),
            hp_z=np.zeros((len(filters.hp_sos), 2, n)),
            back_z=np.zeros((len(filters.hp_sos), 2, n)),
            ahead=np.zeros((waits, n)),
            taps=np.array(filters.taps, order="C"),
            window=np.zeros((2 * long, n)),
            lp_sos=np.array(filters.lp_sos, order="C"),
            lp_z=np.zeros((len(filters.lp_sos), 2, n)),
            held=np.full(n, np.nan),
            bad=np.zeros((ring, n), np.uint8),
            stamps=np.zeros((ring, 2), np.int64),
        )
        state.up, state.down, state.block = up, down, filters.block
        state.last, state.limit = NEVER, spec.period_ns + round(self.reset_gap_s * NS)
        self.set_state(state, delay_s=filters.delay_s)
        made = {"envelope": {k: v for k, v in asdict(self).items() if k != "reset_gap_s"}, "normalisation": "none"}
        out = spec.derive(
            dtype=np.dtype(np.float64),
            rate_hz=rate,
            settling_s=spec.settling_s + filters.settling_s,
            meta={**spec.meta, **made},
        )
        return {"out": out}

    def process(self, port: str, chunk: Chunk) -> Emitted:
        s = self.state
        if not len(chunk.time):
            return Chunk(np.empty(0, np.int64), np.empty((0, len(s.held))), self._until(chunk.until))
        x = np.ascontiguousarray(chunk.data, np.float64)
        runs = [
            self._run(x[run.start : run.stop], chunk.time[run.start : run.stop], run.lost, run.restarts)
            for run in self._runs(chunk)
        ]
        marks, out = (
            runs[0] if len(runs) == 1 else (np.concatenate([m for m, _ in runs]), np.concatenate([o for _, o in runs]))
        )
        whole = Chunk(marks[:, 0].copy(), out, self._until(chunk.until))
        lost = marks[:, 1]
        return _cut(whole, lost) if lost.any() else whole

    @classmethod
    def cases(cls) -> list[Case]:
        rng = np.random.default_rng(6)
        spec = StreamSpec((3,), rate_hz=500.0, channels=("TA", "GM", "SO"), units=("uV",))
        samples = {"in": (spec, grid(500.0, 700), rng.standard_normal((700, 3)) * 50 + 10)}
        return [
            Case(cls(), samples, least=100),
            Case(cls(phase="causal", cutoff_hz=8.0), samples, least=100),
            Case(cls(rate_hz=0.0, highpass_hz=0.0), samples, least=500),
        ]

    def _ratio(self, rate_hz: float) -> tuple[int, int, float]:
        """Output over input rate as up / down, and the rate that gives."""
        wanted = self.rate_hz or rate_hz
        ratio = Fraction(wanted / rate_hz).limit_denominator(1000)
        if not 0 < ratio <= 1 or abs(float(ratio) * rate_hz / wanted - 1) > 1e-3:
            raise ParameterError(
                "rate_hz",
                self.rate_hz,
                f"between {rate_hz / 1000:g} and {rate_hz:g} (the input's rate), or 0 to keep that",
            )
        return ratio.numerator, ratio.denominator, rate_hz * ratio.numerator / ratio.denominator

    def _check(self, rate_in: float, rate_out: float) -> None:
        if self.cutoff_hz >= rate_out / 2:
            raise ParameterError(
                "cutoff_hz", self.cutoff_hz, f"below {rate_out / 2:g} (half of the envelope's {rate_out:g} Hz)"
            )
        if self.highpass_hz >= rate_in / 2:
            raise ParameterError(
                "highpass_hz", self.highpass_hz, f"below {rate_in / 2:g} (half of the input's {rate_in:g} Hz)"
            )

    def _zero(self, rate_in: float, up: int, down: int, rate_out: float) -> Filters:
        hp, start = self._highpass(rate_in)
        ahead = highpass_reach(self.highpass_hz, self.highpass_order, rate_in) if len(hp) else 0
        block = max(1, round(BLOCK_S * rate_in)) if len(hp) else 1
        taps = lowpass_phases(self.cutoff_hz, self.order, rate_in, up)
        delay = (ahead + block - 1 + taps.shape[1] // 2) / rate_in
        return Filters(hp, start, ahead, taps, _after(rate_in, up, 0.0), block, np.zeros((0, 6)), delay, delay)

    def _causal(self, rate_in: float, up: int, down: int, rate_out: float) -> Filters:
        hp, start = self._highpass(rate_in)
        settling = 1.2 * self.highpass_order / self.highpass_hz if len(hp) else 0.0
        taps = np.ones((1, 1))
        if up != down:
            taps = antialias_phases(self.cutoff_hz, max(rate_out - self.cutoff_hz, 0.6 * rate_out), rate_in, up)
        low, group = causal_lowpass(self.order, self.cutoff_hz, rate_out)
        look = taps.shape[1] // 2 / rate_in
        return Filters(
            hp,
            start,
            0,
            taps,
            _after(rate_in, up, group),
            1,
            low,
            look + group,
            settling + 2 * look + 1.2 * self.order / self.cutoff_hz,
        )

    def _highpass(self, rate_hz: float) -> tuple[Samples, Samples]:
        if not self.highpass_hz:
            return np.zeros((0, 6)), np.zeros((0, 2))
        sos = butterworth(self.highpass_order, self.highpass_hz, "highpass", rate_hz)
        return sos, steady_memory(sos)

    def _runs(self, chunk: Chunk) -> list[EnvelopeRun]:
        """The chunk cut where a gap is long enough to start again."""
        s = self.state
        before = s.last if s.last != NEVER else int(chunk.time[0])
        same = s.up == s.down
        runs = []
        start, lost, restarts = 0, chunk.lost if same or not chunk.lost else -1, False
        while start < len(chunk.time):
            stop = gap(chunk.time, before, s.limit, start + restarts)
            if stop > start:
                runs.append(EnvelopeRun(start, stop, lost, restarts))
            start, lost, restarts = stop, -1, True
        return runs

    def _run(self, x: Samples, time: Times, lost: int, restarts: bool) -> tuple[Times, Samples]:
        """Consecutive samples to what is then known: per row its stamp and the `lost` before it, and the rows."""
        s = self.state
        if restarts:
            self._reset()
        s.last = int(time[-1])
        room = (len(x) + len(s.ahead)) * s.up // s.down + 3
        out, marks = np.empty((room, x.shape[1])), np.empty((room, 2), np.int64)
        rows = envelope(s, x, time, lost, out, marks)
        return marks[:rows], out[:rows]

    def _reset(self) -> None:
        s = self.state
        for array in (s.hp_z, s.ahead, s.window, s.lp_z, s.bad, s.stamps):
            array[...] = 0
        s.taken = s.rectified = s.written = s.filled = 0
        s.held[...] = np.nan

    def _until(self, until: int) -> int:
        """Just before the next output's stamp, as far as that is known; else what the input's `until` allows."""
        s = self.state
        if until in (FOREVER, NEVER):
            return until
        earliest = until + min(int(s.after[0]), 0)
        sample, phase = divmod(s.written * s.down, s.up)
        if s.last == NEVER or sample >= s.taken or until >= s.last + s.limit:
            return earliest
        return min(earliest, stamp(s.stamps, sample, s.after, phase, sample + 1 < s.taken) - 1)


def _after(rate_in: float, up: int, shift_s: float) -> Times:
    """The ns that each of the `up` positions between two samples lies after the first of them, with the stamps' shift in it."""
    return np.round(np.arange(up) / up * (NS / rate_in) - shift_s * NS).astype(np.int64)


@remembered
def causal_lowpass(order: int, cutoff_hz: float, rate_hz: float) -> tuple[Samples, float]:
    """A Butterworth low-pass as sections (s, 6), and its mean group delay in seconds over the lower half of what it passes."""
    from scipy.signal import freqz_sos

    low = butterworth(order, cutoff_hz, "lowpass", rate_hz)
    frequencies = np.linspace(0.0, cutoff_hz / 2, 101)
    phase = np.unwrap(np.angle(freqz_sos(low, frequencies, fs=rate_hz)[1]))
    return low, float(-np.mean(np.diff(phase)) / (2 * np.pi * frequencies[1]))


def _cut(whole: Chunk, lost: Times) -> list[tuple[str, Chunk]]:
    """The chunk cut before every sample that has something `lost` before it (n,)."""
    starts = sorted({0, *(int(i) for i in lost.nonzero()[0])})
    pieces = []
    for a, b in zip(starts, [*starts[1:], len(whole)], strict=True):
        piece = whole.part(a, b)
        piece.lost = int(lost[a])
        pieces.append(("out", piece))
    return pieces
