"""What ends the program, and what is only an operator's fault."""

from __future__ import annotations

import signal
import threading
from types import FrameType

import pytest

from kinegraph.stream.errors import Interrupted, Terminated, asked_to_end, interruption


def ours(number: int, frame: FrameType | None) -> None:
    raise Interrupted


@pytest.mark.parametrize(
    ("error", "handled_by_us", "asked"),
    [
        (Interrupted(), True, True),
        (Terminated(), True, True),
        (Terminated(), False, True),
        (KeyboardInterrupt(), False, True),
        (
            KeyboardInterrupt(),
            True,
            False,
        ),  # raised by an operator's own code: our handler would have raised another one
        (ValueError(), False, False),
    ],
)
def test_signals_end_the_program_and_faults_do_not(error: BaseException, handled_by_us: bool, asked: bool) -> None:
    before = signal.signal(signal.SIGINT, ours if handled_by_us else signal.default_int_handler)
    try:
        assert asked_to_end(error) is asked
    finally:
        signal.signal(signal.SIGINT, before)


def test_another_thread_is_never_asked() -> None:
    rows: list[bool] = []
    thread = threading.Thread(target=lambda: rows.append(asked_to_end(Interrupted())))
    thread.start()
    thread.join()
    assert rows == [False]


def test_an_interruption_is_found_behind_what_a_library_made_of_it() -> None:
    asked = Interrupted()
    made = RuntimeError("the library was interrupted")
    made.__cause__ = ValueError("in between")
    made.__cause__.__context__ = asked
    assert interruption(made) is asked
    assert interruption(asked) is asked
    assert interruption(RuntimeError("of its own")) is None
