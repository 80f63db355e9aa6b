"""The zero of a force plate, as the foot itself shows it: what the plate reads while the foot is in the air."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.kernel import kernel

BLOCK_S, WINDOW = 0.05, 80
"""Force is looked at in blocks of 50 ms, the latest 80 of them: 4 s, two or more strides."""
FLAT, WALKING, NOISES, PART = 3, 5.0, 4.0, 0.3
"""A swing is recognised by this many flat blocks in a row, in a window that spans this many thresholds; a contact begins at least this many
standard deviations of the noise above zero; a new zero counts by this part."""
FORGET = 0.98
"""What a swing block says of cross-talk fades by this factor with every later one."""

ZERO = np.dtype(
    [
        ("known", "<i8"),
        ("zero", "<f8"),
        ("noise", "<f8"),
        ("crosstalk", "<f8"),
        ("blocks", "<i8"),
        ("n", "<i8"),
        ("shift", "<f8"),
        ("sums", "<f8", (3,)),
        ("swings", "<f8", (5,)),
        ("means", "<f8", (WINDOW,)),
        ("others", "<f8", (WINDOW,)),
        ("sds", "<f8", (WINDOW,)),
    ]
)
"""What is known of a plate: its zero, noise and cross-talk; blocks so far since a gap; the open block's count, first value and sums of
(load, load^2, other); fading sums over swing blocks of 1, other, other^2, load, load other; a ring of blocks."""


@kernel
def forget(m: np.void) -> None:
    """After a gap: what was measured stays, the open window goes."""
    m["blocks"] = m["n"] = 0
    for k in range(3):
        m["sums"][k] = 0.0


@kernel
def close_block(m: np.void) -> None:
    """Add the open block to the ring: its mean, standard deviation, and the other plate's mean."""
    n, k = m["n"], m["blocks"] % WINDOW
    mean = m["sums"][0] / n
    m["means"][k], m["others"][k] = m["shift"] + mean, m["sums"][2] / n
    m["sds"][k] = math.sqrt(max(m["sums"][1] / n - mean * mean, 0.0) * n / max(n - 1, 1))
    forget_block(m)
    m["blocks"] += 1


@kernel
def forget_block(m: np.void) -> None:
    m["n"] = 0
    for k in range(3):
        m["sums"][k] = 0.0


@kernel
def look(m: np.void, threshold: float, most: float) -> None:
    """After a block: if the latest ones are the foot's swing, they are the plate's new zero, noise and cross-talk.

    They are if they are flat (within `threshold`), no higher than the lowest in the window (by less than `threshold`), within `most` of
    the zero so far (0 at first), and the window spans a stance; the middle one counts, which no contact reaches into. The first flat
    blocks are the tare.
    """
    count = min(m["blocks"], WINDOW)
    if m["blocks"] < FLAT:
        return
    low, high = math.inf, -math.inf
    for k in range(count):
        low, high = min(low, m["means"][k]), max(high, m["means"][k])
    first, last = math.inf, -math.inf
    for j in range(FLAT):
        k = (m["blocks"] - 1 - j) % WINDOW
        first, last = min(first, m["means"][k]), max(last, m["means"][k])
    middle = (m["blocks"] - 2) % WINDOW
    mean, noise = m["means"][middle], m["sds"][middle]
    swing = high - low > WALKING * threshold
    if last - first > threshold or mean > low + threshold or abs(mean - m["zero"]) > most or noise > 2.0 * threshold:
        return
    if not swing and m["known"]:
        return
    if swing:
        crosstalk(m, mean, m["others"][middle])
    other = m["crosstalk"] * m["others"][middle]
    part = PART if m["known"] and abs(mean - other - m["zero"]) < threshold else 1.0
    m["zero"] += part * (mean - other - m["zero"])
    m["noise"] += part * (noise - m["noise"])
    m["known"] = 1


@kernel
def crosstalk(m: np.void, load: float, other: float) -> None:
    """What part of the other plate's load this one shows while its own foot is in the air: least squares over swings, with a fading memory.

    Fitted from how the load moves with the other's within swings, so an offset does not matter. Known once the other has moved enough.
    """
    w = m["swings"]
    for k in range(5):
        w[k] *= FORGET
    w[0] += 1.0
    w[1] += other
    w[2] += other * other
    w[3] += load
    w[4] += load * other
    spread = w[2] - w[1] * w[1] / w[0]
    if w[0] < 5.0 or spread / w[0] < 100.0:
        return
    slope = (w[4] - w[1] * w[3] / w[0]) / spread
    m["crosstalk"] = min(max(slope, -0.3), 0.3)


@kernel
def zeroed(
    load: Samples, other: Samples, starts: Array, size: int, threshold: float, most: float, memory: Array, out: Samples
) -> None:
    """Write `load` (n,) less the plate's zero and cross-talk into `out` (n,), scaled so that a contact begins at `threshold`.

    other   (n,)  load of the other plate, 0 without one;  starts (n,) 1 where a gap ends: blocks do not reach across it
    memory  (1,)  of dtype ZERO
    Where the noise is high, a contact begins higher: at four standard deviations, where that is more than `threshold`.
    """
    m = memory[0]
    for i in range(load.shape[0]):
        if starts[i]:
            forget(m)
        if np.isfinite(load[i]) and np.isfinite(other[i]):
            if m["n"] == 0:
                m["shift"] = load[i]
            off = load[i] - m["shift"]
            m["n"] += 1
            m["sums"][0] += off
            m["sums"][1] += off * off
            m["sums"][2] += other[i]
            if m["n"] == size:
                close_block(m)
                look(m, threshold, most)
        begins = max(threshold, NOISES * m["noise"])
        out[i] = (load[i] - m["zero"] - m["crosstalk"] * other[i]) * (threshold / begins)
