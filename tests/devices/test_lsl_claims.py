"""A sender with another rate than it declares, or with stamps of another clock, is named."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from kinegraph.devices.clocks.rate_check import Policy
from kinegraph.devices.lsl.metadata import Described
from kinegraph.devices.lsl.pull import Pull
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.errors import RunError
from tests.support.device_feed import Kept

ZERO = 1_700_000_000 * NS


class ScriptedFeed(Kept):
    """A feed at the time of the script."""

    at = 0.0

    def now(self) -> int:
        return ZERO + round(self.at * NS)

    def local_clock(self) -> float:
        return self.at


class Sender:
    """Declares `declared` Hz, and sends blocks of 0.1 s at `sent` Hz for 12 s, with stamps that are `epoch` later than its clock."""

    def __init__(self, feed: ScriptedFeed, declared: float, sent: float, epoch: float = 0.0) -> None:
        self.described = Described("s", "EEG", "id", "elsewhere", "float32", 1, declared)
        self.lsl, self._feed, self._sent, self._epoch, self._made = feed, feed, sent, epoch, 0

    def pull(self) -> tuple[Array, Samples]:
        self._feed.at += 0.1
        if self._feed.at > 12.0:
            self._feed.stop()
        until = int(self._feed.at * self._sent)
        stamps = np.arange(self._made, until) / self._sent + self._epoch
        self._made = until
        return np.zeros((len(stamps), 1), np.float32), stamps

    def correction(self) -> float:
        return 0.0

    def uncertainty(self) -> float:
        return 0.0

    def has_our_clock(self, stamp: float) -> bool:
        return True

    def has_reconnected(self) -> bool:
        return False


def findings(declared: float, sent: float, epoch: float = 0.0, policy: Policy = "warn") -> list[Any]:
    feed = ScriptedFeed()
    sender = Sender(feed, declared, sent, epoch)
    Pull(sender, sender.described.spec, feed, 0.5, 0.0, 5.0, policy).run()  # type: ignore[arg-type]
    return [(kind, facts) for kind, facts in feed.reports if kind in ("rate mismatch", "stamps of another clock")]


@pytest.mark.parametrize(("declared", "sent"), [(250.0, 125.0), (256.0, 250.0), (100.0, 250.0)])
def test_a_wrong_rate_is_found_within_seconds(declared: float, sent: float) -> None:
    [(kind, facts)] = findings(declared, sent)
    assert (
        kind == "rate mismatch"
        and facts["declared_hz"] == declared
        and facts["measured_hz"] == pytest.approx(sent, rel=1e-3)
    )


@pytest.mark.parametrize("sent", [250.0, 250.4, 249.6])
def test_a_clock_that_is_a_little_off_is_no_wrong_rate(sent: float) -> None:
    assert findings(250.0, sent) == []


def test_a_wrong_rate_ends_the_session_where_that_is_wanted() -> None:
    with pytest.raises(RunError, match="is not as declared"):
        findings(250.0, 125.0, policy="fail")


def test_stamps_of_another_epoch_are_named_once() -> None:
    [(kind, facts)] = findings(250.0, 250.0, epoch=1.7e9)
    assert kind == "stamps of another clock" and facts["shifted_s"] == pytest.approx(-1.7e9, abs=0.01)
