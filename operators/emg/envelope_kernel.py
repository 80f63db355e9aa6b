"""The envelope's inner loop: high-pass, rectify, low-pass and thin out, sample by sample (channels side by side)."""

from __future__ import annotations

import math
from dataclasses import dataclass

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.compiler.record import numbers_of, record
from kinegraph.stream.kernel import kernel


class EnvelopeNumbers:
    up: int
    down: int
    block: int
    taken: int
    rectified: int
    written: int
    filled: int
    last: int
    limit: int


@record
@dataclass(slots=True)
class EnvelopeState(EnvelopeNumbers):
    """
    up, down   output over input rate; `after` (up,): the ns that each of the `up` positions lies after its sample
    block      B, how many samples are filtered backwards at a time
    hp_sos     (s, 6)        high-pass (s = 0 without one), hp_z (s, 2, c) its memory, hp_start (s, 2) that for a constant 1
    ahead      (B + L, c)    what left the high-pass and is run through it backwards, B samples at a time, from L samples ahead
    back_z     (s, 2, c)     memory on the way back; B = 1, L = 0: there is no way back
    taps       (up, 2 h + 1) low-pass, one row for each position between two samples
    window     (2 V, c)      the last V = 2 h + 1 rectified samples, each kept twice, V apart, so that a window never wraps
    lp_sos     (q, 6)        causal low-pass at the output's rate (q = 0 without one), lp_z (q, 2, c) its memory
    held       (c,)          the last finite value; NaN before the first; replaces what is not finite
    bad        (R, c), stamps (R, 2)   per recent input sample: whether it was not finite; its stamp, and `lost` just before it
    taken, rectified, written   samples taken, rectified, rows written since the start or the last reset; filled: rows in `ahead`
    last, limit   stamp of the latest sample; how much later the next may come without a reset, ns
    """

    numbers: Array
    after: Times
    hp_sos: Samples
    hp_start: Samples
    hp_z: Samples
    back_z: Samples
    ahead: Samples
    taps: Samples
    window: Samples
    lp_sos: Samples
    lp_z: Samples
    held: Samples
    bad: Array
    stamps: Times


NUMBERS = numbers_of(EnvelopeNumbers)


@kernel
def gap(time: Times, before: int, limit: int, start: int) -> int:
    """The first place from `start` on where a stamp lies more than `limit` after the one before it (`before` the first); else len(time)."""
    place: int = time.shape[0]
    for i in range(start, time.shape[0]):
        if time[i] - (time[i - 1] if i else before) > limit:
            place = i
            break
    return place


@kernel
def run(sos: Samples, z: Samples, source: Samples, i: int, rows: Samples, j: int) -> None:
    """Row i of `source` (n, c) through the sections (s, 6) into row j of `rows`, memory z (s, 2, c).

    Transposed direct form II, operations in scipy's order.
    """
    for c in range(rows.shape[1]):
        rows[j, c] = source[i, c]
    for s in range(sos.shape[0]):
        b0, b1, b2, a1, a2 = sos[s, 0], sos[s, 1], sos[s, 2], sos[s, 4], sos[s, 5]
        for c in range(rows.shape[1]):
            v = rows[j, c]
            y = b0 * v + z[s, 0, c]
            z[s, 0, c] = b1 * v - a1 * y + z[s, 1, c]
            z[s, 1, c] = b2 * v - a2 * y
            rows[j, c] = y


@kernel
def sound(x: Samples, held: Samples) -> bool:
    """Whether every value is finite, and every channel has had one before."""
    bad = 0
    for c in range(held.shape[0]):
        bad += math.isnan(held[c])
    for i in range(x.shape[0]):
        for c in range(x.shape[1]):
            bad += not math.isfinite(x[i, c])
    return bad == 0


@kernel
def hold(
    x: Samples, i: int, held: Samples, bad: Array, slot: int, to: Samples, at: int, start: Samples, z: Samples
) -> None:
    """Copy row i of `x` to row `at` of `to`; the last finite value (`held`) replaces what is not finite, which `bad` notes.

    A channel's first finite value also sets the sections' memory as if it had always been there: no step from an offset.
    """
    for c in range(x.shape[1]):
        v = x[i, c]
        if not math.isfinite(v):
            bad[slot, c] = 1
            v = 0.0 if math.isnan(held[c]) else held[c]
        elif math.isnan(held[c]):
            for s in range(start.shape[0]):
                z[s, 0, c] = start[s, 0] * v
                z[s, 1, c] = start[s, 1] * v
            held[c] = v
        else:
            held[c] = v
        to[at, c] = v


