"""Damaged copies of a valid file: bytes changed, cut, doubled and moved, numbers made extreme, words of the file put elsewhere."""

from __future__ import annotations

import datetime
import os
import random
import re
import struct

SECONDS = float(os.environ.get("KINEGRAPH_FUZZ_S", "0"))
"""How long copies are made of each file; 0: a fixed number of them."""

EXTREME = [
    *(
        struct.pack(f"<{kind}", value)
        for kind, value in (("H", 0xFFFF), ("I", 0xFFFFFFFF), ("Q", 2**63), ("q", -1), ("I", 0))
    ),
    *(struct.pack("<Q", 1 << 40), struct.pack("<I", 1 << 30), struct.pack("<d", float("nan")), struct.pack("<f", 1e38)),
]
TEXTS = [
    b"-1",
    b"0",
    b"1e308",
    b"nan",
    b"inf",
    b"1,5",
    b"99999999999999999999",
    b"",
    b"\x00",
    b"\xff",
    b"\n",
    b",",
    b";",
    b"[/red]",
]
TEXTS += [b"9999-12-31T23:59:59Z", b"0001-01-01", b"1e-320", b"\xe2\x80\xae", b"{" * 40]
NUMBER = re.compile(rb"-?\d+(\.\d+)?")


def seed_of(name: str) -> str:
    """What copies of it are drawn from: always the same, or, for KINEGRAPH_FUZZ_S, others every day or by KINEGRAPH_FUZZ_SEED."""
    return f"{name} {os.environ.get('KINEGRAPH_FUZZ_SEED', datetime.date.today()) if SECONDS else ''}"


def mutant(whole: bytes, chance: random.Random) -> bytes:
    """One to four changes."""
    data = bytearray(whole)
    for _ in range(chance.choice((1, 1, 1, 2, 4))):
        data = chance.choice((_flip, _cut, _double, _remove, _extreme, _text, _number, _swap))(data, chance)
    return bytes(data)


def _at(data: bytearray, chance: random.Random) -> int:
    """A place, as often near the beginning, where heads stand, or the end, as anywhere."""
    size = max(len(data), 1)
    return chance.choice(
        (chance.randrange(size), chance.randrange(min(size, 600)), size - 1 - chance.randrange(min(size, 300)))
    )


def _flip(data: bytearray, chance: random.Random) -> bytearray:
    if data:
        data[_at(data, chance)] ^= chance.choice((1, 0x80, 0xFF, chance.randrange(1, 256)))
    return data


def _cut(data: bytearray, chance: random.Random) -> bytearray:
    return data[: _at(data, chance)]


def _double(data: bytearray, chance: random.Random) -> bytearray:
    at = _at(data, chance)
    piece = data[at : at + chance.choice((1, 4, 16, 200))]
    return data[:at] + piece * chance.choice((2, 3)) + data[at + len(piece) :]


def _remove(data: bytearray, chance: random.Random) -> bytearray:
    at = _at(data, chance)
    return data[:at] + data[at + chance.choice((1, 2, 8, 100)) :]


def _extreme(data: bytearray, chance: random.Random) -> bytearray:
    at, value = _at(data, chance), chance.choice(EXTREME)
    return data[:at] + value + data[at + len(value) :]


def _text(data: bytearray, chance: random.Random) -> bytearray:
    at = _at(data, chance)
    return data[:at] + chance.choice(TEXTS) + data[at:]


def _number(data: bytearray, chance: random.Random) -> bytearray:
    found = list(NUMBER.finditer(bytes(data[:20_000])))
    if not found:
        return _flip(data, chance)
    match = chance.choice(found)
    return data[: match.start()] + chance.choice(TEXTS) + data[match.end() :]


def _swap(data: bytearray, chance: random.Random) -> bytearray:
    a, b = sorted((_at(data, chance), _at(data, chance)))
    return data[:a] + data[b : b + 32] + data[a:b] + data[b + 32 :]
