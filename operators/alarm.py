"""An alarm: something is wrong with what is being recorded, and somebody can still do something about it."""

from __future__ import annotations

import numpy as np

ALARM = np.dtype([("onset", "<i8"), ("subject", "<U16"), ("state", "<U8"), ("what", "<U64"), ("advice", "<U120")])
"""What is wrong, with whom (a channel, "contacts"), since when, and what to do; `state` is "on", or "over" when it has passed."""
ALARM_UNITS = ("ns", "", "", "", "")
ON, OVER = "on", "over"
