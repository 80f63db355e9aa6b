"""The sets and repetitions of a training session, as they are reported: what a report is made from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.outlets.terminal.exercise_screen import DOUBTED
from kinegraph.stream.chunk import NEVER, NS, Array, Samples

MAX_SETS, MAX_REPETITIONS, MAX_RESTS, MAX_WORDS = 500, 20_000, 2000, 500
"""Of a longer session this many rows are kept, the first ones; the rest are counted, and the CSV file has them all. Names and
features beyond the first MAX_WORDS are left blank."""
MAX_LETTERS = 24
WALKING = "walking"
"""What operators.segmentation.names.naming calls it."""
REPETITION = np.dtype(
    [
        ("activity", "<i8"), ("repetition", "<i4"), ("onset", "<i8"), ("duration_s", "<f4"), ("range", "<f4"),
        ("distance", "<f4"), ("symmetry", "<f4"), ("sure", "<f4"), ("name", "<i2"), ("moves", "<i2"),
    ]
)  # fmt: skip
"""As it is kept, in few bytes: names by their place among the words."""
TEXTS = ("name", "moves")
SET = np.dtype(
    [
        ("activity", "<i8"),
        ("onset", "<i8"),
        ("end", "<i8"),
        ("repetitions", "<i4"),
        ("symmetry", "<i4"),
        ("cluster", "<i8"),
        ("certainty", "<f8"),
    ]
)
REST = np.dtype([("onset", "<i8"), ("end", "<i8")])


@dataclass(slots=True)
class Training:
    """sets, repetitions, rests, words: what has come, in order, the first `n_...` of each. began, ended: ns; left_out: how many more."""

    sets: Array
    repetitions: Array
    rests: Array
    words: Array
    n_sets: int = 0
    n_repetitions: int = 0
    n_rests: int = 0
    n_words: int = 0
    began: int = NEVER
    ended: int = NEVER
    left_out: int = 0


def nothing_done() -> Training:
    rows = (np.zeros(MAX_SETS, SET), np.zeros(MAX_REPETITIONS, REPETITION), np.zeros(MAX_RESTS, REST))
    return Training(*rows, np.zeros(MAX_WORDS, f"<U{MAX_LETTERS}"))


def take(training: Training, kind: str, event: Any) -> None:
    """Keep an event of `kind` (sets, repetitions, rests), if there is room, and room for the set that it belongs to."""
    table = getattr(training, kind)
    n = getattr(training, f"n_{kind}")
    if n == len(table) or (kind == "repetitions" and _beyond(training, event)):
        training.left_out += 1
        return
    for field in table.dtype.names or ():
        value = event[field]
        table[n][field] = _place(training, str(value)[:MAX_LETTERS]) if field in TEXTS else value
    setattr(training, f"n_{kind}", n + 1)


def _beyond(training: Training, event: Any) -> bool:
    """Whether no more sets are kept, and this repetition belongs to another one."""
    return training.n_sets == len(training.sets) and bool(event["activity"] > training.sets["activity"][-1])


def _place(training: Training, word: str) -> int:
    """Where it stands among the words, from now on; -1: blank, or there are too many."""
    known = training.words[: training.n_words]
    if len(found := np.flatnonzero(known == word)):
        return int(found[0])
    if not word or training.n_words == len(training.words):
        return -1
    training.words[training.n_words] = word
    training.n_words += 1
    return training.n_words - 1


@dataclass(frozen=True, slots=True)
class Exercise:
    """One set, as the report shows it. Times in s; NaN: not known. durations, ranges, distances: one number per repetition. start_s: of
    the first repetition, before which the set may begin with a rest.

    name: with a question mark where it is hardly sure; partial: repetitions that go much less far than the set's median, and are not among
    `repetitions`; tempo: repetitions a minute; even: how much the durations scatter, in per cent,
    without the last one if a rest follows, as a movement that fades away looks shorter than it is; rest_s: after the set; alike: how alike
    left and right move, 0 to 1; doubtful: chance might have made these repetitions; starts: of the repetitions, from the session's start
    """

    number: int
    name: str
    start_s: float
    repetitions: int
    partial: int
    tempo: float
    even: float
    rest_s: float
    symmetry: str
    moves: str
    durations: tuple[float, ...]
    ranges: tuple[float, ...]
    distances: tuple[float, ...]
    starts: tuple[float, ...]
    alike: float
    doubtful: bool


SYMMETRY = {0: "", 1: "both sides at once", 2: "sides in turn", 3: "one side, or unlike"}


def exercises(training: Training, full_share: float) -> list[Exercise]:
    """The sets of a session, with their repetitions; what does not repeat is no set, nor is walking.

    A repetition is partial if its range is less than `full_share` of its set's median.
    """
    sets, all_, rests = training.sets[: training.n_sets], training.repetitions[: training.n_repetitions], training.rests
    made: list[Exercise] = []
    for k, one in enumerate(sets):
        mine = all_[all_["activity"] == one["activity"]]
        name = _called(training, mine)
        if name == WALKING:
            continue
        spans = whole_repetitions(mine)
        durations = spans["duration_s"]
        middle = (rests["onset"][: training.n_rests] + rests["end"][: training.n_rests]) / 2.0
        here = rests[: training.n_rests][(middle > _last(one, spans)) & (middle < _next(sets, k, all_))]
        mean = float(durations.mean(dtype=np.float64)) if len(durations) else np.nan
        partial = int((spans["range"] < full_share * np.median(spans["range"])).sum()) if len(spans) else 0
        made.append(
            Exercise(
                len(made) + 1,
                name or f"exercise {one['cluster'] + 1}",
                float((spans["onset"][0] if len(spans) else one["onset"]) - training.began) / NS,
                int(one["repetitions"]) - partial,
                partial,
                60.0 / mean if mean > 0.0 else np.nan,
                _unevenness(durations[:-1] if len(here) else durations),
                float((here["end"] - here["onset"]).sum()) / NS if len(here) else np.nan,
                SYMMETRY.get(int(one["symmetry"]), ""),
                _most_often(training, mine["moves"]),
                tuple(map(float, durations)),
                tuple(map(float, spans["range"])),
                tuple(map(float, spans["distance"])),
                tuple(((spans["onset"] - training.began) / NS).tolist()),
                float(np.nanmean(spans["symmetry"])) if np.isfinite(spans["symmetry"]).any() else np.nan,
                bool(one["certainty"] <= 0.0),
            )
        )
    return made


def _called(training: Training, mine: Array) -> str:
    """The name that most repetitions of a set bear, with a question mark where they are hardly sure of it."""
    name = _most_often(training, mine["name"])
    sure = mine["sure"][mine["name"] == _place(training, name)] if name else np.zeros(0)
    return f"{name}?" if len(sure) and 0.0 < float(np.median(sure)) < DOUBTED else name


def _unevenness(durations: Samples) -> float:
    """How much durations scatter, in per cent of their mean; NaN: there are fewer than three."""
    return (
        100.0 * float(durations.std() / durations.mean()) if len(durations) > 2 and durations.mean() > 0.0 else np.nan
    )


def _last(one: Any, spans: Array) -> float:
    """When the last repetition of a set ended, ns; the set itself may end with a rest, and the next one begin with it."""
    return float(spans["onset"][-1] + spans["duration_s"][-1] * NS) if len(spans) else float(one["end"])


def _next(sets: Array, k: int, all_: Array) -> float:
    """When the first repetition of the set after number k began, ns."""
    if k + 1 >= len(sets):
        return np.inf
    starts = all_["onset"][all_["activity"] == sets["activity"][k + 1]]
    return float(starts.min() if len(starts) else sets["onset"][k + 1])


def whole_repetitions(rows: Array) -> Array:
    """One row per repetition: of two steps the durations add up, the range is the larger, the distance the mean."""
    made = rows[:0].copy()
    for number in dict.fromkeys(rows["repetition"].tolist()):
        steps = rows[rows["repetition"] == number]
        row = steps[:1].copy()
        row["duration_s"], row["range"], row["distance"], row["symmetry"] = (
            steps["duration_s"].sum(), steps["range"].max(), steps["distance"].mean(), steps["symmetry"][-1],
        )  # fmt: skip
        made = np.concatenate([made, row])
    return made


def _most_often(training: Training, places: Array) -> str:
    """The word at most of these places; of equals the first."""
    known = [int(place) for place in places if place >= 0]
    return str(training.words[max(dict.fromkeys(known), key=known.count)]) if known else ""
