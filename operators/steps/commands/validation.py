"""How well steps tell something of people: of the same people, of people never seen, and by chance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.operators.steps.classifier import wilson
from kinegraph.operators.steps.step_kernel import chosen
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.errors import KinegraphError

SHUFFLED_STEPS = 40
DRAWS = 2000
TRIES = 3
"""As many sets of features are tried; the best of several passes a limit more easily than one."""
SETS = ("acceleration", "angular_velocity", "both")


@dataclass(frozen=True, slots=True)
class Labelled:
    """Steps (n, 50), and of each: its class, its person, and its walk (recording).

    alike   in training every class counts as much, and in it every person, however many steps there are of them
    """

    features: Samples
    labels: Array
    persons: Array
    walks: Array
    alike: bool = False

    def __post_init__(self) -> None:
        check_labelled(self)


@dataclass(frozen=True, slots=True)
class PerClass:
    """How well one class is separated from the rest; NaN where there is nothing to divide by."""

    name: str
    sensitivity: float
    specificity: float
    predictive: float


@dataclass(frozen=True, slots=True)
class Trust:
    """What a forest is worth with one set of features.

    random     accuracy with steps drawn at random: it has seen steps of the same people
    subjects   accuracy with whole people left out; per_class: of these
    majority   the share of steps in the largest class: what always saying it would reach
    least      the accuracy with people left out is at least this, but for one in 20 TRIES, when people are drawn again and again
    voted, people, low, high   people for whom most steps were right, and the 95 % interval of their share
    chance     the share of shuffles of labels among people that did at least as well (permutation test)
    probability (n, k)   of left-out people's steps, for the threshold
    """

    features: str
    random: float
    subjects: float
    majority: float
    least: float
    voted: int
    people: int
    low: float
    high: float
    chance: float
    per_class: list[PerClass]
    probability: Samples

    @property
    def verdict(self) -> str:
        better = self.least > self.majority and self.chance <= 0.05
        return "better than guessing" if better else "not better than guessing"


def check_labelled(given: Labelled) -> None:
    """Raise KinegraphError for what nothing can be learned from, or what would flatter."""
    classes, people = np.unique(given.labels), np.unique(given.persons)
    if len(classes) < 2:
        raise KinegraphError(f"all steps are of one class ({', '.join(map(str, classes))}); two at least are needed")
    if len(people) < 4:
        raise KinegraphError(f"there are {len(people)} people; leaving people out needs four at least")
    if np.isnan(given.features).all(axis=0).any():
        raise KinegraphError("a feature is missing in every step: is there angular velocity?")
    owner = dict[bytes, str]()
    for row, person in zip(given.features, given.persons, strict=True):
        before = owner.setdefault(row.tobytes(), str(person))
        if before != person:
            raise KinegraphError(
                f"{before} and {person} have a step in common to the last bit: one recording under two names?"
            )


def forest(trees: int, seed: int = 1) -> Any:
    from sklearn.ensemble import RandomForestClassifier

    return RandomForestClassifier(trees, random_state=seed, n_jobs=1)


def weights(persons: Array, labels: Array) -> Samples:
    """Of steps (n,), mean 1: every class counts as much, and in it every person."""
    made = np.empty(len(labels))
    for label in np.unique(labels):
        of = labels == label
        people, at, count = np.unique(persons[of], return_inverse=True, return_counts=True)
        made[of] = 1.0 / (len(people) * count[at])
    return np.asarray(made / made.mean())


def fitted(given: Labelled, rows: Array, columns: list[int], trees: int, labels: Array, seed: int = 1) -> Any:
    """A forest trained on these steps."""
    own = weights(given.persons[rows], labels[rows]) if given.alike else None
    return forest(trees, seed).fit(given.features[rows][:, columns], labels[rows], sample_weight=own)


def leave_out(
    given: Labelled, columns: list[int], trees: int, folds: int = 0, labels: Array | None = None, seed: int = 1
) -> Samples:
    """Probabilities (n, k) of every step by a forest that has seen nothing of its person: each left out alone, or in `folds` groups."""
    labels = given.labels if labels is None else labels
    classes, people = np.unique(labels), np.unique(given.persons)
    groups = [[p] for p in people] if not folds else [people[k::folds] for k in range(folds)]
    x, out = given.features[:, columns], np.zeros((len(labels), len(classes)))
    for group in groups:
        left = np.isin(given.persons, group)
        trained = fitted(given, ~left, columns, trees, labels, seed)
        out[np.ix_(left, np.isin(classes, trained.classes_))] = trained.predict_proba(x[left])
    return out


def trust(given: Labelled, features: str, trees: int = 60, shuffles: int = 19) -> Trust:
    """Try a set of features on steps at random, on people left out, and on labels shuffled among people."""
    from sklearn.model_selection import StratifiedKFold

    columns, classes = chosen(features), np.unique(given.labels)
    least = min(int((given.labels == c).sum()) for c in classes)
    folds = StratifiedKFold(max(min(10, least), 2), shuffle=True, random_state=1)
    x = given.features[:, columns]
    random = np.array(
        [
            fitted(given, seen, columns, trees, given.labels).score(x[rest], given.labels[rest])
            for seen, rest in folds.split(x, given.labels)
        ]
    )
    probability = leave_out(given, columns, trees)
    answers = classes[probability.argmax(axis=1)]
    people = np.unique(given.persons)
    right = [(answers == given.labels)[given.persons == p].mean() > 0.5 for p in people]
    low, high = wilson(float(sum(right)), float(len(people)))
    majority = max(float((given.labels == c).mean()) for c in classes)
    return Trust(
        features, float(random.mean()), float((answers == given.labels).mean()), majority,
        least_accuracy(answers == given.labels, given.persons), int(sum(right)), len(people), low, high,
        permutation(given, columns, shuffles), [_per_class(str(c), answers == c, given.labels == c) for c in classes], probability,
    )  # fmt: skip


def least_accuracy(right: Array, persons: Array) -> float:
    """The share of steps that are right, at least, when as many people are drawn again and again: below it in one of 20 TRIES draws."""
    people, at = np.unique(persons, return_inverse=True)
    hits, count = np.bincount(at, right), np.bincount(at)
    drawn = np.random.default_rng(1).integers(0, len(people), (DRAWS, len(people)))
    return float(np.quantile(hits[drawn].sum(axis=1) / count[drawn].sum(axis=1), 0.05 / TRIES))


def permutation(given: Labelled, columns: list[int], shuffles: int) -> float:
    """The share of shuffles of labels among people, the true order with them, that do as well as it; five groups are left out in turn.

    At most 40 steps of each person take part, in the true order and in every shuffle, spread over their walks.
    """
    given = _thinned(given, SHUFFLED_STEPS)
    people, first = np.unique(given.persons, return_index=True)
    own, index = given.labels[first], np.searchsorted(people, given.persons)
    rng, classes = np.random.default_rng(1), np.unique(given.labels)

    def accuracy(labels: Array) -> float:
        probability = leave_out(given, columns, 20, min(5, len(people)), labels)
        return float((classes[probability.argmax(axis=1)] == labels).mean())

    true = accuracy(given.labels)
    as_good = sum(accuracy(rng.permutation(own)[index]) >= true for _ in range(shuffles))
    return (1 + as_good) / (1 + shuffles)


def _thinned(given: Labelled, most: int) -> Labelled:
    """At most this many steps of each person, evenly spread."""
    kept = list[int]()
    for person in np.unique(given.persons):
        own = np.flatnonzero(given.persons == person)
        kept += np.unique(own[np.linspace(0, len(own) - 1, min(most, len(own))).astype(np.int64)]).tolist()
    at = np.sort(np.array(kept))
    return Labelled(given.features[at], given.labels[at], given.persons[at], given.walks[at], given.alike)


def uncertain_below(probability: Samples, right: Array, wanted: float) -> float:
    """The probability above which left-out people's steps are right in `wanted` of cases, at least a tenth of all; 1.01 without one."""
    best = probability.max(axis=1)
    for threshold in np.arange(0.0, 1.0, 0.02):
        sure = best >= threshold
        if sure.mean() >= 0.1 and right[sure].mean() >= wanted:
            return float(round(threshold, 2))
    return 1.01


def _per_class(name: str, answers: Array, true: Array) -> PerClass:
    def share(a: Array, of: Array) -> float:
        return float((a & of).sum() / of.sum()) if of.any() else float("nan")

    return PerClass(name, share(answers, true), share(~answers, ~true), share(true, answers))
