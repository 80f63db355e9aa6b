"""Nights of estimated sleep against reference hypnograms: what `kinegraph sleep evaluate` reckons and shows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinegraph.operators.sleep.evaluation.agreement import Confusion, Limits, interval, limits
from kinegraph.operators.sleep.evaluation.reference import Hypnogram
from kinegraph.stream.chunk import NS, Times
from kinegraph.stream.data.csv_writer import Sheet
from kinegraph.stream.domain.night import UNKNOWN, Night, States, night
from kinegraph.stream.errors import KinegraphError

if TYPE_CHECKING:
    from rich.table import Table

NUMBERS = {"tst": "TST", "sol": "SOL", "waso": "WASO"}
NOTE = (
    "Sleep and wake are estimated from movement; quiet wakefulness is commonly scored as sleep. Sleep is the positive class. "
    "Not a medical device."
)


@dataclass(frozen=True, slots=True)
class Pair:
    """One night on both sides, epoch by epoch of the reference: times (n,) ns, states (n,); what one side does not know, neither does."""

    name: str
    person: str
    time: Times
    estimate: States
    reference: States
    confusion: Confusion
    found: Night
    truth: Night


def pair(name: str, person: str, estimate: Hypnogram, reference: Hypnogram, offset_s: float = 0.0) -> Pair:
    """Bring two hypnograms together. `offset_s` is added to the reference's times; where one of both counts from 0 without a date, the
    reference's first epoch is laid on the estimate's first. Raises KinegraphError where they do not overlap.
    """
    shift = 0 if estimate.dated == reference.dated else int(estimate.onset[0] - reference.onset[0])
    reference = reference.later(shift + round(offset_s * NS))
    length = int(np.median(reference.end - reference.onset))
    n = max(1, round((int(reference.end[-1]) - int(reference.onset[0])) / length))
    time = reference.onset[0] + np.arange(n) * length
    e, r = estimate.at(time + length // 2), reference.at(time + length // 2)
    if not ((e != UNKNOWN) & (r != UNKNOWN)).any():
        apart = estimate.end[-1] <= reference.onset[0] or reference.end[-1] <= estimate.onset[0]
        why = "do not overlap" if apart else "have no epoch in common that both know"
        raise KinegraphError(
            f"{name}: estimate and reference {why}: {_span(estimate)} and {_span(reference)}; --offset shifts the reference"
        )
    confusion = Confusion.of(e, r)
    unknown = (e == UNKNOWN) | (r == UNKNOWN)
    e, r = np.where(unknown, UNKNOWN, e).astype(np.int8), np.where(unknown, UNKNOWN, r).astype(np.int8)
    minutes, blank = length / (60 * NS), np.full(n, np.nan)
    return Pair(name, person, time, e, r, confusion, night(e, blank, minutes, "AASM"), night(r, blank, minutes, "AASM"))


def total(pairs: list[Pair]) -> Confusion:
    """All epochs of all nights."""
    made = Confusion(0, 0, 0, 0, 0)
    for one in pairs:
        made = made + one.confusion
    return made


def agreement(pairs: list[Pair]) -> dict[str, Limits]:
    """Bias and limits of TST, SOL and WASO, estimate less reference, in minutes."""
    persons = [one.person for one in pairs]
    return {
        key: limits(np.array([getattr(one.found, key) - getattr(one.truth, key) for one in pairs]), persons)
        for key in NUMBERS
    }


def pooled_intervals(pairs: list[Pair]) -> list[tuple[float, float]]:
    """95 % intervals of the pooled sensitivity, specificity and kappa."""
    confusions, persons = [one.confusion for one in pairs], [one.person for one in pairs]
    numbers = (lambda c: c.sensitivity, lambda c: c.specificity, lambda c: c.kappa)
    return [interval(confusions, persons, of) for of in numbers]


def results(pairs: list[Pair]) -> dict[str, Any]:
    """What `tables` shows, for programs; nights in minutes."""

    def counts(c: Confusion) -> dict[str, float]:
        rates = {"sensitivity": c.sensitivity, "specificity": c.specificity, "kappa": c.kappa}
        return {"epochs": c.epochs, "unknown": c.unknown, **rates}

    nights = [{"night": one.name, "person": one.person, **counts(one.confusion)} for one in pairs]
    return {"nights": nights, "pooled": counts(total(pairs)), "agreement_min": agreement(pairs)}


def tables(pairs: list[Pair]) -> list[Table]:
    """Epochs, and nights, for the terminal."""
    from rich.table import Table

    epochs = Table(box=None, title="Epoch by epoch (sleep positive)", title_justify="left")
    epochs.add_column("night", overflow="fold")
    epochs.add_column("person", overflow="fold")
    for column in ("epochs", "unknown", "sensitivity", "specificity", "kappa"):
        epochs.add_column(column, justify="right")
    for one in pairs:
        epochs.add_row(one.name, one.person, *_counts(one.confusion))
    if len(pairs) > 1:
        epochs.add_row("pooled", "", *_counts(total(pairs)), style="bold")
        intervals = pooled_intervals(pairs)
        if not any(np.isnan(low) for low, _ in intervals):
            texts = (f"{low:.3f} to {high:.3f}" for low, high in intervals)
            epochs.add_row("95 % interval (persons resampled)", "", "", "", *texts)
    nights = Table(
        box=None, title="Nights: estimate less reference, minutes (AASM), 95 % intervals", title_justify="left"
    )
    for column in ("", "", "minutes", "from", "to", "nights", "persons"):
        nights.add_column(column, justify="right" if column else "left")
    for key, found in agreement(pairs).items():
        rows = (
            ("bias", found.bias, found.bias_interval),
            ("lower limit", found.low, found.low_interval),
            ("upper limit", found.high, found.high_interval),
        )
        for k, (what, value, around) in enumerate(rows):
            counts = () if k else (str(found.nights), str(found.persons))
            nights.add_row("" if k else NUMBERS[key], what, _n(value), *map(_n, around), *counts)
    return [epochs, nights]


def write_table(pairs: list[Pair], path: Path) -> None:
    """One row per night as CSV."""
    with path.open("w", newline="", encoding="utf-8") as file:
        sheet = Sheet(file)
        sheet.writerow(
            ["night", "person", "epochs", "unknown", "sensitivity", "specificity", "kappa"]
            + [f"{key} {side} (min)" for key in NUMBERS for side in ("estimate", "reference")]
        )
        for one in pairs:
            c = one.confusion
            values = [getattr(side, key) for key in NUMBERS for side in (one.found, one.truth)]
            sheet.writerow([one.name, one.person, c.epochs, c.unknown, c.sensitivity, c.specificity, c.kappa, *values])


def _counts(c: Confusion) -> list[str]:
    return [str(c.epochs), str(c.unknown), *(_n(v, 3) for v in (c.sensitivity, c.specificity, c.kappa))]


def _n(value: float, digits: int = 1) -> str:
    return f"{value:.{digits}f}" if value == value else "-"


def _span(hypnogram: Hypnogram) -> str:
    first, last = (np.datetime64(int(t), "ns").astype("datetime64[s]") for t in (hypnogram.onset[0], hypnogram.end[-1]))
    return f"{first} to {last}"
