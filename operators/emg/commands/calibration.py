"""The numbers of a calibration, computed by the same operators as a session's."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, Samples, StreamSpec, Times, empty
from kinegraph.stream.engine.flow.merge import Merge
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.operator import Emitted
from kinegraph.stream.recording import Recording

MIN_CYCLES = 3


def settled_envelope(
    envelope: Envelope, spec: StreamSpec, chunks: Iterable[Chunk]
) -> tuple[Times, Samples, StreamSpec]:
    """The envelope of a recorded signal without what is not settled: stamps (n,), samples (n, channels), spec. Raises KinegraphError."""
    operator = envelope.unopened()
    out = operator.open({"in": spec})["out"]
    times, rows, since = [np.empty(0, np.int64)], [np.empty((0, *out.shape))], None
    for chunk in chunks:
        for piece in _pieces(operator.process("in", chunk)):
            if len(piece):
                since = int(piece.time[0]) if since is None or piece.lost else since
                settled = piece.time >= since + round(out.settling_s * NS)
                times.append(piece.time[settled])
                rows.append(piece.data[settled])
    time, data = np.concatenate(times), np.concatenate(rows)
    if not len(time):
        raise KinegraphError(
            f"the recording is too short: an envelope takes {out.settling_s + operator.delay_s:.2f} s to settle"
        )
    return time, data, out


def highest_mean(time: Times, data: Samples, spec: StreamSpec, window_s: float) -> Samples:
    """Per channel the highest mean (channels,) over windows of `window_s` without a gap and without NaN. Raises KinegraphError."""
    n = max(1, round(window_s * (spec.rate_hz or 1)))
    if len(time) < n:
        raise KinegraphError(
            f"the recording holds {len(time)} settled samples of envelope; one window of {window_s:g} s needs {n}"
        )
    windows = np.lib.stride_tricks.sliding_window_view(data, n, axis=0).mean(axis=-1)
    whole = time[n - 1 :] - time[: len(time) - n + 1] <= round((n + 1) * spec.period_ns)
    means = np.where(whole[:, None] & np.isfinite(windows), windows, -np.inf)
    return np.asarray(means.max(axis=0))


def mean_cycle(
    envelope: Envelope, spec: StreamSpec, recording: Recording, emg: str, touchdown: str
) -> tuple[Samples, int]:
    """The mean curve (100, channels) of the recording's accepted cycles, and how many they were. Raises KinegraphError."""
    enveloping, cutting = envelope.unopened(), Cycles()
    specs = {"signal": enveloping.open({"in": spec})["out"], "touchdown": recording.stream(touchdown).spec}
    cutting.open(specs)
    merge = Merge(specs)
    contacts = [*recording.chunks(touchdown), empty(specs["touchdown"], FOREVER)]
    curves: list[Array] = []
    pieces = [("touchdown", chunk) for chunk in contacts]
    for chunk in recording.chunks(emg):
        pieces += [("signal", piece) for piece in _pieces(enveloping.process("in", chunk))]
    for port, chunk in [*pieces, ("signal", empty(specs["signal"], FOREVER))]:
        for name, piece in merge.push(port, chunk):
            curves += [out.data for output, out in cutting.process(name, piece) or () if output == "cycles"]
    cycles = np.concatenate(curves)
    if len(cycles) < MIN_CYCLES:
        raise KinegraphError(
            f"{recording.path}: {len(cycles)} whole cycles; a task reference needs at least {MIN_CYCLES}"
        )
    return np.asarray(np.nanmean(cycles, axis=0)), len(cycles)


def quality(spec: StreamSpec, chunks: Iterable[Chunk], *, steady: bool = False) -> tuple[list[str], Samples]:
    """Per channel the verdict on the whole recording ("good", "bad: mains hum"), and its baseline noise (channels,).

    steady   the muscles do the same throughout (rest, a held contraction), so that no contrast is no fault
    """
    operator = SignalQuality(min_contrast=1.0) if steady else SignalQuality()
    operator.open({"in": spec})
    found = np.concatenate([operator.process("in", chunk).data for chunk in chunks])
    if not len(found):
        return ["not judged: too short"] * spec.shape[0], np.zeros(spec.shape[0])
    rows = found.reshape(-1, spec.shape[0])
    flags = [": ".join(part for part in (row["session_flag"], row["session_reason"]) if part) for row in rows[-1]]
    return flags, np.asarray(rows["noise"].mean(axis=0))


def _pieces(emitted: Emitted) -> list[Chunk]:
    if emitted is None:
        return []
    return [emitted] if isinstance(emitted, Chunk) else [chunk for _, chunk in emitted]
