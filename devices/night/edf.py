"""A night as EDF+: the hypnogram as annotations, the activity as a signal; for every program that sleep laboratories use."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from devices.night.numbers import exits
from devices.night.shelf import Epochs, Facts, clock, zone_of
from stream.chunk import NS, Samples

if TYPE_CHECKING:
    from edfio import Edf, EdfSignal

STAGES = {"wake": "Sleep stage W", "sleep": "Sleep stage S", "unknown": "Sleep stage ?"}
"""`S` is sleep without saying which: movement tells no stages apart."""
MOST_PADDING = 50
NOT_SEEN = -1.0
"""What stands in a signal where nothing is known: EDF has no other way."""


def write_edf(path: Path, facts: Facts, epochs: Epochs) -> None:
    """Write the file, whole or not at all; times are those of the wall clock, as EDF wants. Raises OSError."""
    import edfio

    step = round(facts.epoch_s * NS)
    begin = int(epochs.onset[0])
    place = np.round((epochs.onset - begin) / step).astype(np.int64)
    local = clock(begin, zone_of(facts.timezone))
    notes: list[tuple[int, float | None, str]] = [
        (int(t), step / NS, STAGES[str(s)]) for t, s in zip(epochs.onset, epochs.texts["state"], strict=True)
    ]
    notes += [(int(t), None, str(what).capitalize()) for t, what in facts.switched]
    notes += [(s.begin, (s.end - s.begin) / NS, "Out of bed") for s in exits(facts)]
    notes += [(int(a), (int(b) - int(a)) / NS, "Not running") for a, b in facts.breaks]
    inside = [(max(0.0, (t - begin) / NS), length, text) for t, length, text in notes if t >= begin - step]
    told = [edfio.EdfAnnotation(onset, length, text) for onset, length, text in sorted(inside, key=lambda n: n[0])]

    def made(more: int) -> Edf:
        signals = [_signal(name, unit, epochs.numbers[of], place, facts.epoch_s, more) for name, of, unit in SIGNALS]
        return edfio.Edf(
            [s for s in signals if s is not None],
            patient=edfio.Patient(code=_word(str(facts.session.get("subject", "X")))),
            recording=edfio.Recording(startdate=local.date(), equipment_code="kinegraph"),
            starttime=local.time().replace(microsecond=0),
            data_record_duration=facts.epoch_s,
            annotations=told,
        )

    draft = path.with_name(f".{path.stem}.draft.edf")
    try:
        _first_that_can_be(made).write(draft)
        draft.replace(path)
    finally:
        draft.unlink(missing_ok=True)


SIGNALS = (
    ("Activity", "activity", ""),
    ("Breathing rate", "breaths_per_min", "/min"),
)


def _first_that_can_be(made: Callable[[int], Edf]) -> Edf:
    """The file with as few epochs of nothing at its end as can be.

    edfio compares the signals' lengths in seconds, as rounded numbers; for some numbers of epochs they differ in the last digit.
    """
    for more in range(MOST_PADDING):
        try:
            return made(more)
        except ValueError as error:
            if "durations" not in str(error) or more == MOST_PADDING - 1:
                raise
    raise AssertionError("unreachable")


def _signal(name: str, unit: str, values: Samples, place: np.ndarray, epoch_s: float, more: int) -> EdfSignal | None:
    """One number per epoch; None where nothing is known of the whole night."""
    import edfio

    if not np.isfinite(values).any():
        return None
    row = np.full(int(place[-1]) + 1 + more, NOT_SEEN)
    row[place] = np.where(np.isfinite(values), values, NOT_SEEN)
    top = max(1.0, math.ceil(float(row.max())))
    return edfio.EdfSignal(row, 1 / epoch_s, label=name, physical_dimension=unit, physical_range=(NOT_SEEN, top))


def _word(text: str) -> str:
    """A code without spaces and outside no alphabet, as EDF wants it."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in text)[:20] or "X"
