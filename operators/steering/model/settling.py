"""Parts that come to fit: placed in turn by their borders, shapes moved against neighbours and markers (thesis 9.4.1, 9.4.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from kinegraph.operators.steering.model.assemble_kernel import columns
from kinegraph.operators.steering.model.part import Part
from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import record
from kinegraph.stream.kernel import kernel

ROUNDS = 3
"""How often places and shapes take turns: the thesis's "few iterations"."""
MOST = 0.05
"""A marker draws a shape no farther than this, in diagonals."""
STIFF = 1e-6
"""A coefficient that moves vertices by less, in diagonals, stays as predicted."""
BETAS, MARKED = (0.001, 0.003, 0.01, 0.03, 0.1, 0.3), (0.0, 1.0, 10.0, 100.0)


@dataclass(frozen=True, slots=True)
class SoftShapes:
    """How shapes are moved (9.14): `beta`, here as its root and in diagonals of the mesh, and by how many vertices of a border a marked
    one counts."""

    beta: float = 0.03
    marked: float = 1.0


def offered() -> list[SoftShapes]:
    return [SoftShapes(beta, marked) for beta, marked in product(BETAS, MARKED)]


@record
@dataclass(frozen=True, slots=True)
class Borders:
    """What kernels read of a `Settling`, under the same names."""

    turns: Array
    begins: Times
    others: Times
    own: Samples
    theirs: Samples
    weights: Samples
    solve: Samples


