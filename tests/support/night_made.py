"""A made-up night, as the graph's operators would tell it, for the night's log: epochs provisional and final, bed, breathing, a map."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.devices.reports.night import NightLog, archive
from kinegraph.stream.chunk import NS, Array, Chunk, StreamSpec

STEP = 30 * NS
LATE = 3
"""The final score comes so many epochs later."""
EVENING = 1_767_218_400 * NS  # 2025-12-31 22:00 UTC
EPOCH = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("state", "U7"),
        ("score", "<f8"),
        ("activity", "<f8"),
        ("final", "?"),
        ("rescored", "?"),
    ]
)
BED = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("state", "U7")])
SEEN = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("sleeper", "U16"),
        ("moved_s", "<f8"),
        ("seen", "<f8"),
        ("bed", "U7"),
        ("crosstalk", "<f8"),
        ("why", "U8"),
    ]
)
VIEW = np.dtype([("onset", "<i8"), ("what", "U8"), ("down", "<f8"), ("right", "<f8")])
BREATH = np.dtype(
    [("onset", "<i8"), ("end", "<i8"), ("sleeper", "U16"), ("rate", "<f8"), ("confidence", "<f8"), ("coverage", "<f8")]
)
MAP = np.dtype([("onset", "<i8"), ("end", "<i8"), ("frames", "<i8"), ("map", "<f4", (48, 64))])
MINUTES = (
    "tib",
    "tst",
    "tst_low",
    "tst_high",
    "sol",
    "sol_low",
    "sol_high",
    "waso",
    "waso_low",
    "waso_high",
    "mean_awakening",
    "longest_bout",
)
PERCENT = ("se", "se_low", "se_high", "movement", "fragmentation")
NIGHT = np.dtype(
    [("onset", "<i8"), ("end", "<i8"), ("convention", "U8"), ("bed", "U9"), ("estimated", "?"), ("awakenings", "<i8")]
    + [(name, "<f8") for name in (*MINUTES, *PERCENT)]
)
SPECS = {
    "bed": StreamSpec((), BED),
    "seen": StreamSpec((), SEEN),
    "breathing": StreamSpec((), BREATH),
    "view": StreamSpec((), VIEW),
    "lights": StreamSpec((), np.dtype([("on", "?")])),
    "map": StreamSpec((), MAP),
    "epochs": StreamSpec((), EPOCH, meta={"epoch_s": 30.0, "method": "thesis", "threshold": 0.3, "rescored": False}),
    "nights": StreamSpec((), NIGHT),
}


class Night:
    """`n` epochs; somebody is in bed from `inn` to `out`, leaves it for a while, and is not seen for ten minutes."""

    def __init__(self, n: int = 480, inn: int = 40, out: int = 460, seed: int = 5) -> None:
        rng = np.random.default_rng(seed)
        self.n, self.inn, self.out = n, inn, out
        self.gone = range(n // 2, n // 2 + 20)
        self.exit = range(n // 3, n // 3 + 12)
        asleep = np.zeros(n, np.bool_)
        for k in range(inn + 30, out - 6):
            asleep[k] = rng.random() > 0.02 if asleep[k - 1] else rng.random() < 0.15
        self.bed = np.where((np.arange(n) >= inn) & (np.arange(n) < out), "in", "out")
        self.bed[self.exit] = "out"
        asleep[self.exit] = False
        self.moved = np.where(rng.random(n) < np.where(asleep, 0.06, 0.8), rng.beta(1.2, 4, n), 0.0)
        self.moved[self.bed == "out"] = 1.0
        self.state = np.where(asleep, "sleep", "wake").astype("U7")
        self.first = np.where(rng.random(n) < 0.03, "wake", self.state)
        self.rate = 13 + 2 * np.sin(np.arange(n) / 90) + rng.normal(0, 0.4, n)
        self.rate[(self.moved > 0.1) | (self.bed == "out")] = np.nan
        self.confidence = np.clip(rng.normal(0.75, 0.15, n), 0, 1)
        for k in self.gone:
            self.state[k] = self.first[k] = "unknown"
            self.moved[k] = self.rate[k] = np.nan
            self.bed[k] = "unknown"

    def onset(self, k: int) -> int:
        return EVENING + k * STEP

    def chunks(self, begin: int = 0, end: int | None = None) -> Iterator[tuple[str, Chunk]]:
        """What the graph says at each epoch's end, in its order."""
        for k in range(begin, self.n if end is None else end):
            t, seen = self.onset(k), 0.0 if k in self.gone else 0.93
            if k == 0 or self.bed[k] != self.bed[k - 1]:
                yield "bed", event(BED, t, t, "", self.bed[k])
            moved = self.moved[k] * 30
            yield (
                "seen",
                event(SEEN, t, t, t + STEP, "", moved, seen, self.bed[k], np.nan, "unseen" if k in self.gone else ""),
            )
            yield "breathing", event(BREATH, t, t, t + STEP, "", self.rate[k], self.confidence[k], 0.6)
            yield "epochs", event(EPOCH, t, t, t + STEP, self.first[k], 0.2, self.moved[k], False, False)
            if k >= LATE:
                yield "epochs", self.final(k - LATE, t)

    def final(self, k: int, stamp: int) -> Chunk:
        return event(EPOCH, stamp, self.onset(k), self.onset(k) + STEP, self.state[k], 0.2, self.moved[k], True, False)

    def end(self) -> Iterator[tuple[str, Chunk]]:
        """The last finals, the map, and the night's numbers."""
        stamp = self.onset(self.n)
        for k in range(self.n - LATE, self.n):
            yield "epochs", self.final(k, stamp)
        y, x = np.mgrid[:48, :64]
        body = 3 * np.exp(-(((x - 30) / 14) ** 2) - ((y - 26) / 7) ** 2) + 2 * np.exp(
            -(((x - 48) / 5) ** 2) - ((y - 24) / 5) ** 2
        )
        frame = body + 0.05 * np.random.default_rng(1).gamma(2.0, 1.0, (48, 64))
        frame[:6, :9] = np.nan
        yield "map", event(MAP, stamp, self.onset(self.inn), stamp, 860_000, frame)
        here = self.state[self.inn : self.out]
        tst, lost = float((here == "sleep").sum()) / 2, float((here == "unknown").sum()) / 2
        tib = len(here) / 2
        first = int(np.flatnonzero(here == "sleep")[0])
        waso = float((here[first:] == "wake").sum()) / 2
        yield "nights", event(
            NIGHT, stamp, self.onset(self.inn), self.onset(self.out), "AASM", "detected", True, 11,
            tib, tst, tst, tst + lost, first / 2, first / 2, first / 2, waso, waso, waso + lost, 2.1, 73.5,
            100 * tst / tib, 100 * tst / tib, 100 * (tst + lost) / tib, 12.3, 21.0,
        )  # fmt: skip


def event(dtype: Any, stamp: int, *values: Any) -> Chunk:
    return Chunk(np.array([stamp]), np.array([values], dtype), stamp)


def opened(root: Path, ports: tuple[str, ...] = tuple(SPECS), **more: Any) -> NightLog:
    log = NightLog(path=str(root), timezone=more.pop("timezone", "Europe/Berlin"), **more)
    log.open({port: SPECS[port] for port in ports})
    return log


def feed(log: NightLog, reported: Iterator[tuple[str, Chunk]]) -> None:
    for port, chunk in reported:
        if port in log.runtime.specs:
            log.process(port, chunk)


def whole(root: Path, **more: Any) -> Night:
    """Write a night from its beginning to its end."""
    night, log = Night(), opened(root, **more)
    log.begin()
    feed(log, night.chunks())
    feed(log, night.end())
    log.close()
    return night


def states(night: Night, begin: int = 0) -> list[str]:
    return [str(s) for s in night.state[begin:]]


def as_array(values: Any) -> Array:
    return np.asarray(values)


def logged(folder: Path) -> list[str]:
    """The states in a night's log."""
    return [str(s) for s in archive.read_epochs(folder).texts["state"]]
