"""Motion that does not repeat: recordings shuffled, with random phases, and noise; how many repetitions are found in it all the same."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.motion import RATE, events, kinect, poses, regular
from bench.report import Section
from kinegraph.operators.features.stack import Stack
from kinegraph.operators.segmentation import Segment
from kinegraph.stream.chunk import Array

PIECE_S = 0.5


def frames_shuffled(x: Array, rng: np.random.Generator) -> Array:
    """All frames in random order: nothing but chance comes back."""
    return x[rng.permutation(len(x))]


def shuffled(x: Array, rng: np.random.Generator) -> Array:
    """Pieces of half a second in random order."""
    size = round(PIECE_S * RATE)
    pieces = [x[i : i + size] for i in range(0, len(x) - size + 1, size)]
    return np.concatenate([pieces[i] for i in rng.permutation(len(pieces))])


def phases(x: Array, rng: np.random.Generator) -> Array:
    """The same spectrum of every channel, each of its frequencies at a random phase: a stationary noise."""
    spectrum = np.fft.rfft(x - x.mean(0), axis=0)
    spectrum *= np.exp(2j * np.pi * rng.random(spectrum.shape))
    return np.fft.irfft(spectrum, len(x), axis=0) + x.mean(0)


SURROGATES: dict[str, Callable[[Array, np.random.Generator], Array]] = {
    "as recorded": lambda x, rng: x,
    "frames shuffled": frames_shuffled,
    "pieces of 0.5 s shuffled": shuffled,
    "random phases": phases,
    "random walk": lambda x, rng: np.cumsum(rng.normal(size=(len(x), 8)), 0),
}


def surrogates(folder: Path, draws: int = 3) -> Section:
    """Of all recordings: how many repetitions per minute, and how much of the time they fill."""
    rows: list[list[str]] = []
    known = [pose.data for _, _, pose, _ in poses(folder)]
    known += [kinect(path).data for path in sorted(folder.glob("msrc12/*.npz"))]
    for name, make in SURROGATES.items():
        count, within, total, clean, whole, runs, certain, cuts = 0, 0.0, 0.0, 0, 0, 0, 0, 0
        for k, data in enumerate(known):
            for draw in range(1 if name == "as recorded" else draws):
                x = make(data[np.isfinite(data).all(1)], np.random.default_rng((k, draw)))
                result = events(regular(x).through(Stack()), Segment())
                repeats = result["primitive"][result["primitive"]["repetition"] > 0]
                sure = result["activity"]["activity"][result["activity"]["certainty"] > 0.0]
                certain += int(np.isin(repeats["activity"], sure).sum())
                cuts += len(sure)
                count, runs = count + len(repeats), runs + 1
                within += float((repeats["end"] - repeats["onset"]).sum()) / 1e9
                total += len(x) / RATE
                clean += not len(repeats)
                whole += len(result["activity"]) == 1
        shares = [f"{within / total:.0%}", f"{clean} of {runs}", f"{whole} of {runs}"]
        sure_ = [f"{60 * certain / total:.1f}", f"{60 * cuts / total:.1f}"]
        rows.append([name, f"{60 * count / total:.1f}", *sure_, *shares])
    title = "Motion that does not repeat: what is found in it all the same"
    return Section(
        title,
        [
            "",
            "repetitions per minute",
            "certain ones",
            "certain activities",
            "of the time",
            "recordings without any",
            "not cut at all",
        ],
        rows,
    )
