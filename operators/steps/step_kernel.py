"""A step's numbers: the 26 features of three channels, and the 50 of six (thesis, chapter 7)."""

from __future__ import annotations

from math import cos, log, pi, sqrt

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.kernel import kernel

STATISTICS = ("mean", "sd", "least", "most", "rms", "entropy", "energy", "amplitude")
SENSOR = (("ax", "ay", "az"), ("gx", "gy", "gz"))
GRAVITY = (("a_vertical", "a_horizontal", "a_norm"), ("g_vertical", "g_horizontal", "g_norm"))
COUNT = 50
BINS = 16
FASTEST_HZ = 20.0
WEINBERG = 0.46


def feature_names(axes: str) -> list[str]:
    """The 50 features by name: step length and duration, then 8 of each channel of acceleration and of angular velocity."""
    channels = [name for three in (SENSOR if axes == "sensor" else GRAVITY) for name in three]
    return ["length", "duration", *(f"{channel} {what}" for channel in channels for what in STATISTICS)]


def chosen(features: str) -> list[int]:
    """Which of the 50 a set is of: acceleration (26), angular_velocity (26), both (50)."""
    first = {"acceleration": 2, "angular_velocity": 26, "both": 2}[features]
    return [0, 1, *range(first, first + (48 if features == "both" else 24))]


@kernel
def align(window: Samples, out: Samples) -> None:
    """Six channels (n, 6) as amounts that do not depend on how the sensor is turned, into `out` (n, 6).

    Along the mean acceleration, which is gravity's over a step: vertical; across it: horizontal; the norm. The same of angular velocity.
    """
    n = window.shape[0]
    gravity = np.zeros(3)
    for i in range(n):
        for c in range(3):
            gravity[c] += window[i, c]
    length = sqrt(gravity[0] ** 2 + gravity[1] ** 2 + gravity[2] ** 2)
    for c in range(3):
        gravity[c] = gravity[c] / length if length > 0.0 else 0.0
    for i in range(n):
        for first in (0, 3):
            up = square = 0.0
            for c in range(3):
                up += window[i, first + c] * gravity[c]
                square += window[i, first + c] * window[i, first + c]
            out[i, first] = up
            out[i, first + 1] = sqrt(max(square - up * up, 0.0))
            out[i, first + 2] = sqrt(square)


@kernel
def amplitude(x: Samples, mean: float, rate_hz: float) -> float:
    """The largest amplitude of a sine in `x` (n,), its mean taken off, at the window's own frequencies up to 20 Hz (Goertzel)."""
    n, count = x.shape[0], 0
    while count < n // 2 and (count + 1) * rate_hz / n <= FASTEST_HZ:
        count += 1
    turn, before, last = np.empty(count), np.zeros(count), np.zeros(count)
    for k in range(count):
        turn[k] = 2.0 * cos(2.0 * pi * (k + 1) / n)
    for i in range(n):  # the frequencies side by side: each alone would wait for its own last value
        value = x[i] - mean
        for k in range(count):
            now = value + turn[k] * last[k] - before[k]
            before[k], last[k] = last[k], now
    highest = 0.0
    for k in range(count):
        power = last[k] * last[k] + before[k] * before[k] - turn[k] * last[k] * before[k]
        highest = max(highest, 2.0 * sqrt(max(power, 0.0)) / n)
    return highest


@kernel
def entropy(x: Samples, least: float, most: float) -> float:
    """Shannon's, in nats, of a histogram of 16 equal bins from the least to the most value; 0 where all are equal."""
    counts, n = np.zeros(BINS), x.shape[0]
    if not most > least:
        return 0.0
    for i in range(n):
        counts[min(int((x[i] - least) / (most - least) * BINS), BINS - 1)] += 1.0
    total = 0.0
    for count in counts:
        if count > 0.0:
            total -= count / n * log(count / n)
    return total


@kernel
def describe(window: Samples, rate_hz: float, gravity: bool, scratch: Samples, out: Samples) -> None:
    """The 50 features of a step's samples `window` (n, 6) m/s2 and rad/s, into `out` (50,); `scratch` (n, 6) and (6, n) are written over.

    Step length is Weinberg's model (2002): 0.46 times the fourth root of the range of vertical acceleration.
    """
    n = window.shape[0]
    turned = np.empty((n, 6))
    align(window, turned)
    least = most = turned[0, 0]
    for i in range(n):
        least, most = min(least, turned[i, 0]), max(most, turned[i, 0])
    out[0] = WEINBERG * (most - least) ** 0.25
    out[1] = n / rate_hz
    for c in range(6):
        column = scratch[c, :n]
        for i in range(n):
            column[i] = turned[i, c] if gravity else window[i, c]
        total = square = 0.0
        least = most = column[0]
        for i in range(n):
            total += column[i]
            square += column[i] * column[i]
            least, most = min(least, column[i]), max(most, column[i])
        mean = total / n
        at = 2 + 8 * c
        if not np.isfinite(square):
            out[at : at + 8] = np.nan
            continue
        out[at], out[at + 1] = mean, sqrt(max(square / n - mean * mean, 0.0))
        out[at + 2], out[at + 3], out[at + 4] = least, most, sqrt(square / n)
        out[at + 5], out[at + 6] = entropy(column, least, most), square / rate_hz
        out[at + 7] = amplitude(column, mean, rate_hz)


@kernel
def turned_by(window: Samples, rate_hz: float) -> float:
    """By how much the body turned about the vertical, in degrees; to the left positive where the sensor measures reaction to gravity."""
    turned = np.empty(window.shape)
    align(window, turned)
    total = 0.0
    for i in range(window.shape[0]):
        total += turned[i, 3]
    return total / rate_hz * 180.0 / pi
