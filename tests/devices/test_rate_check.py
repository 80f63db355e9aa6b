"""Devices that are not as declared: at their start the session is refused with the likely mistake, and later the alarm is raised."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.clocks.rate_check import RateCheck
from kinegraph.devices.cyton.simulator import CytonModel
from kinegraph.devices.cyton.source import Cyton
from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.lines.source import AsciiLines
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.stream.chunk import NS
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import RunError
from kinegraph.stream.graph.reading.load import load_text
from tests.devices.scripted import BEGAN, played
from tests.support.device_feed import Kept

DECLARED = 250.0
COLUMNS = ("index", "t", "n")


@pytest.mark.parametrize("clock", ["counter", "time", "both", "none"])
@pytest.mark.parametrize(
    ("true_hz", "hint"), [(200.0, ""), (169.0, ""), (500.0, "2 times"), (125.0, "by 2"), (240.0, "")]
)
def test_a_rate_that_is_not_as_declared_is_named(
    clock: str, true_hz: float, hint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = {"counter": "n" if clock in ("counter", "both") else "", "time": "t" if clock in ("time", "both") else ""}
    source = AsciiLines("the port", COLUMNS, rate_hz=DECLARED, **given)
    if clock == "none" and true_hz == 240.0:
        feed = played(source, Indexed(rate_hz=true_hz).brain(), 12.0, monkeypatch)
        assert feed.problems["rate mismatch"], "what may be loss only raises the alarm"
        return
    with pytest.raises(RunError, match="rate_mismatch: warn") as refused:
        played(source, Indexed(rate_hz=true_hz).brain(), 12.0, monkeypatch)
    text = str(refused.value)
    assert "the port" in text and "rate_hz" in text and hint in text and "not 250" in text
    named = float(text.partition("sends ")[2].split()[0])
    assert named == pytest.approx(true_hz, rel=0.01)


@pytest.mark.parametrize(
    ("declared", "true", "mends"),
    [("us", "ms", "are ms, not us"), ("ms", "us", "are us, not ms"), ("s", "ms", "are ms, not s"), ("us", "ns", "are ns")],
)  # fmt: skip
def test_a_time_in_another_unit_is_named(declared: str, true: str, mends: str, monkeypatch: pytest.MonkeyPatch) -> None:
    source = AsciiLines("a", COLUMNS, time="t", time_unit=declared, time_bits=0, rate_mismatch="warn")  # type: ignore[arg-type]
    with pytest.raises(RunError, match=mends):
        played(source, Indexed(time_unit=true).brain(), 12.0, monkeypatch)


@pytest.mark.parametrize("clock", [{"counter": "n"}, {"time": "t"}, {}])
@pytest.mark.parametrize("true_hz", [200.0, 169.0, 500.0])
def test_with_warn_the_stamps_follow_the_true_rate(
    clock: dict[str, str], true_hz: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = AsciiLines("a", COLUMNS, rate_hz=DECLARED, rate_mismatch="warn", **clock)
    feed = played(source, Indexed(rate_hz=true_hz).brain(), 45.0, monkeypatch)
    lines = [facts for kind, facts in feed.reports if kind == "finding"]
    assert len(lines) == 1 and float(str(lines[0]["seen"]).split()[0]) == pytest.approx(true_hz, rel=0.01)
    error = (feed.time("out") - BEGAN) / NS - feed.data("out")[:, 0] / true_hz
    settled = feed.data("out")[:, 0] > 12 * true_hz
    assert np.abs(error[settled]).max() < (0.010 if clock else 0.015), "without a clock by each arrival alone"


@pytest.mark.parametrize(
    "wrong",
    [GOOD, FaultInjection(lose=0.1), FaultInjection(lose=0.05, duplicate=0.06, corrupt=0.02, reset_every_s=1.9),
     FaultInjection(stall_every_s=1.3, stall_s=0.4),
     FaultInjection(reset_every_s=1.9),
     FaultInjection(jump_every_s=2.0, jump_s=3600.0)],
)  # fmt: skip
@pytest.mark.parametrize("clock", ["counter", "time", "both"])
@pytest.mark.parametrize("drift_ppm", [0.0, pytest.param(200.0, marks=pytest.mark.nightly), -20_000.0])
def test_a_device_as_declared_is_left_alone(
    clock: str, wrong: FaultInjection, drift_ppm: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = {"counter": "n" if clock in ("counter", "both") else "", "time": "t" if clock in ("time", "both") else ""}
    source = AsciiLines("a", COLUMNS, time_bits=0, rate_hz=DECLARED, **given)  # type: ignore[arg-type]
    brain = Indexed(rate_hz=DECLARED * (1 + drift_ppm * 1e-6), drift_ppm=drift_ppm).brain()
    feed = played(source, brain, 65.0 if wrong is GOOD else 12.0, monkeypatch, wrong, jitter_s=0.02)
    assert not feed.problems["rate mismatch"]


def test_a_queue_that_fills_for_a_while_is_no_slower_device() -> None:
    check, feed = RateCheck("a", 100.0, "fail"), Kept()
    for i in range(1200):
        late = np.interp(i / 100, [0, 3, 6, 9], [0, 0.2, 0.05, 0.2])
        check.see(1, 0, round((i / 100 + late) * NS), feed)
    assert not feed.problems


@pytest.mark.parametrize(("backlog_s", "emptied_s"), [(0.8, 2.5), (0.8, 0.2), (-0.6, 3.0), (-0.6, 1.0)])
def test_a_radio_that_catches_up_or_falls_behind_at_its_start_is_no_other_rate(
    backlog_s: float, emptied_s: float
) -> None:
    check, feed = RateCheck("a", 100.0, "fail"), Kept()
    for i in range(1200):
        made = i / 100
        late = np.interp(made, [0, emptied_s], [max(backlog_s, 0.0), max(-backlog_s, 0.0)])
        check.see(1, 0, round((made + late) * NS), feed)
    assert not feed.problems


@pytest.mark.parametrize("speed", [0.4, 0.7, 0.9])
def test_a_computer_that_does_not_keep_up_is_no_other_unit_of_time(speed: float) -> None:
    """Each report is taken later than the one before; their own times are those of the declared rate."""
    check, feed = RateCheck("a", 250.0, "fail", unit="us"), Kept()
    for i in range(round(9.0 * 250 * speed)):
        device = np.array([i * 4_000_000])
        check.see(1, 0, round(device[0] / speed), feed, device)
    assert not feed.problems


def test_a_time_and_a_rate_that_are_wrong_alike_are_told_after_ten_seconds() -> None:
    check, feed = RateCheck("a", 500.0, "fail", unit="us"), Kept()
    with pytest.raises(RunError, match=r"advances by 0\.5 s in a second"):
        for i in range(3000):
            check.see(1, 0, i * 4_000_000, feed, np.array([i * 2_000_000]))


@pytest.mark.parametrize("at_once", [1, 5])
def test_a_radio_that_drops_out_each_second_is_no_other_unit_of_time(at_once: int) -> None:
    """Three tenths of each second are missing, and the device's time shows it."""
    check, feed = RateCheck("a", None, "fail", unit="us"), Kept()
    kept = [i for i in range(12 * 250) if i % 250 >= 75]
    for first in range(0, len(kept), at_once):
        device = np.array(kept[first : first + at_once]) * 4_000_000
        check.see(at_once, 0, int(device[-1]) + NS, feed, device)
    assert not feed.problems


