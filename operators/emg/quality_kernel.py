"""What equal samples tell about an amplifier: clipping and dead channels."""

from __future__ import annotations

import math

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.kernel import kernel

LEVELS = 32
"""A window with a range of fewer smallest steps is too coarse to detect clipping."""


@kernel
def runs(window: Samples, held: Samples, rails: Samples, full_scale: float, flat: int, counts: Samples) -> None:
    """Fill what is not finite in `window` (n, c), in place, and count per channel.

    held (c,)      the last finite value, which fills
    rails (2, c)   the lowest and the highest value so far; widened by this window
    full_scale     amounts from 0.99 of it on are clipped; 0: samples at the window's very highest (or lowest) value are, if there are 3 or
                   more of them, they lie within 2 % of the widest range so far of its end, and the window has levels enough
    flat           from how many equal samples on they are a flat line
    counts (3, c)  written: samples clipped, in runs of `flat` or more, and not finite
    """
    n = window.shape[0]
    for c in range(window.shape[1]):
        step = math.inf
        low, high, lows, highs, beyond = math.inf, -math.inf, 0, 0, 0
        run = 1
        for i in range(n):
            v = window[i, c]
            if not math.isfinite(v):
                counts[2, c] += 1
                v = held[c]
                window[i, c] = v
            held[c] = v
            if i and v == window[i - 1, c]:
                run += 1
                if run == flat:
                    counts[1, c] += flat
                elif run > flat:
                    counts[1, c] += 1
            else:
                if i:
                    step = min(step, abs(v - window[i - 1, c]))
                run = 1
            if v < low:
                low, lows = v, 0
            if v > high:
                high, highs = v, 0
            lows += v == low
            highs += v == high
            beyond += abs(v) >= 0.99 * full_scale
        rails[0, c] = min(rails[0, c], low)
        rails[1, c] = max(rails[1, c], high)
        near = 0.02 * (rails[1, c] - rails[0, c])
        if full_scale > 0:
            counts[0, c] += beyond
        elif high - low >= LEVELS * step:
            if lows >= 3 and low - rails[0, c] <= near:
                counts[0, c] += lows
            if highs >= 3 and rails[1, c] - high <= near:
                counts[0, c] += highs


@kernel
def powers(spectrum: Array, weights: Samples, out: Samples) -> None:
    """The power of `spectrum` (c, f) complex, weighted and added up over its lines: out[k, c] = sum of weights[k, i] |spectrum[c, i]|^2."""
    for c in range(spectrum.shape[0]):
        for k in range(weights.shape[0]):
            out[k, c] = 0.0
        for i in range(spectrum.shape[1]):
            power = spectrum[c, i].real ** 2 + spectrum[c, i].imag ** 2
            for k in range(weights.shape[0]):
                out[k, c] += weights[k, i] * power
