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
    signals += _wave(epochs, place)
    content = encode(head, step, signals, notes)
    write_complete(path, content)


SIGNALS = (
    ("Activity", "activity", ""),
    ("Breathing rate", "breaths_per_min", "/min"),
    ("Chest lift", "lift_mm", "mm"),
    ("No effort seen", "paused_s", "s"),
)
WAVE_MM = 32.0
"""The chest's movement is written up to this; its negative is written where it is not known."""


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
    return name == "activity" or bool(np.isfinite(epochs.numbers.get(name, np.empty(0))).any())


def _signal(name: str, unit: str, values: Samples, place: np.ndarray) -> EdfSignal:
    """One number per epoch."""
    row = np.full(int(place[-1]) + 1, NOT_SEEN)
    row[place] = np.where(np.isfinite(values), values, NOT_SEEN)
    return EdfSignal(name, unit, NOT_SEEN, max(1.0, math.ceil(float(row.max()))), row)


def _wave(epochs: LoggedEpochs, place: np.ndarray) -> list[EdfSignal]:
    """The chest's movement, as many numbers in every epoch; no signal where nothing is known of it."""
    rows = [text.split() for text in epochs.texts.get("wave", np.empty(0, "U1")).tolist()]
    if not any(value != "x" for row in rows for value in row):
        return []
    values = np.full((int(place[-1]) + 1, max(map(len, rows))), -WAVE_MM)
    for k, row in zip(place.tolist(), rows, strict=True):
        known = np.array([float(value) / 100 if value != "x" else np.nan for value in row])
        values[k, : len(row)] = np.where(np.isfinite(known), np.clip(known, 0.1 - WAVE_MM, WAVE_MM), -WAVE_MM)
    return [EdfSignal("Chest movement", "mm", -WAVE_MM, WAVE_MM, values)]


def _word(text: str) -> str:
    """A code without spaces and outside no alphabet, as EDF wants it."""
    return "".join(c if c.isascii() and c.isalnum() else "_" for c in text)[:20] or "X"
