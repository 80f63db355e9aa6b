"""What the conformance test makes of a case: how many samples lack before it starts again, and how a cutting is described."""

from __future__ import annotations

import numpy as np
import pytest

from operators.pause import Pause
from operators.rectify import Rectify
from stream.chunk import NS, Chunk, StreamSpec
from stream.conformance.case_samples import CaseSamples, _missing, with_faults
from stream.conformance.cut import describe
from stream.conformance.play import row_of


def pieces(sizes: list[int], lost: int = 0) -> list[tuple[str, Chunk]]:
    made = [("in", Chunk(np.arange(n), np.zeros((n, 1)), n)) for n in sizes]
    made[0][1].lost = lost
    return made


@pytest.mark.parametrize(
    ("sizes", "lost", "told"),
    [
        ([7, 7, 7, 1], 0, "'in': 3x7 1"),
        ([1], 0, "'in': 1"),
        ([12, 0, 40, 40], 3, "'in': (lost 3)12 0 2x40"),
        ([k % 2 for k in range(30)], 0, "'in': " + " ".join(str(k % 2) for k in range(30))),
        ([k % 2 for k in range(31)], 0, "'in': " + " ".join(["0 1"] * 10) + " ... (6 more) ... 0 1 0 1 0"),
    ],
)
def test_a_cutting_is_described_on_one_line(sizes: list[int], lost: int, told: str) -> None:
    assert describe(pieces(sizes, lost)) == told


@pytest.mark.parametrize(("later_s", "lacking"), [(1.0, 0), (1.01, 1), (1.5, 50), (1.004, -1)])
def test_a_regular_stream_that_starts_again_lacks_the_samples_between(later_s: float, lacking: int) -> None:
    """100 samples at 100 Hz from 0 to 0.99 s: the next one is due at 1 s."""
    time = np.arange(100) * NS // 100
    tape = CaseSamples(StreamSpec((1,), rate_hz=100.0), time, np.zeros((100, 1)), np.zeros(100, np.int64))
    assert _missing(tape, round(later_s * NS)) == lacking
    assert _missing(CaseSamples(StreamSpec((1,)), time, tape.data, tape.lost), round(later_s * NS)) == 0


def test_only_an_operator_with_one_input_and_an_output_is_tried_as_a_step() -> None:
    spec = StreamSpec((1,), rate_hz=100.0)
    assert row_of(Pause(), {"in": spec, "switch": spec}, {"out": spec}) is None
    assert row_of(Rectify(), {"in": spec}, {}) is None


@pytest.mark.parametrize(
    ("drawn", "told"),
    [
        ([1, 0, 0, 1, 10, 3, 0], "3 samples of 'in' missing from sample 10 on (told: 3)"),
        ([1, 0, 0, 0, 10, 3, 0], "3 samples of 'in' missing from sample 10 on (told: -1)"),
        ([1, 0, 1, 1, 10, 4, 0], "0.04 s of silence on all inputs before sample 10 of 'in'"),
        ([1, 0, 2, 1, 10, 7, 0], "1.57 s of silence on all inputs before sample 10 of 'in'"),
        ([0, 1, 0, 1, 10, 4, 0], "inf in samples 10..13 of 'in', number 0"),
    ],
)
def test_a_fault_is_what_was_drawn(drawn: list[int], told: str) -> None:
    spec = StreamSpec((1,), rate_hz=100.0)
    tapes = {"in": CaseSamples(spec, np.arange(100) * NS // 100, np.zeros((100, 1)), np.zeros(100, np.int64))}
    _, words = with_faults(lambda least, most: drawn.pop(0), tapes, 0.5)
    assert len(words) == 1 and told in words[0] and not drawn
