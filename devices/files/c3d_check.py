"""Whether the head of a C3D file holds together: of one that does not, the library that reads them may crash, or ask for all memory."""

from __future__ import annotations

import struct
from math import prod

BLOCK = 512
"""A C3D file counts in blocks of so many bytes, from 1."""
MOST_BLOCKS = 256
"""So many blocks the parameters may take: one byte counts them."""
HEAD = (254 + MOST_BLOCKS) * BLOCK
"""So many bytes hold the parameters, wherever they begin: one byte says where."""
INTEL, DEC, MIPS = 84, 85, 86
"""Processors, as a C3D file marks them: the first two put the low byte first."""
TYPES = {-1: 1, 1: 1, 2: 2, 4: 4}
"""Bytes of a parameter's values: characters, bytes, whole numbers, floating point numbers."""
LONGEST = 9000
"""Bytes of a record that are believed where there is a choice: 255 labels of 32 letters, and a description."""
WIDEST = 128
"""Characters of a name, at the most."""
LONGEST_TEXT = 127
"""Letters of a description: one signed byte counts them, and the library takes -1 for 4 GB."""
MOST_VALUES = 4 * MOST_BLOCKS * BLOCK
"""Steps through the dimensions of all parameters: [255, 255, 255, 0] hold nothing, and yet the library goes through all of them."""


def broken_at(head: bytes) -> int:
    """The byte at which the description of the parameters breaks off; -1 where it does not. `head` is a file's first HEAD bytes.

    The parameters are records one behind another: the length of a name, a group's number, the name, where the next record begins, and
    of a parameter the type of its values, their dimensions and the values themselves, which must lie before the next record.
    """
    if len(head) < BLOCK or head[0] == 0:
        return 0
    begin = (head[0] - 1) * BLOCK
    data = head[begin : begin + MOST_BLOCKS * BLOCK]
    if len(data) < 4 or data[3] not in (INTEL, DEC, MIPS):
        return begin
    order = ">" if data[3] == MIPS else "<"
    at, values = 4, 0
    while at + 2 <= len(data) and data[at]:
        after, more = _record(data, at, order)
        values += more
        if after < 0 or values > MOST_VALUES:
            return begin + at
        if after == 0:
            return -1
        at = after
    return -1 if at < len(data) else begin + at


def step_at(data: bytes, offset: int, order: str) -> int:
    """How far it is from here to the next record. Some SGI files have single steps in a PC's order: those that are shorter are meant."""
    (step,) = struct.unpack_from(f"{order}h", data, offset)
    if order == ">" and not 0 <= step <= LONGEST:
        (other,) = struct.unpack_from("<h", data, offset)
        return int(other) if 0 <= other <= LONGEST else int(step)
    return int(step)


def _record(data: bytes, at: int, order: str) -> tuple[int, int]:
    """Where the record after this one begins (0: this is the last; -1: it cannot be), and the steps through its dimensions."""
    broken = (-1, 0)
    length, group = struct.unpack_from("bb", data, at)
    name = at + 2
    offset = name + abs(length)
    if group == 0 or abs(length) > WIDEST or offset + 2 > len(data) or not data[name:offset].isascii():
        return broken
    step = step_at(data, offset, order)
    end = offset + step if step else len(data)
    text, steps = offset + 2, 0
    if step < 0 or end > len(data):
        return broken
    if group > 0:
        if offset + 4 > end:
            return broken
        kind, dimensions = struct.unpack_from("bB", data, offset + 2)
        if kind not in TYPES or dimensions > 7 or offset + 4 + dimensions > end:
            return broken
        extents = data[offset + 4 : offset + 4 + dimensions]
        text, steps = offset + 4 + dimensions + prod(extents) * TYPES[kind], prod(extent or 1 for extent in extents)
    if text > end or (text < end and data[text] > LONGEST_TEXT):
        return broken
    return (end if step else 0), steps