@kernel
def backward(sos: Samples, z: Samples, ahead: Samples, block: int, work: Samples) -> None:
    """Filter the rows of `ahead` from the last to the first, from rest; the first `block` rows are replaced by what comes out.

    work (1, c): written over.
    """
    for s in range(z.shape[0]):
        for c in range(z.shape[2]):
            z[s, 0, c] = z[s, 1, c] = 0.0
    for i in range(ahead.shape[0] - 1, block - 1, -1):
        run(sos, z, ahead, i, work, 0)
    for i in range(block - 1, -1, -1):
        run(sos, z, ahead, i, ahead, i)


@kernel
def envelope(s: EnvelopeState, x: Samples, time: Times, lost: int, out: Samples, marks: Times) -> int:
    """Take the samples `x` (n, c), `lost` before them; write what is then known of the envelope to `out`; returns the rows written.

    marks  (rows, 2)  written: the output's stamp, and `lost` just before it

    Output m describes the position m down / up in samples. It is NaN where any sample since the previous output's was not finite.
    """
    ahead, hp_sos, hp_z, bad, stamps, block = s.ahead, s.hp_sos, s.hp_z, s.bad, s.stamps, s.block
    work = out[out.shape[0] - 1 :]
    plain = sound(x, s.held)
    if plain and x.shape[0]:
        for c in range(x.shape[1]):
            s.held[c] = x[x.shape[0] - 1, c]
    rows = 0
    for i in range(x.shape[0]):
        slot = s.taken % stamps.shape[0]
        stamps[slot, 0] = time[i]
        stamps[slot, 1] = lost if i == 0 else 0
        for c in range(x.shape[1]):
            bad[slot, c] = 0
        filled = s.filled
        if plain:
            run(hp_sos, hp_z, x, i, ahead, filled)
        else:
            hold(x, i, s.held, bad, slot, ahead, filled, s.hp_start, hp_z)
            run(hp_sos, hp_z, ahead, filled, ahead, filled)
        s.taken += 1
        s.filled = filled + 1
        if s.filled < ahead.shape[0]:
            continue
        if ahead.shape[0] > 1:
            backward(hp_sos, s.back_z, ahead, block, work)
        for b in range(block):
            rows = low(s, b, out, marks, rows)
        for b in range(block, ahead.shape[0]):
            for c in range(ahead.shape[1]):
                ahead[b - block, c] = ahead[b, c]
        s.filled -= block
    return rows


@kernel
def stamp(stamps: Times, sample: int, after: Times, phase: int, followed: bool) -> int:
    """When the position `phase` / up after `sample` is; at the earliest, where the next sample is not yet known (`followed`).

    After a stall a device's stamps may lie closer than its rate says: the position comes before the next sample all the same.
    """
    begin = stamps[sample % stamps.shape[0], 0]
    if phase == 0 or not followed:
        return int(begin + after[0])
    return int(min(begin + after[phase], stamps[(sample + 1) % stamps.shape[0], 0] + after[0] - 1))


@kernel
def low(s: EnvelopeState, at: int, out: Samples, marks: Times, rows: int) -> int:
    """Rectify row `at` of `ahead` and write the outputs that are then known; returns the rows written so far. See `envelope`."""
    clean, taps, window, stamps, up, down = s.ahead, s.taps, s.window, s.stamps, s.up, s.down
    long = taps.shape[1]
    newest = s.rectified
    s.rectified += 1
    here = newest % long
    for c in range(clean.shape[1]):
        window[here, c] = window[here + long, c] = abs(clean[at, c])
    while (s.written * down) // up + long // 2 == newest:
        m = s.written
        s.written += 1
        phase = (m * down) % up
        first = (newest + 1) % long
        for c in range(out.shape[1]):
            out[rows, c] = 0.0
        for k in range(long):
            weight = taps[phase, k]
            for c in range(out.shape[1]):
                out[rows, c] += weight * window[first + k, c]
        run(s.lp_sos, s.lp_z, out, rows, out, rows)
        sample = newest - long // 2
        lost = 0
        for k in range(min(sample, ((m - 1) * down) // up + 1) if m > 0 else 0, sample + 1):
            slot = k % stamps.shape[0]
            lost = -1 if lost < 0 or stamps[slot, 1] < 0 else lost + stamps[slot, 1]
            stamps[slot, 1] = 0
            for c in range(out.shape[1]):
                if s.bad[slot, c]:
                    out[rows, c] = math.nan
        marks[rows, 0] = stamp(stamps, sample, s.after, phase, sample < newest)
        marks[rows, 1] = lost
        rows += 1
    return rows
