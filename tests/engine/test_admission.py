"""Admission, as a table: what comes, at which watermark, and what enters."""

from __future__ import annotations

from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, StreamSpec
from kinegraph.stream.engine.flow.admission import admit, conform, followed, join, ordered, soundness
from kinegraph.stream.engine.flow.promise import impossible
from kinegraph.stream.engine.supervisor import TRANSITIONS
from kinegraph.stream.errors import RunError
from kinegraph.stream.graph.backpressure import POLICIES, Policy

pytestmark = pytest.mark.quick

SPEC = StreamSpec((1,), rate_hz=1000.0)


def chunk(stamps: list[int], until: int, lost: int = 0) -> Chunk:
    return Chunk(np.array(stamps, np.int64), np.array(stamps, float).reshape(-1, 1), until, lost)


def as_lists(made: Chunk | None) -> Any:
    return None if made is None else (made.time.tolist(), made.data[:, 0].tolist(), made.until, made.lost)


def entered(stamps: list[int], until: int, lost: int = 0) -> Any:
    return as_lists(chunk(stamps, until, lost))


NO = {"has_readers": False}
TABLE = {
    "in order": (chunk([5, 6], 6), 4, 0, {}, entered([5, 6], 6), 0),
    "the first ever": (chunk([5], 5), NEVER, 0, {}, entered([5], 5), 0),
    "one late": (chunk([4, 5], 5), 4, 0, {}, entered([5], 5, 1), 1),
    "late after a gap": (chunk([4, 5], 5, 3), 4, 0, {}, entered([5], 5, 4), 1),
    "late after an unknown gap": (chunk([4, 5], 5, -1), 4, 0, {}, entered([5], 5, -1), 1),
    "all late": (chunk([2, 3], 3), 4, 0, {}, entered([], 4, 2), 2),
    "owed by a resumed session": (chunk([5], 5), 4, -1, {}, entered([5], 5, -1), 0),
    "owed, and no sample yet": (chunk([], 5), 4, -1, {}, entered([], 5), 0),
    "only time": (chunk([], 9), 4, 0, {}, entered([], 9), 0),
    "no news": (chunk([], 4), 4, 0, {}, None, 0),
    "a watermark that would go back": (chunk([], 3, 2), 4, 0, {}, entered([], 4, 2), 0),
    "only time, without readers": (chunk([], 9), 4, 0, NO, None, 0),
    "a sample, without readers": (chunk([5], 9), 4, 0, NO, entered([5], 9), 0),
    "a gap, without readers": (chunk([], 9, 1), 4, 0, NO, entered([], 9, 1), 0),
    "the end, without readers": (chunk([], FOREVER), 4, 0, NO, entered([], FOREVER), 0),
    "the end twice": (chunk([], FOREVER), FOREVER, 0, {}, None, 0),
}


FOLLOWED = {
    "data of years ago": (chunk([9], 9), NEVER, 4, entered([4], 4)),
    "data ahead of the clock": (chunk([9], 9), 4, 20, entered([20], 20)),
    "two words between two data": (chunk([9], 9), 20, 20, entered([21], 21)),
    "no sample": (chunk([], 9), 4, 20, entered([], 20)),
    "no sample, and no data": (chunk([], 9), 20, 20, entered([], 20)),
    "the end": (chunk([], FOREVER), 4, 20, entered([], FOREVER)),
}


@pytest.mark.parametrize("case", FOLLOWED)
def test_a_word_is_stamped_by_the_data_and_never_late(case: str) -> None:
    given, watermark, newest, (times, _, until, lost) = FOLLOWED[case]
    made = followed(given, watermark, newest)
    assert (made.time.tolist(), made.until, made.lost) == (times, until, lost)
    assert made.data.tolist() == given.data.tolist()
    assert admit(made, watermark, 0, 0, has_readers=True, checks_clock=False).late == 0


@pytest.mark.parametrize("case", TABLE)
def test_what_enters(case: str) -> None:
    given, watermark, pending_gap, options, expected, late = TABLE[case]
    before = as_lists(given)
    verdict = admit(given, watermark, pending_gap, arrival=0, **{"has_readers": True, "checks_clock": False, **options})
    assert (as_lists(verdict.chunk), verdict.late) == (expected, late)
    assert as_lists(given) == before, "what a source gave is left as it is"
    again = admit(given, watermark, pending_gap, arrival=0, **{"has_readers": True, "checks_clock": False, **options})
    assert as_lists(again.chunk) == expected


@pytest.mark.parametrize(
    ("until", "checks_clock", "ahead_ns"), [(NS, True, 0), (3 * NS, True, 3 * NS), (3 * NS, False, 0)]
)
def test_stamps_ahead_of_the_clock_are_reported(until: int, checks_clock: bool, ahead_ns: int) -> None:
    assert admit(chunk([until], until), 0, 0, 0, has_readers=True, checks_clock=checks_clock).ahead_ns == ahead_ns


@pytest.mark.parametrize(
    ("stamps", "until", "kept", "complete", "dropped"),
    [
        ([1, 2, 3], 3, [1, 2, 3], 3, 0),
        ([1, 2, 3], 1, [1, 2, 3], 3, 0),
        ([1, 5, 3, 4, 6], 9, [1, 5, 6], 9, 2),
        ([2, 2], 2, [2, 2], 2, 0),
        ([*range(100), 7], 0, [*range(100)], 99, 1),
        ([], 4, [], 4, 0),
    ],
)
def test_time_that_runs_backwards(stamps: list[int], until: int, kept: list[int], complete: int, dropped: int) -> None:
    made, count = ordered(chunk(stamps, until))
    assert (made.time.tolist(), made.until, count) == (kept, complete, dropped)


