"""The EMG session computed plainly: whole recordings, numpy and scipy, one step after another. What the operators must agree with."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.signal import butter, sosfilt, sosfilt_zi


def zero_phase_envelope(x, fs, cutoff=20.0, order=4, highpass=20.0, highpass_order=2, up=3, down=25):
    """(n, c) raw EMG to (m, c): high-pass there and back in blocks, rectify, weigh with the low-pass's autocorrelation."""
    clean = np.abs(_there_and_back(x, fs, highpass, highpass_order, round(0.02 * fs)))
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


def cycles(time, signal, touchdowns):
    """(k, 100, c): each cycle at 0..99 %, read from the cubic through the samples with central (parabola) slopes. Times in s."""
    curve = CubicHermiteSpline(time, signal, np.gradient(signal, time, axis=0))
    return np.array([curve(a + (b - a) * np.arange(100) / 100) for a, b in pairwise(touchdowns)])


def statistics(curves, touchdowns, liftoffs):
    """{name: (k, c)} per cycle and muscle."""
    duration = np.diff(touchdowns)[:, None]
    stance = np.array([(lift - a) / (b - a) for (a, b), lift in zip(pairwise(touchdowns), liftoffs, strict=False)])
    standing = np.arange(100)[None, :] / 100 < stance[:, None]
    mean = np.array([c.mean(axis=0) for c in curves])
    deviation = np.full(mean.shape, np.nan)
    for k in range(1, len(curves)):
        before = curves[:k].mean(axis=0)
        deviation[k] = np.linalg.norm(curves[k] - before, axis=0) / curves[: k + 1].max(axis=(0, 1))
    return {
        "peak": curves.max(axis=1),
        "peak_pct": curves.argmax(axis=1).astype(float),
        "mean": mean,
        "integrated": mean * duration,
        "mean_stance": np.array([c[s].mean(axis=0) for c, s in zip(curves, standing, strict=True)]),
        "mean_swing": np.array([c[~s].mean(axis=0) for c, s in zip(curves, standing, strict=True)]),
        "integrated_stance": np.array([c[s].sum(axis=0) for c, s in zip(curves, standing, strict=True)])
        * duration
        / 100,
        "integrated_swing": np.array([c[~s].sum(axis=0) for c, s in zip(curves, standing, strict=True)])
        * duration
        / 100,
        "deviation": deviation,
    }


def variance_ratio(curves):
    """Hershler and Milner 1978, term by term; (c,)."""
    n, k = curves.shape[:2]
    about_curve = ((curves - curves.mean(axis=0)) ** 2).sum(axis=(0, 1)) / (k * (n - 1))
    about_grand = ((curves - curves.mean(axis=(0, 1))) ** 2).sum(axis=(0, 1)) / (k * n - 1)
    return about_curve / about_grand


def variation(curves):
    """Winter's CV in %; (c,)."""
    sd = curves.std(axis=0, ddof=1)
    return 100 * np.sqrt((sd**2).mean(axis=0)) / np.abs(curves.mean(axis=0)).mean(axis=0)


def deviations(curves):
    """The thesis's tables 6.1: mean distance of a cycle to the mean curve, and mean absolute deviation of the distances."""
    scaled = curves / curves.max(axis=(0, 1))
    distance = np.array([np.linalg.norm(c - scaled.mean(axis=0), axis=0) for c in scaled])
    return distance.mean(axis=0), np.abs(distance - distance.mean(axis=0)).mean(axis=0)


def co_contraction(a, b):
    """Falconer and Winter 1985, in %: twice the common area over the sum of both."""
    return 100 * 2 * np.minimum(a, b).sum() / (a.sum() + b.sum())


def local_maxima(curve):
    """Positions p in 1..98 of a (100,) curve that are higher than both neighbours."""
    return [p for p in range(1, 99) if curve[p - 1] < curve[p] > curve[p + 1]]
