"""The night in which the clocks change: one rule for every time that is given of it, the clock that the night began with."""

from __future__ import annotations

import re
from datetime import datetime, timedelta
from pathlib import Path
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from matplotlib.dates import num2date

from kinegraph.devices.commands import nights as command
from kinegraph.devices.reports.night import archive, figures
from kinegraph.devices.reports.night.edf import write_edf
from kinegraph.devices.reports.night.numbers import quality, table
from kinegraph.devices.reports.night.page import line, render, title
from kinegraph.stream.chunk import NS

STEP = 30 * NS
CHANGES = [
    ("Europe/Berlin", "2026-10-24T22:55", -60, "CEST", "CET"),
    ("Europe/Berlin", "2026-03-28T22:55", 60, "CET", "CEST"),
    ("America/New_York", "2026-10-31T22:55", -60, "EDT", "EST"),
    ("America/New_York", "2026-03-07T22:55", 60, "EST", "EDT"),
    ("Australia/Lord_Howe", "2026-04-04T22:55", -30, "+11", "+1030"),
    ("Australia/Lord_Howe", "2026-10-03T22:55", 30, "+1030", "+11"),
    ("America/Santiago", "2026-04-04T22:55", -60, "-03", "-04"),
    ("UTC", "2026-10-24T22:55", 0, "UTC", "UTC"),
    ("Asia/Tokyo", "2026-10-24T22:55", 0, "JST", "JST"),
]


def night(zone: str, evening: str, minutes: int = 340) -> tuple[archive.Facts, archive.LoggedEpochs]:
    """5 h 40 min in bed from this time of the wall clock on; ten minutes unseen, just after the clocks have changed."""
    begun = round(datetime.fromisoformat(evening).replace(tzinfo=ZoneInfo(zone)).timestamp()) * NS
    n = 2 * minutes
    onset = begun + np.arange(n) * STEP
    states = np.full(n, "sleep", "U7")
    states[500:520] = "unknown"
    texts = {"state": states, "bed": np.full(n, "in"), "provisional": states, "cause": np.full(n, "")}
    numbers = {name: np.full(n, 0.5) for name in archive.COLUMNS[2:] if name not in archive.TEXTS}
    facts = archive.Facts("n", begun, 30.0, zone, closed=True)
    each = dict.fromkeys(
        ("tst", "tst_low", "tst_high", "sol", "sol_low", "sol_high", "waso", "waso_low", "waso_high", "mean_awakening"), 5.0
    )  # fmt: skip
    more = dict.fromkeys(("se", "se_low", "se_high", "movement", "fragmentation", "longest_bout"), 50.0)
    facts.numbers = {
        "onset": begun, "end": begun + n * STEP, "tib": minutes, "convention": "AASM", "bed": "detected", "estimated": True,
        "awakenings": 1, **each, **more,
    }  # fmt: skip
    return facts, archive.LoggedEpochs(onset, onset + STEP, texts, numbers)


@pytest.mark.parametrize(("zone", "evening", "change", "before", "after"), CHANGES)
def test_every_time_of_a_night_is_by_the_clock_that_it_began_with(
    tmp_path: Path, zone: str, evening: str, change: int, before: str, after: str, capsys: pytest.CaptureFixture[str]
) -> None:
    import edfio

    facts, epochs = night(zone, evening)
    header = line(facts, epochs)
    assert header.startswith(f"22:55 to 04:35 {before}"), "5 h 40 min after the beginning"
    by_the_new = f"{datetime(2000, 1, 1, 4, 35) + timedelta(minutes=change):%H:%M}"
    assert (f"the clocks changed that night: by the new time ({after}) it ended at {by_the_new}" in header) == bool(
        change
    )
    assert "03:05–03:15 (10 min)" in dict(quality(facts, epochs))["Not scored"]
    page = render(facts, epochs, None, table(facts, epochs))
    assert re.search(r"in bed 22:55", page) and re.search(r"out of bed 04:35", page), "the labels in the figure"
    begin, end = (num2date(day) for day in figures.days(np.array([facts.begun, facts.numbers["end"]]), facts))
    assert (f"{begin:%H:%M}", f"{end:%H:%M}") == ("22:55", "04:35"), "the axis"
    write_edf(tmp_path / "n.edf", facts, epochs)
    edf = edfio.read_edf(tmp_path / "n.edf")
    assert str(edf.starttime) == "22:55:00" and edf.startdate.isoformat() == evening[:10]
    assert title(facts).startswith(f"Night of {datetime.fromisoformat(evening):%A}")

    folder = tmp_path / "nights" / evening[:10]
    folder.mkdir(parents=True)
    facts.save(folder)
    (folder / archive.EPOCHS).write_text(",".join(archive.COLUMNS) + "\n")
    command.nights(path=tmp_path / "nights")
    listed = capsys.readouterr().out
    assert "22:55" in listed and "04:35" in listed
