"""How well contacts are found: foot-worn inertial sensors against annotated steps, markers against an offline method.

    KINEGRAPH_DATA=folder python -m bench.contacts

reads `steps/imu_voisard_*.npz` (Voisard 2023, IPOL 497) and `emg/emg_epfl_*.npz`, and prints what docs/lab/contacts.md quotes. A found
contact is right if it can be paired, one to one, with an annotated one at most 250 ms away.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from kinegraph.operators.contacts.acceleration import AccelerationContacts
from kinegraph.operators.contacts.contacts import Contacts
from kinegraph.operators.contacts.inertial import InertialContacts
from kinegraph.operators.contacts.marker import MarkerContacts
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec

TOLERANCE_S = 0.25
START_NS = 1_700_000_000 * NS
FOOT = StreamSpec(
    (6,),
    rate_hz=100.0,
    channels=("ax", "ay", "az", "gx", "gy", "gz"),
    units=("m/s2", "m/s2", "m/s2", "rad/s", "rad/s", "rad/s"),
)


@dataclass(slots=True)
class Walk:
    """One foot in one trial: seconds (n,), samples (n, 6) m/s2 and rad/s, annotated touch-downs and lift-offs in s."""

    seconds: Array
    samples: Array
    touchdown: Array
    liftoff: Array


@dataclass(slots=True)
class Score:
    """How found contacts compare with true ones."""

    right: int = 0
    extra: int = 0
    missed: int = 0
    errors_s: list[float] = field(default_factory=list)
    delays_s: list[float] = field(default_factory=list)

    def add(self, onset: Array, decided: Array, truth: Array, tolerance_s: float = TOLERANCE_S) -> None:
        """Compare onsets (n,) and their times of decision (n,) with the truth (m,), all in s."""
        pairs = pair(onset, truth, tolerance_s)
        self.right += len(pairs)
        self.extra += len(onset) - len(pairs)
        self.missed += len(truth) - len(pairs)
        self.errors_s += [float(onset[i] - truth[j]) for i, j in pairs]
        self.delays_s += list(decided - onset)

    def merge(self, other: Score) -> None:
        self.right, self.extra, self.missed = (
            self.right + other.right,
            self.extra + other.extra,
            self.missed + other.missed,
        )
        self.errors_s += other.errors_s
        self.delays_s += other.delays_s

    @property
    def f1(self) -> float:
        return 2 * self.right / max(1, 2 * self.right + self.extra + self.missed)

    @property
    def precision(self) -> float:
        return self.right / max(1, self.right + self.extra)

    @property
    def recall(self) -> float:
        return self.right / max(1, self.right + self.missed)

    @property
    def median_ms(self) -> float:
        """Median of the absolute error."""
        return 1e3 * float(np.median(np.abs(self.errors_s))) if self.errors_s else np.nan

    def row(self) -> list[str]:
        delays, errors = 1e3 * np.array(self.delays_s), 1e3 * np.array(self.errors_s)
        return [
            f"{self.f1:.3f}",
            f"{self.precision:.3f}",
            f"{self.recall:.3f}",
            f"{self.median_ms:.0f}",
            f"{np.median(errors):+.0f}",
            f"{np.percentile(np.abs(errors), 90):.0f}",
            f"{np.median(delays):.0f} / {np.percentile(delays, 95):.0f} / {delays.max():.0f}",
        ]


def pair(found: Array, truth: Array, tolerance_s: float) -> list[tuple[int, int]]:
    """As many pairs as can be made, one to one, at most `tolerance_s` apart, with the least sum of differences."""
    from scipy.optimize import linear_sum_assignment

    if not len(found) or not len(truth):
        return []
    apart = np.abs(np.subtract.outer(found, truth))
    cost = np.where(apart <= tolerance_s, apart, 1e3)
    return [(int(i), int(j)) for i, j in zip(*linear_sum_assignment(cost), strict=True) if apart[i, j] <= tolerance_s]


def people(folder: Path) -> list[Path]:
    return sorted((folder / "steps").glob("imu_voisard_s*.npz"))


def walks(file: Path) -> Iterator[Walk]:
    """Every foot and trial of one person. Rows are put on the time of the packet counter, which is what the annotations count."""
    with np.load(file) as data:
        for trial in data["trials"]:
            for foot, side in (("lf", "left"), ("rf", "right")):
                counter, events = data[f"t{trial}_{foot}_counter"], data[f"t{trial}_{side}_events"]
                seconds = (counter - counter[0]) / float(data["fs"])
                samples = data[f"t{trial}_{foot}"].astype(np.float64)
                yield Walk(seconds, samples, events[:, 1] / 100.0, events[:, 0] / 100.0)


def run(operator: Contacts[Any], spec: StreamSpec, seconds: Array, samples: Array) -> dict[str, tuple[Array, Array]]:
    """Onsets and times of decision in s, of touch-downs and lift-offs."""
    operator.open({"in": spec})
    time = START_NS + np.round(seconds * NS).astype(np.int64)
    result = operator.process("in", Chunk(time, np.ascontiguousarray(samples), int(time[-1])))
    return {name: ((c.data["onset"] - START_NS) / NS, (c.time - START_NS) / NS) for name, c in result}


def score(
    walk: Walk,
    change: Callable[[Walk], tuple[StreamSpec, Walk]],
    operator: type[InertialContacts | AccelerationContacts] = InertialContacts,
) -> tuple[Score, Score]:
    """Touch-downs and lift-offs of one foot and trial."""
    spec, walk = change(walk)
    result = run(operator(), spec, walk.seconds, walk.samples)
    down, up = Score(), Score()
    down.add(*result["touchdown"], walk.touchdown)
    up.add(*result["liftoff"], walk.liftoff)
    return down, up


def as_recorded(walk: Walk) -> tuple[StreamSpec, Walk]:
    return FOOT, walk


def turned(walk: Walk) -> tuple[StreamSpec, Walk]:
    """The sensor mounted at random."""
    q, _ = np.linalg.qr(np.random.default_rng(len(walk.seconds)).normal(size=(3, 3)))
    return FOOT, Walk(
        walk.seconds, np.hstack([walk.samples[:, :3] @ q, walk.samples[:, 3:] @ q]), walk.touchdown, walk.liftoff
    )


def reversed_(walk: Walk) -> tuple[StreamSpec, Walk]:
    """Every rate of turn with the other sign."""
    return scaled(-1.0)(walk)


def scaled(factor: float) -> Callable[[Walk], tuple[StreamSpec, Walk]]:
    def change(walk: Walk) -> tuple[StreamSpec, Walk]:
        return FOOT, Walk(walk.seconds, walk.samples * factor, walk.touchdown, walk.liftoff)

    return change


def noisy(walk: Walk) -> tuple[StreamSpec, Walk]:
    """White noise of 0.1 rad/s and an offset of 0.05 rad/s."""
    noise = np.random.default_rng(1).normal(0.05, 0.1, walk.samples.shape)
    return FOOT, Walk(walk.seconds, walk.samples + noise, walk.touchdown, walk.liftoff)


def thinned(walk: Walk) -> tuple[StreamSpec, Walk]:
    """One packet in five lost besides."""
    kept = np.random.default_rng(2).random(len(walk.seconds)) > 0.2
    return FOOT, Walk(walk.seconds[kept], walk.samples[kept], walk.touchdown, walk.liftoff)


def at_rate(rate_hz: float) -> Callable[[Walk], tuple[StreamSpec, Walk]]:
    """Resampled on straight lines."""

    def change(walk: Walk) -> tuple[StreamSpec, Walk]:
        seconds = np.arange(0.0, walk.seconds[-1], 1 / rate_hz)
        samples = np.column_stack([np.interp(seconds, walk.seconds, column) for column in walk.samples.T])
        return FOOT.derive(rate_hz=rate_hz), Walk(seconds, samples, walk.touchdown, walk.liftoff)

    return change


VARIANTS: dict[str, Callable[[Walk], tuple[StreamSpec, Walk]]] = {
    "as recorded": as_recorded,
    "mounted at random": turned,
    "all signs reversed": reversed_,
    "scale x 0.8": scaled(0.8),
    "scale x 1.25": scaled(1.25),
    "noise and offset": noisy,
    "20 % more packets lost": thinned,
    "at 50 Hz": at_rate(50.0),
    "at 64 Hz": at_rate(64.0),
    "at 200 Hz": at_rate(200.0),
    "at 400 Hz": at_rate(400.0),
}


def inertial(folder: Path, console: Console) -> None:
    per_person: dict[str, tuple[Score, Score]] = {}
    for file in people(folder):
        per_person[file.stem.removeprefix("imu_voisard_")] = _sum(score(walk, as_recorded) for walk in walks(file))
    everyone = _sum(iter(per_person.values()))
    _print(console, "Foot-worn inertial sensor, person by person", {**per_person, "all": everyone})
    variants = {
        name: _sum(score(walk, change) for file in people(folder) for walk in walks(file))
        for name, change in VARIANTS.items()
    }
    _print(console, "Foot-worn inertial sensor, all persons, changed on purpose", variants)
    alone = {
        file.stem.removeprefix("imu_voisard_"): _sum(
            score(walk, as_recorded, AccelerationContacts) for walk in walks(file)
        )
        for file in people(folder)
    }
    _print(console, "Foot-worn accelerometer alone", {**alone, "all": _sum(iter(alone.values()))})


def _sum(scores: Iterator[tuple[Score, Score]]) -> tuple[Score, Score]:
    down, up = Score(), Score()
    for one, other in scores:
        down.merge(one)
        up.merge(other)
    return down, up


def _print(console: Console, title: str, rows: dict[str, tuple[Score, Score]]) -> None:
    for k, name in enumerate(("touch-down", "lift-off")):
        table = Table(title=f"{title}: {name}")
        heads = ("", "F1", "precision", "recall", "|error| ms", "median ms", "p90 ms", "decided after ms (p50/p95/max)")
        for head in heads:
            table.add_column(head, justify="left" if not head else "right")
        for row, scores in rows.items():
            table.add_row(row, *scores[k].row())
        console.print(table)


def marker_trials(folder: Path) -> Iterator[tuple[str, Array, tuple[str, ...]]]:
    """Name, markers (m, 8, 3) in mm at 100 Hz, and the markers' names, of every overground trial."""
    for file in sorted((folder / "emg").glob("emg_epfl_S*.npz")):
        with np.load(file) as data:
            names = tuple(str(name) for name in data["kin_names"])
            for key in sorted(k for k in data.files if k.startswith("T_") and k.endswith("_kin")):
                yield f"{file.stem} {key}", data[key].astype(np.float64), names


