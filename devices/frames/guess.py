"""What frames a device sends, guessed from its bytes: sync, length, counter, time, checksum, numbers. No port, no clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.frames.checksums import CHECKSUMS
from kinegraph.devices.frames.packet_decoder import Framing, uncobs, unslip

MAX = 512
"""Bytes of the longest frame that is looked for."""
LEAST = 12
"""This many frames must have come."""
SHARE = 0.9
"""This share of the frames must bear a guess out."""
COMMON = 40
"""Beginnings that are tried, by how often they come."""

Order = Literal["little", "big"]


@dataclass(slots=True)
class FrameGuess:
    """A declaration as a graph holds it, without a name and a rate.

    frames   how many there were
    covered  what share of the bytes they are
    """

    framing: Framing = "none"
    sync: bytes = b""
    size: int = 0
    frames: int = 0
    covered: float = 0.0
    endian: Order = "little"
    checksum: str = "none"
    checksum_from: int = 0
    fields: list[dict[str, Any]] = field(default_factory=list)
    time_step: float = 0.0
    """Step of the device's time from frame to frame; 0: no device time."""


def guess(data: bytes) -> FrameGuess | None:
    """What these bytes are, if they are mostly frames of one kind; the beginning and the end may be cut."""
    kinds: tuple[Framing, ...] = ("cobs", "slip")
    for framing in kinds:
        packets = _packets(data, framing)
        if packets:
            made = FrameGuess(framing, b"", len(packets[0]), len(packets), 1.0)
            return _explain(made, packets)
    found = _aligned(data)
    if found is None:
        return None
    sync, frames = found
    size = len(frames[0])
    return _explain(FrameGuess("none", sync, size, len(frames), len(frames) * size / len(data)), frames)


def _packets(data: bytes, framing: Framing) -> list[bytes]:
    """The packets, if these bytes are escaped ones of one length."""
    end, unescape = (b"\0", uncobs) if framing == "cobs" else (b"\xc0", unslip)
    pieces = [piece for piece in data.split(end)[1:-1] if piece]
    packets = [packet for piece in pieces if (packet := unescape(piece))]
    size, count = Counter(map(len, packets)).most_common(1)[0] if packets else (0, 0)
    return [p for p in packets if len(p) == size] if size > 2 and count >= max(LEAST, SHARE * len(pieces)) else []


def _aligned(data: bytes) -> tuple[bytes, list[bytes]] | None:
    """The bytes that frames begin with, and the frames."""
    best: tuple[float, int, bytes, int] | None = None
    for length in (3, 2, 1):
        grams = Counter(data[i : i + length] for i in range(len(data) - length))
        for gram, _ in grams.most_common(COMMON):
            places = _places(data, gram)
            steps = Counter(np.diff(places).tolist())
            steps = Counter({step: n for step, n in steps.items() if length < step <= MAX})
            if not steps:
                continue
            step, n = steps.most_common(1)[0]
            score = (min(1.0, n * step / len(data)), -step, gram, step)
            if n >= LEAST and (
                best is None or score[0] > best[0] + 0.02 or (score[0] > best[0] - 0.02 and step < best[3])
            ):
                best = score
        if best and best[0] > 1 - 0.5 * (1 - SHARE):
            break
    if best is None or best[0] < 0.5:
        return None
    return _widened(data, best[2], best[3])


def _widened(data: bytes, gram: bytes, size: int) -> tuple[bytes, list[bytes]] | None:
    """All constant bytes around those that were found are the sync."""
    places = _places(data, gram)
    places = places[np.isin(places + size, places)]
    back = 0
    while back < size - len(gram) and len({data[p - back - 1] for p in places[1:]}) == 1:
        back += 1
    starts = [p - back for p in places.tolist() if p >= back and p - back + size <= len(data)]
    frames = [data[p : p + size] for p in starts]
    if len(frames) < LEAST:
        return None
    width = next((i for i in range(size) if len({f[i] for f in frames}) > 1), size)
    return (frames[0][:width], frames) if 0 < width < size else None


def _places(data: bytes, gram: bytes) -> NDArray[np.int64]:
    found, at = [], data.find(gram)
    while at >= 0:
        found.append(at)
        at = data.find(gram, at + 1)
    return np.array(found, np.int64)


def _explain(made: FrameGuess, frames: Sequence[bytes]) -> FrameGuess:
    """Find checksum, counter, time and numbers within frames of one length."""
    made.checksum, made.checksum_from, order = _checksum(frames, len(made.sync))
    checksum, body = CHECKSUMS[made.checksum], made.size - CHECKSUMS[made.checksum].size
    if checksum.size:
        byte_order = order or "little"
        frames = [
            f for f in frames if checksum.of(f[made.checksum_from : body]) == int.from_bytes(f[body:], byte_order)
        ]
    rows = np.frombuffer(b"".join(frames), np.uint8).reshape(len(frames), -1)
    start, end = len(made.sync), made.size - CHECKSUMS[made.checksum].size
    roles: dict[int, dict[str, Any]] = {}
    for at in range(start, end):
        one = None if roles else _counter_at(rows, at, end)
        if one:
            roles[at] = one
    if time := _time(rows, start, end, roles):
        roles[time[0]], made.time_step = time[1], time[2]
    made.endian = order or _smoother(rows, start, end, roles)
    for one in roles.values():
        if int(one["type"][1:]) == 8:
            one.pop("endian")
        elif one["endian"] == made.endian:
            del one["endian"]
    made.fields = _fields(rows, start, end, roles, made.endian)
    return made


