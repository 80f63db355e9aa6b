"""Counters that do not count, times that stand still, start again too early or are too coarse: named, or borne, never in silence.

The device's first column is each line's true index; time is made up.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from kinegraph.devices.frames.declared import Field, Frame
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.lines.source import AsciiLines
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError, RunError
from tests.devices.scripted import BEGAN, Arriving, played
from tests.support.device_feed import check

RATE = 250.0
COLUMNS = ("index", "t", "n")


class Liar:
    """Says for each sample, made at i / RATE, what `line` gives."""

    ahead_s = 0.0

    def __init__(self, line: Callable[[int], bytes]) -> None:
        self._line, self._said = line, 0

    def receive(self, data: bytes) -> bytes:
        return b""

    def restart(self) -> None: ...

    def say(self, seconds: float) -> list[bytes]:
        due = int(seconds * RATE)
        rows = [self._line(i) for i in range(self._said, due)]
        self._said = max(self._said, due)
        return rows


def lines(
    time: Callable[[float], str] = lambda s: f"{s * 1e6:.0f}", number: Callable[[int], int] = lambda i: i
) -> Liar:
    return Liar(lambda i: f"{i},{time(i / RATE)},{number(i)}\r\n".encode())


def errors_s(feed: Arriving) -> np.ndarray:
    return np.asarray((feed.time("out") - BEGAN) / NS - feed.data("out")[:, 0] / RATE)


FALSE_COUNTERS: list[tuple[Callable[[int], int], str]] = [
    (lambda i: 7, "its counter stands still at 7"),
    (lambda i: 65_535 - i % 65_536, "its counter counts down"),
    (lambda i: 2 * i % 65_536, "its counter goes up by 2"),
    (lambda i: 10 * i % 65_536, "does it count samples"),
]


@pytest.mark.parametrize("time", ["", "t"])
@pytest.mark.parametrize(("number", "named"), FALSE_COUNTERS)
def test_what_does_not_count_by_one_ends_the_session(
    number: Callable[[int], int], named: str, time: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = AsciiLines("the port", COLUMNS, counter="n", time=time, rate_hz=RATE, rate_mismatch="warn")
    with pytest.raises(RunError, match=named):
        played(source, lines(number=number), 12.0, monkeypatch)


def test_the_same_of_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    frame = Frame(
        "A5 5A", (Field("u8", role="counter"), Field("i16", name="a")), name="x", rate_hz=RATE, checksum="sum8"
    )

    def reported(i: int) -> bytes:
        body = b"\xa5\x5a" + bytes([(255 - i) % 256, i % 256, i // 256 % 128])
        return body + bytes([sum(body) % 256])

    with pytest.raises(RunError, match="counts down"):
        played(Binary("a", (frame,)), Liar(reported), 12.0, monkeypatch)


@pytest.mark.parametrize(
    ("number", "named"),
    [
        (lambda i: 7, "their counter stands still at 7"),
        (lambda i: -i % 256, "their counter counts down"),
        (lambda i: 30 * i % 256, "their counter goes up by 30 a frame"),
    ],
)
def test_a_counter_for_which_frames_without_a_checksum_are_not_believed_is_named(
    number: Callable[[int], int], named: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    frame = Frame("A5 5A", (Field("u8", role="counter"), Field("i16", name="a")), name="x", rate_hz=RATE)
    brain = Liar(lambda i: b"\xa5\x5a" + bytes([number(i), i % 256, i // 256 % 128]))
    with pytest.raises(DeviceError, match=f"no frame is valid: .*{named}.*leave the counter out"):
        played(Binary("a", (frame,)), brain, 12.0, monkeypatch)


@pytest.mark.parametrize(
    "wrong", [GOOD, FaultInjection(lose=0.4, seed=3), FaultInjection(duplicate=0.4), FaultInjection(corrupt=0.2)]
)
@pytest.mark.parametrize("time", ["", "t"])
def test_a_counter_that_counts_is_left_alone(wrong: FaultInjection, time: str, monkeypatch: pytest.MonkeyPatch) -> None:
    source = AsciiLines("a", COLUMNS, counter="n", time=time, rate_hz=RATE)
    assert not played(source, lines(), 20.0, monkeypatch, wrong).problems["counter mismatch"]


def test_a_counter_that_starts_again_early_is_named_and_can_be_declared(monkeypatch: pytest.MonkeyPatch) -> None:
    source = AsciiLines("a", COLUMNS, counter="n", counter_bits=8, rate_hz=RATE)
    feed = played(source, lines(number=lambda i: i % 200), 15.0, monkeypatch)
    (texts,) = [facts["text"] for kind, facts in feed.reports if kind == "counter mismatch"]
    assert "goes from 199 to 0" in str(texts) and "set counter_wraps to 200" in str(texts)
    mended = AsciiLines("a", COLUMNS, counter="n", counter_wraps=200, rate_hz=RATE)
    feed = played(mended, lines(number=lambda i: i % 200), 15.0, monkeypatch, FaultInjection(lose=0.01))
    assert not feed.reports and -1 not in feed.lost("out").values()
    missing = np.diff(feed.data("out")[:, 0]) - 1
    assert sum(feed.lost("out").values()) == missing.sum() > 0


def test_a_time_that_stands_still_from_the_start_ends_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    source = AsciiLines("the port", COLUMNS, time="t", rate_hz=RATE, rate_mismatch="warn")
    with pytest.raises(RunError, match="the port is not as declared: its time stands still"):
        played(source, lines(lambda s: "12345"), 12.0, monkeypatch)


@pytest.mark.parametrize("counter", ["", "n"])
@pytest.mark.parametrize("stops_s", [0.5, 1.9, 5.0, 9.8])
def test_a_time_that_stops_in_the_first_seconds_is_named_as_what_it_is(
    stops_s: float, counter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same was reported as a rate of 300 for 250 Hz, or ended in a division by zero."""
    source = AsciiLines("the port", COLUMNS, time="t", counter=counter, rate_hz=RATE)
    brain = lines(lambda s: f"{min(s, stops_s) * 1e6:.0f}")
    with pytest.raises(
        RunError, match=f"the port is not as declared: its time stands still at .* from {stops_s:.1f} s on"
    ):
        played(source, brain, 20.0, monkeypatch)
    source = AsciiLines("the port", COLUMNS, time="t", counter=counter, rate_hz=RATE, rate_mismatch="warn")
    feed = played(source, lines(lambda s: f"{min(s, stops_s) * 1e6:.0f}"), 20.0, monkeypatch)
    index, error = feed.data("out")[:, 0], errors_s(feed)
    assert sorted(kind for kind, _ in feed.reports) == ["device clock jumped", "finding"]
    (gap,) = feed.lost("out")
    assert np.abs(error[(index < stops_s * RATE) | (np.arange(len(index)) >= gap)]).max() < 0.015
    assert feed.problems["time stands still"] == 1 and not feed.problems["lost line"]