@dataclass(frozen=True, slots=True)
class Settling:
    """What holds parts together. A row is a vertex of a part that another part has too, or that a marker stands for.

    greedy         whether parts are placed by their borders
    turns    (p,)  which parts are turned by them as well: those of the body
    begins   (p + 1,)  where the rows of each part begin
    others   (n,)  the other part; -1 - m for marker m
    own, theirs (n, 1 + k, 3)  where the vertex is at the mean shape, and how each coefficient of the shape moves it, in this part and in
                   the other one
    weights  (n,)  how much it counts
    spread   (p, k)  variances of the coefficients in the training; 0 for a mode that a part does not have
    solve    (p, k, k) of 9.14; (0, 0, 0) where shapes stay as predicted
    most     m     how far a marker draws at most
    shapes         how shapes are moved; None: not
    """

    greedy: bool
    turns: Array
    begins: Times
    others: Times
    own: Samples
    theirs: Samples
    weights: Samples
    spread: Samples
    solve: Samples
    most: float
    shapes: SoftShapes | None = None

    @staticmethod
    def of(
        parts: Sequence[Part],
        clusters: Sequence[int],
        limbs: Sequence[str | None],
        marked: Times,
        spread: Sequence[Samples],
        greedy: bool,
    ) -> Settling:
        """What holds `parts` together, in the order in which they are to be placed.

        clusters  of which cluster of the mesh each is: a shared one is there once for every limb, and touches but its own limb and the body
        limbs     of which limb each is; None: of the body   marked (m,) the markers' vertices   spread  each part's variances
        """
        k = max(len(part.modes) for part in parts)
        body = [limb is None for limb in limbs]
        begins, rows = [0], list[tuple[int, Samples, Samples]]()
        for a, part in enumerate(parts):
            for b, other in enumerate(parts):
                copies = clusters.count(clusters[a]) > 1 or clusters.count(clusters[b]) > 1
                if clusters[a] == clusters[b] or (copies and not (body[a] or body[b] or limbs[a] == limbs[b])):
                    continue
                _, mine, its = np.intersect1d(part.vertices, other.vertices, assume_unique=True, return_indices=True)
                rows += [(b, *both) for both in zip(_moves(part, mine, k), _moves(other, its, k), strict=True)]
            for m, vertex in enumerate(marked):
                here = np.flatnonzero((part.vertices == vertex) & (part.weights > 0.0))
                rows += [(-1 - m, one, np.zeros((1 + k, 3))) for one in _moves(part, here, k)]
            begins.append(len(rows))
        variances = np.zeros((len(parts), k))
        for a, one in enumerate(spread):
            variances[a, : len(one)] = one
        return Settling(
            greedy,
            np.array(body) & (not all(body)),
            np.array(begins, np.int64),
            np.array([row[0] for row in rows], np.int64),
            np.array([row[1] for row in rows]).reshape(-1, 1 + k, 3),
            np.array([row[2] for row in rows]).reshape(-1, 1 + k, 3),
            np.ones(len(rows)),
            variances,
            np.zeros((0, 0, 0)),
            0.0,
        )

    def by(self, shapes: SoftShapes, diagonal: float) -> Settling:
        """The same with shapes that are moved: of 9.14 all that does not depend on the frame."""
        weights = np.where(self.others < 0, shapes.marked, 1.0)
        solve = np.zeros((*self.spread.shape, self.spread.shape[1]))
        for a in range(len(solve)):
            has = np.flatnonzero(self.spread[a] > (STIFF * diagonal) ** 2)
            rows = slice(self.begins[a], self.begins[a + 1])
            moves = self.own[rows][:, 1 + has]
            square = np.einsum("n,nki,nli->kl", weights[rows], moves, moves)
            square += np.diag((shapes.beta * diagonal) ** 2 / self.spread[a][has])
            solve[a][np.ix_(has, has)] = np.linalg.inv(square)
        return replace(self, weights=weights, solve=solve, most=MOST * diagonal, shapes=shapes)

    @property
    def borders(self) -> Borders:
        """For kernels."""
        return Borders(self.turns, self.begins, self.others, self.own, self.theirs, self.weights, self.solve)

    def without_markers(self) -> Settling:
        """The same for markers that lie on another body: borders alone move the shapes."""
        if self.shapes is None:
            return self
        return self.by(SoftShapes(self.shapes.beta, 0.0), self.most / MOST)

    def __call__(self, predicted: Sequence[Samples], marks: Samples, share: float) -> list[Samples]:
        """Predictions of all parts, (9 + modes,) each, brought to fit; markers `marks` (m, 3) draw shapes by `share`."""
        y = np.zeros((len(predicted), 9 + self.spread.shape[1]))
        for a, one in enumerate(predicted):
            y[a, : len(one)] = one
        settle(y, np.ascontiguousarray(marks), share, self.greedy, self.borders, self.most, ROUNDS)
        return [y[a, : len(one)] for a, one in enumerate(predicted)]


def _moves(part: Part, rows: Times, most: int) -> Samples:
    """Where vertices of a part are, and how each coefficient moves them, (n, 1 + most, 3)."""
    made = np.zeros((len(rows), 1 + most, 3))
    made[:, 0] = part.mean[rows]
    shapes = part.modes.reshape(len(part.modes), -1, 3)[:, rows] * np.sqrt(len(part.vertices))
    made[:, 1 : 1 + len(shapes)] = shapes.transpose(1, 0, 2)
    return made


@kernel
def point(moves: Samples, y: Samples, out: Samples) -> None:
    """A vertex `out` (3,) of `moves` (1 + k, 3) at the coefficients y[9:]."""
    for i in range(3):
        out[i] = moves[0, i]
        for m in range(y.shape[0] - 9):
            out[i] += y[9 + m] * moves[1 + m, i]


@kernel
def put_point(moves: Samples, y: Samples, turn: Samples, room: Samples, out: Samples) -> None:
    """The same where the part is: turned and moved."""
    point(moves, y, room)
    for i in range(3):
        out[i] = turn[i, 0] * room[0] + turn[i, 1] * room[1] + turn[i, 2] * room[2] + y[6 + i]


