"""Electrodes before the start: rest, contraction, crosstalk and hum of every channel, from some seconds of raw EMG."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.signal import butter, sosfiltfilt

from kinegraph.operators.emg.quality import MAX_NOISE_UV, MICROVOLTS, SignalQuality
from kinegraph.operators.monitors.electrode_watch import ADVICE
from kinegraph.stream.chunk import FOREVER, Chunk, Samples, StreamSpec, Times
from kinegraph.stream.domain.impedance import Impedance
from kinegraph.stream.errors import InputError

MIN_RISE = 3.0
"""A contraction comes to at least this many times the level at rest (rms)."""
SHARED, SAME = 0.5, 0.9
"""Correlation of two channels from which one hears the other's muscle, and from which both are the same signal."""
MAX_OHM = 50e3
"""Impedance above which an electrode is doubtful; from ten times that on it is bad."""
BLOCK_S = 0.1
HELD_BLOCKS = 5
"""A contraction is judged by its strongest half second, as `emg calibrate mvc` does by default: muscles may take turns."""
HELP = {
    **ADVICE,
    "no contraction": "contract this muscle; if you did, look whether the electrode lies over its belly and its cable is plugged in",
    "crosstalk": "move the electrode nearer to the middle of its muscle, or take a smaller distance between its poles",
    "impedance": "shave, abrade and clean the skin, take a fresh electrode or more gel; let it settle for some minutes",
    "not connected": "look whether the electrode sticks and its cable is plugged in; and the reference, if all are",
    "same signal": "two channels show one signal: look for swapped or doubled leads, or a bridge of gel or sweat",
}
"""What to do, by what is wrong."""


@dataclass(frozen=True, slots=True)
class Electrode:
    """What was found of one channel: levels as rms in the signal's unit; `flag` good, doubtful or bad; what is wrong, what to do.

    rest, contraction   the quietest tenth of the 100 ms at rest ends here; of the strongest half second the median 100 ms
    hum                 share of the power from 20 to 450 Hz in the mains' lines
    shared, with_       the highest correlation with another channel during the contraction, and that channel
    ohm                 what the device measured of each pole, + first; empty: it does not measure that
    """

    name: str
    rest: float
    contraction: float
    hum: float
    shared: float
    with_: str
    flag: str
    reason: str
    ohm: tuple[float, ...] = ()

    @property
    def advice(self) -> str:
        return HELP.get(self.reason, "")


def check_electrodes(
    spec: StreamSpec, time: Times, data: Samples, rest: tuple[float, float], contraction: tuple[float, float],
    impedances: Sequence[Impedance] = (), max_ohm: float = MAX_OHM,
) -> list[Electrode]:  # fmt: skip
    """Judge every channel of raw EMG (n, channels) by its impedances and its stages, (begin, end) in seconds from the first sample.

    The limits are those of `SignalQuality`, and ours: MIN_RISE, SHARED, SAME, MAX_OHM (`max_ohm`; ten times that is bad). Raises
    InputError where a stage holds less than a second.
    """
    seconds = (time - time[0]) / 1e9 if len(time) else np.empty(0)
    quiet, strong = (data[(seconds >= a) & (seconds < b)] for a, b in (rest, contraction))
    rate = spec.rate_hz or 0.0
    for name, stage in (("rest", quiet), ("contraction", strong)):
        if not rate or len(stage) < rate:
            raise InputError("in", f"{len(stage)} samples of {name}", "a second of it at least, at a regular rate")
    hum, flags, reasons = _quality(spec, time, data)
    below, above = np.quantile(_levels(quiet, rate), 0.1, axis=0), _strongest(_levels(strong, rate))
    shared, other = _shared(
        strong, rate, [k for k, reason in enumerate(reasons) if reason not in ("flat line", "mains hum")]
    )
    limit = MAX_NOISE_UV * MICROVOLTS.get(spec.units[0], np.inf)
    names = list(spec.channels) or [f"channel {k + 1}" for k in range(data.shape[1])]
    found = []
    for k, name in enumerate(names):
        flag, reason = flags[k], reasons[k]
        if reason in ("", "baseline noise"):
            flag, reason = _stages(below[k], above[k], shared[k], limit)
        ohm = tuple(each.ohm for each in impedances if each.channel == name)
        if ohm and (flag == "good" or not max(ohm) < 10 * max_ohm):
            flag, reason = _by_ohm(max(ohm), max_ohm)
        with_ = names[other[k]] if other[k] >= 0 else ""
        found.append(
            Electrode(name, float(below[k]), float(above[k]), float(hum[k]), float(shared[k]), with_, flag, reason, ohm)
        )
    return found


