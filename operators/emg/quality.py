"""How far a raw EMG channel can be trusted: clipping, flat line, mains hum, baseline noise, motion artefact."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from kinegraph.operators.emg.amplitude_reference import AmplitudeReference
from kinegraph.operators.emg.one_kind import refuse_mixed
from kinegraph.operators.emg.quality_kernel import powers, runs
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.data.require import regular_signal
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.filter import reset_gap
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

QUALITY = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("channel", "<i4"),
        ("name", "<U16"),
        ("clipped", "<f8"),
        ("flat", "<f8"),
        ("missing", "<f8"),
        ("hum", "<f8"),
        ("artefact", "<f8"),
        ("noise", "<f8"),
        ("contrast", "<f8"),
        ("flag", "<U8"),
        ("reason", "<U16"),
        ("session_flag", "<U8"),
        ("session_reason", "<U16"),
    ]
)
SHARES = ("clipped", "flat", "missing", "hum", "artefact")
LIMITS: dict[str, tuple[str, float, float]] = {
    "missing": ("missing samples", 0.01, 0.2),
    "flat": ("flat line", 0.02, 0.2),
    "clipped": ("clipping", 0.001, 0.01),
    "hum": ("mains hum", 0.15, 0.3),
    "artefact": ("artefact", 0.6, 0.9),
}
"""Per measure: the reason's name, the share above which a channel is doubtful, and that above which it is bad."""
DOUBTFUL, BAD = (np.array([[limits[k]] for limits in LIMITS.values()]) for k in (1, 2))
FLAGS = np.array([*(["bad"] * len(LIMITS)), *(["doubtful"] * len(LIMITS)), "good"])
REASONS = np.array([*(2 * [limits[0] for limits in LIMITS.values()]), ""])
MAX_NOISE_UV = 10.0
"""Baseline noise, rms, from which an electrode is doubtful: ours. In movement the quietest 100 ms of a second are seldom at rest."""
BAD_NOISE = 3.0
"""From this many times that noise on, an electrode is bad."""
RISEN = (3.0, 6.0)
"""A window with noise above the limit is doubtful, or bad, if it is also this many times the lowest of the session."""
MICROVOLTS = {"uV": 1.0, "µV": 1.0, "mV": 1e-3, "V": 1e-6}
ENOUGH = 3
"""Windows after which the session's contrast and noise are judged."""


@dataclass(slots=True)
class QualityState:
    """
    window (n, c), time (n,)   the samples of the open window; `fill` of them; held (c,) the last finite values
    taper (n,)                 Hann window of the spectrum
    bands (5, f)               weights of the spectrum's lines: 1-20 Hz, from 1 Hz on, from 20 Hz on; hum at 50 and at 60 Hz
    sums (7, c)                over all windows: power in the three bands, hum's two, quietest and loudest block's rms
    counts (3, c)              over all windows: samples clipped, flat, missing; `windows` in all
    rails (2, c)               lowest and highest value so far
    rest (c,)                  baseline noise at rest; NaN: not known
    floor (c,)                 the lowest noise of a window so far; max_noise: the limit, in the signal's unit
    """

    window: Samples
    time: Times
    fill: int
    held: Samples
    taper: Samples
    bands: Samples
    sums: Samples
    counts: Samples
    windows: int
    rails: Samples
    rest: Samples
    floor: Samples
    max_noise: float
    last: int
    limit: int
    names: list[str]


