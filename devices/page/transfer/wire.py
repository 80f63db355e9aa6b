"""What travels to the page: a JSON header and numbers behind it, in one binary message; and what comes back, validated.

    u32 length of the header | header, JSON in UTF-8, padded with spaces to a multiple of 8 (with the u32) | numbers, little-endian

`docs/lab/page-messages.md` lists every message. The same messages go from the session's process to the server's,
each behind a u32 of its length.
"""

from __future__ import annotations

from struct import Struct
from typing import Any, Literal, TypeAlias

import msgspec

VERSION = 1
OPTIONS = "KINEGRAPH_PAGE"
"""The variable of its environment in which a server finds where it is to listen."""
LENGTH = Struct("<I")
MAX_BYTES = 64 << 20
"""No message between our own processes is longer."""
MAX_ASKED_BYTES = 4096
"""No message of a client is longer."""
MAX_TEXT = 64

_encoder = msgspec.json.Encoder()


def encode(header: dict[str, Any], *numbers: bytes | memoryview) -> bytes:
    """One message."""
    text = _encoder.encode(header)
    text += b" " * (-(len(text) + LENGTH.size) % 8)
    return b"".join((LENGTH.pack(len(text)), text, *numbers))


def decode(message: bytes | memoryview) -> tuple[dict[str, Any], memoryview]:
    """The header of a message, and the numbers behind it. Raises ValueError for anything else."""
    view = memoryview(message)
    if len(view) < LENGTH.size or (end := LENGTH.size + LENGTH.unpack_from(view)[0]) > len(view):
        raise ValueError("a message that was cut off")
    header = msgspec.json.decode(view[LENGTH.size : end])
    if not isinstance(header, dict):
        raise ValueError("a message without a header")
    return header, view[end:]


class See(msgspec.Struct, tag="see", tag_field="do", forbid_unknown_fields=True):
    """Send these streams from now on, each thinned out to one point per given number of nanoseconds; 0: every sample."""

    streams: dict[int, int]


class Look(msgspec.Struct, tag="look", tag_field="do", forbid_unknown_fields=True):
    """Of a recording: these streams from one time to another (s since the beginning), in at most `points` points; `at` is the cursor."""

    streams: list[int]
    begin: float
    end: float
    at: float
    points: int


class Analyse(msgspec.Struct, tag="analyse", tag_field="do", forbid_unknown_fields=True):
    """The spectrum of a signal between two times (s since the beginning), or the spectrogram of one of its channels."""

    stream: int
    what: Literal["spectrum", "spectrogram"]
    begin: float
    end: float
    channel: int = 0


class Mark(msgspec.Struct, tag="mark", tag_field="do", forbid_unknown_fields=True):
    """Annotate this moment, or that one (s since the beginning)."""

    text: str
    at: float | None = None


class RecordTake(msgspec.Struct, tag="take", tag_field="do", forbid_unknown_fields=True):
    """Begin a take of what the avatar does, or end it."""

    name: str
    on: bool


class Tell(msgspec.Struct, tag="tell", tag_field="do", forbid_unknown_fields=True):
    """Change a value."""

    node: str
    text: str


class SetPace(msgspec.Struct, tag="pace", tag_field="do", forbid_unknown_fields=True):
    """Of a replay: how many times real time; 0: pause."""

    speed: float


class StepOn(msgspec.Struct, tag="step", tag_field="do", forbid_unknown_fields=True):
    """Of a replay: go on for the given seconds, then stop."""

    seconds: float


class Seek(msgspec.Struct, tag="seek", tag_field="do", forbid_unknown_fields=True):
    """Of a replay: go to a moment (s since its first input)."""

    to: float


Asked: TypeAlias = See | Look | Analyse | Mark | RecordTake | Tell | SetPace | StepOn | Seek
_asked = msgspec.json.Decoder(Asked)


def asked(message: str | bytes) -> Asked:
    """What a client asks for. Raises ValueError (msgspec's) for anything else; lengths and ranges are checked here."""
    found: Asked = _asked.decode(message)
    match found:
        case See(streams) if len(streams) > 1000 or not all(0 <= w < 1 << 62 for w in streams.values()):
            raise ValueError("a client asks for too much")
        case Look(streams, begin, end, at, points) if not (len(streams) <= 1000 and 2 <= points <= 10_000):
            raise ValueError("a client asks for too much")
        case Look(_, begin, end, at) if not (-1e9 < begin < end < 1e9 and -1e9 < at < 1e9):
            raise ValueError("a client asks for an impossible time")
        case Analyse(_, _, begin, end) if not -1e9 < begin < end < 1e9:
            raise ValueError("a client asks for an impossible time")
        case Mark(text, at) if not text.strip() or len(text) > MAX_TEXT or (at is not None and not -1e9 < at < 1e9):
            raise ValueError(f"an annotation has 1 to {MAX_TEXT} characters")
        case RecordTake(name) if len(name) > MAX_TEXT:
            raise ValueError("a name that is too long")
        case Tell(node, text) if len(node) > 200 or len(text) > MAX_TEXT:
            raise ValueError("a value that is too long")
        case SetPace(speed) if not 0 <= speed <= 1000:
            raise ValueError("a speed is from 0 to 1000")
        case StepOn(seconds) if not 0 < seconds <= 1e6:
            raise ValueError("a step must be longer than zero")
        case Seek(to) if not 0 <= to < 1e9:
            raise ValueError("a client asks for an impossible time")
    return found
