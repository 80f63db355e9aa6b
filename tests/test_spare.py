"""Arrays are taken again only when nobody holds them."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np
import pytest

from operators.iir import Lowpass
from operators.rectify import Rectify
from stream.chunk import Chunk, StreamSpec
from stream.operator import Operator, grid
from stream.spare import Spare


def test_what_nobody_holds_is_taken_again() -> None:
    spare = Spare(3)
    first = id(spare.rows(5))
    assert id(spare.rows(5)) == first
    rows, stamps = (array.ctypes.data for array in spare.both(5))
    assert [array.ctypes.data for array in spare.both(5)] == [rows, stamps]


@pytest.mark.parametrize("hold", [
    lambda a: a,
    lambda a: a[:2],
    lambda a: a[2:].T,
    lambda a: a.reshape(-1),
    lambda a: memoryview(a),
    lambda a: np.frombuffer(a),
    lambda a: a.view(np.uint8),
    lambda a: Chunk(np.zeros(5, np.int64), a, 0),
    lambda a: deque([(a, 1)]),
    lambda a: a.ctypes.data_as,
    lambda a: iter(a),
    lambda a: lambda: a,
])  # fmt: skip
def test_what_somebody_holds_is_not(hold: Any) -> None:
    spare = Spare(3)
    rows = spare.rows(5)
    place, held = rows.ctypes.data, hold(rows)
    del rows
    assert spare.rows(5).ctypes.data != place
    rows, stamps = spare.both(5)
    place, held = stamps.ctypes.data, hold(stamps)
    del stamps
    assert spare.both(5)[1].ctypes.data != place
    assert spare.both(5)[0].ctypes.data != rows.ctypes.data
    del held


def test_another_length_is_another_array() -> None:
    spare = Spare(2)
    assert spare.rows(4).shape == (4, 2)
    assert spare.rows(3).shape == (3, 2)
    for n in (4, 4, 0, 3):
        assert spare.rows(n + 1).shape == (n + 1, 2)
        assert [array.shape for array in spare.both(n)] == [(n, 2), (n,)]
    assert spare.rows(0).shape == (0, 2)


@pytest.mark.parametrize("operator", [Rectify(), Lowpass(cutoff_hz=20.0)])
def test_what_was_emitted_and_is_kept_stays_as_it_is(operator: Operator[Any]) -> None:
    """A reader that keeps every third chunk, one that keeps views, and one in another thread."""
    rng = np.random.default_rng(3)
    running = operator.fresh()
    running.open({"in": StreamSpec((4,), rate_hz=1000.0)})
    kept: list[tuple[Any, bytes]] = []
    waiting: deque[tuple[Any, bytes]] = deque()
    seen: list[bool] = []
    over = threading.Event()

    def read() -> None:
        while not over.is_set() or waiting:
            if waiting:
                data, was = waiting.popleft()
                seen.append(data.tobytes() == was)

    reader = threading.Thread(target=read)
    reader.start()
    for i in range(3000):
        times = grid(1000.0, 10, 10**9 + i * 10**7)
        made = running.process("in", Chunk(times, rng.normal(size=(10, 4)), int(times[-1])))
        assert isinstance(made, Chunk)
        if i % 3 == 0:
            kept.append((made.data, made.data.tobytes()))
        elif i % 3 == 1:
            view = made.data[2:5]
            kept.append((view, view.tobytes()))
        elif i % 30 == 2:
            waiting.append((made.data, made.data.tobytes()))
    over.set()
    reader.join()
    assert all(data.tobytes() == was for data, was in kept)
    assert len(seen) == 100
    assert all(seen)
