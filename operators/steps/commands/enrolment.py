"""How often a forest of persons accepts strangers and rejects people it knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.steps.commands.validation import Labelled, forest
from kinegraph.operators.steps.step_kernel import chosen
from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.errors import KinegraphError


@dataclass(frozen=True, slots=True)
class Enrolment:
    """known: the share of known people's left-out walks that were given the right name, threshold aside; threshold: of the mean probability
    of the likeliest; false_accept: of strangers' walks that were taken for somebody, by the threshold of the other strangers; false_reject:
    of known people's walks that were taken for a stranger or another person; strangers, walks: how many walks of each."""

    known: float
    threshold: float
    false_accept: float
    false_reject: float
    strangers: int
    walks: int


def enrolment(given: Labelled, features: str, trees: int, accept: float = 0.05) -> Enrolment:
    """Leave out every person (a stranger), and every walk of the others; the threshold accepts at most `accept` of strangers' walks."""
    columns, people = chosen(features), np.unique(given.persons)
    if any(len(np.unique(given.walks[given.persons == p])) < 2 for p in people):
        raise KinegraphError("every enrolled person must have two recordings at least: one is left out to try it")
    x, strangers, known = given.features[:, columns], list[list[float]](), list[tuple[float, bool]]()
    for person in people:
        here = given.persons == person
        trained = forest(trees).fit(x[~here], given.persons[~here])
        strangers.append([float(p.max()) for p in _walks(trained.predict_proba(x[here]), given.walks[here])])
    order = np.concatenate([np.unique(given.walks[given.persons == p], return_inverse=True)[1] for p in people])
    at = np.concatenate([np.flatnonzero(given.persons == p) for p in people])
    turn = np.empty(len(order), np.int64)
    turn[at] = order
    for k in range(int(turn.max()) + 1):
        left = turn == k
        trained = forest(trees).fit(x[~left], given.persons[~left])
        walks = np.unique(given.walks[left])
        for walk, p in zip(walks, _walks(trained.predict_proba(x[left]), given.walks[left]), strict=True):
            true = given.persons[given.walks == walk][0]
            known.append((float(p.max()), bool(trained.classes_[p.argmax()] == true)))
    threshold = _beyond(strangers, accept)
    accepted = float(
        np.mean(
            [s >= _beyond(strangers[:k] + strangers[k + 1 :], accept) for k, own in enumerate(strangers) for s in own]
        )
    )
    rejected = float(np.mean([not right or score < threshold for score, right in known]))
    return Enrolment(
        float(np.mean([right for _, right in known])),
        threshold,
        accepted,
        rejected,
        sum(map(len, strangers)),
        len(known),
    )


def _walks(probability: Samples, walks: Array) -> list[Samples]:
    """The mean probabilities of each walk."""
    return [np.asarray(probability[walks == walk].mean(axis=0)) for walk in np.unique(walks)]


def _beyond(strangers: list[list[float]], accept: float) -> float:
    """The score that at most the share `accept` of the strangers' scores reaches."""
    scores = np.sort(np.concatenate(strangers))
    return float(scores[min(int(np.ceil((1 - accept) * len(scores))), len(scores) - 1)]) + 1e-9
