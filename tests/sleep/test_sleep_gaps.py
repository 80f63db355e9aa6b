"""Recordings that hold several nights with gaps between them, and lights that stay off for days: right numbers, or a warning."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from structlog.testing import capture_logs

from kinegraph.operators.sleep.periods import EPOCH
from kinegraph.operators.sleep.statistics import SleepStatistics
from kinegraph.stream.chunk import FOREVER, NS, Array, Chunk, StreamSpec
from kinegraph.stream.engine.flow.merge import Merge

START = 1_767_218_400 * NS  # 2025-12-31T22:00Z
SPEC = StreamSpec((), EPOCH, units=("ns", "ns", "", "", "counts", "", ""), meta={"epoch_s": 60.0, "method": "oakley"})
ON = StreamSpec((), np.dtype([("on", "?")]))


def epochs(begin_h: float, hours: float, state: str = "sleep") -> Array:
    """Final epochs of a minute."""
    rows = np.zeros(round(60 * hours), EPOCH)
    rows["onset"] = START + (round(60 * begin_h) + np.arange(len(rows))) * 60 * NS
    rows["end"], rows["state"], rows["final"] = rows["onset"] + 60 * NS, state, True
    rows["activity"] = np.nan if state == "unknown" else 0.0
    return rows


def numbers(
    pieces: list[Array], lights: list[tuple[float, bool]] | None = None, **more: Any
) -> list[tuple[float, ...]]:
    """(onset, end in h after the start, minutes in bed, asleep, unknown) of every row."""
    operator = SleepStatistics(**more)
    specs = {"epochs": SPEC, **({"lights": ON} if lights is not None else {})}
    operator.open(specs)
    merge, found, merged = Merge(specs), [], []
    rows = [("epochs", int(row["end"]), np.array([row], EPOCH)) for piece in pieces for row in piece]
    rows += [("lights", START + round(h * 3600) * NS, np.array([(on,)], ON.dtype)) for h, on in lights or ()]
    for port, at, data in sorted(rows, key=lambda row: row[1]):
        merged += merge.push(port, Chunk(np.array([at]), data, at))
    for port, spec in specs.items():
        merged += merge.push(port, Chunk(np.empty(0, np.int64), np.empty(0, spec.dtype), FOREVER))
    for chunk in [operator.process(port, piece) for port, piece in merged] + [operator.close()]:
        for row in chunk.data:
            at = ((int(row[name]) - START) / NS / 3600 for name in ("onset", "end"))
            found.append((*(round(h, 2) for h in at), *(float(row[name]) for name in ("tib", "tst", "unknown"))))
    return found


TWO_NIGHTS = [(0, 8, 480, 480, 0), (24, 31, 420, 420, 0)]


@pytest.mark.parametrize("filled_h", [0, 9, 16])
def test_a_recording_with_a_gap_between_its_nights_gives_a_row_for_each(filled_h: int) -> None:
    """The gap has no epochs at all, unknown ones throughout, or unknown ones as far as a scorer fills it."""
    gap = [epochs(8, filled_h, "unknown")] if filled_h else []
    assert numbers([epochs(0, 8), *gap, epochs(24, 7)]) == TWO_NIGHTS


def test_a_short_gap_in_a_night_is_a_part_of_it() -> None:
    assert numbers([epochs(0, 3), epochs(4, 4)]) == [(0, 8, 480, 420, 60)]
    assert numbers([epochs(0, 3), epochs(3, 1, "unknown"), epochs(4, 4)]) == [(0, 8, 480, 420, 60)]


def test_scheduled_nights_of_which_nothing_was_recorded_have_no_numbers() -> None:
    schedule = {"schedule": "22:00-06:00", "timezone": "UTC"}
    assert numbers([epochs(0, 8), epochs(96, 8), epochs(104, 1, "wake")], **schedule) == [
        (0, 8, 480, 480, 0),
        (96, 104, 480, 480, 0),
    ]
    assert len(numbers([epochs(0, 8), epochs(8, 30, "unknown"), epochs(48, 9)], **schedule)) == 2


@pytest.mark.parametrize(("hours", "rows"), [(23, 1), (24, 1), (24.5, 0), (30, 0), (80, 0)])
def test_lights_that_stay_off_longer_than_a_day_are_no_night_and_it_is_said(hours: float, rows: int) -> None:
    with capture_logs() as logs:
        made = numbers([epochs(0, hours + 12)], [(1, False), (1 + hours, True), (3 + hours, False), (11 + hours, True)])
    assert len(made) == rows + 1 and made[-1] == (3 + hours, 11 + hours, 480, 480, 0)
    assert any("longer than longest_h" in entry["event"] for entry in logs) == (rows == 0)


def test_lights_that_never_came_on_again_are_told_of_too() -> None:
    with capture_logs() as logs:
        assert numbers([epochs(0, 40)], [(1, False)]) == []
    assert any("longer than longest_h" in entry["event"] for entry in logs)


@pytest.mark.parametrize(("seconds", "rows"), [(20, 0), (59, 0), (60, 1), (600, 1)])
def test_lights_that_are_off_for_less_than_an_epoch_are_no_night(seconds: float, rows: int) -> None:
    made = numbers([epochs(0, 12)], [(1, False), (1 + seconds / 3600, True), (3, False), (11, True)])
    assert len(made) == rows + 1 and made[-1] == (3, 11, 480, 480, 0)
