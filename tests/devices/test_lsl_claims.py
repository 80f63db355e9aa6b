"""A sender with another rate than it declares, or with stamps of another clock, is named."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from kinegraph.devices.lsl.inlet import LslInlet
from kinegraph.devices.lsl.metadata import Described, differences, marker_spec
from kinegraph.devices.lsl.pull import Pull
from kinegraph.stream.chunk import NS, Array, Samples
from kinegraph.stream.domain.claims import ClaimGate
from kinegraph.stream.domain.finding import REPORT, Finding
from kinegraph.stream.errors import DeviceError
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


def findings(declared: float, sent: float, epoch: float = 0.0) -> list[Finding]:
    """What the pull itself finds, and the gate that its chunks pass in a session."""
    feed = ScriptedFeed()
    sender = Sender(feed, declared, sent, epoch)
    spec = sender.described.spec
    Pull(sender, spec, feed, 0.5, 0.0, 5.0).run()  # type: ignore[arg-type]
    gate = ClaimGate("s", spec, wrong=LslInlet.rate_tolerance)
    for chunk in feed.chunks["out"]:
        gate.see(chunk)
    return [*(Finding.from_facts(facts) for kind, facts in feed.reports if kind == REPORT), *gate.look()]


@pytest.mark.parametrize(("declared", "sent"), [(250.0, 125.0), (256.0, 250.0), (100.0, 250.0)])
def test_a_wrong_rate_is_found_within_seconds(declared: float, sent: float) -> None:
    [found] = findings(declared, sent)
    assert (found.kind, found.claimed, found.seen) == ("rate", f"{declared:g} Hz", f"{sent:g} Hz")


@pytest.mark.parametrize("sent", [250.0, 250.4, 249.6])
def test_a_clock_that_is_a_little_off_is_no_wrong_rate(sent: float) -> None:
    assert findings(250.0, sent) == []


def test_a_wrong_rate_ends_the_session_where_that_is_wanted() -> None:
    assert LslInlet(name="s", channels=1, rate_hz=250.0, rate_mismatch="fail").refuses == {"rate"}


def test_stamps_of_another_epoch_are_named_once() -> None:
    [found] = findings(250.0, 250.0, epoch=1.7e9)
    assert found.kind == "epoch" and "1699999999.9" in found.seen


@pytest.mark.parametrize("markers", [np.array([[7, -8]], np.int32), np.array([[b"7", b"-8"]])])
def test_whole_numbers_are_markers_as_texts_are(markers: Array) -> None:
    described = Described("m", "Markers", "id", "elsewhere", "int32" if markers.dtype.kind == "i" else "string", 2, 0.0)
    spec = marker_spec(2, 16, "Markers")
    assert differences(described, spec) == []
    feed = ScriptedFeed()
    sender = Sender(feed, 0.0, 1.0)
    sender.described = described
    sender.pull = lambda: (feed.stop(), (markers, np.array([0.1])))[1]  # type: ignore[method-assign, func-returns-value]
    Pull(sender, spec, feed, 0.5, 0.0, 5.0).run()  # type: ignore[arg-type]
    [event] = feed.data("out")
    assert (event["text1"], event["text2"]) == ("7", "-8")


def test_the_rate_that_the_graph_states_counts_where_that_is_wanted() -> None:
    described = Described("s", "EEG", "id", "elsewhere", "float32", 1, 250.0)
    measured = LslInlet(name="s", channels=1, rate_hz=125.0, rate_mismatch="measured")
    believed = LslInlet(name="s", channels=1, rate_hz=125.0)
    measured._check(SimpleNamespace(described=described))  # type: ignore[arg-type]
    with pytest.raises(DeviceError, match="its rate is 250 Hz"):
        believed._check(SimpleNamespace(described=described))  # type: ignore[arg-type]