@pytest.mark.parametrize(("share", "grave"), [(0.03, False), (0.05, False), (0.12, False), (0.5, True)])
@pytest.mark.parametrize("seed", range(3))
def test_what_may_be_loss_is_no_reason_to_end_a_session(share: float, grave: bool, seed: int) -> None:
    """Without a counter, too few samples are a slower device or lost ones: up to a limit the alarm is raised, no more."""
    check, feed, random = RateCheck("a", 100.0, "fail"), Kept(), np.random.default_rng(seed)
    found, ended = [], False
    try:
        for i in range(1200):
            if random.random() >= share:
                found.append(check.see(1, 0, round((i / 100 + 0.2 * random.random()) * NS), feed))
    except RunError as error:
        ended = True
        assert "lost on the way" in str(error)
    assert ended == grave
    assert (share <= 0.04 or ended) or feed.problems["rate mismatch"] == 1
    assert all("lost on the way" in str(facts["remedy"]) for _, facts in feed.reports)


@pytest.mark.parametrize("timed", [False, True])
def test_a_counter_that_was_garbled_does_not_outweigh_what_came(timed: bool) -> None:
    check, feed = RateCheck("a", 250.0, "fail", counted=True), Kept()
    for i in range(3000):
        at = np.array([round(i * NS / 250)])
        check.see(1, 15 if i % 20 == 3 else 0, int(at[0]) + NS, feed, at if timed else None)
    assert not feed.problems


@pytest.mark.parametrize("again", [False, True])
def test_later_it_raises_the_alarm_and_goes_on(again: bool) -> None:
    """A device that is switched to another rate while it runs, or has another one when it comes back."""
    check, feed = RateCheck("a", 100.0, "fail"), Kept()
    feed.again = again
    at, found = 0, []
    for hz, seconds in ((100.0, 0 if again else 30), (50.0, 100)):
        for _ in range(round(hz * seconds)):
            at += round(NS / hz)
            found.append(check.see(1, 0, at, feed))
    assert [hz for hz in found if hz] == [pytest.approx(50.0, rel=0.02)] * (feed.problems["rate mismatch"])
    assert [kind for kind, _ in feed.reports] == ["finding"]


def test_a_board_with_another_rate_ends_the_session(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("kinegraph.devices.cyton.simulator.PACKETS_HZ", 500.0)
    with pytest.raises(RunError, match="it sends 500 samples a second, not 250"):
        played(Cyton("a"), CytonModel(), 12.0, monkeypatch)


def test_a_session_is_ended_in_words(tmp_path: Path) -> None:
    with Indexed(rate_hz=100.0).serving() as port:
        graph = load_text(
            f"nodes: {{lines: {{use: devices.lines.AsciiLines, port: {port}, columns: [i, t, n], counter: n, rate_hz: 250}}}}"
        )
        outcome = Session(graph, tmp_path / "s", duration_s=30).run()
    assert outcome.error is not None and "is not as declared: it sends" in str(outcome.error)
    assert outcome.exit_code == 3, "it is the device that is wrong, no operator"