@dataclass(frozen=True, slots=True)
class SignalQuality(Operator[QualityState]):
    """Raw EMG (channels,) in, one event per window of `window_s` and channel out, stamped with the window's last sample.

    clipped    share of samples at the amplifier's end: amounts from 99 % of `full_scale` on; where that is not known, samples exactly
               at the window's highest or lowest value, if 3 or more are and it lies within 2 % of the end of the range so far
    flat       share of samples in runs of equal ones of at least 50 ms
    missing    share of samples that are NaN or infinite (the last finite value replaces them elsewhere)
    hum        share of the power from 20 to 450 Hz that mains hum has: lines at 50 Hz and its multiples (or 60 Hz, whichever has more,
               unless `mains_hz` says), each above the level of its neighbours
    artefact   share of the power from 1 to 450 Hz that lies below 20 Hz: cable and skin move, EMG has little there
    noise      rms of the window's quietest 100 ms, about its mean; the baseline where there is a pause in every window
    contrast   rms of the loudest 100 ms over the quietest: activity over baseline

    `flag` is good, doubtful or bad for this window, `session_flag` for all windows so far (powers and samples are added up, noise and
    contrast averaged); `reason` names the worst. The limits (doubtful, bad): missing 1 %, 20 %; flat 2 %, 20 %; clipped 0.1 %, 1 %;
    hum 15 %, 30 %; artefact 60 %, 90 % (an envelope's high-pass removes most of it, so it takes much to be called bad). "baseline noise":
    for the session, from the third window on, if the quietest window's noise is above `max_noise` (doubtful) or three times that (bad),
    if contrast is below `min_contrast` (doubtful; a muscle that never works looks the same), or if noise is above three times that of the
    reference `rest` (doubtful; a file by `kinegraph emg calibrate rest`); for a window, if its noise is above these limits and at least
    three (six) times that of the quietest.
    The limits are ours, from recordings with known faults; SENIAM and the thesis give no limits. Whether cycles repeat is another question,
    which `CycleEnsemble` answers ("not repeatable"); it is no measure of the electrode.

    A gap longer than `reset_gap_s` throws the open window away. Memory: one window.

    >>> found = SignalQuality()(np.zeros((4000, 1)), rate_hz=1000, channels=["TA"], units=["uV"])
    >>> found[["name", "flag", "reason"]][0].item()
    ('TA', 'bad', 'flat line')
    """

    window_s: float = param(1.0, least=0.5, most=60.0, help="length of a window")
    mains_hz: Literal[0, 50, 60] = param(0, help="mains frequency; 0: 50 or 60, whichever hums more")
    full_scale: float = param(
        0.0, least=0.0, help="the largest absolute value the amplifier can give, in the signal's unit; 0: unknown"
    )
    min_contrast: float = param(2.0, least=1.0, help="less is baseline noise")
    max_noise: float = param(
        0.0, least=0.0, help="more is baseline noise, in the signal's unit; 0: 10 uV, where the unit is one of voltage"
    )
    rest: str = param("", help="a rest reference, for its baseline noise")
    reset_gap_s: float = reset_gap(0.05)

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        rate_hz = regular_signal(spec)
        refuse_mixed(spec)
        if rate_hz < 200:
            raise InputError("in", spec.describe(), "raw EMG at 200 Hz or more")
        n, c = round(self.window_s * rate_hz), spec.shape[0]
        names = list(spec.channels or [f"channel {i + 1}" for i in range(c)])
        bands = _weights(np.arange(n // 2 + 1, dtype=np.float64) * (rate_hz / n), self.mains_hz)
        self.set_state(
            QualityState(
                np.zeros((n, c)), np.zeros(n, np.int64), 0, np.zeros(c), np.hanning(n), bands, np.zeros((7, c)), np.zeros((3, c)), 0,
                np.outer([np.inf, -np.inf], np.ones(c)), self._rest(names), np.full(c, np.inf), self._most_noise(spec),
                NEVER, spec.period_ns + round(self.reset_gap_s * NS), names,
            ),
            decision_s={"out": spec.period_ns / NS},
        )  # fmt: skip
        unit = spec.units[0] if len(spec.units) == 1 else ""
        units = ("ns", "ns", "", "", "", "", "", "", "", unit, "", "", "", "", "")
        meta = {**spec.meta, "window_s": self.window_s}
        return {"out": StreamSpec((), QUALITY, units=units, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        rows, stamps = [], []
        n = len(s.window)
        if chunk.lost and s.last != NEVER and chunk.time[0] - s.last > s.limit:
            s.fill = 0
        start = 0
        while start < len(chunk.time):
            stop = min(start + n - s.fill, len(chunk.time))
            s.window[s.fill : s.fill + stop - start] = chunk.data[start:stop]
            s.time[s.fill : s.fill + stop - start] = chunk.time[start:stop]
            s.fill += stop - start
            start = stop
            if s.fill == n:
                s.fill = 0
                rows.append(self._judge())
                stamps.append(int(s.time[-1]))
        if len(chunk.time):
            s.last = int(chunk.time[-1])
        data = np.concatenate(rows) if rows else np.empty(0, QUALITY)
        return Chunk(np.array(stamps, np.int64).repeat(s.window.shape[1]), data, chunk.until, -1 if chunk.lost else 0)

    @classmethod
    def cases(cls) -> list[Case]:
        spec = StreamSpec((2,), rate_hz=250.0, channels=("TA", "SO"), units=("uV",))
        x = np.random.default_rng(9).standard_normal((1200, 2)) * 20
        return [Case(cls(window_s=0.5), {"in": (spec, grid(250.0, 1200), x)}, least=12)]

    def _rest(self, names: list[str]) -> Samples:
        if not self.rest:
            return np.full(len(names), np.nan)
        found = AmplitudeReference.read(Path(self.rest))
        if not found.noise:
            raise ParameterError("rest", self.rest, f"a reference taken at rest, this one was taken at {found.kind}")
        noise = dict(zip(found.channels, found.noise, strict=True))
        return np.array([noise.get(name, np.nan) for name in names])

    def _most_noise(self, spec: StreamSpec) -> float:
        """The limit in the signal's unit; infinite where that is no voltage and no limit is given."""
        unit = spec.units[0] if len(set(spec.units)) == 1 else ""
        return self.max_noise or MAX_NOISE_UV * MICROVOLTS.get(unit, np.inf)

    def _judge(self) -> Array:
        """One row per channel on the full window, which is also added to the session."""
        s = self.state
        n, c = s.window.shape
        counts = np.zeros((3, c))
        runs(s.window, s.held, s.rails, self.full_scale, max(3, n * 50 // round(self.window_s * 1000)), counts)
        sums = np.empty((7, c))
        powers(np.fft.rfft(np.ascontiguousarray((s.window - s.window.mean(axis=0)).T) * s.taper, axis=1), s.bands, sums)
        block = max(2, n // round(self.window_s * 10))
        level = s.window[: n // block * block].reshape(-1, block, c).std(axis=1)
        sums[5], sums[6] = level.min(axis=0), level.max(axis=0)
        s.sums += sums
        s.counts += counts
        s.windows += 1
        rows = np.empty(c, QUALITY)
        rows["onset"], rows["end"], rows["channel"], rows["name"] = s.time[0], s.time[-1], np.arange(c), s.names
        measures = _measures(sums, counts / n, 1)
        for name, values in measures.items():
            rows[name] = values
        noise, limit = measures["noise"], s.max_noise
        s.floor = np.fmin(s.floor, np.where(noise > 0, noise, np.inf))
        limits = [np.maximum(times * limit, k * s.floor) for times, k in zip((1.0, BAD_NOISE), RISEN, strict=True)]
        rows["flag"], rows["reason"] = _noisy(*_verdicts(measures), noise > limits[0], noise > limits[1])
        session = _measures(s.sums, s.counts / (n * s.windows), s.windows)
        flag, reason = _verdicts(session)
        if s.windows >= ENOUGH:
            still = np.where(np.isfinite(s.floor), s.floor, 0.0)
            doubtful = (still > limit) | (session["noise"] > 3 * s.rest) | (session["contrast"] < self.min_contrast)
            flag, reason = _noisy(flag, reason, doubtful, still > BAD_NOISE * limit)
        rows["session_flag"], rows["session_reason"] = flag, reason
        return rows


def _noisy(flag: Array, reason: Array, doubtful: Array, bad: Array) -> tuple[Array, Array]:
    """Flags and reasons (c,) with baseline noise, where nothing worse has been found."""
    worse = bad & (flag != "bad")
    noisy = worse | (doubtful & (flag == "good"))
    return np.where(worse, "bad", np.where(noisy, "doubtful", flag)), np.where(noisy, "baseline noise", reason)


def _weights(frequency: Samples, mains_hz: int) -> Samples:
    """Weights (5, f): of the three bands, then of hum at 50 and 60 Hz, for lines at `frequency` (f,)."""
    top = min(450.0, 0.95 * float(frequency[-1]))
    bands = np.array(
        [
            (frequency >= 1) & (frequency < 20),
            (frequency >= 1) & (frequency <= top),
            (frequency >= 20) & (frequency <= top),
        ]
    )
    hum = np.zeros((2, len(frequency)))
    for k, mains in enumerate((50, 60)):
        if mains_hz in (0, mains):
            for line in np.arange(mains, top - 5, mains):
                away = np.abs(frequency - line)
                hit, beside = away < 2.5, (away >= 2.5) & (away < 7.5)
                hum[k, hit] = 1.0
                hum[k, beside] = -hit.sum() / beside.sum()
    return np.concatenate([bands, hum])


def _measures(sums: Samples, shares: Samples, windows: int) -> dict[str, Samples]:
    """The measures by name, (c,) each, of sums over `windows` windows; NaN where there is no signal at all."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return {
            "clipped": shares[0],
            "flat": shares[1],
            "missing": shares[2],
            "hum": np.clip(np.maximum(sums[3], sums[4]) / sums[2], 0.0, 1.0),
            "artefact": sums[0] / sums[1],
            "noise": sums[5] / windows,
            "contrast": sums[6] / sums[5],
        }


def _verdicts(measured: dict[str, Samples]) -> tuple[Array, Array]:
    """Flag and reason per channel: the first measure that is bad, else the first that is doubtful."""
    values = np.array([measured[name] for name in LIMITS])
    good = np.ones((1, values.shape[1]), np.bool_)
    first = np.concatenate([values > BAD, values > DOUBTFUL, good]).argmax(axis=0)
    return FLAGS[first], REASONS[first]
