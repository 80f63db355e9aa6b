"""Breathing rates beside a PSG's effort belt, epoch by epoch."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from datetime import UTC
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import NS, Samples, Times
from kinegraph.stream.data.bounded import reading
from kinegraph.stream.errors import KinegraphError

BELTS = ("effort", "thor", "chest", "abd", "rib", "resp")
"""What labels of effort belts hold, the first found first; airflow is no effort."""
RATE_LABEL, FLOW = "Breathing rate", "flow"
SLOWEST, FASTEST, STEP = 5.0, 47.0, 0.05
"""Breaths per minute that are looked for in a belt."""
CLEAR = 0.35
"""Of a belt's power from `SLOWEST` on, this share lies within 2 per minute of the rate or of its double, or the epoch has none."""


@dataclass(frozen=True, slots=True)
class BreathAgreement:
    """One night: how many epochs the belt has a rate in, and of these, ours; median and 95 % of the absolute difference, its mean (1/min).

    within  share of the differences within our own interval; NaN where the file has none
    """

    name: str
    belt: str
    epochs: int
    known: int
    median: float
    most: float
    bias: float
    within: float

    def row(self) -> list[str]:
        share = f"{self.known / self.epochs:.2f} of {self.epochs}" if self.epochs else "0"
        within = f"{self.within:.2f}" if self.within == self.within else "-"
        return [self.name, self.belt, share, f"{self.median:.2f}", f"{self.most:.2f}", f"{self.bias:+.2f}", within]


HEADER = ("night", "belt", "epochs with a rate", "median error (1/min)", "95 %", "bias", "within interval")


def breath_agreement(name: str, estimate: Path, reference: Path, offset_s: float) -> BreathAgreement | None:
    """Our rates against those of the reference's effort belt, at our epochs; None where either file has no breath."""
    if reference.suffix.lower() != ".edf":
        return None
    ours, belt = _rates(estimate), _belt(reference)
    if ours is None or belt is None:
        return None
    onset, epoch_s, rate, error = ours
    begin, rate_hz, samples, label = belt
    truth = np.full(len(onset), np.nan)
    n = round(epoch_s * rate_hz)
    for k, start in enumerate(onset.tolist()):
        first = round((start / NS - begin / NS - offset_s) * rate_hz)
        if first >= 0 and first + n <= len(samples):
            truth[k] = belt_rate(samples[first : first + n], rate_hz)
    there = np.isfinite(truth)
    both = there & np.isfinite(rate)
    gap = (rate - truth)[both]
    nan = float("nan")
    median, most = np.percentile(abs(gap), (50, 95)) if len(gap) else (nan, nan)
    known = np.isfinite(error[both])
    within = float((abs(gap) <= error[both])[known].mean()) if known.any() else nan
    bias = float(gap.mean()) if len(gap) else nan
    return BreathAgreement(name, label, int(there.sum()), int(both.sum()), float(median), float(most), bias, within)


def belt_rate(x: Samples, rate_hz: float) -> float:
    """Breaths per minute in an epoch of a belt; NaN where no rate is clear.

    >>> t = np.arange(300) / 10
    >>> round(belt_rate(np.sin(2 * np.pi * t / 4), 10.0), 1)
    15.0
    """
    if np.ptp(x) == 0 or not np.isfinite(x).all():
        return float("nan")
    n = len(x)
    line = np.polynomial.Polynomial.fit(np.arange(n), x, 1)(np.arange(n))
    length = max(n, round(60 * rate_hz / STEP))
    power = np.abs(np.fft.rfft((x - line) * np.hanning(n), length)) ** 2
    per_min = 60 * np.fft.rfftfreq(length, 1 / rate_hz)
    asked = (per_min >= SLOWEST) & (per_min <= FASTEST)
    rate = float(per_min[asked][power[asked].argmax()])
    near = (abs(per_min - rate) < 2) | (abs(per_min - 2 * rate) < 2)
    return rate if power[near].sum() > CLEAR * power[per_min >= SLOWEST].sum() else float("nan")


def _rates(path: Path) -> tuple[Times, float, Samples, Samples] | None:
    """Onsets (ns), length (s), rates and halves of their intervals of a night of ours: hypnogram.edf, or epochs.csv."""
    if path.suffix.lower() == ".csv":
        return _from_table(path)
    if path.suffix.lower() != ".edf":
        return None
    edf, begin = _edf(path)
    signal = next((s for s in edf.signals if s.label == RATE_LABEL), None)
    if signal is None:
        return None
    step_s = 1 / float(signal.sampling_frequency)
    rate = np.where(signal.data > 0, signal.data, np.nan)
    onset = begin + np.round(np.arange(len(rate)) * step_s * NS).astype(np.int64)
    return onset, step_s, rate, np.full(len(rate), np.nan)


def _from_table(path: Path) -> tuple[Times, float, Samples, Samples] | None:
    from kinegraph.stream.data.tables import read_records

    rows = [row for _, row in read_records(path)]
    if not rows or not {"onset", "end", "breaths_per_min"} <= rows[0].keys():
        return None
    onset, end = (_stamps([str(row[name]) for row in rows]) for name in ("onset", "end"))
    rate, error = (
        np.array([float(row.get(name) or "nan") for row in rows]) for name in ("breaths_per_min", "rate_error")
    )
    return onset, float(np.median(end - onset)) / NS, rate, error


def _stamps(texts: list[str]) -> Times:
    stamps: Times = np.array([text.removesuffix("Z") for text in texts], "datetime64[ns]").astype(np.int64)
    return stamps


def _belt(path: Path) -> tuple[int, float, Samples, str] | None:
    """When it begins (ns), its rate, and its samples, of the belt of a PSG."""
    edf, begin = _edf(path)
    for word in BELTS:
        for signal in edf.signals:
            label = signal.label.lower()
            if word in label and FLOW not in label and signal.label not in (RATE_LABEL, "No effort seen"):
                return begin, float(signal.sampling_frequency), np.asarray(signal.data, np.float64), signal.label
    return None


def _edf(path: Path) -> tuple[Any, int]:
    import edfio

    with reading(path, "EDF", KinegraphError), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        edf = edfio.read_edf(path)
        return edf, round(edf.startdatetime.replace(tzinfo=UTC).timestamp() * NS)
