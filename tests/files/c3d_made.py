"""C3D files written byte by byte, also such as no program writes."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

BLOCK = 512
GROUPS = {"POINT": 1, "ANALOG": 2, "EVENT": 3, "TRIAL": 4}


class Made(NamedTuple):
    """A parameter: its group and name, the type and the extents of its values, these, and its description."""

    group: str
    name: str
    kind: int
    extents: Sequence[int]
    values: bytes
    description: bytes = b""


def whole(name: str, value: int) -> Made:
    group, _, short = name.partition(":")
    return Made(group, short, 2, [], struct.pack("<H", value))


def real(name: str, *values: float) -> Made:
    group, _, short = name.partition(":")
    return Made(group, short, 4, [] if len(values) == 1 else [len(values)], struct.pack(f"<{len(values)}f", *values))


def texts(name: str, *values: str) -> Made:
    group, _, short = name.partition(":")
    width = max(map(len, values), default=0)
    return Made(group, short, -1, [width, len(values)], "".join(value.ljust(width) for value in values).encode())


def usual(markers: int = 2, frames: int = 3, channels: int = 2, per_frame: int = 5) -> list[Made]:
    """The parameters needed to read such a file; more than 255 channels are not described."""
    made = [
        *(whole("POINT:USED", markers), whole("POINT:FRAMES", min(frames, 0xFFFF)), real("POINT:SCALE", -0.1)),
        *(
            real("POINT:RATE", 100.0),
            texts("POINT:UNITS", "mm"),
            texts("POINT:LABELS", *(f"M{i}" for i in range(markers))),
        ),
        *(whole("ANALOG:USED", channels), real("ANALOG:RATE", 100.0 * per_frame), real("ANALOG:GEN_SCALE", 1.0)),
    ]
    if channels > 255:
        return made
    return [
        *made,
        *(real("ANALOG:SCALE", *[1.0] * channels), Made("ANALOG", "OFFSET", 2, [channels], bytes(2 * channels))),
        *(texts("ANALOG:LABELS", *(f"C{i}" for i in range(channels))), texts("ANALOG:UNITS", *["V"] * channels)),
    ]


def c3d_bytes(
    parameters: Sequence[Made], markers: int = 2, frames: int = 3, channels: int = 2, per_frame: int = 5
) -> bytes:
    """A PC's file of floating-point numbers 0, 1, 2, ...: of every frame its markers (x, y, z, residual), then its analogue samples."""
    if not any(one.name == "DATA_START" for one in parameters):
        parameters = [
            *parameters,
            whole("POINT:DATA_START", 2 + blocks_of([*parameters, whole("POINT:DATA_START", 0)])),
        ]
    blocks = blocks_of(parameters)
    counts = (markers, channels * per_frame, 1, min(frames, 0xFFFF), 10, -0.1, 2 + blocks, per_frame, 100.0)
    head = struct.pack("<BBHHHHHfHHf", 2, 0x50, *counts)
    begin = bytes([1, 0x50, blocks, 84]) + section_of(parameters)
    numbers = np.arange(frames * (4 * markers + channels * per_frame), dtype="<f4").tobytes()
    return head.ljust(BLOCK, b"\x00") + begin.ljust(blocks * BLOCK, b"\x00") + numbers


def blocks_of(parameters: Sequence[Made]) -> int:
    return -(-(4 + len(section_of(parameters))) // BLOCK)


def section_of(parameters: Sequence[Made]) -> bytes:
    """The records of groups and parameters, and the zero that ends them."""
    made = b"".join(
        struct.pack("bb", len(group), -number) + group.encode() + struct.pack("<hB", 3, 0)
        for group, number in GROUPS.items()
    )
    for one in parameters:
        body = struct.pack("bB", one.kind, len(one.extents)) + bytes(one.extents) + one.values
        body += bytes([len(one.description)]) + one.description
        made += struct.pack("bb", len(one.name), GROUPS[one.group]) + one.name.encode()
        made += struct.pack("<h", 2 + len(body)) + body
    return made + b"\x00"


def but(parameters: Sequence[Made], *others: Made) -> list[Made]:
    """These parameters, of which `others` replace those of the same name."""
    names = {(one.group, one.name) for one in others}
    return [*(one for one in parameters if (one.group, one.name) not in names), *others]
