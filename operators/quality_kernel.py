"""What equal samples tell about an amplifier: clipping and dead channels."""

from __future__ import annotations

import math

from stream.chunk import Samples
from stream.kernel import kernel


@kernel
def runs(window: Samples, held: Samples, top: Samples, learn: bool, flat: int, counts: Samples) -> None:
    """Fill what is not finite in `window` (n, c), in place, and count per channel.

    held (c,)      the last finite value, which fills
    top (c,)       the largest amount so far; raised by this window if `learn`
    flat           from how many equal samples on they are a flat line
    counts (3, c)  written: samples in runs of 3 or more equal ones within 2 % of `top`, in runs of `flat` or more, and not finite
    """
    n = window.shape[0]
    for c in range(window.shape[1]):
        for i in range(n):
            if math.isfinite(window[i, c]):
                held[c] = window[i, c]
                if learn and abs(held[c]) > top[c]:
                    top[c] = abs(held[c])
            else:
                window[i, c] = held[c]
                counts[2, c] += 1
        i = 0
        while i < n:
            j = i + 1
            while j < n and window[j, c] == window[i, c]:
                j += 1
            if j - i >= 3 and top[c] > 0 and abs(window[i, c]) >= 0.98 * top[c]:
                counts[0, c] += j - i
            if j - i >= flat:
                counts[1, c] += j - i
            i = j
