"""Axivity AX3 and AX6: .cwa files, blocks of 512 bytes. Source: Open Movement, Docs/ax3/cwa.h."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import numpy as np

from kinegraph.devices.formats.import_result import Asked, Understood
from kinegraph.devices.formats.wearables import UNTRIED
from kinegraph.stream.chunk import NS, Array, Samples, StreamSpec
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series

BLOCK = np.dtype([
    ("head", "S2"), ("length", "<u2"), ("fraction", "<u2"), ("session", "<u4"), ("sequence", "<u4"), ("time", "<u4"), ("light", "<u2"),
    ("temperature", "<u2"), ("events", "u1"), ("battery", "u1"), ("rate", "u1"), ("packing", "u1"), ("offset", "<i2"), ("count", "<u2"),
    ("data", "u1", 480), ("checksum", "<u2"),
])  # fmt: skip
HEADER = 1024
BREAK_S = 1.0
"""A longer step between blocks is a gap; a shorter one is the device's clock."""


def knows(head: bytes) -> bool:
    return head[:4] == b"MD\xfc\x03"


def read_cwa(path: Path, asked: Asked) -> Understood:
    """.acc (g), and .gyro (deg/s) of an AX6. Stamps follow the device's clock, block by block. Raises RecordingError."""
    made = Understood(path, "Axivity CWA", doubts=[UNTRIED])
    raw = path.read_bytes()
    blocks = np.frombuffer(raw, BLOCK, offset=HEADER, count=max(0, len(raw) - HEADER) // BLOCK.itemsize)
    sums = (
        blocks.view("<u2").reshape(len(blocks), -1).sum(axis=1, dtype=np.int64)
        if len(blocks)
        else np.zeros(0, np.int64)
    )
    good = (blocks["head"] == b"AX") & (blocks["length"] == 508) & ((sums & 0xFFFF == 0) | (blocks["checksum"] == 0))
    good &= (blocks["count"] > 0) & (blocks["time"] != 0)
    if bad := int((~good & (blocks["head"] == b"AX")).sum()):
        made.doubt(f"{bad} of {len(blocks)} blocks are damaged or empty and left out")
    blocks = blocks[good]
    if not len(blocks):
        raise RecordingError(f"{path}: there are no samples in it")
    kinds = set(zip(blocks["rate"].tolist(), blocks["packing"].tolist(), strict=True))
    if len(kinds) > 1:
        raise RecordingError(f"{path}: its rate or its axes change on the way; cut it with the maker's program (OMGUI)")
    ((code, packing),) = kinds
    rate, axes = 3200.0 / (1 << (15 - (code & 15))), packing >> 4
    if axes not in (3, 6, 9) or packing & 15 not in (0, 2) or (packing & 15 == 0 and axes != 3):
        raise RecordingError(f"{path}: holds {axes} axes packed in way {packing & 15}, which is not known")
    most = 480 // 4 if packing & 15 == 0 else 480 // (2 * axes)
    counts = np.minimum(blocks["count"], most).astype(np.int64)
    data = np.concatenate(
        [_unpacked(block["data"], n, axes, packing & 15) for block, n in zip(blocks, counts, strict=True)]
    )
    begins = _begins(blocks, rate)
    time, lost = _stamps(begins, counts, rate)
    light = int(blocks["light"][0])
    accel = slice(0, 3) if axes == 3 else slice(3, 6)
    _add(made, "acc", time, lost, data[:, accel] / (1 << (8 + (light >> 13))), rate, "g")
    if axes >= 6:
        _add(made, "gyro", time, lost, data[:, :3] * (8000.0 / (1 << (light >> 10 & 7)) / 32768.0), rate, "deg/s")
    made.facts["device"] = f"Axivity {'AX6' if axes >= 6 else 'AX3'} {int.from_bytes(raw[5:7], 'little')}"
    made.local_time(datetime.fromisoformat(str(np.datetime64(round(begins[0] * 1e6), "us"))))
    return made


def _unpacked(data: Array, count: int, axes: int, way: int) -> Samples:
    """Counts (count, axes) of a block."""
    if way == 2:
        whole: Samples = np.frombuffer(data.tobytes(), "<i2", count * axes).reshape(count, axes).astype(np.float64)
        return whole
    words = np.frombuffer(data.tobytes(), "<u4", count).astype(np.int64)
    numbers = np.stack([words & 1023, words >> 10 & 1023, words >> 20 & 1023], axis=1)
    numbers = np.where(numbers > 511, numbers - 1024, numbers) << (words >> 30)[:, None]
    made: Samples = numbers.astype(np.float64)
    return made


def _begins(blocks: Array, rate: float) -> Samples:
    """When each block's first sample was taken: seconds since 1970 by the device's clock."""
    packed = blocks["time"].astype(np.int64)
    months = (2000 - 1970 + (packed >> 26 & 63)) * 12 + np.maximum(packed >> 22 & 15, 1) - 1
    days = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + (packed >> 17 & 31) - 1
    seconds = days * 86_400 + (packed >> 12 & 31) * 3600 + (packed >> 6 & 63) * 60 + (packed & 63)
    fine = blocks["fraction"] & 0x8000 != 0
    fraction = np.where(fine, (blocks["fraction"] & 0x7FFF) / 32768.0, 0.0)
    index = blocks["offset"] + np.floor(fraction * rate)
    begins: Samples = seconds + fraction - index / rate
    return begins


def _stamps(begins: Samples, counts: Array, rate: float) -> tuple[Array, Array]:
    """Times (n,) in ns since the first sample, even within each block; and the samples lost before each."""
    ends = np.append(begins[1:], begins[-1] + counts[-1] / rate)
    usual = counts / rate
    broken = np.abs(ends - begins - usual) > BREAK_S
    length = np.where(broken, usual, ends - begins)
    first = np.concatenate([[0], np.cumsum(counts)])
    time, lost = np.empty(int(counts.sum())), np.zeros(int(counts.sum()), np.int64)
    for k, count in enumerate(counts.tolist()):
        time[first[k] : first[k + 1]] = begins[k] - begins[0] + length[k] * np.arange(count) / count
        if k and broken[k - 1]:
            lost[first[k]] = max(0, round((begins[k] - begins[k - 1] - usual[k - 1]) * rate)) or -1
    return np.maximum.accumulate(np.round(time * NS).astype(np.int64)), lost


def _add(made: Understood, part: str, time: Array, lost: Array, data: Samples, rate: float, unit: str) -> None:
    spec = StreamSpec((3,), data.dtype, rate, ("x", "y", "z"), (unit,))
    made.series.append(Series(made.name(part), spec, time, np.ascontiguousarray(data), lost if lost.any() else None))
