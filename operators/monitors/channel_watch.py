"""Alarms about channels that are one (identical samples, far too alike), and about one that clips below its amplifier's range."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kinegraph.operators.monitors.latch import Latch
from kinegraph.stream.chunk import NEVER, Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.data.require import regular_signal
from kinegraph.stream.domain.alarm import FoundAlarms, alarm, alarm_chunk, alarms_spec
from kinegraph.stream.kernel import kernel
from kinegraph.stream.operator import Case, Operator, grid
from kinegraph.stream.params import param

SAME = "look at the leads and the channel list: two channels show one electrode pair"
CLIPS = "lower the gain, or see whether the electrode is loose: the peaks are cut off"
ALIKE = "look for swapped or doubled leads, a bridge of gel, electrodes too near to each other"


@kernel
def add_up(
    x: Samples, last: Samples, sums: Samples, products: Samples, same: Samples, moved: Samples, ends: Samples
) -> int:
    """Add the samples (n, c) to what a window has: sums (c,) and products (c, c) of the differences of neighbouring samples, pairs of equal
    samples (c, c), differences that are not 0 (c,); ends (4, c): the highest value, how often it came, the lowest, how often. `last`
    (c,) is the sample before. Returns how many differences there were."""
    counted = 0
    for i in range(x.shape[0]):
        whole = True
        for a in range(x.shape[1]):
            whole = whole and bool(np.isfinite(x[i, a] - last[a]))
        counted += 1 if whole else 0
        for a in range(x.shape[1]):
            step = x[i, a] - last[a]
            if whole:
                sums[a] += step
                moved[a] += 1.0 if step != 0.0 else 0.0
            for b in range(x.shape[1]):
                if whole:
                    products[a, b] += step * (x[i, b] - last[b])
                if x[i, a] == x[i, b] and np.isfinite(x[i, a]):
                    same[a, b] += 1.0
        for a in range(x.shape[1]):
            if not np.isfinite(x[i, a]):
                last[a] = np.nan
                continue
            if x[i, a] > ends[0, a]:
                ends[0, a], ends[1, a] = x[i, a], 0.0
            if x[i, a] < ends[2, a]:
                ends[2, a], ends[3, a] = x[i, a], 0.0
            ends[1, a] += 1.0 if x[i, a] == ends[0, a] else 0.0
            ends[3, a] += 1.0 if x[i, a] == ends[2, a] else 0.0
            last[a] = x[i, a]
    return counted


@dataclass(slots=True)
class ChannelWatchState:
    """
    filled, began        samples of the window under way, the first one's stamp;  last (c,) the sample before
    sums (c,), products (c, c), same (c, c)   of the differences of neighbouring samples in it; pairs of equal samples
    ends (4, c)          highest and lowest value in it, and how often each came
    alarms (c, c)        of pairs (1: same, 2: alike), on the diagonal of channels (3: clips)
    """

    filled: int
    began: int
    last: Samples
    counted: int
    sums: Samples
    products: Samples
    same: Samples
    moved: Samples
    ends: Samples
    alarms: Latch
    size: int
    names: list[str]


@dataclass(frozen=True, slots=True)
class ChannelWatch(Operator[ChannelWatchState]):
    """A raw signal of several channels in, an alarm for each pair of channels that is one, or nearly one, and for one that clips.

    Every `window_s` each pair is judged. "same samples as B": at least `same_share` of the samples are equal, in a channel that moves.
    "alike B": the differences of neighbouring samples (without offset, drift and movement) correlate by `most` or more, and by
    `above` more than the median pair does, so that mains hum on all channels is no alarm. Two windows in a row make an alarm, two
    sound ones end it. Stamped with the window's last sample.
    "clipping below the range": a window's highest or lowest value comes `clipped` times or more in a signal that hardly ever stands still
    (one of few steps is left alone). `SignalQuality` sees clipping at the end of the range only.

    >>> noise = np.random.default_rng(1).standard_normal((3000, 1)).repeat(2, axis=1)
    >>> found = ChannelWatch()(noise, rate_hz=1000, channels=["TA", "SO"], units=["uV"])
    >>> found[["subject", "what"]].tolist()
    [('TA', 'same samples as SO')]
    """

    window_s: float = param(1.0, above=0.0, most=60.0, help="how long a window is")
    same_share: float = param(0.9, above=0.0, most=1.0, help="share of equal samples from which channels are the same")
    most: float = param(0.9, above=0.0, most=1.0, help="correlation from which channels are alike")
    clipped: int = param(5, least=2, help="a window's highest or lowest value comes this often where it is cut off")
    above: float = param(0.3, least=0.0, most=1.0, help="by how much it exceeds that of the median pair")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        rate_hz = regular_signal(spec)
        c = spec.shape[0]
        names = list(spec.channels or [f"channel {i + 1}" for i in range(c)])
        square = (c, c)
        self.set_state(
            ChannelWatchState(
                0, NEVER, np.full(c, np.nan), 0, np.zeros(c), np.zeros(square), np.zeros(square), np.zeros(c), nothing(c),
                Latch.calm(c, c), max(2, round(self.window_s * rate_hz)), names,
            ),
            decision_s={"out": max(2, round(self.window_s * rate_hz)) / rate_hz},
        )  # fmt: skip
        return alarms_spec(spec.meta)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        found: FoundAlarms = []
        data, at = np.ascontiguousarray(chunk.data, np.float64), 0
        while at < len(chunk.time):
            n = min(s.size - s.filled, len(chunk.time) - at)
            s.began = int(chunk.time[at]) if s.filled == 0 else s.began
            s.counted += add_up(data[at : at + n], s.last, s.sums, s.products, s.same, s.moved, s.ends)
            s.filled += n
            at += n
            if s.filled == s.size:
                self._judge(found, int(chunk.time[at - 1]))
        return alarm_chunk(found, chunk)

    @classmethod
    def cases(cls) -> list[Case]:
        rng = np.random.default_rng(2)
        n = 3000
        x = rng.standard_normal((n, 4))
        x[400:1500, 1] = x[400:1500, 0]
        x[1000:2000, 3] = x[1000:2000, 2] + 0.1 * x[1000:2000, 3]
        spec = StreamSpec((4,), rate_hz=200.0, channels=("TA", "SO", "GM", "BF"), units=("uV",))
        return [Case(cls(), {"in": (spec, grid(200.0, n), x)}, least=4)]

    def _judge(self, found: FoundAlarms, stamp: int) -> None:
        s = self.state
        n = max(s.counted, 1)
        cov = s.products / n - (s.sums / n)[:, None] * (s.sums / n)
        with np.errstate(invalid="ignore", divide="ignore"):
            r = np.abs(cov / np.sqrt(np.diag(cov)[:, None] * np.diag(cov)))
        upper = np.triu_indices(len(r), 1)
        known = r[upper][np.isfinite(r[upper])]
        usual = float(np.median(known)) if len(known) > 2 else 0.0
        for a, b in zip(*(u.tolist() for u in upper), strict=True):
            same = s.same[a, b] >= self.same_share * s.size and s.moved[a] > 0.5 * s.counted
            alike = r[a, b] >= self.most and r[a, b] >= usual + self.above
            self._pair(found, stamp, a, b, 1 if same else 2 if alike else 0)
        for a in range(len(r)):
            cut = max(s.ends[1, a], s.ends[3, a]) >= self.clipped and s.moved[a] > 0.9 * s.counted
            self._pair(found, stamp, a, a, 3 if cut else 0)
        s.ends = nothing(len(r))
        s.filled = s.counted = 0
        s.sums, s.products, s.same, s.moved = (np.zeros_like(v) for v in (s.sums, s.products, s.same, s.moved))

    def _pair(self, found: FoundAlarms, stamp: int, a: int, b: int, kind: int) -> None:
        """An alarm stays of its kind until it is over."""
        s = self.state
        was = int(s.alarms.on[a, b])
        if not s.alarms.turns((a, b), was if kind and was else kind, 2):
            return
        if a == b:
            found.append(alarm(stamp, s.began, s.names[a], "clipping below the range", CLIPS if kind else ""))
            return
        what = f"{'same samples as' if (kind or was) == 1 else 'alike'} {s.names[b]}"
        since = stamp if not kind else s.began
        found.append(alarm(stamp, since, s.names[a], what, ("", SAME, ALIKE)[kind]))


def nothing(channels: int) -> Samples:
    """No highest and no lowest value."""
    return np.array([[-np.inf], [0.0], [np.inf], [0.0]]).repeat(channels, axis=1)