def _by_ohm(worst: float, most: float) -> tuple[str, str]:
    """Flag and reason by the impedance of a channel's worse pole."""
    if not np.isfinite(worst):
        return "bad", "not connected"
    return ("bad" if worst >= 10 * most else "doubtful", "impedance") if worst > most else ("good", "")


def _stages(rest: float, contraction: float, shared: float, limit: float) -> tuple[str, str]:
    """Flag and reason by the levels (rms) at rest and in contraction, and by the correlation with another channel."""
    if shared >= SAME:
        return "bad", "same signal"
    if rest > limit:
        return ("bad" if rest > 3 * limit else "doubtful"), "baseline noise"
    if not contraction >= MIN_RISE * rest:
        return "bad", "no contraction"
    return ("doubtful", "crosstalk") if shared >= SHARED else ("good", "")


def _quality(spec: StreamSpec, time: Times, data: Samples) -> tuple[Samples, list[str], list[str]]:
    """Hum, flag and reason per channel: over all windows, and of the worst window where one is bad."""
    operator = SignalQuality(reset_gap_s=1.0)
    operator.open({"in": spec})
    rows = operator.process("in", Chunk(time, data, FOREVER)).data
    hum, flags, reasons = np.zeros(data.shape[1]), [], []
    for k in range(data.shape[1]):
        own = rows[rows["channel"] == k]
        hum[k] = np.nanmax(own["hum"], initial=0.0)
        bad = own[(own["flag"] == "bad") & (own["reason"] != "baseline noise")]
        flags.append("bad" if len(bad) else str(own["session_flag"][-1]))
        reasons.append(str(bad["reason"][0] if len(bad) else own["session_reason"][-1]))
    return hum, flags, reasons


def _levels(data: Samples, rate_hz: float) -> Samples:
    """The rms (blocks, channels) of every 100 ms."""
    n = max(2, round(BLOCK_S * rate_hz))
    return np.asarray(np.nan_to_num(data)[: len(data) // n * n].reshape(-1, n, data.shape[1]).std(axis=1))


def _strongest(levels: Samples) -> Samples:
    """The highest level (channels,) that is held for half a second; the median of its blocks, so that a knock is no contraction."""
    held = np.lib.stride_tricks.sliding_window_view(levels, HELD_BLOCKS, axis=0)
    return np.asarray(np.median(held, axis=-1).max(axis=0))


def _shared(data: Samples, rate_hz: float, usable: list[int]) -> tuple[Samples, Times]:
    """The highest correlation (channels,) of each usable channel with another one above 20 Hz, and with which (-1 without one)."""
    best, other = np.zeros(data.shape[1]), np.full(data.shape[1], -1)
    x = sosfiltfilt(butter(4, 20.0, "highpass", fs=rate_hz, output="sos"), np.nan_to_num(data), axis=0)
    norm = np.sqrt((x**2).sum(axis=0))
    for a, b in combinations(usable, 2):
        r = abs(float((x[:, a] * x[:, b]).sum())) / (norm[a] * norm[b]) if norm[a] and norm[b] else 0.0
        for k, to in ((a, b), (b, a)):
            if r > best[k]:
                best[k], other[k] = r, to
    return best, other
