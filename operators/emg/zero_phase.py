"""Zero-phase Butterworth filters that can run live: symmetric FIR filters with a short, stated look-ahead.

Filtering forwards and then backwards (`sosfiltfilt`) needs the whole recording. Its effect, though, is that of one symmetric impulse
response, the autocorrelation of the causal filter's, which dies away within a fraction of a second. Cut off where it has, it is an FIR
filter that delays every frequency by the same time, so that subtracting that time from the stamps leaves peaks where they are.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from kinegraph.stream.chunk import Samples
from kinegraph.stream.data.design_cache import remembered

TAIL = 1e-3
"""The response is cut off where all that follows stays below this part of its largest tap."""


@remembered
def lowpass_phases(cutoff_hz: float, order: int, rate_hz: float, up: int) -> Samples:
    """Taps of the squared Butterworth low-pass, for samples at `rate_hz` read at `up` positions between two of them.

    Returns (up, 2 h + 1): row r, column h + k weighs the sample k places after the one at or before the position, where the position lies
    r / up of a sample after that one. Each row adds up to 1, so that a constant passes unchanged whatever the position.

    As an anti-alias filter: at order 4, what lies 3 times above the cut-off is attenuated by 76 dB, 5 times above by 112 dB.
    """
    half = _response(cutoff_hz, order, rate_hz * up, "lowpass")
    h = -(-len(half) // up)
    taps = np.zeros((up, 2 * h + 1))
    offsets = np.abs(np.arange(-h, h + 1)[None, :] * up - np.arange(up)[:, None])
    inside = offsets < len(half)
    taps[inside] = half[offsets[inside]]
    return np.asarray(taps / taps.sum(axis=1, keepdims=True), np.float64)


@remembered
def highpass_reach(cutoff_hz: float, order: int, rate_hz: float) -> int:
    """How many samples ahead a backward pass of the Butterworth high-pass must begin for its start from rest to have died away."""
    return len(_response(cutoff_hz, order, rate_hz, "highpass"))


@remembered
def antialias_phases(pass_hz: float, stop_hz: float, rate_hz: float, up: int) -> Samples:
    """Taps like `lowpass_phases`, of a Kaiser-windowed low-pass, 60 dB down at `stop_hz`: the plain reduction before a causal filter."""
    from scipy.signal import firwin, kaiserord

    wide = rate_hz * up
    count, beta = kaiserord(60.0, (stop_hz - pass_hz) / (wide / 2))
    half = firwin(count | 1, (stop_hz + pass_hz) / 2, window=("kaiser", beta), fs=wide)[count // 2 :]
    h = -(-len(half) // up)
    offsets = np.abs(np.arange(-h, h + 1)[None, :] * up - np.arange(up)[:, None])
    taps = np.where(offsets < len(half), half[np.minimum(offsets, len(half) - 1)], 0.0)
    return np.ascontiguousarray(taps / taps.sum(axis=1, keepdims=True))


def _response(cutoff_hz: float, order: int, rate_hz: float, kind: Literal["lowpass", "highpass"]) -> Samples:
    """One half of the autocorrelation of a Butterworth filter's impulse response, from lag 0 to where it has died away."""
    from scipy.signal import butter, fftconvolve, sosfilt

    seconds = 4.0 * order / cutoff_hz
    impulse = np.zeros(int(seconds * rate_hz) + 2)
    impulse[0] = 1.0
    h = sosfilt(butter(order, cutoff_hz, kind, fs=rate_hz, output="sos"), impulse)
    half = np.asarray(fftconvolve(h, h[::-1])[len(h) - 1 :], np.float64)
    reach = np.abs(half[1:]) if kind == "highpass" else np.abs(half)
    alive = np.nonzero(reach >= TAIL * reach.max())[0]
    return half[: int(alive[-1]) + 2 + (kind == "highpass")]
