"""Butterworth low-, high- and band-pass and notch filters, run as second-order sections bit-equal to scipy's sosfilt.

scipy designs the filters; our kernel runs them. On finite input the numbers equal `scipy.signal.sosfilt(sos, x, axis=0)` in every bit.

Stamps. A causal filter shows a feature of the signal late by its group delay, which differs with frequency. Low-pass filters subtract the
group delay at 0 Hz from their stamps, band-pass filters that at the geometric centre of the band: within the band peaks then stand where
zero-phase filtering would put them, to within the spread of the delay over the band. High-pass and notch filters delay what they let pass
only near their cut-off, so their stamps are left alone.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec, Times
from kinegraph.stream.data.design_cache import remembered
from kinegraph.stream.data.finite import finite
from kinegraph.stream.data.require import regular, width_of
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.filter import Filter, FilterState, Kernel
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, grid
from kinegraph.stream.params import param

SETTLED = 0.01
"""A filter counts as settled when this share of its slowest transient is left."""


@kernel
def sections(x: Samples, sos: Samples, z: Samples, out: Samples) -> None:
    """Run `x` (n, c) through `sos` (s, 6) with memory `z` (s, 2, c) into `out` (n, c).

    Transposed direct form II in scipy's order of operations. What is not finite gives NaN and leaves its channel's memory alone.
    """
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            out[i, c] = finite(x[i, c])
        for s in range(sos.shape[0]):
            b0, b1, b2, a1, a2 = sos[s, 0], sos[s, 1], sos[s, 2], sos[s, 4], sos[s, 5]
            for c in range(x.shape[1]):
                v = out[i, c]
                z0 = z[s, 0, c]
                z1 = z[s, 1, c]
                y = b0 * v + z0
                z[s, 0, c] = b1 * v - a1 * y + z1 if v == v else z0
                z[s, 1, c] = b2 * v - a2 * y if v == v else z1
                out[i, c] = y


@kernel
def one_value(x: float, sos: Samples, z: Samples) -> float:
    """One value through sections (s, 6) with memory (s, 2), for kernels that filter as they go along."""
    for s in range(sos.shape[0]):
        y = sos[s, 0] * x + z[s, 0]
        z[s, 0] = sos[s, 1] * x - sos[s, 4] * y + z[s, 1]
        z[s, 1] = sos[s, 2] * x - sos[s, 5] * y
        x = y
    return x


@kernel
def late_sections(
    x: Samples, sos: Samples, z: Samples, out: Samples, time: Times, delay_ns: int, stamps: Times
) -> None:
    """`sections`, and `time` (n,) less the delay into `stamps` (n,)."""
    for i in range(time.shape[0]):
        stamps[i] = time[i] - delay_ns
    sections(x, sos, z, out)


@kernel
def primed_sections(
    x: Samples,
    sos: Samples,
    steady: Samples,
    waiting: Times,
    z: Samples,
    out: Samples,
    time: Times,
    delay_ns: int,
    stamps: Times,
) -> None:
    """`late_sections`, but a channel's first finite value counts as if it had always been there.

    `steady` (s, 2) is the memory for a constant 1, `waiting` (c + 1,) 1 where a channel waits for a value, and at last how many do.
    """
    c = x.shape[1]
    for k in range(c if waiting[c] else 0):
        for i in range(x.shape[0]):
            if waiting[k] and abs(x[i, k]) < math.inf:
                for s in range(z.shape[0]):
                    z[s, 0, k] = steady[s, 0] * x[i, k]
                    z[s, 1, k] = steady[s, 1] * x[i, k]
                waiting[k] = 0
                waiting[c] -= 1
    late_sections(x, sos, z, out, time, delay_ns, stamps)


@dataclass(slots=True)
class SectionsState(FilterState):
    sos: Samples
    z: Samples
    steady: Samples
    waiting: Times


class _Sections(Filter[SectionsState]):
    """Second-order sections over a regular stream; subclasses design them."""

    __slots__ = ()
    start: Literal["zero", "first"]

    def design(self, rate_hz: float) -> tuple[Samples, float]:
        """The sections (s, 6), and the frequency in Hz of the group delay to subtract from stamps (NaN: subtract nothing)."""
        raise NotImplementedError

    def begin(self, spec: StreamSpec) -> tuple[SectionsState, Kernel]:
        rate_hz, c = regular(spec), width_of(spec)
        sos, centre_hz = self.design(rate_hz)
        if slowest(sos) >= 1.0:
            raise ParameterError(
                "order", getattr(self, "order", 2), f"lower: at {rate_hz:g} Hz this filter would not be stable"
            )
        first = self.start == "first"
        state = SectionsState(
            delay_s=0.0 if math.isnan(centre_hz) else group_delay(sos, centre_hz / rate_hz) / rate_hz,
            settling_s=settling(sos) / rate_hz,
            sos=sos,
            z=np.zeros((len(sos), 2, c)),
            steady=steady_memory(sos) if first else np.zeros((len(sos), 2)),
            waiting=np.append(np.ones(c, np.int64), c),
        )
        return state, primed_sections if first else late_sections


@dataclass(frozen=True, slots=True)
class Lowpass(_Sections):
    """Butterworth low-pass. Stamps are earlier by the group delay at 0 Hz, which is also the declared delay.

    The thesis smooths rectified EMG with order 4 at 20 Hz (section 6.2.3) and markers at 10 Hz (section 6.2.4); it names no direction of
    filtering, and offline one would filter forwards and backwards. Here the filter runs forwards only and its stamps make up for it.

    >>> Lowpass(cutoff_hz=5)(np.ones(200), rate_hz=100)[[0, 5, -1]].round(3)
    array([0.   , 0.145, 1.   ])
    """

    delays: ClassVar[str] = "group delay at 0 Hz"
    references: ClassVar[str] = "`scipy.signal.sosfilt`, every bit"
    cutoff_hz: float = param(above=0.0, help="where the filter is 3 dB down")
    order: int = param(4, least=1, most=20, help="of the filter: each adds 6 dB per octave")
    start: Literal["zero", "first"] = param("zero", help="what came before: zeros, or the first sample's value")

    def design(self, rate_hz: float) -> tuple[Samples, float]:
        below_nyquist("cutoff_hz", self.cutoff_hz, rate_hz)
        return butterworth(self.order, self.cutoff_hz, "lowpass", rate_hz), 0.0

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [_case(cls(cutoff_hz=20.0)), _case(cls(cutoff_hz=90.0, order=3, start="first"))]


@dataclass(frozen=True, slots=True)
class Highpass(_Sections):
    """Butterworth high-pass: removes offset and drift, e.g. motion artefacts of EMG below 10-20 Hz. Stamps unchanged, no delay declared.

    >>> Highpass(cutoff_hz=20)(np.full(1000, 5.0), rate_hz=1000)[[0, 10, -1]].round(3)
    array([ 4.242, -1.754,  0.   ])
    """

    delays: ClassVar[str] = "no delay; stamps stay"
    references: ClassVar[str] = "`sosfilt`, every bit"
    cutoff_hz: float = param(above=0.0, help="where the filter is 3 dB down")
    order: int = param(4, least=1, most=20, help="of the filter: each adds 6 dB per octave")
    start: Literal["zero", "first"] = param("zero", help="what came before: zeros, or the first sample's value")

    def design(self, rate_hz: float) -> tuple[Samples, float]:
        below_nyquist("cutoff_hz", self.cutoff_hz, rate_hz)
        return butterworth(self.order, self.cutoff_hz, "highpass", rate_hz), math.nan

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [_case(cls(cutoff_hz=20.0)), _case(cls(cutoff_hz=5.0, order=2, start="first"))]


@dataclass(frozen=True, slots=True)
class Bandpass(_Sections):
    """Butterworth band-pass. `order` counts as in scipy: each flank has it, the whole filter twice as much.

    Stamps are earlier by the group delay at the geometric centre of the band, which is also the declared delay.

    >>> sine = np.sin(2 * np.pi * 20 * np.arange(1000) / 1000)  # 20 Hz
    >>> float(Bandpass(low_hz=10, high_hz=40)(5 + sine, rate_hz=1000)[-500:].max().round(2))
    1.0
    """

    delays: ClassVar[str] = "group delay at √(low · high)"
    references: ClassVar[str] = "`sosfilt`, every bit"
    low_hz: float = param(above=0.0, help="lower edge, 3 dB down")
    high_hz: float = param(above=0.0, help="upper edge, 3 dB down")
    order: int = param(4, least=1, most=20, help="of each flank: each adds 6 dB per octave")
    start: Literal["zero", "first"] = param("zero", help="what came before: zeros, or the first sample's value")

    def design(self, rate_hz: float) -> tuple[Samples, float]:
        below_nyquist("high_hz", self.high_hz, rate_hz)
        if self.low_hz >= self.high_hz:
            raise ParameterError("low_hz", self.low_hz, f"below high_hz, which is {self.high_hz:g}")
        return butterworth(self.order, (self.low_hz, self.high_hz), "bandpass", rate_hz), math.sqrt(
            self.low_hz * self.high_hz
        )

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [_case(cls(low_hz=20.0, high_hz=90.0))]


@dataclass(frozen=True, slots=True)
class Notch(_Sections):
    """Second-order notches (scipy's `iirnotch`) at a frequency and, if wanted, its multiples: mains hum.

    Stamps unchanged, no delay declared.

    >>> hum = np.sin(2 * np.pi * 50 * np.arange(2000) / 1000)
    >>> float(np.abs(Notch(notch_hz=50)(hum, rate_hz=1000)[-100:]).max().round(2))
    0.0
    """

    delays: ClassVar[str] = "no delay; stamps stay"
    references: ClassVar[str] = "`iirnotch` through `sosfilt`, every bit"
    notch_hz: float = param(50.0, above=0.0, help="what is removed, e.g. 50 or 60 Hz mains")
    width_hz: float = param(2.0, above=0.0, help="width of each notch, 3 dB down to 3 dB down")
    harmonics: int = param(1, least=1, help="how many multiples of notch_hz are removed, itself included")
    start: Literal["zero", "first"] = param("zero", help="what came before: zeros, or the first sample's value")

    def design(self, rate_hz: float) -> tuple[Samples, float]:
        below_nyquist("notch_hz", self.notch_hz, rate_hz)
        below_nyquist("width_hz", self.width_hz, rate_hz)
        if self.harmonics * self.notch_hz >= rate_hz / 2:
            most = math.ceil(rate_hz / 2 / self.notch_hz) - 1
            raise ParameterError(
                "harmonics", self.harmonics, f"at most {most} (notches below half of the input's {rate_hz:g} Hz)"
            )
        return notches(self.notch_hz, self.width_hz, self.harmonics, rate_hz), math.nan

    @classmethod
    def cases(cls) -> Sequence[Case]:
        return [_case(cls(notch_hz=30.0, harmonics=3))]


@remembered
def butterworth(
    order: int, cutoff_hz: float | Sequence[float], kind: Literal["lowpass", "highpass", "bandpass"], rate_hz: float
) -> Samples:
    """scipy's Butterworth design as sections (s, 6)."""
    from scipy.signal import butter

    return butter(order, cutoff_hz, kind, fs=rate_hz, output="sos")


@remembered
def notches(notch_hz: float, width_hz: float, harmonics: int, rate_hz: float) -> Samples:
    """scipy's notches at a frequency and its multiples, all `width_hz` wide, as sections (s, 6)."""
    from scipy.signal import iirnotch, tf2sos

    made = [tf2sos(*iirnotch(k * notch_hz, k * notch_hz / width_hz, fs=rate_hz)) for k in range(1, harmonics + 1)]
    return np.ascontiguousarray(np.concatenate(made))


@remembered
def steady_memory(sos: Samples) -> Samples:
    """The memory (s, 2) that sections have after a constant 1 for ever."""
    from scipy.signal import sosfilt_zi

    return np.ascontiguousarray(sosfilt_zi(sos))


def below_nyquist(parameter: str, given: float, rate_hz: float) -> None:
    if given >= rate_hz / 2:
        raise ParameterError(parameter, given, f"below {rate_hz / 2:g} (half of the input's {rate_hz:g} Hz)")


def group_delay(sos: Samples, turns: float) -> float:
    """The group delay in samples of sections (s, 6) at a frequency in cycles per sample: minus the phase's slope, section by section."""
    shift = cmath.exp(-2j * math.pi * turns)
    powers = [1.0, shift, shift * shift]
    total = 0.0
    for section in sos:
        for sign, coefficients in ((1.0, section[:3]), (-1.0, section[3:])):
            terms = [float(c) * p for c, p in zip(coefficients, powers, strict=True)]
            total += sign * ((terms[1] + 2 * terms[2]) / sum(terms)).real
    return total


def slowest(sos: Samples) -> float:
    """How much of the slowest transient is left after one sample: the largest pole's modulus."""
    return max(float(abs(root)) for section in sos for root in np.roots(section[3:]))


def settling(sos: Samples) -> float:
    """After how many samples the slowest pole's share in a transient has fallen to `SETTLED`."""
    left = slowest(sos)
    return math.log(SETTLED) / math.log(left) if left > 0 else 0.0


def _case(operator: _Sections) -> Case:
    data = np.random.default_rng(2).normal(size=(600, 3)) + 0.5
    spec = StreamSpec((3,), rate_hz=200.0, channels=("a", "b", "c"), units=("uV",))
    return Case(operator, {"in": (spec, grid(200.0, 600), data)}, least=600)
