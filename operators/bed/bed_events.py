"""The events that tell who is in bed."""

from __future__ import annotations

import numpy as np

BED = np.dtype(
    [("onset", "<i8"), ("sleeper", "U16"), ("state", "U7"), ("height", "<f8"), ("raised", "<f8"), ("why", "U8")]
)
"""A sleeper is in bed, out of it, or unknown since `onset`; with the bed's mean height above the empty one, and the share raised.

why   of `unknown`: unseen, dark, camera (it was moved), still (no breath for long), region (something moves in an empty region); of `in`:
      body (there is, or seems to be, a second one), or ""
"""
UNKNOWN, IN, OUT = 0, 1, 2
NAMES = np.array(["unknown", "in", "out"])
