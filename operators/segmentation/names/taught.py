"""Exercises that somebody has shown: named repetitions, as `kinegraph motion label` keeps them, and what a repetition is called by them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinegraph.operators.segmentation.names.comparison import unlike
from kinegraph.stream.chunk import Array, Samples, StreamSpec
from kinegraph.stream.data.model_file import Model, ModelError, describe_input, read_model, write_model
from kinegraph.stream.errors import KinegraphError

KIND = "exercises"
UNKNOWN = "unknown"
MOST_LETTERS = 24
"""A name is no longer."""
MOST_NAMES = 32
"""This many exercises may be taught while a session runs."""
MOST_SHOWN = 5
"""This many repetitions of an exercise are kept."""
SAID = re.compile(r"this is\b:?\s*(\S.*)", re.IGNORECASE)
"""An annotation that names what is being done."""
LATELY_NS = 10 * 10**9
"""A name given after an exercise belongs to it, unless it ended longer ago than this."""
REACHES = 1.5
"""A repetition is of an exercise if it lies no further from those shown than REACHES times as far as they do from each other (median), or
than the radius that they were found with; and nearer than to any other exercise. By the median, one of them that is unlike the
others does not let everything pass."""


@dataclass(frozen=True, slots=True)
class Taught:
    """Repetitions by which exercises are known.

    names      of the exercises
    frames     (k, longest, features), of repetition k; beyond its length not used
    lengths    (k,)
    exercise   (k,)  which of the names it is
    reach      (names,)  how far a repetition of each may lie from those shown
    """

    names: list[str]
    frames: Samples
    lengths: Array
    exercise: Array
    reach: Samples

    @classmethod
    def read(cls, path: Path, port: str, spec: StreamSpec) -> Taught:
        """Raises ModelError, or InputError where the model was made from other features."""
        model = read_model(path, KIND, "motion label")
        model.check_input(port, spec)
        names = _names(model)
        lengths = model.array("lengths", (None,), np.int64)
        frames = np.ascontiguousarray(model.arrays.get("frames", np.empty(0)), np.float64)
        if frames.ndim != 3 or frames.shape[0] != len(lengths) or frames.shape[2] != spec.shape[0]:
            raise ModelError(
                f"{path}: array 'frames' has the shape {frames.shape}; it must be one repetition per length"
            )
        exercise = model.array("exercise", (len(lengths),), np.int64)
        reach = model.array("reach", (len(names),))
        if not len(lengths) or (lengths < 1).any() or (lengths > frames.shape[1]).any():
            raise ModelError(f"{path}: array 'lengths' must hold numbers of frames, 1 to {frames.shape[1]}")
        if (exercise < 0).any() or (exercise >= len(names)).any():
            raise ModelError(f"{path}: array 'exercise' names exercises that do not exist")
        return cls(names, frames, lengths, exercise, reach)

    def write(self, path: Path, spec: StreamSpec, source: str) -> None:
        header = {"input": describe_input(spec), "names": self.names, "source": source}
        arrays = {"frames": self.frames, "lengths": self.lengths, "exercise": self.exercise, "reach": self.reach}
        write_model(path, KIND, header, arrays)

    def distances(self, x: Samples) -> Samples:
        """How far repetition x (n, features) lies from each exercise (names,): from the nearest of its repetitions."""
        longest = self.frames.shape[1]
        far, cost = np.empty((len(x), longest)), np.empty((2, longest))
        nearest = np.full(len(self.names), math.inf)
        for k, length in enumerate(self.lengths):
            name = self.exercise[k]
            nearest[name] = min(nearest[name], unlike(x, self.frames[k, :length], far, cost))
        return nearest

    def distance_from(self, x: Samples, name: str) -> float:
        """How far repetition x (n, features) lies from the nearest one of this name; NaN if the name is unknown."""
        return float(self.distances(x)[self.names.index(name)]) if name in self.names else math.nan

    def call(self, distances: Samples) -> tuple[str, float, float]:
        """What a repetition is called, how far it lies from those shown of that name, and how sure that is, from 0 to 1.

        Sure is 1 where it is the same as one of those, 0 where it lies as far away as is allowed, or as near to another exercise.
        """
        best = int(distances.argmin())
        distance = float(distances[best])
        bound = min(float(self.reach[best]), *(d for k, d in enumerate(distances) if k != best), math.inf)
        if distance > self.reach[best]:
            return UNKNOWN, distance, 0.0
        return self.names[best], distance, (1.0 - distance / bound if bound > 0.0 else 0.0)


def grown(known: Taught | None, name: str, x: Samples, radius: float) -> Taught:
    """The model with one more repetition x (n, features) of `name`, found within `radius`; the same where enough of them are kept."""
    if known is None:
        kept: list[tuple[int, Samples]] = []
        names, reach = [name], np.zeros(1)
    else:
        kept = [(int(k), known.frames[i, : known.lengths[i]]) for i, k in enumerate(known.exercise)]
        names = known.names if name in known.names else [*known.names, name]
        reach = np.append(known.reach, np.zeros(len(names) - len(known.names)))
    mine = names.index(name)
    if known is not None and sum(k == mine for k, _ in kept) >= MOST_SHOWN:
        return known
    made = _packed(names, [*kept, (mine, x)], reach)
    made.reach[mine] = max(reach[mine], _reach([one for k, one in [*kept, (mine, x)] if k == mine], radius))
    return made


def taught(shown: Sequence[tuple[str, Sequence[Samples]]], radius: float) -> Taught:
    """The model of exercises of which these repetitions (n, features) were shown, found within `radius`. Raises KinegraphError."""
    names = [name for name, _ in shown]
    kept = [(k, one) for k, (_, all_) in enumerate(shown) for one in _spread(all_)]
    reach = np.array([_reach([one for number, one in kept if number == k], radius) for k in range(len(names))])
    if not (reach > 0.0).all():
        raise KinegraphError(
            "a single repetition was shown, and nothing says how far another may be from it; show two or more"
        )
    return _packed(names, kept, reach)


def _packed(names: list[str], kept: list[tuple[int, Samples]], reach: Samples) -> Taught:
    """`kept`: the number of a name, and a repetition of it (n, features)."""
    lengths = np.array([len(one) for _, one in kept])
    frames = np.zeros((len(kept), lengths.max(), kept[0][1].shape[1]))
    for k, (_, one) in enumerate(kept):
        frames[k, : len(one)] = one
    return Taught(names, frames, lengths, np.array([k for k, _ in kept]), reach)


def _reach(mine: list[Samples], radius: float) -> float:
    """How far another repetition may lie from these (n, features) of one name."""
    longest = max(map(len, mine))
    far, cost = np.empty((longest, longest)), np.empty((2, longest))
    between = [unlike(a, b, far, cost) for i, a in enumerate(mine) for b in mine[:i]]
    within = [d for d in between if d < math.inf]
    return max(radius, REACHES * float(np.median(within))) if within else radius


def _spread(all_: Sequence[Samples]) -> list[Samples]:
    """At most MOST_SHOWN of them, evenly spaced."""
    chosen = np.unique(np.linspace(0, len(all_) - 1, min(MOST_SHOWN, len(all_))).round().astype(int))
    return [all_[k] for k in chosen]


def fit_for_name(name: str) -> bool:
    """Whether an exercise may be called so."""
    return 0 < len(name) <= MOST_LETTERS and name != UNKNOWN and name.isprintable()


def name_in(text: str) -> str:
    """What an annotation calls the exercise: of "this is: squat" squat; "" where it says nothing of the kind."""
    found = SAID.fullmatch(text.strip())
    return found[1].strip() if found else ""


def of_what_ended(given_at: int, ended: int, begins: int, has_name: bool) -> bool:
    """Whether a name given before an exercise had `ended`, or in the pause until the next one `begins`, belongs to the former.

    In the pause it is that of the nearer one; of the next one if what ended already has a name, or ended LATELY_NS ago. Times in ns.
    """
    return given_at < ended or (not has_name and given_at - ended < min(LATELY_NS, begins - given_at))


def _names(model: Model) -> list[str]:
    names = model.header.get("names")
    if (
        not isinstance(names, list)
        or not names
        or not all(isinstance(n, str) and 0 < len(n) <= MOST_LETTERS for n in names)
    ):
        raise ModelError(f"{model.path}: the header's `names` must be texts of 1 to {MOST_LETTERS} letters")
    return [str(name) for name in names]