def zeni(markers: Array, foot: int, hip: int) -> tuple[Array, Array]:
    """Offline reference (Zeni 2008): extremes of the foot's place before the hip along y, filtered both ways at 10 Hz; in s."""
    from scipy.signal import butter, filtfilt, find_peaks

    path = markers[:, [foot, hip]]
    lost = (path == 0).all(axis=2)
    index = np.arange(len(path))
    y = np.column_stack([np.interp(index, index[~lost[:, i]], path[~lost[:, i], i, 1]) for i in (0, 1)])
    ahead = filtfilt(*butter(2, 10 / 50), y[:, 0] - y[:, 1]) * np.sign(y[-1, 1] - y[0, 1])
    return find_peaks(ahead, prominence=150)[0] / 100, find_peaks(-ahead, prominence=150)[0] / 100


def markers(folder: Path, console: Console) -> None:
    rows: dict[str, tuple[Score, Score]] = {}
    for label, foot, reference in (
        ("ankle and hip", "ANK", "HIP"),
        ("toe and hip", "TOE", "HIP"),
        ("ankle alone", "ANK", ""),
        ("toe alone", "TOE", ""),
    ):
        down, up = Score(), Score()
        for _, path, names in marker_trials(folder):
            spec = StreamSpec(path.shape[1:], rate_hz=100.0, channels=names, units=("mm",))
            for side in "LR":
                operator = MarkerContacts(marker=side + foot, reference=side + reference if reference else "")
                result = run(operator, spec, np.arange(len(path)) / 100.0, path)
                truth = zeni(path, names.index(side + foot), names.index(side + "HIP"))
                down.add(*result["touchdown"], truth[0], 0.15)
                up.add(*result["liftoff"], truth[1], 0.15)
        rows[label] = down, up
    _print(console, "Markers against Zeni's offline method (150 ms)", rows)


def main() -> int:
    folder = os.environ.get("KINEGRAPH_DATA")
    console = Console(width=120)
    if not folder or not people(Path(folder)):
        console.print("KINEGRAPH_DATA must name the folder that holds steps/imu_voisard_*.npz")
        return 2
    inertial(Path(folder), console)
    markers(Path(folder), console)
    return 0


if __name__ == "__main__":
    sys.exit(main())