@kernel
def settle(y: Samples, marks: Samples, share: float, greedy: bool, borders: Borders, most: float, rounds: int) -> None:
    """Bring the predictions of all parts `y` (p, 9 + k) to fit, by a `Settling`; markers `marks` (m, 3) draw shapes by `share`."""
    p = y.shape[0]
    predicted = y.copy()
    turns, room = np.empty((p, 3, 3)), np.empty((3, 3))
    for a in range(p):
        columns(y[a], turns[a])
    shaped = rounds if borders.solve.shape[0] else 0
    for again in range(shaped + 1):
        for a in range(1, p if greedy else 0):
            place_by_border(a, y, turns, borders, room)
        for a in range(p if again < shaped else 0):
            shape_by_neighbours(a, y, predicted[a], turns, marks, share, borders, most, room)


@kernel
def place_by_border(a: int, y: Samples, turns: Samples, borders: Borders, room: Samples) -> None:
    """Move part `a` to its border with the parts placed before it, and turn it if it may be turned (9.4.1); `room` (3, 3)."""
    mine, there, work = room[0], room[1], room[2]
    begins, others, own, theirs = borders.begins, borders.others, borders.own, borders.theirs
    n, mean, target = 0, np.zeros(3), np.zeros(3)
    for row in range(begins[a], begins[a + 1]):
        if 0 <= others[row] < a:
            point(own[row], y[a], mine)
            put_point(theirs[row], y[others[row]], turns[others[row]], work, there)
            n += 1
            mean += mine
            target += there
    if n == 0:
        return
    mean /= n
    target /= n
    if borders.turns[a] and n > 2:
        spread = np.zeros((3, 3))
        for row in range(begins[a], begins[a + 1]):
            if 0 <= others[row] < a:
                point(own[row], y[a], mine)
                put_point(theirs[row], y[others[row]], turns[others[row]], work, there)
                for i in range(3):
                    for j in range(3):
                        spread[i, j] += (mine[i] - mean[i]) * (there[j] - target[j])
        u, _, vt = np.linalg.svd(spread)
        sign = 1.0 if np.linalg.det(u) * np.linalg.det(vt) > 0.0 else -1.0
        for i in range(3):
            for j in range(3):
                turns[a, i, j] = u[j, 0] * vt[0, i] + u[j, 1] * vt[1, i] + sign * u[j, 2] * vt[2, i]
    for i in range(3):
        y[a, i], y[a, 3 + i] = turns[a, i, 0], turns[a, i, 1]
        y[a, 6 + i] = target[i] - (turns[a, i, 0] * mean[0] + turns[a, i, 1] * mean[1] + turns[a, i, 2] * mean[2])


@kernel
def shape_by_neighbours(
    a: int, y: Samples, predicted: Samples, turns: Samples, marks: Samples, share: float, borders: Borders, most: float, room: Samples
) -> None:  # fmt: skip
    """Move the shape of part `a` from what was `predicted` (9 + k,) towards neighbours and markers (9.14); room (3, 3)."""
    mine, there, work = room[0], room[1], room[2]
    begins, others, own, theirs = borders.begins, borders.others, borders.own, borders.theirs
    solve, k = borders.solve[a], y.shape[1] - 9
    found = np.zeros(k)
    for row in range(begins[a], begins[a + 1]):
        if others[row] >= 0:
            put_point(theirs[row], y[others[row]], turns[others[row]], work, there)
        else:
            there[:] = marks[-1 - others[row]]
        point(own[row], predicted, mine)
        far = 0.0
        for i in range(3):
            work[i] = -mine[i]
            for j in range(3):
                work[i] += turns[a, j, i] * (there[j] - y[a, 6 + j])
            far += work[i] * work[i]
        scale = borders.weights[row]
        if others[row] < 0:
            scale *= share * min(1.0, most / max(np.sqrt(far), 1e-12))
        for m in range(k):
            for i in range(3):
                found[m] += scale * own[row, 1 + m, i] * work[i]
    for m in range(k):
        y[a, 9 + m] = predicted[9 + m]
        for q in range(k):
            y[a, 9 + m] += solve[m, q] * found[q]
