"""Operators with several inputs, run over whole streams in any cutting; and the real recordings as streams."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from kinegraph.operators.emg.envelope import Envelope
from kinegraph.stream.chunk import FOREVER, NS, Chunk, StreamSpec
from kinegraph.stream.engine.flow.merge import Merge
from tests.support.real import real_arrays

CONTACT = np.dtype([("onset", "<i8")])


def stamps(n, rate=1000.0, start=0):
    return start + np.round(np.arange(n) * NS / rate).astype(np.int64)


def contacts(seconds, side="right", late=0.0):
    """Contact events at `seconds`, reported `late` s afterwards."""
    onset = np.round(np.asarray(seconds, float) * NS).astype(np.int64)
    return StreamSpec((), CONTACT, units=("ns",), meta={"side": side}), onset + round(late * NS), onset.view(CONTACT)


def drive(operator, inputs, size=None, end=True):
    """Feed `inputs` (port: (spec, time, data[, {index: lost}])) in chunks of `size`, merged; gives {output: (spec, time, data)}."""
    operator = operator.unopened()
    specs = {port: given[0] for port, given in inputs.items()}
    outputs = operator.open(specs)
    merge = Merge(specs)
    found = {name: ([], []) for name in outputs}
    pieces = [piece for port, given in inputs.items() for piece in _pieces(port, given, size)]
    pieces.sort(key=lambda piece: piece[1].time[0])
    if end:
        pieces += [(port, Chunk(given[1][:0], given[2][:0], FOREVER)) for port, given in inputs.items()]
    for port, chunk in pieces:
        for name, piece in merge.push(port, chunk) if len(specs) > 1 else [(port, chunk)]:
            emitted = operator.process(name, piece)
            for output, out in [(next(iter(outputs)), emitted)] if isinstance(emitted, Chunk) else emitted or ():
                found[output][0].append(out.time)
                found[output][1].append(out.data)
    return {name: (outputs[name], np.concatenate(time), np.concatenate(data)) for name, (time, data) in found.items()}


def _pieces(port, given, size):
    time, data = given[1:3]
    lost = given[3] if len(given) > 3 else {}
    step = size or max(len(time), 1)
    edges = sorted({*range(0, len(time), step), *lost, len(time)})
    for a, b in pairwise(edges):
        yield port, Chunk(time[a:b], data[a:b], int(time[b - 1]), lost.get(a, 0))


def recording(name):
    """One of the real recordings; skips where it is not there."""
    return {key: array.copy() for key, array in real_arrays(f"emg/{name}.npz").items()}


def treadmill():
    """The treadmill recording: raw EMG, touch-downs and lift-offs as streams."""
    z = recording("emg_santuz_tw12")
    spec = StreamSpec((13,), rate_hz=1000.0, channels=tuple(map(str, z["names"])), units=("uV",))
    time = np.round(z["t_s"] * NS).astype(np.int64)
    return {
        "emg": (spec, time, z["emg_uV"].astype(float)),
        "touchdown": contacts(z["touchdown_s"]),
        "liftoff": contacts(z["liftoff_s"]),
    }


def enveloped(emg, **parameters):
    return drive(Envelope(**parameters), {"in": emg}, 100)["out"]
