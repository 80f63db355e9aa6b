"""A device's clock that is set while it measures: stamps against the true index, which the device's first column carries."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.devices.clocks.device_clock import DeviceClock
from kinegraph.devices.frames.declared import Field, Frame
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.lines.source import AsciiLines
from kinegraph.devices.mti.simulator import MtiModel
from kinegraph.devices.mti.source import Mti
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.stream.chunk import NS
from tests.devices.scripted import BEGAN, Arriving, played
from tests.support.device_feed import check, reading, wait_for

RATE = 250.0
JUMPS = [0.03, 9.0, 3600.0, -0.5, *(pytest.param(s, marks=pytest.mark.nightly) for s in (0.5, 3.0, 17_950_000.0, -2.0))]
"""s; the third is a change of the hour, the seventh one from the time since switching on to that of the day."""


def never_after_arrival(feed: Arriving) -> None:
    timing = feed.data("timing")
    assert (timing["stamp"] <= timing["arrival"]).all(), int((timing["stamp"] - timing["arrival"]).max())


@pytest.mark.parametrize("jump_s", JUMPS)
@pytest.mark.parametrize("counter", ["", "n"])
def test_a_jump_is_a_restart_and_no_stamp_leaves_the_truth(
    jump_s: float, counter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = AsciiLines(
        "a", ("index", "t", "n"), time="t", time_unit="us", time_bits=0, counter=counter, rate_hz=RATE
    )  # fmt: skip
    wrong = FaultInjection(jump_every_s=6.0, jump_s=jump_s)
    feed = played(source, Indexed(rate_hz=RATE).brain(), 20.0, monkeypatch, wrong)
    check(source, feed)
    never_after_arrival(feed)
    index = feed.data("out")[:, 0]
    true = BEGAN + np.round(index / RATE * NS).astype(np.int64)
    error = np.abs(feed.time("out") - true) / NS
    assert error.max() < 0.010, error.argmax()
    jumps = [facts for kind, facts in feed.reports if kind == "device clock jumped"]
    assert [facts["jump_s"] for facts in jumps] == pytest.approx([jump_s] * 3, abs=0.005)
    gaps = feed.lost("out")
    assert list(gaps.values()) == [-1] * 3 and len(index) > 20 * RATE - 20
    assert feed.problems["device restarted"] == 3


@pytest.mark.parametrize("jump_s", [0.5, 3600.0, -2.0])
def test_the_same_holds_of_frames_and_of_ticks(jump_s: float, monkeypatch: pytest.MonkeyPatch) -> None:
    frame = Frame(
        name="x",
        sync="A5 5A",
        rate_hz=200,
        fields=(
            Field("u16", role="counter"),
            Field("u64", role="time", unit="us"),
            Field("i16", name="a"),
        ),
    )
    binary = Binary("a", (frame,))
    sources = [(binary, BinaryModel(binary), "x", 200), (Mti("tcp://a"), MtiModel(), "imu", 100)]
    for source, brain, output, rate in sources:
        wrong = FaultInjection(jump_every_s=6.0, jump_s=jump_s)
        feed = played(source, brain, 20.0, monkeypatch, wrong)
        check(source, feed)
        never_after_arrival(feed)
        steps = np.diff(feed.time(output)) / NS
        assert steps.max() < 4 / rate + 0.004 and len(steps) > 20 * rate - 20
        assert list(feed.lost(output).values()) == [-1] * 3
        lines = [facts["jump_s"] for kind, facts in feed.reports if kind == "device clock jumped"]
        assert lines == pytest.approx([jump_s] * 3, abs=0.01)


def test_a_wrong_number_is_no_jump(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of lines without a checksum one in a hundred has a byte changed, also in its time."""
    source = AsciiLines("a", ("index", "t", "n"), time="t", rate_hz=RATE)
    wrong = FaultInjection(corrupt=0.01, from_s=1.0)
    feed = played(source, Indexed(rate_hz=RATE).brain(), 30.0, monkeypatch, wrong)
    never_after_arrival(feed)
    assert not [kind for kind, _ in feed.reports]
    index, number = feed.data("out").T
    sound = index == number
    error = np.abs(feed.time("out") - BEGAN - index / RATE * NS)[sound] / NS
    assert error.max() < 0.010


def test_over_a_pseudo_terminal() -> None:
    with Indexed(rate_hz=200).serving(FaultInjection(jump_every_s=1.5, jump_s=3600.0)) as port:
        source = AsciiLines(port, ("index", "t", "n"), time="t", time_bits=0, rate_hz=200)
        with reading(source) as feed:
            wait_for(lambda: len([kind for kind, _ in feed.reports if kind == "device clock jumped"]) >= 2)
    check(source, feed)
    timing = feed.data("timing")
    assert (timing["stamp"] <= timing["arrival"]).all()


def test_stamps_raised_above_the_line_stay_before_their_arrival() -> None:
    """A packet half a second late is followed by packets in time: theirs must not run ahead of their arrival."""
    clock = DeviceClock()
    clock.see(0, NS // 2)
    last = int(clock.stamps(np.array([0]))[0])
    for i in range(1, 500):
        device, arrival = i * 4_000_000, max(i * 4_000_000, NS // 2)
        clock.see(device, arrival)
        stamp = int(clock.stamps(np.array([device]))[0])
        assert last < stamp and (stamp <= arrival or stamp == last + 1)
        last = stamp
