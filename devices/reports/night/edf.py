"""A night as EDF+: the hypnogram as annotations, the activity as a signal; for every program that sleep laboratories use."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.edf.edf_plus import EdfSignal, Head, Note, encode
from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, night_zone
from kinegraph.devices.reports.night.numbers import exits
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.system.atomic_file import write_complete

STAGES = {"wake": "Sleep stage W", "sleep": "Sleep stage S", "unknown": "Sleep stage ?"}
"""`S` is sleep without saying which: movement tells no stages apart."""
NOT_SEEN = -1.0
"""Written to a signal where nothing is known: EDF has no other way."""


def write_edf(path: Path, facts: Facts, epochs: LoggedEpochs) -> None:
    """Write the file, whole or not at all; times are those of the wall clock, as EDF wants. Raises OSError or DeviceError."""
    step = round(facts.epoch_s * NS)
    begin = int(epochs.onset[0])
    place = (epochs.onset - begin + step // 2) // step
    head = Head(_word(str(facts.session.get("subject", "X"))), "kinegraph", clock(begin, night_zone(facts)))
    notes = [Note(max(0, t - begin), length, text) for t, length, text in _notes(facts, epochs) if t >= begin - step]
    signals = [_signal(name, unit, epochs.numbers[of], place) for name, of, unit in SIGNALS if _known(epochs, of)]
    content = encode(head, step, signals, notes)
    write_complete(path, content)


SIGNALS = (
    ("Activity", "activity", ""),
    ("Breathing rate", "breaths_per_min", "/min"),
)


def _notes(facts: Facts, epochs: LoggedEpochs) -> list[tuple[int, int | None, str]]:
    """Everything that is annotated: when (ns), how long (ns; None: a moment), and what."""
    step = round(facts.epoch_s * NS)
    notes: list[tuple[int, int | None, str]] = [
        (int(t), step, STAGES[str(s)]) for t, s in zip(epochs.onset, epochs.texts["state"], strict=True)
    ]
    notes += [(int(t), None, str(what).capitalize()) for t, what in facts.switched]
    notes += [(s.begin, s.end - s.begin, "Out of bed") for s in exits(facts)]
    notes += [(int(a), int(b) - int(a), "Not running") for a, b in facts.breaks]
    return notes


def _known(epochs: LoggedEpochs, name: str) -> bool:
    """Whether a signal is written: anything is known of it, or it is the one that is always there."""
    return name == "activity" or bool(np.isfinite(epochs.numbers[name]).any())


def _signal(name: str, unit: str, values: Samples, place: np.ndarray) -> EdfSignal:
    """One number per epoch."""
    row = np.full(int(place[-1]) + 1, NOT_SEEN)
    row[place] = np.where(np.isfinite(values), values, NOT_SEEN)
    return EdfSignal(name, unit, NOT_SEEN, max(1.0, math.ceil(float(row.max()))), row)


def _word(text: str) -> str:
    """A code without spaces and outside no alphabet, as EDF wants it."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in text)[:20] or "X"
