"""Structured logging: one line per report, readable by people, or JSON for machines, to standard error; for programs, to `logging`."""

from __future__ import annotations

import logging
import math
import sys
import time
from collections.abc import Callable, MutableMapping
from typing import Any

import structlog

from kinegraph.stream.text.safe_text import plain_log

AGAIN_S = 60.0
"""A warning that is repeated is shown once in this time."""
VARIES = ("opening", "retry_in_s")
"""What differs between a warning and its repetition."""


class Repetitions:
    """Shows a warning or an error once a minute, with the count (`times`) of those in between: a device that fails is opened often.

    The recording's own log has all of them.
    """

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._now = now
        self._shown: dict[str, tuple[float, int]] = {}

    def __call__(self, _logger: object, method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
        if method not in ("warning", "error") or "exc_info" in event:
            return event
        key = repr({name: value for name, value in event.items() if name not in VARIES})
        at, times = self._shown.get(key, (-math.inf, 0))
        if self._now() - at < AGAIN_S:
            self._shown[key] = at, times + 1
            raise structlog.DropEvent
        self._shown[key] = self._now(), 0
        if times:
            event["times"] = times + 1
        return event


def to_logging() -> None:
    """For programs: what is logged goes to Python's `logging`, under "kinegraph", and is shown where the program asks for that.

    A program that has set up structlog itself is left alone, as is the command line.
    """
    if structlog.is_configured():
        return
    logging.getLogger("kinegraph").addHandler(logging.NullHandler())
    structlog.configure(
        processors=[
            structlog.stdlib.filter_by_level,
            plain_log,
            structlog.processors.format_exc_info,
            _as_text,
        ],
        wrapper_class=structlog.stdlib.BoundLogger,
        logger_factory=structlog.stdlib.LoggerFactory(),
    )


def _as_text(_logger: object, _method: str, event: MutableMapping[str, Any]) -> str:
    """An event and its facts: "source ended: node=board"."""
    said = event.pop("event", "")
    facts = " ".join(f"{name}={value}" for name, value in event.items())
    return f"{said}: {facts}" if facts else str(said)


def set_up(*, json: bool = False, verbose: bool = False) -> None:
    """Choose how log lines look: `json`, one object a line; else aligned text, in colours on a terminal."""
    renderer: Any = (
        structlog.processors.JSONRenderer()
        if json
        else structlog.dev.ConsoleRenderer(
            colors=sys.stderr.isatty(), exception_formatter=structlog.dev.plain_traceback
        )
    )
    structlog.configure(
        processors=[
            Repetitions(),
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso" if json else "%H:%M:%S", utc=json),
            structlog.processors.format_exc_info if json else structlog.processors.StackInfoRenderer(),
            plain_log,
            renderer,
        ],
        wrapper_class=structlog.make_filtering_bound_logger(logging.DEBUG if verbose else logging.INFO),
        logger_factory=structlog.PrintLoggerFactory(file=sys.stderr),
        cache_logger_on_first_use=False,
    )
