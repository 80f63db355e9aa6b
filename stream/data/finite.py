"""Bad samples: what is not a finite number is the one quiet NaN, so that the bytes that come out do not depend on what was bad."""

from __future__ import annotations

import math

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel


@kernel
def finite(v: float) -> float:
    """`v`, or the quiet NaN where it is infinite or any NaN; for kernels, into which it is inlined."""
    return v if abs(v) < math.inf else math.nan


def only_finite(x: Samples) -> Samples:
    """`finite` of every number of an array, outside of kernels."""
    return np.where(np.isfinite(x), x, np.nan)
