"""Texts from outside, fit to be shown: what would move a terminal's cursor, colour or hide a line stands there as its code instead.

Names of streams, annotations, what devices say, YAML and files may hold anything. Whatever is printed goes through `plain`: lines through
`say`, tables and panels through `stream.text.screen.Screen`, log lines through `plain_log`.
"""

from __future__ import annotations

import re
import sys
from collections.abc import MutableMapping
from typing import Any

from kinegraph.stream.text.units import shown

HARMFUL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ufeff\ud800-\udfff]")
"""Control characters but line feed and tab, what turns the direction of writing, and halves of characters."""


def plain(text: object) -> str:
    """The text with every harmful character as its code: \\x1b, \\u202e."""
    return HARMFUL.sub(_code, str(text))


def one_line(text: object) -> str:
    """The same with line feeds and tabs as codes, too."""
    return plain(text).replace("\n", "\\n").replace("\t", "\\t")


def say(text: object = "", *, err: bool = False, end: str = "\n", flush: bool = False) -> None:
    """Print to standard output, or error: in one piece, so that no other thread's line lands in it. Units have their micro sign."""
    print(f"{shown(plain(text))}{end}", file=sys.stderr if err else sys.stdout, end="", flush=flush)


def plain_log(_logger: object, _method: str, event: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """A step of structlog: an event's texts, and the names of its facts, on one line."""
    return {one_line(key): _shown(value) for key, value in event.items()}


def _shown(value: Any) -> Any:
    if isinstance(value, str):
        return shown(one_line(value))
    if isinstance(value, dict):
        return {one_line(key): _shown(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_shown(item) for item in value]
    return value


def _code(match: re.Match[str]) -> str:
    code = ord(match[0])
    return f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}"
