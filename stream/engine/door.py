"""A source's door into the graph: the short way, for what comes most.

A chunk in order and on time is worked through on its source's own thread while nothing waits and nobody else has the
turn: to wake another thread for it would cost more than most graphs' work. One thread works on the graph at a time, and in the order in
which chunks came.

All of that way stands here in one function. After a rest of a few milliseconds, which is how a device's chunks come, a processor has to
fetch code and numbers from far memory, and every further function and object on the way costs microseconds. For anything else a door
stays closed, has changed nothing, and the chunk goes the long way: `Runner.normal`, `Channel.put`, `Intake.admit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from threading import Lock
from time import monotonic_ns, perf_counter_ns

import numpy as np

from stream.chunk import NS, STAMP, Chunk
from stream.engine.channel import Doorbell
from stream.engine.intake import AHEAD_NS, Intake
from stream.engine.journal import Journal
from stream.engine.promise import END, MOST_LOST
from stream.engine.supervisor import Door

FEW = 64
"""The order of so many stamps is looked at in Python, which after a rest is much faster than numpy."""
LONG_NS = 1_000_000
LONG_OFTEN = 3
"""Work longer than LONG_NS so often in a row would keep a source from its device: for a second, its chunks are queued."""


@dataclass(slots=True)
class Turn:
    """Who works on the graph now.

    lock   one thread at a time
    open   whether sources may by themselves: after the common start, before the end
    """

    lock: Lock = field(default_factory=Lock)
    open: bool = False


def door(intake: Intake, journal: Journal, turn: Turn, bell: Doorbell, fail: Callable[[Exception], None]) -> Door:
    """The door for one output of a source; `fail` is told what the graph's operators raise."""
    runner, wire, output = intake.runner, intake.wire, intake.output
    channel = runner.channels[output]
    dtype, shape = wire.spec.dtype, wire.spec.shape
    array, acquire, release, nothing_rings = np.ndarray, turn.lock.acquire, turn.lock.release, bell.empty
    write, recorder, offset = journal.writer(intake.number), journal.recorder, runner.clock.at(0)
    awaited = intake.awaited
    whole: tuple[int, ...] = (0, *shape)
    long = queue_until = 0

    def enter(chunk: Chunk) -> bool:
        nonlocal whole, long, queue_until
        time, data = chunk.time, chunk.data
        if (
            time.__class__ is not array
            or time.dtype is not STAMP
            or data.__class__ is not array
            or data.dtype is not dtype
        ):
            chunk = runner.tidy(chunk, output)
            time, data = chunk.time, chunk.data
        n = len(time)
        if n != whole[0]:
            whole = (n, *shape)
        arrival = monotonic_ns() + offset
        if data.shape != whole or runner.state != "running" or arrival < queue_until:
            return False
        if channel.waiting or channel.owed or not turn.open or not nothing_rings() or not acquire(False):
            return False
        entered = False
        try:
            newest = intake.promised + 1
            if n > FEW:
                if time[0] < newest or (time[1:] < time[:-1]).any():
                    return False
                newest = time.item(-1)
            else:
                for stamp in time.tolist():
                    if stamp < newest:
                        return False
                    newest = stamp
            until = chunk.until
            if until < newest or until >= END or intake.owed or not turn.open:
                return False
            if (until > arrival + AHEAD_NS and intake.watched) or not -1 <= chunk.lost <= MOST_LOST:
                return False
            runner.last_alive = intake.last = (arrival - offset) / NS
            intake.silent = intake.stale = False
            if not (n or awaited or chunk.lost):
                return True
            entered = True
            intake.promised = until
            channel.index += n
            channel.chunks += 1
            journal.sequence = sequence = journal.sequence + 1
            journal.arrival = arrival
            if write:
                write(chunk, arrival, sequence)
            start = perf_counter_ns()
            end = wire.send(chunk, start)
        except Exception as error:
            if not entered:
                raise  # the chunk itself is wrong: the source's own fault, and it alone fails
            fail(error)
            return True
        finally:
            release()
        if recorder and recorder.patient:
            recorder.lull()
        long = long + 1 if end - start > LONG_NS else 0
        if long == LONG_OFTEN:
            long, queue_until = 0, arrival + NS
        return True

    return enter