@pytest.mark.parametrize("counter", ["", "n"])
@pytest.mark.parametrize("again_s", [25.0, 99.0])
def test_a_time_that_stops_later_is_a_marked_gap_and_no_stamp_stays_wrong(
    again_s: float, counter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = AsciiLines("a", COLUMNS, time="t", counter=counter, rate_hz=RATE)

    def stops(s: float) -> str:
        return f"{(min(s, 20.0) if s < again_s else s - again_s + 20.0) * 1e6:.0f}"

    feed = played(source, lines(stops), 30.0, monkeypatch)
    check(source, feed)
    index, error = feed.data("out")[:, 0], errors_s(feed)
    gap = next(at for at, lost in feed.lost("out").items() if lost < 0)
    assert 20.0 < index[gap] / RATE < 20.6
    assert np.abs(error[(index <= 20 * RATE) | (np.arange(len(index)) >= gap)]).max() < 0.015, "by each arrival alone"
    assert next(kind for kind, _ in feed.reports) == "device clock jumped"


@pytest.mark.parametrize("bits", [16, 18])
def test_a_time_that_starts_again_earlier_than_declared_is_named(bits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    source = AsciiLines("a", COLUMNS, time="t", rate_hz=RATE)
    brain = lines(lambda s: str(round(s * 1e6) % (1 << bits)))
    with pytest.raises(RunError, match=f"set `time_bits` to {bits}"):
        played(source, brain, 12.0, monkeypatch)
    mended = AsciiLines("a", COLUMNS, time="t", time_bits=bits, rate_hz=RATE)
    feed = played(mended, lines(lambda s: str(round(s * 1e6) % (1 << bits))), 12.0, monkeypatch)
    assert np.abs(errors_s(feed)).max() < 0.010 and not feed.problems


@pytest.mark.parametrize("counter", ["", "n"])
@pytest.mark.parametrize("tick_s", [1.0, 0.1, 0.02])
def test_between_two_ticks_of_a_coarse_time_samples_follow_the_rate(
    tick_s: float, counter: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = AsciiLines("a", COLUMNS, time="t", time_unit="s", time_bits=0, counter=counter, rate_hz=RATE)
    feed = played(source, lines(lambda s: f"{int(s / tick_s + 1e-6) * tick_s:.2f}"), 20.0, monkeypatch)
    check(source, feed)
    known = feed.data("out")[:, 0] > (2 * tick_s + 1.0) * RATE
    assert np.abs(errors_s(feed)[known]).max() < 0.010
    assert not feed.lost("out") and not feed.problems


def test_without_a_rate_the_uncertainty_is_as_coarse_as_the_time(monkeypatch: pytest.MonkeyPatch) -> None:
    source = AsciiLines("a", COLUMNS, time="t", time_unit="s", time_bits=0)
    feed = played(source, lines(lambda s: f"{s:.1f}"), 12.0, monkeypatch)
    assert feed.clocks[-1]["uncertainty_s"] > 0.09


@pytest.mark.parametrize("share", [0.5, 1.0])
def test_checksums_of_which_only_chance_makes_some_right_end_the_session(
    share: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One byte of checksum is right once in 256 times: 13 of 3500 frames were taken for a device's, with exit code 0."""
    frame = Frame(
        "A5 5A", (Field("u8", role="counter"), Field("i32", name="a")), name="x", rate_hz=RATE, checksum="xor8"
    )
    rng = np.random.default_rng(2)

    def reported(i: int) -> bytes:
        body = b"\xa5\x5a" + bytes([i % 256]) + rng.bytes(4)
        right = np.bitwise_xor.reduce(np.frombuffer(body, np.uint8))
        return body + bytes([sum(body) % 256 if rng.random() < share else int(right)])

    source = Binary("the port", (frame,))
    if share < 1:
        feed = played(source, Liar(reported), 12.0, monkeypatch)
        assert feed.count("x") > 1000 and feed.problems["bad checksum"] > 1000
        return
    with pytest.raises(RunError, match=r"frames .* have a right checksum, which is chance; .*sum8"):
        played(source, Liar(reported), 12.0, monkeypatch)
