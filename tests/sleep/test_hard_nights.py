"""Nights of power cuts, lamps, partners, nudges, darkness and clock changes, each from a seed: the report always comes, what it says
follows from the night's log by the definitions, and nothing is scored that could not be judged. `make nights` tries forty."""

from __future__ import annotations

import csv
import json
import os
import re
from datetime import UTC, datetime, timedelta, timezone
from html import unescape
from itertools import pairwise
from pathlib import Path
from zoneinfo import ZoneInfo

import pytest

from kinegraph.devices.reports.night import archive
from kinegraph.stream.chunk import NS
from tests.sleep.hard_night import Lived, live

pytestmark = pytest.mark.nightly

NIGHTS = int(os.environ.get("KINEGRAPH_NIGHTS", "1"))
Rows = list[dict[str, str]]


def logged(folder: Path) -> Rows:
    """The night's log, read by nothing of the product: a row an epoch, `at` in s since 1970."""
    with (folder / "epochs.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        for name in ("onset", "end"):
            row[name] = str(datetime.fromisoformat(row[name]).timestamp())
    return rows


def longest(states: str, letter: str) -> int:
    return max((len(run) for run in re.findall(f"{letter}+", states)), default=0)


def minutes(value: float) -> str:
    return f"{value:.1f} min"


def hours(value: float) -> str:
    return f"{round(value) // 60} h {round(value) % 60:02d} min"


def expected(rows: Rows) -> dict[str, str]:
    """The report's numbers of the epochs (half a minute each) in bed, by their definitions (AASM)."""
    states = "".join({"sleep": "s", "wake": "w"}.get(row["state"], "u") for row in rows)
    assert "s" in states, "a night without any sleep tells nothing"
    first, last = states.index("s"), states.rindex("s")
    wakes = re.findall(r"w+(?=.*s)", states[first:])
    tst, waso = states.count("s") / 2, states[first:].count("w") / 2
    active = [float(row["activity"]) for row in rows[first : last + 1] if row["activity"]]
    movement = 100 * sum(a > 0 for a in active) / len(active)
    still = "".join(
        "x" if not row["activity"] else "." if float(row["activity"]) == 0 else "m" for row in rows[first : last + 1]
    )
    pieces = re.findall(r"\.+", still)
    short = 100 * sum(len(piece) <= 2 for piece in pieces) / len(pieces) if pieces else 0.0
    return {
        "Time in bed (TIB)": hours(len(states) / 2),
        "Total sleep time (TST)": hours(tst),
        "Sleep efficiency (SE)": f"{100 * 2 * tst / len(states):.1f} %",
        "Sleep onset latency (SOL), estimated": minutes(states[:first].count("w") / 2),
        "Wake after sleep onset (WASO)": minutes(waso),
        "Awakenings": str(len(wakes)),
        "Longest sleep in one piece": hours(longest(states, "s") / 2),
        "Movement index": f"{movement:.1f} %",
        "Fragmentation index": f"{movement + short:.1f} %",
    }


def check_report(lived: Lived) -> Rows:
    """Every number on the page and in the EDF is what the log says. Gives the log's rows in bed."""
    folder, facts = lived.folder, json.loads((lived.folder / "night.json").read_text())
    assert facts["closed"] and {path.name for path in folder.iterdir()} >= set(archive.DRAWN)
    rows, numbers = logged(folder), facts["numbers"]
    steps = {float(b["onset"]) - float(a["onset"]) for a, b in pairwise(rows)}
    assert steps == {30.0}, "an epoch is missing, or there twice"
    begin, end = numbers["onset"] / NS, numbers["end"] / NS
    in_bed = [row for row in rows if begin <= (float(row["onset"]) + float(row["end"])) / 2 < end]
    page = (folder / "report.html").read_text()
    assert "Could not be made" not in page
    states = {
        unescape(name): unescape(value)
        for name, value in re.findall(r'<tr><td>([^<]*)<small>[^<]*</small></td><td class="num"><b>([^<]*)</b>', page)
    }
    wanted = expected(in_bed)
    assert {name: states.get(name) for name in wanted} == wanted

    # one clock for all times: that of the night's beginning
    zone = timezone(datetime.fromtimestamp(facts["begun"] / NS, ZoneInfo(lived.night.zone)).utcoffset() or timedelta())
    from_, to = (f"{datetime.fromtimestamp(t, UTC).astimezone(zone):%H:%M}" for t in (begin, end))
    sentence = unescape(re.findall(r'<p class="sentence">([^<]*)</p>', page)[0])
    assert f"in bed {from_} to {to}" in sentence
    awake = sum(row["state"] == "wake" for row in in_bed) / 2
    assert f"awake {round(awake)} min" in sentence if 0 < awake < 60 else True
    edf(folder, in_bed, zone)
    shown = [row for row in rows if begin - 900 <= (float(row["onset"]) + float(row["end"])) / 2 < end + 900]
    assert f"{len(shown)} of 30 s; {sum(row['state'] == 'unknown' for row in shown)} unknown" in page
    assert len(facts["breaks"]) <= len(lived.off)
    return in_bed


def edf(folder: Path, rows: Rows, zone: timezone) -> None:
    """The EDF's annotations say of every epoch in bed what the log says."""
    import edfio

    names = {"Sleep stage S": "sleep", "Sleep stage W": "wake", "Sleep stage ?": "unknown"}
    file = edfio.read_edf(folder / "hypnogram.edf")
    begun = datetime.combine(file.startdate, file.starttime, zone).timestamp()
    states = {
        begun + note.onset + 30.0 * k: names[note.text]
        for note in file.annotations
        if note.text in names
        for k in range(round((note.duration or 0.0) / 30.0))
    }
    assert [states[float(row["onset"])] for row in rows] == [row["state"] for row in rows]


def check_scores(lived: Lived, rows: Rows) -> None:
    """What is out of view is unknown; light, a partner or a nudge do not score a still sleeper as awake."""
    scene, begun = lived.night.scene, lived.night.begun / NS
    blind = [(begun + a, begun + b) for a, b in scene.dark]
    blind += [(begun + at, begun + at + 30) for at, *_ in scene.nudges]
    blind += [(a / NS + 120, b / NS) for a, b in lived.off]  # before, epochs were seen that were not final
    for row in rows:
        a, b = float(row["onset"]), float(row["end"])
        if any(begin <= a and b <= end for begin, end in blind):
            assert row["state"] == "unknown", f"{a - begun:.0f} s: {row}"
    lit = [(begun + a, begun + b) for a, b in scene.lamp]
    two = [(begun + a, begun + b) for a, b in scene.partner]
    for row in rows:
        a, b = float(row["onset"]), float(row["end"])
        disturbed = any(begin <= a and b <= end for begin, end in lit)
        disturbed = disturbed or any(begin < b and a < end for begin, end in two)  # also where the other comes, or goes
        own = any(a - 330 <= begun + move <= b + 120 for move in scene.moves)
        if disturbed and not own:
            assert row["state"] != "wake", f"{a - begun:.0f} s: {row}"


@pytest.mark.timeout(1200)
@pytest.mark.parametrize("seed", range(2, 2 + NIGHTS))
def test_a_hard_night_ends_with_a_report_that_follows_from_its_log(tmp_path: Path, seed: int) -> None:
    lived = live(seed, tmp_path)
    rows = check_report(lived)
    check_scores(lived, rows)
    assert len(rows) >= 60
