"""The gentle alarm: at a movement within the window, by the clock otherwise; never before, never after, once a day."""

from __future__ import annotations

from datetime import datetime, timedelta
from zoneinfo import ZoneInfo

import numpy as np
import pytest

from kinegraph.operators.sleep.gentle_alarm import GentleAlarm
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.errors import ParameterError

EPOCHS = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("moved_s", "<f8")])
SPEC = StreamSpec((), EPOCHS, units=("ns", "", "s"))
ZONE = ZoneInfo("Europe/Berlin")


def rung(
    moved: dict[str, float], *, days: int = 1, first: str = "2026-11-20T22:00", **more: object
) -> list[tuple[str, str]]:
    """(wall clock, why) of every alarm of so many nights of 12 h; `moved`: s of movement in the epoch that ends then."""
    alarm = GentleAlarm(at="07:00", timezone="Europe/Berlin", **more)  # type: ignore[arg-type]
    alarm.open({"epochs": SPEC})
    begin = round(datetime.fromisoformat(first).replace(tzinfo=ZONE).timestamp())
    made = []
    for k in range(days * 2880 - 1440):
        stamp = (begin + 30 * (k + 1)) * NS
        clock = datetime.fromtimestamp(stamp // NS, ZONE)
        row = np.array([(stamp - 30 * NS, "left", moved.get(f"{clock:%H:%M:%S}", 0.0))], EPOCHS)
        for _, chunk in alarm.process("epochs", Chunk(np.array([stamp]), row, stamp)):
            made += [
                (datetime.fromtimestamp(int(e["onset"]) // NS, ZONE).strftime("%H:%M:%S"), str(e["why"]))
                for e in chunk.data
            ]
    return made


def test_the_first_movement_of_the_last_half_hour_gives_the_alarm() -> None:
    assert rung({"06:20:00": 9, "06:41:30": 5, "06:50:00": 9}) == [("06:41:30", "movement")]


def test_without_movement_it_is_the_clock_and_nothing_comes_later() -> None:
    assert rung({"06:29:30": 30, "06:45:00": 1.9, "07:00:00": 9, "07:00:30": 9}) == [("07:00:00", "clock")]


def test_once_a_day() -> None:
    assert rung({"06:31:00": 5}, days=3) == [("06:31:00", "movement")] * 3
    assert rung({}, days=3) == [("07:00:00", "clock")] * 3


def test_weekends_may_be_left_out() -> None:
    alarm = GentleAlarm(at="07:00", days="mon,tue,wed,thu,fri")
    friday = datetime.fromisoformat("2026-11-20T07:00+00:00")
    following = datetime.fromtimestamp(alarm._next(round(friday.timestamp()) * NS) // NS, ZoneInfo("UTC"))
    assert following == friday + timedelta(3)


def test_it_goes_by_the_wall_clock_when_the_clocks_change() -> None:
    assert rung({}, first="2026-10-24T22:00") == [("07:00:00", "clock")]
    assert rung({}, first="2026-03-28T22:00") == [("07:00:00", "clock")]


def test_a_camera_that_is_gone_does_not_silence_it() -> None:
    alarm = GentleAlarm(at="07:00")
    alarm.open({"epochs": SPEC})
    begin = round(datetime.fromisoformat("2026-11-20T23:00+00:00").timestamp()) * NS
    alarm.process("epochs", Chunk(np.array([begin]), np.array([(begin, "", 0.0)], EPOCHS), begin))
    ((_, chunk),) = alarm.process("epochs", Chunk(np.empty(0, np.int64), np.empty(0, EPOCHS), begin + 9 * 3600 * NS))
    assert [str(e["why"]) for e in chunk.data] == ["clock"]


@pytest.mark.parametrize(("name", "value"), [("at", "7 o'clock"), ("timezone", "Mars"), ("days", "someday")])
def test_what_cannot_be_is_refused(name: str, value: str) -> None:
    with pytest.raises(ParameterError, match=name):
        GentleAlarm(**{name: value}).open({"epochs": SPEC})  # type: ignore[arg-type]
