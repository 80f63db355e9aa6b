"""What the conformance test makes of a case: how many samples lack before it starts again, and how a cutting is described."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.laws.case_samples import CaseSamples, _missing
from kinegraph.stream.laws.chunking import describe


def pieces(sizes: list[int], lost: int = 0) -> list[tuple[str, Chunk]]:
    made = [("in", Chunk(np.arange(n), np.zeros((n, 1)), n)) for n in sizes]
    made[0][1].lost = lost
    return made


@pytest.mark.parametrize(
    ("sizes", "lost", "expected"),
    [
        ([7, 7, 7, 1], 0, "'in': 3x7 1"),
        ([1], 0, "'in': 1"),
        ([12, 0, 40, 40], 3, "'in': (lost 3)12 0 2x40"),
        ([k % 2 for k in range(30)], 0, "'in': " + " ".join(str(k % 2) for k in range(30))),
        ([k % 2 for k in range(31)], 0, "'in': " + " ".join(["0 1"] * 10) + " ... (6 more) ... 0 1 0 1 0"),
    ],
)
def test_a_cutting_is_described_on_one_line(sizes: list[int], lost: int, expected: str) -> None:
    assert describe(pieces(sizes, lost)) == expected


@pytest.mark.parametrize(("later_s", "lacking"), [(1.0, 0), (1.01, 1), (1.5, 50), (1.004, -1)])
def test_a_regular_stream_that_starts_again_lacks_the_samples_between(later_s: float, lacking: int) -> None:
    """100 samples at 100 Hz from 0 to 0.99 s: the next one is due at 1 s."""
    time = np.arange(100) * NS // 100
    tape = CaseSamples(StreamSpec((1,), rate_hz=100.0), time, np.zeros((100, 1)), np.zeros(100, np.int64))
    assert _missing(tape, round(later_s * NS)) == lacking
    assert _missing(CaseSamples(StreamSpec((1,)), time, tape.data, tape.lost), round(later_s * NS)) == 0
