"""Structured logging: one line per report, readable by people, or JSON for machines; always to standard error."""

from __future__ import annotations

import logging
import sys
from typing import Any

import structlog

from kinegraph.stream.text.safe_text import plain_log


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
