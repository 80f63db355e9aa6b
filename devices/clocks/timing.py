"""The output `timing` of every device with packets: what the stamps were made from, so that a better mapping can be made later."""

from __future__ import annotations

import numpy as np

from kinegraph.devices.clocks.packet_clock import Stamped
from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times

TIMING = np.dtype([("counter", "<i8"), ("device", "<i8"), ("arrival", "<i8"), ("stamp", "<i8")])
"""One packet: its running counter, the device's time (ns), its arrival and its mapped stamp (ns, session time); -1: missing."""


def timing_spec() -> StreamSpec:
    """The spec of the output `timing`: an event per packet, or per read of a fast device."""
    return StreamSpec((), TIMING, units=("", "ns", "ns", "ns"))


def timing_chunk(counter: Times | int, device: Times | int, arrival: Times | int, stamp: Times, lost: int = 0) -> Chunk:
    """Events of (n,) packets; a number stands for all of them. Stamps never run backwards, nor may they across calls."""
    events = np.empty(len(stamp), TIMING)
    events["counter"], events["device"], events["arrival"], events["stamp"] = counter, device, arrival, stamp
    return Chunk(stamp, events, int(stamp[-1]), lost)


def chunks_of_one(made: Stamped, arrival: int, data: Array, last: int) -> tuple[Chunk, Chunk]:
    """One record with its `data` (1, ...), and its event; `last`: the stamp of the event before, of any stream of the device."""
    row = np.array([made.number, made.device, arrival, made.stamp])
    time = row[3:4]
    record = Chunk(time, data, made.stamp, made.lost)
    if made.stamp >= last:
        return record, Chunk(time, row.view(TIMING), made.stamp)
    return record, Chunk(np.array([last]), row.view(TIMING), last)


def timing_of_one(counter: int, device: int, arrival: int, stamp: int, at: int | None = None) -> Chunk:
    """The event of one packet; `at`: the event's own stamp, where that is not the packet's."""
    row = np.array([counter, device, arrival, stamp])
    if at is None or at == stamp:
        return Chunk(row[3:4], row.view(TIMING), stamp)
    return Chunk(np.array([at]), row.view(TIMING), at)
