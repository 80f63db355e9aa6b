"""Asking a device and waiting for its answer, with an error that says what was expected and what came."""

from __future__ import annotations

import time

from kinegraph.devices.transport.transport import Transport
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed

SHOWN = 32
"""Bytes of a wrong answer that an error shows."""


class _StoppedError(DeviceError):
    """The source must stop; nothing is reported."""


def answer(link: Transport, feed: Feed, *, until: bytes, within_s: float, expected: str) -> bytes:
    """What comes up to and including `until`; raises DeviceError if that is not there in time.

    `expected` completes the sentence "expected ...", with a hint at what to look at where there is one.
    """
    came = bytearray()
    deadline = time.monotonic() + within_s
    while until not in came:
        if feed.stopped:
            raise _StoppedError("stopped while waiting for an answer")
        rest = deadline - time.monotonic()
        if rest <= 0:
            raise DeviceError(f"no answer within {within_s:g} s: expected {expected}; came {shown(bytes(came))}")
        came += link.read(min(rest, 0.1))
    return bytes(came[: came.index(until) + len(until)])


def quiet(link: Transport, feed: Feed, for_s: float, within_s: float) -> None:
    """Throw away what comes, until nothing has come for `for_s`, or for at most `within_s`."""
    deadline = time.monotonic() + within_s
    while link.read(for_s) and time.monotonic() < deadline and not feed.stopped:
        pass


def shown(data: bytes) -> str:
    """Bytes for people: their number, the first in hex, and as text where they are one."""
    if not data:
        return "nothing"
    text = data[:SHOWN].decode("ascii", "replace")
    readable = f" ({text!r})" if all(c.isprintable() or c in "\r\n\t" for c in text) and "\ufffd" not in text else ""
    more = " ..." if len(data) > SHOWN else ""
    return f"{len(data)} bytes: {data[:SHOWN].hex(' ')}{more}{readable}"


def silence(what: str, port: str, silent_s: float, max_s: float, expected: str, came: bytes) -> str:
    """The error of a device that has sent no good `what` for so long; "" while that is at most `max_s`."""
    if silent_s <= max_s:
        return ""
    return f"no {what} from {port} for {max_s:g} s: expected {expected}; came {shown(came)}"


def all_there(link: Transport, first: bytes, most: int = 1 << 20) -> bytes:
    """`first` and everything else that can be read without waiting: what piled up during a stall comes as one."""
    pieces, size = [first], len(first)
    while size < most and (more := link.read(0.0)):
        pieces.append(more)
        size += len(more)
    return b"".join(pieces)
