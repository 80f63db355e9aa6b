"""Spectrum and spectrogram of what a signal's panel shows, made when somebody asks for them: in the page's server, from every sample."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.page.transfer.downsample import as_rows
from kinegraph.devices.page.transfer.wire import Analyse, encode
from kinegraph.stream.chunk import Array, Samples, StreamSpec, Times

FINE_S, COARSE_S = 1.0, 0.25
"""About how long a window is: of a spectrum, and of a spectrogram."""
LEAST, FINEST, COARSEST = 16, 4096, 512
MOST_VALUES = 1 << 21
MAX_COLUMNS = 300


def window_of(rate_hz: float, seconds: float, most: int) -> int:
    """Samples of a window: a power of two."""
    return int(np.clip(1 << round(np.log2(max(rate_hz * seconds, 1.0))), LEAST, most))


def windows(time: Times, size: int, hop: int, period_ns: int) -> NDArray[np.intp]:
    """Where windows begin that no gap interrupts: `size` samples each, `hop` apart."""
    starts = np.arange(0, len(time) - size + 1, hop)
    return starts[time[starts + size - 1] - time[starts] < (size + 0.5) * period_ns] if len(starts) else starts


def densities(rows: Samples, starts: NDArray[np.intp], size: int, rate_hz: float) -> NDArray[np.float64]:
    """Power spectral density (windows, bins, c) in unit^2/Hz of `rows` (n, c): each window without its mean, under a Hann window,
    one-sided. Their mean is Welch's estimate (1967), as scipy.signal.welch gives it; a window with a NaN is NaN."""
    hann = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(size) / size)
    parts = rows[starts[:, None] + np.arange(size)]
    found = np.abs(np.fft.rfft((parts - parts.mean(axis=1, keepdims=True)) * hann[:, None], axis=1)) ** 2
    found /= rate_hz * (hann**2).sum()
    found[:, 1 : size // 2] *= 2
    return found


def analysed(number: int, spec: StreamSpec, asked: Analyse, time: Times, data: Array, t0_ns: int) -> bytes:
    """The message that answers: a spectrum of all channels, or one channel's spectrogram. Without a whole window it holds no bins."""
    rate_hz = float(spec.rate_hz or 0.0)
    rows = as_rows(data)[-MOST_VALUES // max(1, spec.shape[0]) :].astype(np.float64)
    time = time[len(time) - len(rows) :]
    header: dict[str, Any] = {
        "t": asked.what,
        "s": number,
        "begin": asked.begin,
        "end": asked.end,
        "channel": asked.channel,
    }
    if asked.what == "spectrum":
        size = min(window_of(rate_hz, FINE_S, FINEST), window_of(max(len(rows), 1), 0.25, FINEST))
        each = densities(rows, windows(time, size, size // 2, spec.period_ns), size, rate_hz)
        each = each[np.isfinite(each).all(axis=(1, 2))] if len(rows) else each
        header |= {"bins": size // 2 + 1 if len(each) else 0, "bin_hz": rate_hz / size, "windows": len(each)}
        mean = each.mean(axis=0).T if len(each) else np.empty(0)
        return encode(header, np.ascontiguousarray(mean, "<f4").tobytes())
    size = window_of(rate_hz, COARSE_S, COARSEST)
    hop = max(size // 4, -(-len(rows) // MAX_COLUMNS))
    starts = windows(time, size, hop, spec.period_ns)
    each = densities(rows[:, asked.channel : asked.channel + 1], starts, size, rate_hz)[..., 0]
    middles = (time[starts] + size * spec.period_ns // 2 - t0_ns) / 1e9
    header |= {
        "bins": size // 2 + 1 if len(each) else 0,
        "bin_hz": rate_hz / size,
        "windows": len(each),
        "hop": hop / rate_hz,
    }
    level = 10 * np.log10(np.maximum(each, 1e-30))
    return encode(header, middles.astype("<f8").tobytes(), np.ascontiguousarray(level, "<f4").tobytes())
