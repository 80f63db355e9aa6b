"""The progress bar of long work in a notebook, with the time left; where there is no notebook, nothing."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from html import escape
from typing import Any

AFTER_S = 1.0
"""Shorter work shows no bar."""
EVERY_S = 0.25


@contextmanager
def notebook_bar(title: str, total_s: float) -> Iterator[Callable[[float], None]]:
    """Within: call (seconds done) every now and then."""
    display = _display()
    began, drawn, shown = time.monotonic(), 0.0, None

    def progress(done_s: float) -> None:
        nonlocal drawn, shown
        now = time.monotonic()
        if display is None or now - began < AFTER_S or now - drawn < EVERY_S or not 0 < done_s <= total_s:
            return
        drawn, bar = now, bar_html(title, done_s, total_s, now - began)
        if shown is None:
            shown = display(bar, raw=True, display_id=True)
        else:
            shown.update(bar, raw=True)

    yield progress
    if shown is not None:
        shown.update({"text/html": "", "text/plain": ""}, raw=True)


def bar_html(title: str, done_s: float, total_s: float, took_s: float) -> dict[str, str]:
    """How a notebook shows the progress of work, in seconds done and in all; by the kind of the text."""
    left = took_s * (total_s - done_s) / done_s
    text = f"{title}: {done_s:.0f} of {total_s:.0f} s, {left:.0f} s left"
    return {
        "text/html": f'<progress max="{total_s:g}" value="{done_s:g}"></progress> {escape(text)}',
        "text/plain": text,
    }


def _display() -> Any:
    """IPython's function that shows something in a notebook; None where there is no notebook."""
    ipython = sys.modules.get("IPython")
    shell = ipython.get_ipython() if ipython is not None else None
    return ipython.display.display if ipython is not None and hasattr(shell, "kernel") else None
