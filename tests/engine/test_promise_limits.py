"""What a chunk may be, to the last nanosecond: on either side of each limit that `stream.engine.flow.promise` sets."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.engine.flow.promise import Inside, broken, ends, impossible
from kinegraph.stream.system.stalls import calm

SPEC = StreamSpec((2,), rate_hz=100.0)
END, LOST = 4_611_686_018_427_387_904, 281_474_976_710_656


def chunk(time: list[int], until: Any = 100, lost: Any = 0, data: Any = None) -> Chunk:
    made = Chunk(np.array(time, np.int64), np.zeros((len(time), 2)), 100)
    for name, value in {"until": until, "lost": lost, "data": data}.items():
        if value is not None:
            setattr(made, name, value)
    return made


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (chunk([1, 2]), ""),
        (chunk([], until=50), ""),
        (chunk([], until=49), "the watermark "),
        (chunk([], lost=-1), ""),
        (chunk([], lost=-2), "lost=-2"),
        (chunk([], lost=np.int64(3), until=np.int64(60)), ""),
        (chunk([], lost=1.0), "lost=1.0, which is no whole number"),
        (chunk([], lost=True), "lost=True, which is no whole number"),
        (chunk([], until=60.0), "until=60.0, which is no whole number"),
        (chunk([1], data=np.zeros((1, 3))), "(1, 3) float64 samples for 1 stamps; its spec promises (1, 2) float64"),
        (chunk([1], data=np.zeros((1, 2), np.float32)), "(1, 2) float32 samples"),
        (chunk([1], data=np.zeros((2, 2))), "(2, 2) float64 samples for 1 stamps"),
        (chunk([1], data=[[0.0, 0.0]]), "list samples for 1 stamps"),
    ],
)
def test_shape_type_and_watermark(given: Chunk, words: str) -> None:
    reported = broken(SPEC, given, 50)
    assert reported.startswith(words) and bool(reported) == bool(words)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (np.zeros((1, 1), np.int64), "(1, 1) int64 stamps"),
        (np.zeros(1, np.int32), "(1,) int32 stamps"),
        ([1], "list stamps"),
    ],
)
def test_stamps_are_one_row_of_int64(stamps: Any, words: str) -> None:
    given = chunk([1])
    given.time = stamps
    assert broken(SPEC, given, 50).startswith(words)


@pytest.mark.parametrize(
    ("time", "words"),
    [
        ([], ""),
        ([11], ""),
        ([10], "a sample behind its watermark"),
        ([11, 11], ""),
        ([12, 11], "stamps that run backwards"),
        ([20 + NS], ""),
        ([11, 20 + NS], ""),
        ([21 + NS], "a sample at "),
        ([11, 21 + NS], "a sample at "),
    ],
)
def test_stamps_lie_between_the_watermark_and_a_second_after_the_inputs(time: list[int], words: str) -> None:
    reported = ends(chunk(time), promised=10, reached=20)
    assert reported.startswith(words) and bool(reported) == bool(words)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (chunk([-END + 1, END - 1], until=END - 1), ""),
        (chunk([], until=-END + 1), ""),
        (chunk([0, END]), f"stamps up to {END}; "),
        (chunk([-END, 0]), f"stamps up to {END}; "),
        (chunk([], until=END), f"until={END}; "),
        (chunk([], until=-END), f"until={-END}; "),
        (chunk([], lost=LOST), ""),
        (chunk([], lost=LOST + 1), f"lost={LOST + 1}; "),
        (chunk([], lost=-1), ""),
        (chunk([], lost=-2), "lost=-2; "),
    ],
)
def test_times_that_no_device_can_mean(given: Chunk, words: str) -> None:
    reported = impossible(given)
    assert reported.startswith(words) and bool(reported) == bool(words)


@pytest.mark.parametrize(
    ("chunks", "where"),
    [
        ([[1, 1, 2], [2, 3]], None),
        ([[1, 3, 2]], 1),
        ([[1, 2], [], [1, 5]], 1),
        ([[1, 2], [4, 3], [0, 1]], 4),
        ([[3, 2, 4], [5]], 3),
    ],
)
def test_a_replay_finds_the_first_chunk_whose_stamps_run_backwards(chunks: list[list[int]], where: int | None) -> None:
    inside = Inside()
    for time in chunks:
        inside.look(chunk([t * NS for t in time]))
    assert inside.broken.endswith(f"00:00:{where:02d}.000000Z" if where is not None else "")
    assert bool(inside.broken) == (where is not None)


@pytest.fixture
def thawed() -> Iterator[None]:
    """Within: nothing is frozen; the tests' own objects are again afterwards."""
    gc.unfreeze()
    yield
    gc.freeze()


@pytest.mark.usefixtures("thawed")
def test_while_a_session_runs_garbage_is_collected_seldom_and_threads_take_short_turns() -> None:
    before = gc.get_threshold(), sys.getswitchinterval()
    gc.set_threshold(701, 11, 12)
    try:
        with calm():
            assert gc.get_threshold() == (5000, 11, 12)
            assert sys.getswitchinterval() == pytest.approx(0.0002)
            assert gc.get_freeze_count() > 0
        assert (gc.get_threshold(), sys.getswitchinterval()) == ((701, 11, 12), before[1])
        assert gc.get_freeze_count() == 0
    finally:
        gc.set_threshold(*before[0])


@pytest.mark.usefixtures("thawed")
def test_what_the_process_froze_stays_frozen_after_a_session() -> None:
    kept: list[list[object]] = [[] for _ in range(1000)]
    gc.freeze()
    with calm():
        pass
    assert gc.get_freeze_count() >= len(kept)