def _checksum(frames: Sequence[bytes], sync: int) -> tuple[str, int, Order | None]:
    """Kind, range and byte order of a checksum at the frames' end."""
    some = list(dict.fromkeys(frames))[:60]
    orders: tuple[Order, ...] = ("little", "big")
    for (kind, one), start, order in product(
        sorted(CHECKSUMS.items(), key=lambda k: -k[1].size), range(sync + 3), orders
    ):
        end = len(some[0]) - one.size
        if not one.size or start >= end or len(some) < LEAST // 2 or (one.size == 1 and order == "big"):
            continue
        fits = sum(one.of(f[start:end]) == int.from_bytes(f[end:], order) for f in some)
        if fits >= SHARE * len(some):
            return kind, start, order if one.size > 1 else None
    return "none", 0, None


def _counter_at(rows: NDArray[np.uint8], at: int, end: int) -> dict[str, Any] | None:
    """A counter that begins at this byte; the widest that fits."""
    for size, order in product((4, 2, 1), ("little", "big")):
        if at + size > end:
            continue
        low = at if order == "little" else at + size - 1
        counted = _steps(rows, at, size, order) == 1
        wide = size == 1 or (counted.sum() == (_steps(rows, low, 1, order) == 1).sum() and _moves(rows, at, size, low))
        if counted.mean() >= SHARE and wide:
            return {"type": f"u{8 * size}", "endian": order, "role": "counter"}
    return None


def _time(
    rows: NDArray[np.uint8], start: int, end: int, taken: dict[int, dict[str, Any]]
) -> tuple[int, dict[str, Any], float] | None:
    """Where the device's time stands, and by how much it goes on: the number that does so most evenly, and of these the widest."""
    found: list[tuple[float, int, int, str]] = []
    for size, order in product((4, 2), ("little", "big")):
        for at in range(start, end - size + 1):
            low = at if order == "little" else at + size - 1
            if not any(at <= known < at + size for known in taken) and np.ptp(rows[:, low]):
                found.append((round(_unevenness(rows, at, size, order), 2), -size, at, order))
    if not found or min(found)[0] >= 0.2:
        return None
    _, size, at, order = min(found)
    steps = _steps(rows, at, -size, order)
    usual = steps[np.abs(steps - np.median(steps)) <= 0.2 * np.median(steps)]
    return at, {"type": f"u{-8 * size}", "endian": order, "role": "time"}, float(usual.mean())


def _steps(rows: NDArray[np.uint8], at: int, size: int, order: str) -> NDArray[np.int64]:
    return np.diff(_numbers(rows, at, size, order)) % (1 << 8 * size)


def _moves(rows: NDArray[np.uint8], at: int, size: int, low: int) -> bool:
    """Whether the bytes of a number above its lowest change at all."""
    return any(np.ptp(rows[:, i]) > 0 for i in range(at, at + size) if i != low)


def _unevenness(rows: NDArray[np.uint8], at: int, size: int, order: str) -> float:
    """How far the steps of a number lie from their median, as a share of it; infinite for what does not go on like a clock."""
    if at + size > rows.shape[1]:
        return np.inf
    steps = _steps(rows, at, size, order)
    usual = float(np.median(steps))
    if not 1 < usual < (1 << 8 * size) / 8:
        return np.inf
    return float(np.quantile(np.abs(steps - usual), SHARE)) / usual


def _numbers(rows: NDArray[np.uint8], at: int, size: int, order: str) -> NDArray[np.int64]:
    parts = rows[:, at : at + size].astype(np.int64)
    parts = parts if order == "little" else parts[:, ::-1]
    return np.asarray((parts << 8 * np.arange(size)).sum(axis=1))


def _smoother(rows: NDArray[np.uint8], start: int, end: int, taken: dict[int, dict[str, Any]]) -> Order:
    """The byte order in which numbers of 16 bits change least from frame to frame."""
    rough = dict.fromkeys(("little", "big"), 0.0)
    for at in _free(start, end, taken, 2):
        for order in rough:
            numbers = _numbers(rows, at, 2, order)
            numbers = numbers - (numbers >> 15 << 16)
            rough[order] += float(np.abs(np.diff(numbers)).mean())
    return "big" if rough["big"] < rough["little"] else "little"


def _free(start: int, end: int, taken: dict[int, dict[str, Any]], size: int) -> list[int]:
    """Where numbers of this many bytes lie between what is known."""
    places, at = [], start
    while at + size <= end:
        if at in taken:
            at += int(taken[at]["type"][1:]) // 8
        elif any(at < known < at + size for known in taken):
            at += 1
        else:
            places.append(at)
            at += size
    return places


def _fields(
    rows: NDArray[np.uint8], start: int, end: int, roles: dict[int, dict[str, Any]], order: Order
) -> list[dict[str, Any]]:
    """All fields in order: what is known, and numbers of 32 bits where they read as floats, else 16, else 8 bits."""
    floats = [at for at in _free(start, end, roles, 4) if _is_float(rows, at, order)]
    pairs = _free(start, end, {**roles, **{at: {"type": "f32"} for at in floats}}, 2)
    made: list[dict[str, Any]] = []
    at, n = start, 0
    while at < end:
        if at in roles:
            one = dict(roles[at])
        else:
            n += 1
            one = {"type": "f32" if at in floats else "i16" if at in pairs else "u8", "name": f"x{n}"}
        made.append(one)
        at += int(one["type"][1:]) // 8
    return made


def _is_float(rows: NDArray[np.uint8], at: int, order: Order) -> bool:
    raw = np.frombuffer(rows[:, at : at + 4].tobytes(), "<f4" if order == "little" else ">f4")
    with np.errstate(all="ignore"):
        numbers = raw.astype(np.float64)
    sizes = np.abs(numbers)
    return bool(
        (np.isfinite(numbers) & ((sizes == 0) | ((sizes > 1e-6) & (sizes < 1e7)))).all() and np.ptp(numbers) > 0
    )