def test_arrays_of_other_kinds_are_converted_and_others_left_alone() -> None:
    right = chunk([1, 2], 2)
    assert conform(SPEC, right) is right
    made = conform(SPEC, Chunk([1, 2], [[1], [2]], 2))  # type: ignore[arg-type]
    assert as_lists(made) == as_lists(right) and made.data.dtype == np.float64 and made.time.dtype == np.int64


def other(**changes: Any) -> Chunk:
    """A sound chunk of two samples, but for what is changed."""
    right = chunk([1, 2], 2)
    return Chunk(**{"time": right.time, "data": right.data, "until": 2, "lost": 0} | changes)


UNSOUND = {
    "times in a list": other(time=[1, 2]),
    "samples in a list": other(data=[[1.0], [2.0]]),
    "stamps of another type": other(time=np.array([1, 2], np.int32)),
    "samples of another type": other(data=np.array([[1], [2]], np.int16)),
    "another shape": other(data=np.zeros((2, 2))),
    "fewer samples than stamps": other(data=np.zeros((1, 1))),
    "time runs backwards": other(time=np.array([2, 1])),
    "stamps with gaps in memory": other(time=np.array([1, 0, 2, 0])[::2]),
    "complete before its last sample": other(until=1),
    "lost less than nothing": other(lost=-2),
    "lost more than anybody": other(lost=2**60),
    "a stamp that cannot be": other(time=np.array([-(2**63), 2])),
    "an end that cannot be": other(until=2**62),
}


@pytest.mark.parametrize("case", UNSOUND)
def test_what_is_not_sound_is_seen(case: str) -> None:
    is_sound = soundness(SPEC)
    assert not is_sound(UNSOUND[case])
    assert is_sound(other())  # and what is sound still is
    assert not is_sound(UNSOUND[case])


@given(
    stamps=st.lists(st.integers(-9, 9) | st.integers(-(2**63), 2**63 - 1), max_size=5),
    until=st.integers(-9, 20) | st.integers(-(2**63), 2**63 - 1),
    lost=st.integers(-3, 3),
)
def test_what_is_sound_needs_nothing(stamps: list[int], until: int, lost: int) -> None:
    """The short look never passes what the long one would change or refuse."""
    made = chunk(stamps, until, lost)
    if soundness(SPEC)(made):
        assert conform(SPEC, made) is made and ordered(made) == (made, 0) and not impossible(made)


class Before:
    """A full queue that notes what a policy has it do."""

    name, limit = "board.out", 3

    def __init__(self, closed: bool) -> None:
        self.closed = closed
        self.done: list[str] = []

    def wait_for_room(self) -> None:
        self.done.append("waited")

    def replace_oldest(self, chunk: Chunk, arrival: int) -> bool:
        self.done.append(f"dropped the oldest for {as_lists(chunk)} of {arrival}")
        return True


@pytest.mark.parametrize(
    ("policy", "closed", "does", "in_place_of_another"),
    [
        ("block", False, ["waited"], False),
        ("block", True, ["waited"], False),  # which a closed queue does not
        ("drop_oldest", False, ["dropped the oldest for ([1], [1.0], 1, 0) of 7"], True),
        ("drop_oldest", True, [], False),
    ],
)
def test_backpressure(policy: Policy, closed: bool, does: list[str], in_place_of_another: bool) -> None:
    queue = Before(closed)
    assert POLICIES[policy](queue, chunk([1], 1), 7) is in_place_of_another
    assert queue.done == does


def test_a_full_queue_whose_policy_is_to_fail() -> None:
    with pytest.raises(RunError, match=r"the queue of board\.out is full \(3 chunks\) and its policy is 'fail'"):
        POLICIES["fail"](Before(closed=False), chunk([1], 1), 7)


def test_every_policy_that_a_graph_may_say_is_there() -> None:
    assert POLICIES.keys() == set(get_args(Policy))


def test_every_state_of_a_source_leads_to_an_end() -> None:
    states = set(TRANSITIONS)
    assert {after for events in TRANSITIONS.values() for after in events.values()} <= states
    for state in states - {"ended", "stopped"}:
        assert TRANSITIONS[state]["stop"] == "stopped" and TRANSITIONS[state]["failed"] == "failed"
    assert TRANSITIONS["ended"] == {}


EVENT = np.dtype([("onset", "<i8"), ("size", "<f4", (2,))])


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("dtype", [np.float32, np.uint16, np.bool_, np.complex128, ">f8", "M8[ns]", "<U2", EVENT])
def test_chunks_of_any_kind_are_joined_into_memory_of_their_own(dtype: Any, stride: int) -> None:
    random = np.random.default_rng(4)
    given = [random.integers(0, 255, (3, 64), np.uint8).astype("<i8").astype("<U2") if dtype == "<U2" else
             np.frombuffer(random.integers(0, 2, (3, 64), np.uint8).tobytes() * np.dtype(dtype).itemsize, dtype).reshape(3, -1)
             for _ in range(3)]  # fmt: skip
    chunks = [Chunk(np.arange(3) + 3 * i, data[:, ::stride], 3 * i + 2) for i, data in enumerate(given)]
    made = join(chunks)
    assert made.data.dtype == np.dtype(dtype) and (made.until, made.lost) == (8, 0)
    assert made.data.tobytes() == b"".join(one.data.tobytes() for one in chunks)
    assert made.time.tolist() == list(range(9))
    assert (
        made.data.flags.c_contiguous
        and made.data.flags.writeable
        and not any(np.may_share_memory(made.data, one.data) for one in chunks)
    )
