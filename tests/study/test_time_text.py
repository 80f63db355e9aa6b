"""Durations, rates and clock times, at the edges of their rounding."""

from __future__ import annotations

import ast
import doctest
import re
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.text import time_text
from kinegraph.stream.text.time_text import about, delay, duration, elapsed, hour_of_day, in_hours, moment, rate

HOUSE = Path(__file__).resolve().parents[2]


def test_the_examples() -> None:
    assert doctest.testmod(time_text).failed == 0


@pytest.mark.parametrize("edge", [60.0, 119.995, 3600.0, 7199.96, 36_000.0])
def test_no_part_of_a_duration_ever_reaches_sixty(edge: float) -> None:
    for seconds in edge + np.arange(-0.12, 0.12, 0.001):
        text = duration(float(seconds))
        parts = re.split(r":", text.split()[0])
        assert all(float(part) < 60 for part in parts), (seconds, text)
        assert sum(float(p) * 60**i for i, p in enumerate(reversed(parts))) == pytest.approx(seconds, abs=0.051)


def test_the_lengths_that_were_shown_wrong() -> None:
    assert duration(119.96) == "2:00.0 min" and duration(3599.97) == "1:00:00.0 h"


@pytest.mark.parametrize("seconds", [9.99949, 9.9995, 999.949, 9999.49, 9999.5, 99_999.0, 1e6])
def test_no_duration_or_rate_is_written_in_powers_of_ten(seconds: float) -> None:
    for text in (delay(seconds), duration(seconds), about(60 * seconds), rate(seconds), rate(1e3 * seconds)):
        assert "e" not in text, text


def test_minutes_carry_into_hours_and_days() -> None:
    assert [in_hours(m) for m in (0.4, 59.4, 59.5, 119.5)] == ["0 h 00 min", "0 h 59 min", "1 h 00 min", "2 h 00 min"]
    assert [hour_of_day(h) for h in (0.0, 11.99, 11.9999, 23.9999)] == ["12:00", "23:59", "00:00", "12:00"]


def test_a_clock_shows_what_has_passed() -> None:
    assert [elapsed(s) for s in (0.99, 59.999, 3599.999, 3600.0)] == ["0:00", "0:59", "59:59", "1:00:00"]
    assert moment(1_700_000_000 * NS - 1) == "2023-11-14 22:13:19.999 UTC"
    assert moment(-1_500_000_000, 4) == "-1.5000 s" and moment(2**63 - 1) == "the end of time"


def test_what_is_not_known_is_a_dash() -> None:
    nan = float("nan")
    assert {duration(nan), delay(nan), elapsed(nan), in_hours(None), hour_of_day(nan)} == {"–"}


def test_a_stream_of_a_million_samples_a_second_says_so() -> None:
    assert "at 2000000 Hz" in StreamSpec((1,), rate_hz=2e6).describe()


ELSEWHERE = {"stream/text/time_text.py", "devices/formats/edf/edf_plus.py"}
"""Also a file's own format: an EDF date."""


def test_every_length_and_clock_time_goes_through_one_formatter() -> None:
    """No other module divides by 60 to write a text."""
    found = []
    for package in ("stream", "devices", "operators"):
        for path in (HOUSE / package).rglob("*.py"):
            text = path.read_text(encoding="utf-8")
            if not re.search(r"strftime|\b60\b", text) or (name := path.relative_to(HOUSE).as_posix()) in ELSEWHERE:
                continue
            for node in ast.walk(ast.parse(text)):
                written = ast.unparse(node) if isinstance(node, ast.FormattedValue) else ""
                dated = isinstance(node, ast.Attribute) and node.attr == "strftime"
                split = (
                    isinstance(node, ast.Call)
                    and ast.unparse(node.func) == "divmod"
                    and ast.unparse(node.args[1]) == "60"
                )
                if dated or split or re.search(r"(//|%) 60\b", written):
                    found.append(f"{name}:{node.lineno}")
    assert found == []
