"""What piled up before a stream was read is handed over in as few reads as it fills, without a pause between them: no lag stays behind."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.lsl.metadata import Described
from kinegraph.devices.lsl.pull import Pull
from kinegraph.stream.chunk import Array, Samples
from tests.support.device_feed import Kept

RATE_HZ = 2000.0
ROOM = 4096


class Clock:
    """LSL's local clock, which stands where the script has it."""

    at = 0.0

    def local_clock(self) -> float:
        return self.at


class Scripted:
    """A connection on which `backlog` samples wait; then ten come with each read, just made. Stops the feed after `reads` reads."""

    described = Described("s", "EMG", "id", "elsewhere", "float32", 1, RATE_HZ)

    def __init__(self, feed: Kept, backlog: int, reads: int, unmeasured: int) -> None:
        self.lsl = Clock()
        self.lsl.at = backlog / RATE_HZ
        self._feed, self._waiting, self._left, self._unmeasured = feed, backlog, reads, unmeasured
        self._made = 0
        self.emitted_before: list[int] = []
        """How many samples had been handed over when each read began."""

    def pull(self) -> tuple[Array, Samples]:
        self.emitted_before.append(sum(len(c.time) for c in self._feed.chunks.get("out", [])))
        self._left -= 1
        if not self._left:
            self._feed.stop()
        if not self._waiting:
            self.lsl.at += 10 / RATE_HZ
            self._waiting = 10
        n = min(self._waiting, ROOM)
        self._waiting -= n
        stamps = np.arange(self._made, self._made + n) / RATE_HZ
        self._made += n
        return np.zeros((n, 1), np.float32), stamps

    def correction(self) -> float | None:
        self._unmeasured -= 1
        if self._unmeasured >= 0:
            self._waiting += 20  # it piles up while the clocks are compared
            return None
        return 0.0

    def uncertainty(self) -> float:
        return 0.0

    def has_our_clock(self, stamp: float) -> bool:
        return False

    def has_reconnected(self) -> bool:
        return False


@pytest.mark.parametrize("unmeasured", [0, 30])
@pytest.mark.parametrize("backlog", [10, 4000, 10_000])
def test_a_backlog_is_gone_after_the_reads_that_it_fills(
    backlog: int, unmeasured: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    feed = Kept()
    waits: list[float] = []
    monkeypatch.setattr(feed, "wait", lambda seconds: waits.append(seconds) or False)
    connection = Scripted(feed, backlog, 20, unmeasured)
    Pull(connection, Scripted.described.spec, feed, 0.5, 0.0, 5.0).run()  # type: ignore[arg-type]
    reads = np.diff([*connection.emitted_before, sum(len(c.time) for c in feed.chunks["out"])])
    full = -(-(backlog + 20 * unmeasured) // ROOM) + 1
    assert (reads[full:] == 10).all(), (
        "after that every read brings what was just made, and hands it over before the next"
    )
    assert reads[:full].sum() >= backlog
    assert len(waits) <= unmeasured, "nothing but the comparison of the clocks is waited for, and that once"


class Garbled(Scripted):
    """Some stamps and samples of the fifth read are bits that no clock and no amplifier gives."""

    def pull(self) -> tuple[Array, Samples]:
        data, stamps = super().pull()
        if len(self.emitted_before) == 5:
            stamps[:4] = [1e300, -1e300, np.inf, np.nan]
            data[4] = np.array([0x7F800001], np.uint32).view(np.float32)  # a NaN that processors signal for
        return data, stamps


def test_impossible_stamps_and_signalling_nans_do_not_end_the_reading() -> None:
    feed = Kept()
    connection = Garbled(feed, 10, 10, 0)
    Pull(connection, Scripted.described.spec, feed, 0.5, 0.0, 5.0).run()  # type: ignore[arg-type]
    assert feed.count("out") == 100 and feed.problems["impossible stamp"] == 4
    assert np.flatnonzero(np.isnan(feed.data("out")[:, 0])).tolist() == [44]
    assert (np.diff(feed.time("out")) >= 0).all()
