"""The envelope's inner loop: high-pass, rectify, low-pass and thin out, sample by sample (channels side by side)."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Array, Samples, Times
from kinegraph.stream.kernel import kernel


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
def envelope(
    x: Samples,
    time: Times,
    lost: int,
    hp_sos: Samples,
    hp_start: Samples,
    hp_z: Samples,
    back_z: Samples,
    ahead: Samples,
    taps: Samples,
    step: Times,
    rectified: Samples,
    lp_sos: Samples,
    lp_z: Samples,
    held: Samples,
    bad: Array,
    stamps: Times,
    count: Times,
    out: Samples,
    marks: Times,
) -> int:
    """Take the samples `x` (n, c); write what is then known of the envelope to `out`; returns the rows written.

    hp_sos     (s, 6)        high-pass (s = 0 without one), hp_z (s, 2, c) its memory, hp_start (s, 2) that for a constant 1
    ahead      (B + L, c)    what left the high-pass and is run through it backwards, B samples at a time, from L samples ahead
    back_z     (s, 2, c)     memory on the way back; B = 1, L = 0: there is no way back
    taps       (up, 2 h + 1) low-pass, one row for each position between two samples
    step       (3 + up,)     up, down, B, then the ns that each of the `up` positions lies after its sample
    rectified  (2 V, c)      the last V = 2 h + 1 rectified samples, each kept twice, V apart, so that a window never wraps
    lp_sos     (q, 6)        causal low-pass at the output's rate (q = 0 without one), lp_z (q, 2, c) its memory
    held       (c,)          the last finite value; NaN before the first; replaces what is not finite
    bad        (R, c), stamps (R, 2)   per recent input sample: whether it was not finite; its stamp, and `lost` just before it
    count      (4,)          samples taken, rectified, rows written since the start or the last reset; rows filled in `ahead`
    marks      (rows, 2)     written: the output's stamp, and `lost` just before it
    lost                     of the first sample of `x`

    Output m describes the position m down / up in samples. It is NaN where any sample since the previous output's was not finite.
    """
    block = step[2]
    work = out[out.shape[0] - 1 :]
    plain = sound(x, held)
    if plain and x.shape[0]:
        for c in range(x.shape[1]):
            held[c] = x[x.shape[0] - 1, c]
    rows = 0
    for i in range(x.shape[0]):
        slot = count[0] % stamps.shape[0]
        stamps[slot, 0] = time[i]
        stamps[slot, 1] = lost if i == 0 else 0
        for c in range(x.shape[1]):
            bad[slot, c] = 0
        if plain:
            run(hp_sos, hp_z, x, i, ahead, count[3])
        else:
            hold(x, i, held, bad, slot, ahead, count[3], hp_start, hp_z)
            run(hp_sos, hp_z, ahead, count[3], ahead, count[3])
        count[0] += 1
        count[3] += 1
        if count[3] < ahead.shape[0]:
            continue
        if ahead.shape[0] > 1:
            backward(hp_sos, back_z, ahead, block, work)
        for b in range(block):
            rows = low(ahead, b, taps, step, rectified, lp_sos, lp_z, bad, stamps, count, out, marks, rows)
        for b in range(block, ahead.shape[0]):
            for c in range(ahead.shape[1]):
                ahead[b - block, c] = ahead[b, c]
        count[3] -= block
    return rows


@kernel
def stamp(stamps: Times, sample: int, step: Times, phase: int, followed: bool) -> int:
    """When the position `phase` / up after `sample` is; at the earliest, where the next sample is not yet known (`followed`).

    After a stall a device's stamps may lie closer than its rate says: the position comes before the next sample all the same.
    """
    begin = stamps[sample % stamps.shape[0], 0]
    if phase == 0 or not followed:
        return int(begin + step[3])
    return int(min(begin + step[3 + phase], stamps[(sample + 1) % stamps.shape[0], 0] + step[3] - 1))


@kernel
def low(
    clean: Samples,
    at: int,
    taps: Samples,
    step: Times,
    rectified: Samples,
    lp_sos: Samples,
    lp_z: Samples,
    bad: Array,
    stamps: Times,
    count: Times,
    out: Samples,
    marks: Times,
    rows: int,
) -> int:
    """Rectify row `at` of `clean` and write the outputs that are then known; returns the rows written so far. See `envelope`."""
    up, down = step[0], step[1]
    long = taps.shape[1]
    newest = count[1]
    count[1] += 1
    here = newest % long
    for c in range(clean.shape[1]):
        rectified[here, c] = rectified[here + long, c] = abs(clean[at, c])
    while (count[2] * down) // up + long // 2 == newest:
        m = count[2]
        count[2] += 1
        phase = (m * down) % up
        first = (newest + 1) % long
        for c in range(out.shape[1]):
            out[rows, c] = 0.0
        for k in range(long):
            weight = taps[phase, k]
            for c in range(out.shape[1]):
                out[rows, c] += weight * rectified[first + k, c]
        run(lp_sos, lp_z, out, rows, out, rows)
        sample = newest - long // 2
        lost = 0
        for k in range(min(sample, ((m - 1) * down) // up + 1) if m > 0 else 0, sample + 1):
            slot = k % stamps.shape[0]
            lost = -1 if lost < 0 or stamps[slot, 1] < 0 else lost + stamps[slot, 1]
            stamps[slot, 1] = 0
            for c in range(out.shape[1]):
                if bad[slot, c]:
                    out[rows, c] = math.nan
        marks[rows, 0] = stamp(stamps, sample, step, phase, sample < newest)
        marks[rows, 1] = lost
        rows += 1
    return rows
