"""What may enter the graph: every rule about a source's chunk, as functions of the chunk and a few numbers, without thread or clock.

`soundness` tells a chunk to which nothing needs to be done; else `conform` puts it into the arrays that its spec declares and `ordered`
refuses time that runs backwards. `admit` decides lateness, gaps and the watermark, `followed` gives background sources the data's time
where no source is live. Whichever way a chunk takes into the graph (`stream.engine.ingress`), inline on its source's thread or through a
queue, these are what it passes; what a full queue does is `stream.graph.backpressure`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec
import numpy as np

from kinegraph.stream.chunk import FOREVER, NS, STAMP, Array, Chunk, StreamSpec, add_lost
from kinegraph.stream.domain.claims import ClaimGate, survey
from kinegraph.stream.engine.flow.promise import END, MAX_LOST

AHEAD_NS = NS
"""A live sample's stamp may lie this far after its arrival, by what a device's clock is wrong; beyond that it is reported."""

JOINED_BYTES = 8192
"""Chunks with more samples than this enter alone: to copy them costs more than it saves."""


class Verdict(msgspec.Struct, gc=False):
    """What becomes of a chunk.

    chunk     as it enters; None: it says nothing new, and nothing changes
    late      how many samples were dropped because they came at or before the watermark
    ahead_ns  how far the watermark lies ahead of the arrival, beyond what a clock may be wrong; 0: it does not
    """

    chunk: Chunk | None
    late: int = 0
    ahead_ns: int = 0


NOTHING_NEW = Verdict(None)


def soundness(spec: StreamSpec, gate: ClaimGate | None = None) -> Callable[[Chunk], bool]:
    """What tells whether a source's chunk is as it should be in every respect: `conform` and `ordered` would give it back as it is.

    It is asked of every chunk, so it remembers the shape that the last one had, and few names are looked up. A chunk that is sound has
    passed the `gate`, which compares its stamps with what was declared.
    """
    array, dtype, tail, shape, rows = np.ndarray, spec.dtype, spec.shape, spec.shape, -1
    gate = gate or ClaimGate("", spec)
    numbers, keep = gate.numbers, gate.keep

    def is_sound(chunk: Chunk) -> bool:
        nonlocal shape, rows
        time, data, until = chunk.time, chunk.data, chunk.until
        if time.__class__ is not array or data.__class__ is not array:
            return False
        if time.dtype is not STAMP or data.dtype is not dtype:
            return False
        n = len(time)
        if n != rows or data.shape != shape:
            if data.shape != (n, *tail):
                return False
            shape, rows = data.shape, n
        if not (time.flags.carray and -1 <= chunk.lost <= MAX_LOST and -END < until < END):
            return False
        code = survey(time, until, chunk.lost, numbers)
        if code > 1:
            keep(data[0])
        return code > 0

    return is_sound


def conform(spec: StreamSpec, chunk: Chunk) -> Chunk:
    """The chunk in arrays of the declared dtypes, its stamps side by side in memory. Its shape may be another; samples are put in order by
    the edge they enter."""
    time, data = chunk.time, chunk.data
    if (
        time.__class__ is np.ndarray
        and time.dtype is STAMP
        and time.flags.carray
        and data.__class__ is np.ndarray
        and data.dtype is spec.dtype
    ):
        return chunk
    times, samples = np.require(time, STAMP, ["C", "A", "W"]), np.require(data, spec.dtype, ["C", "A", "W"])
    return Chunk(times, samples, chunk.until, chunk.lost)


def ordered(chunk: Chunk) -> tuple[Chunk, int]:
    """The chunk without samples older than one before them, complete up to its last sample; and how many were dropped."""
    time, dropped = chunk.time, 0
    n = len(time)
    if n > 1 and (time[1:] < time[:-1]).any():
        keep = time >= np.maximum.accumulate(time)
        dropped = n - int(keep.sum())
        time = np.ascontiguousarray(time[keep])
        chunk = Chunk(time, np.ascontiguousarray(chunk.data[keep]), chunk.until, chunk.lost)
    if n and chunk.until < (last := time.item(-1)):
        chunk = Chunk(time, chunk.data, last, chunk.lost)
    return chunk, dropped


def admit(
    chunk: Chunk, watermark: int, pending_gap: int, arrival: int, *, has_readers: bool, checks_clock: bool
) -> Verdict:
    """The lateness rule: a sample at or before the stream's `watermark` is dropped and counted as lost; the watermark never goes back.

    pending_gap samples lost before the next one, beyond what its chunk says
    arrival   when the chunk came (ns of session time)
    has_readers whether anybody waits for what time brings; if not, only samples enter
    checks_clock whether stamps ahead of the session's clock are still to be reported
    """
    time, until, lost = chunk.time, chunk.until, chunk.lost
    n, late = len(time), 0
    ahead_ns = until - arrival if checks_clock and arrival + AHEAD_NS < until < FOREVER else 0
    if n and time.item(0) <= watermark:
        keep = time > watermark
        late = n - int(keep.sum())
        n -= late
        lost = add_lost(lost, late)
        chunk = Chunk(np.ascontiguousarray(time[keep]), np.ascontiguousarray(chunk.data[keep]), until, lost)
    if not n:
        if not lost and (until <= watermark or not (has_readers or until == FOREVER)):
            return Verdict(None, late, ahead_ns) if late or ahead_ns else NOTHING_NEW
    elif pending_gap:
        lost = add_lost(pending_gap, lost)
    if until < watermark:
        until = watermark
    if lost != chunk.lost or until != chunk.until:
        chunk = Chunk(chunk.time, chunk.data, until, lost)
    return Verdict(chunk, late, ahead_ns)


def followed(chunk: Chunk, watermark: int, newest: int) -> Chunk:
    """A background source's chunk where no other source is live: stamped when it enters by how far the data have come (`newest`), since
    the clock says nothing about them. Never late, for its samples lie after the stream's `watermark`."""
    n = len(chunk.time)
    at = max(newest, watermark + 1) if n else newest
    return Chunk(np.full(n, at, STAMP), chunk.data, FOREVER if chunk.until == FOREVER else at, chunk.lost)


def joins(until: int, chunk: Chunk) -> bool:
    """Whether a chunk may enter together with those before it, complete up to `until`: no answer depends on how samples come in chunks, and
    what each chunk costs is so paid once for all. Not across a gap, a
    late sample, an empty chunk or the end."""
    time = chunk.time
    if chunk.lost or not len(time) or chunk.data.nbytes > JOINED_BYTES:
        return False
    return time.item(0) > until and chunk.until < END


def join(chunks: Sequence[Chunk]) -> Chunk:
    """Chunks of one stream, each of which `joins` the one before it, as one."""
    if len(chunks) == 1:
        return chunks[0]
    time, data = _joined([chunk.time for chunk in chunks]), _joined([chunk.data for chunk in chunks])
    return Chunk(time, data.reshape(len(time), *chunks[0].data.shape[1:]), chunks[-1].until, chunks[0].lost)


def _joined(arrays: list[Array]) -> Array:
    """Arrays of one dtype, one after the other in memory of their own; flat where they are in order already, which is ten times as fast."""
    try:
        return np.frombuffer(bytearray().join(arrays), arrays[0].dtype)  # type: ignore[arg-type]
    except (BufferError, ValueError, TypeError):  # such as rows that are not in order
        return np.concatenate(arrays, dtype=arrays[0].dtype)
