"""The EMG session computed plainly: whole recordings, numpy and scipy, one step after another. What the operators must agree with."""

from __future__ import annotations

import numpy as np
from scipy.signal import butter, sosfilt, sosfilt_zi


def zero_phase_envelope(x, fs, cutoff=20.0, order=4, highpass=20.0, highpass_order=2, up=3, down=25):
    """(n, c) raw EMG to (m, c): high-pass there and back in blocks, rectify, weigh with the low-pass's autocorrelation."""
    clean = np.abs(_there_and_back(x, fs, highpass, highpass_order, down // up + 1))
    h = _impulse(butter(order, cutoff, fs=fs * up, output="sos"), int(4 * order / cutoff * fs * up) + 2)
    g = np.array([h[: len(h) - lag] @ h[lag:] for lag in range(len(h))])
    half = g[: np.nonzero(np.abs(g) >= 1e-3 * g.max())[0][-1] + 2]
    reach = -(-len(half) // up)
    out = []
    m = 0
    while (m * down) // up + reach < len(clean):
        place = m * down / up
        base, total, weights = (m * down) // up, 0.0, 0.0
        for k in range(base - reach, base + reach + 1):
            lag = abs(k * up - m * down)
            if lag < len(half):
                weights += half[lag]
                total = total + (half[lag] * clean[k] if k >= 0 else 0.0)
        assert abs(place - base) < 1
        out.append(total / weights)
        m += 1
    return np.array(out)


def _there_and_back(x, fs, cutoff, order, block):
    sos = butter(order, cutoff, "highpass", fs=fs, output="sos")
    start = sosfilt_zi(sos)[:, :, None] * x[0]
    there, _ = sosfilt(sos, x, axis=0, zi=start)
    h = _impulse(sos, int(4 * order / cutoff * fs) + 2)
    g = np.array([h[: len(h) - lag] @ h[lag:] for lag in range(len(h))])
    ahead = np.nonzero(np.abs(g[1:]) >= 1e-3 * np.abs(g[1:]).max())[0][-1] + 3
    back = [
        sosfilt(sos, there[a : a + block + ahead][::-1], axis=0)[::-1][:block]
        for a in range(0, len(x) - block - ahead + 1, block)
    ]
    return np.concatenate(back)


def _impulse(sos, n):
    return sosfilt(sos, np.eye(1, n)[0])
