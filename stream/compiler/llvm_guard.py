"""Whether LLVM is at work in a thread: interrupted there, an object that changes hands would be freed twice, and the process crash."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import FrameType

AGAIN_S = 0.01
"""After this time a signal is looked at again that came while LLVM was at work."""


def within_llvm(frame: FrameType | None) -> bool:
    """Whether the code that a signal interrupted was called by llvmlite, or is llvmlite's own; `frame` is what a handler is given."""
    while frame is not None:
        if str(frame.f_globals.get("__name__", "")).startswith("llvmlite"):
            return True
        frame = frame.f_back
    return False


def later(again: Callable[[], None]) -> None:
    """Call `again` in a moment, from another thread."""
    timer = threading.Timer(AGAIN_S, again)
    timer.daemon = True
    timer.start()
