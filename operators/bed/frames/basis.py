"""The vectors that blocks are projected on: learned from sums over blocks, never from kept frames, a little with every frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.bed.frames.blocks import iterate, left_over
from kinegraph.stream.chunk import Samples

STEPS = 64
"""Steps of iteration until vectors are taken, one a frame."""


@dataclass(slots=True)
class Learner:
    """What a basis is learned from. n = block x block.

    sums        (n + 1, n)  over the blocks of this stretch: products, and in the last row the blocks themselves
    count       how many blocks
    covariance  (n, n)      of the stretch before, while its vectors are sought; centre (n,): its mean block, less its level
    vectors     (m, n)      what is sought; the first one is the level
    step        how many steps were made; STEPS: nothing is sought
    work        (n,)        room
    """

    sums: Samples
    count: int
    covariance: Samples
    centre: Samples
    vectors: Samples
    step: int
    work: Samples

    @staticmethod
    def of(block: int, components: int) -> Learner:
        n = block * block
        return Learner(
            np.zeros((n + 1, n)), 0, np.zeros((n, n)), np.zeros(n), np.zeros((components, n)), STEPS, np.zeros(n)
        )

    def conclude(self) -> None:
        """The stretch is over: seek its vectors, and begin another stretch."""
        n = self.centre.shape[0]
        if self.count >= n:
            self.centre[:] = self.sums[n] / self.count
            np.divide(self.sums[:n], self.count, out=self.covariance)
            self.covariance -= self.centre[:, None] * self.centre[None, :]
            self.centre -= self.centre.mean()
            self.vectors[:] = _start(*self.vectors.shape)
            self.step = 0
        self.sums[:] = 0.0
        self.count = 0

    @property
    def idle(self) -> bool:
        """Whether nothing is sought."""
        return self.step >= STEPS

    def advance(self) -> bool:
        """One step; whether it was the last."""
        if self.idle:
            return False
        iterate(self.covariance, self.vectors, self.work)
        self.step += 1
        return self.step == STEPS

    def missed(self, vectors: Samples) -> float:
        """What vectors leave over of the stretch's variance, in mm^2 per block."""
        return left_over(self.covariance, np.ascontiguousarray(vectors))


def means(block: int, components: int) -> Samples:
    """(components, block * block): vectors that let a block's mean through and nothing else."""
    vectors = np.zeros((components, block * block))
    vectors[0] = 1.0 / block
    return vectors


def _start(m: int, n: int) -> Samples:
    """The level, and vectors that no covariance is likely to be orthogonal to; the same every time."""
    vectors: Samples = np.random.default_rng(0).normal(size=(m, n)) / np.sqrt(n)
    vectors[0] = 1.0 / np.sqrt(n)
    return vectors
