"""Anti-aliased resampling by any rational ratio: scipy's polyphase filter, run sample by sample."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from kinegraph.operators.inputs.continuity import Continuity, back, watch
from kinegraph.stream.chunk import NEVER, NS, STAMP, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.design_cache import remembered
from kinegraph.stream.data.require import numeric, regular
from kinegraph.stream.domain.rotation import rotation_free
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

MOST = 1000
"""The largest term of a ratio of rates."""
NEAR = 1e-3
"""How far, relatively, the ratio that is used may be from the one that was asked for."""


@kernel
def polyphase(
    x: Samples,
    table: Samples,
    phases: Times,
    down: int,
    held: Samples,
    bad: NDArray[np.bool_],
    ring: Samples,
    places: Times,
    time: Times,
    out: Samples,
    stamps: Times,
) -> None:
    """Resample `x` (n, c) into `out` (m, c), where m is how many outputs are due with the newest of these samples.

    table   (up, k)  the filter's phases, each beginning with the weight of the newest sample
    phases  (3, up)  per phase: how much later than the newest sample an output's stamp is (ns; mostly negative), and the first and last
                     age, in samples, of those samples that lie nearest to the output in time (last excluded)
    held    (c,)     each channel's newest finite value, which replaces bad ones
    ring    (2l, c)  the newest l values, each written twice, l rows apart; `bad` (2l, c) says which of them stand for bad samples
    places  (3,)     the place in the ring that is filled next; how far ahead of the next sample the next output lies, in steps of the
                     upsampled signal; the stamp of the newest output
    """
    up = table.shape[0]
    size = ring.shape[0] // 2
    made = 0
    for i in range(x.shape[0]):
        at = places[0]
        for c in range(x.shape[1]):
            fine = abs(x[i, c]) < math.inf
            if fine:
                held[c] = x[i, c]
            ring[at, c] = held[c]
            ring[at + size, c] = held[c]
            bad[at, c] = not fine
            bad[at + size, c] = not fine
        newest = at + size
        places[0] = 0 if at == size - 1 else at + 1
        while places[1] < up:
            phase = places[1]
            for c in range(x.shape[1]):
                out[made, c] = 0.0
            for k in range(table.shape[1]):
                for c in range(x.shape[1]):
                    out[made, c] += table[phase, k] * ring[newest - k, c]
            for age in range(phases[1, phase], phases[2, phase]):
                for c in range(x.shape[1]):
                    if bad[newest - age, c]:
                        out[made, c] = math.nan
            places[2] = max(places[2] + 1, time[i] + phases[0, phase])
            stamps[made] = places[2]
            made += 1
            places[1] += down
        places[1] -= up


@dataclass(slots=True)
class ResampleState(Continuity):
    table: Samples
    phases: Times
    up: int
    down: int
    lead: int
    held: Samples
    bad: Array
    ring: Samples
    places: Times


@dataclass(frozen=True, slots=True)
class Resample(Operator[ResampleState]):
    """The same signal at another rate, low-passed at half the lower of both rates: scipy's `resample_poly(x, up, down)` to rounding.

    up / down   `rate_hz` over the input's rate as a ratio of whole numbers up to 1000, the nearest one where it is no such ratio; the
                output's spec names the rate that comes out, and a rate that cannot be met within 0.1 % is refused
    stamps      of the first input sample and every down/up samples from it, each reckoned from the newest input sample: a device's drift
                is followed and nothing accumulates
    delay       half the filter, `half_length` samples of the slower rate (0.1 s at 100 Hz), rounded up to a whole output sample
    gaps        up to `reset_gap_s` a gap is bridged by each channel's last value, so that the output's grid goes on; a longer one begins
                a new grid. The first output thereafter carries lost = -1
    bad samples each is replaced by its channel's last good value; the outputs nearest to it in time are NaN

    As in scipy, zeros are taken to stand before the first sample, and the outputs of the first half filter are marked as settling. Nothing
    stands for what comes after the end: the last half filter is not emitted.

    >>> slow = Resample(rate_hz=50)(np.sin(2 * np.pi * np.arange(200) / 100), rate_hz=100)
    >>> len(slow), float(slow.max().round(2))
    (90, 1.0)
    """

    delays: ClassVar[str] = "`half_length` samples of the slower rate"
    references: ClassVar[str] = "`scipy.signal.resample_poly`, to rounding"
    inputs = {"in": Input(rows=True)}
    contiguous = True
    rate_hz: float = param(above=0.0, help="rate that is wanted")
    half_length: int = param(
        10, least=1, most=100, help="half the filter in samples of the slower rate; fewer: less delay, softer cut"
    )
    reset_gap_s: float = reset_gap(0.1)

    def open(self, specs: Specs) -> Specs:
        spec = numeric(specs["in"])
        rotation_free(spec)
        rate_hz = regular(spec)
        up, down = ratio(self.rate_hz, rate_hz)
        taps, half = low_pass(up, down, self.half_length)
        lead = half + (-half) % down
        delay_s = lead / up / rate_hz
        seen = watch(specs["in"], delay_s=delay_s, reset_gap_s=self.reset_gap_s)
        c = seen["width"]
        table = phase_table(np.concatenate([np.zeros(lead - half), taps]), up)
        phases = nearest_samples(up, down, lead, NS / rate_hz)
        size = max(table.shape[1], int(phases[2].max()))
        state = ResampleState(
            **seen,
            table=table,
            phases=phases,
            up=up,
            down=down,
            lead=lead,
            held=np.zeros(c),
            bad=np.zeros((2 * size, c), np.bool_),
            ring=np.zeros((2 * size, c)),
            places=np.array([0, lead, NEVER], np.int64),
        )
        self.set_state(state, delay_s=delay_s)
        settling_s = spec.settling_s + half / up / rate_hz
        return {"out": spec.derive(rate_hz=rate_hz * up / down, settling_s=settling_s)}

    def _rest(self) -> None:
        state = self.state
        for array in (state.held, state.bad, state.ring):
            array[...] = 0
        state.places[:2] = 0, state.lead

    def process(self, port: str, chunk: Chunk) -> Chunk:
        state = self.state
        time = chunk.time
        x = chunk.data
        lost = 0
        if len(time):
            if chunk.lost:
                lost = -1
                if state.breaks(chunk):
                    self._rest()
                else:
                    time, x = self._bridge(time, x, state.missing(chunk))
            state.last[0] = chunk.time[-1]
        ahead = len(time) * state.up - int(state.places[1])
        m = -(-ahead // state.down) if ahead > 0 else 0
        out, stamps, s = np.empty((m, state.width)), np.empty(m, STAMP), state
        polyphase(x, s.table, s.phases, s.down, s.held, s.bad, s.ring, s.places, time, out, stamps)
        return Chunk(stamps, out.reshape(m, *s.nothing.shape[1:]), self._promise(chunk.until), lost)

    def _bridge(self, time: Times, x: Array, missing: int) -> tuple[Times, Array]:
        """The samples with `missing` ones before them, of each channel's last value, evenly between the stamps on both sides."""
        state = self.state
        before, after = state.last.item(0), int(time[0])
        stamps = [before + (after - before) * k // (missing + 1) for k in range(1, missing + 1)]
        made = np.repeat(state.held[None], missing, axis=0)
        return np.concatenate([np.array(stamps, np.int64), time]), np.concatenate([made, x])

    def _promise(self, until: int) -> int:
        """No later output lies at or before this; a gap that has begun may yet be bridged, so nothing is promised inside it."""
        state = self.state
        if until - state.last.item(0) - state.period_ns < state.limit_ns:
            until = min(until, state.last.item(0))
        return max(back(until, state.delay_ns), int(state.places[2]))

    @classmethod
    def cases(cls) -> Sequence[Case]:
        data = np.random.default_rng(10).normal(size=(500, 3))
        inputs: dict[str, Any] = {"in": (StreamSpec((3,), rate_hz=200.0), grid(200.0, 500), data)}
        return [
            Case(cls(rate_hz=30.0), inputs, least=60),
            Case(cls(rate_hz=441.0, half_length=4), inputs, least=1000),
        ]


def ratio(wanted_hz: float, rate_hz: float) -> tuple[int, int]:
    """`wanted_hz` / `rate_hz` as up / down in lowest terms, each at most `MOST`; rates are taken by their decimal digits."""
    exact = Fraction(repr(wanted_hz)) / Fraction(repr(rate_hz))
    small = min(exact, 1 / exact).limit_denominator(MOST)  # 0: further than any ratio reaches
    near = small if exact <= 1 or not small else 1 / small
    if not small or abs(near / exact - 1) > NEAR:
        accepts = f"between {rate_hz / MOST:g} and {rate_hz * MOST:g} (the input's {rate_hz:g} Hz over or times {MOST})"
        raise ParameterError("rate_hz", wanted_hz, accepts)
    return near.numerator, near.denominator


@remembered
def low_pass(up: int, down: int, half_length: int) -> tuple[Samples, int]:
    """The filter of scipy's `resample_poly` (a Kaiser window, beta 5) at `up` times the rate, and the place of its middle tap."""
    if up == down:
        return np.ones(1), 0
    from scipy.signal import firwin

    half = half_length * max(up, down)
    taps: Samples = firwin(2 * half + 1, 1 / max(up, down), window=("kaiser", 5.0)) * up
    return taps, half


def phase_table(taps: Samples, up: int) -> Samples:
    """`taps` (t,) as (up, k): row p holds taps p, p + up, p + 2 up, ..., filled up with zeros."""
    padded = np.zeros(-(-len(taps) // up) * up)
    padded[: len(taps)] = taps
    return np.ascontiguousarray(padded.reshape(-1, up).T)


def nearest_samples(up: int, down: int, lead: int, period_ns: float) -> Times:
    """Per phase of the output: (3, up) how its stamp differs from the newest sample's, and which ages lie nearest to it in time.

    An output of phase p lies (lead - p) / up samples before the newest one. Nearest to it are the samples within half an output's
    distance, half a sample's at least, so that each sample is the nearest to some output.
    """
    made = np.empty((3, up), np.int64)
    reach = Fraction(max(up, down), 2 * up)
    for p in range(up):
        age = Fraction(lead - p, up)
        made[0, p] = -round(float(age) * period_ns)
        made[1, p] = max(0, math.ceil(age - reach))
        made[2, p] = max(0, math.floor(age + reach) + 1)
    return made
