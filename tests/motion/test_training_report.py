"""The report of a training session: sets, repetitions, tempo, rest, and a row for each repetition."""

from __future__ import annotations

import csv
import errno
import re
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.reports.training import TrainingReport
from kinegraph.stream.chunk import Chunk
from kinegraph.stream.data.state import size_of
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.graph import Graph
from tests.support.exercise_events import EVENTS, event


def report_of(
    folder: Path, parts: list[tuple[str, Chunk]], full_share: float = 0.5
) -> tuple[str, list[dict[str, str]]]:
    outlet = TrainingReport(path=str(folder / "training.html"), title="Tuesday", full_share=full_share)
    outlet.open({port: EVENTS[port] for port in outlet.inputs})
    outlet.meet(Graph("train", {}, "", session={"subject": "P07 <b>"}))
    outlet.begin()
    for port, chunk in parts:
        outlet.process(port, chunk)
    outlet.close()
    with Path(outlet.file).with_suffix(".csv").open(newline="") as file:
        return Path(outlet.file).read_text(), list(csv.DictReader(file))


def test_a_page_that_could_not_be_written_is_not_told_of_as_left_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    outlet = TrainingReport(path=str(tmp_path / "training.html"))
    outlet.open({port: EVENTS[port] for port in outlet.inputs})
    outlet.begin()
    monkeypatch.setattr("kinegraph.devices.reports.training.report.write_complete", full)
    with pytest.raises(DeviceError, match="No space left on device"):
        outlet.close()
    assert outlet.file == str(tmp_path / "training.csv")
    (tmp_path / "training.csv").unlink()
    assert outlet.file == ""


def test_a_report_that_could_not_be_begun_is_not_told_of_as_left_behind(tmp_path: Path) -> None:
    """Where its folder cannot be made, say."""
    outlet = TrainingReport(path=str(tmp_path / "there" / "training.html"))
    outlet.open({port: EVENTS[port] for port in outlet.inputs})
    (tmp_path / "there").write_text("a file")
    with pytest.raises((DeviceError, OSError)):
        outlet.begin()
    assert outlet.file == ""


def sets(sure: float = 0.7) -> list[tuple[str, Chunk]]:
    parts = []
    for k in range(2):
        for n in range(5):
            onset = 20.0 * k + 2.0 * n
            numbers = {
                "duration_s": 2.0 + 0.1 * n,
                "range": 30.0 + n,
                "moves": "ankle_l.y",
                "distance": 1.5,
                "sure": sure,
                "symmetry": 0.9,
            }
            fields = {
                "onset": onset,
                "end": onset + 2,
                "activity": k,
                "repetition": n + 1,
                "name": "squat" if k else "arms",
            }
            parts.append(("repetition", event("repetition", onset + 3, **fields, **numbers)))
        ends = {
            "onset": 19.0 * k,  # the second set begins with a rest
            "end": 20.0 * k + 18.5 - 8.5 * k,  # and the first one ends with it
            "activity": k,
            "repetitions": 5,
            "symmetry": 1,
            "certainty": 0.4 * k,
        }
        parts.append(("activity", event("activity", 20 * k + 13, repeats=True, **ends)))
        parts.append(
            ("activity", event("activity", 20 * k + 14, repeats=False, activity=9, onset=20 * k + 10, end=20 * k + 12))
        )
    parts.insert(-7, ("rest", event("rest", 19, onset=10.2, end=18.2)))
    return parts


@pytest.mark.parametrize(("full_share", "counted"), [(0.5, ["4", "1"]), (0.4, ["5"]), (0.0, ["5"])])
def test_a_repetition_of_less_than_half_of_the_usual_range_is_partial_and_is_not_counted(
    tmp_path: Path, full_share: float, counted: list[str]
) -> None:
    parts = sets()
    half = next(chunk for port, chunk in parts if port == "repetition" and chunk.data["repetition"][0] == 3)
    half.data["range"] = 14.0  # the median of the set is 32
    page, _ = report_of(tmp_path, parts, full_share)
    first = re.findall("<td>1</td><td class=.text.>arms.*?</td><td>.*?</td>(.*?)<td>27", page)
    assert re.findall(r"<td>(\d+)</td>", first[0]) == counted
    assert ("went less far than 50 %" in page) == (len(counted) == 2)


def test_what_is_done_only_twice_is_no_set(tmp_path: Path) -> None:
    parts = sets()
    first = next(chunk for port, chunk in parts if port == "activity" and chunk.data["repeats"][0])
    first.data["repetitions"] = 2
    page, rows = report_of(tmp_path, parts)
    assert len(rows) == 10 and "A set has 3 repetitions or more" in page
    assert re.findall(r"<td>(\d+)</td><td class=.text.>(\w+)", page) == [("1", "squat")]


def test_the_report_has_sets_repetitions_tempo_and_rest_and_a_row_for_each(tmp_path: Path) -> None:
    page, rows = report_of(tmp_path, sets())
    assert len(rows) == 10 and [row["exercise"] for row in rows] == ["arms"] * 5 + ["squat"] * 5
    assert float(rows[6]["duration (s)"]) == pytest.approx(2.1) and float(rows[6]["range"]) == 31.0
    text = re.sub(r"<svg.*?</svg>", "", page, flags=re.S)
    cells = [
        [re.sub("<.*?>", "", c) for c in re.findall("<td.*?>(.*?)</td>", row)]
        for row in re.findall("<tr>(.*?)</tr>", text)
    ]
    assert ["arms", "1", "5"] in cells and ["squat", "1", "5"] in cells
    one = next(row for row in cells if row[:2] == ["1", "arms (not sure)"])
    assert ["2", "squat"] in [row[:2] for row in cells]
    # the last of the five, before the rest, is left out of how uneven they are: 6 % with it
    assert one[3:11] == ["5", "27.3", "5", "32.0 ankle_l.y", "1.50", "8.0", "both sides at once", "90"]
    assert [row[2] for row in cells if row[:2] == ["2", "squat"]] == ["0:17"]
    assert rows[0]["sides alike"] == "0.9" and page.count("<circle") == 2 * 3 * 5
    assert "P07 &lt;b&gt;" in page and page.count("<rect") == 10 and "http" not in page


@pytest.mark.parametrize(("sure", "name"), [(0.18, "squat?"), (0.36, "squat"), (0.0, "squat")])
def test_a_name_that_is_hardly_sure_is_a_question_in_the_report(tmp_path: Path, sure: float, name: str) -> None:
    page, rows = report_of(tmp_path, sets(sure))
    assert f">{name}<" in page and ("Name?" in page) is (name == "squat?")
    assert {row["exercise"] for row in rows} == {"arms", "squat"}


def test_the_course_is_as_wide_as_the_session_and_sides_are_shown_where_they_are_known(tmp_path: Path) -> None:
    """Both sets are over after half of the session: no dot lies in the right half of its row."""
    end = ("rest", event("rest", 54, onset=30, end=54))
    (tmp_path / "long").mkdir()
    page, _ = report_of(tmp_path / "long", [*sets(), end])
    wide = float(re.findall(r'viewBox="0 0 (\d+) 44"', page)[0])
    places = [float(x) for x in re.findall(r'<circle cx="([\d.]+)"', page)]
    assert 0.4 * wide < max(places) < 0.6 * wide and min(places) < 0.05 * wide
    assert ">Sides<" in page
    unknown = [(port, chunk) for port, chunk in sets()]
    for port, chunk in unknown:
        if port == "activity":
            chunk.data["symmetry"] = 0
    (tmp_path / "unknown").mkdir()
    assert ">Sides<" not in report_of(tmp_path / "unknown", unknown)[0]


def test_a_difference_that_nobody_can_see_looks_like_none(tmp_path: Path) -> None:
    """Ranges of 103.0 and 103.2 cm lie beside each other; of 80 and 120 cm they take the whole height."""
    for first, second, most in ((103.0, 103.2, 2.0), (80.0, 120.0, 36.0)):
        parts = []
        for n, reach in enumerate((first, second, first)):
            fields = {"onset": 2.0 * n, "end": 2.0 * n + 2, "activity": 0, "repetition": n + 1, "name": "arms"}
            parts.append(
                ("repetition", event("repetition", 2.0 * n + 3, duration_s=2.0, range=reach, distance=np.nan, **fields))
            )
        parts.append(("activity", event("activity", 12, repeats=True, onset=0, end=6, activity=0, repetitions=3)))
        page, _ = report_of(tmp_path, parts)
        heights = [float(y) for y in re.findall(r'cy="([0-9.]+)"', page)]
        assert len(heights) == 6 and 0.0 < max(heights[3:]) - min(heights[3:]) <= most + 0.1
        assert most < 10 or max(heights[3:]) - min(heights[3:]) > 35.0


def test_a_second_report_takes_another_name_and_one_of_nothing_says_so(tmp_path: Path) -> None:
    first, _ = report_of(tmp_path, sets())
    second, rows = report_of(tmp_path, [])
    assert "Nothing repeated" in second and not rows and "Nothing repeated" not in first
    assert {path.name for path in tmp_path.iterdir()} == {
        f"training{n}.{s}" for n in ("", "-2") for s in ("html", "csv")
    }


def test_hours_of_training_take_no_more_memory_than_one(tmp_path: Path) -> None:
    """The 500 sets that the page shows are kept with their repetitions, in less than a mebibyte; all are in the table."""
    outlet = TrainingReport(path=str(tmp_path / "training.html"), min_repetitions=2)
    outlet.open({port: EVENTS[port] for port in outlet.inputs})
    outlet.begin()
    assert size_of(outlet.state.training) < 1 << 20
    for k in range(520):
        for n in range(2):
            fields = {
                "onset": 9.0 * k + n,
                "activity": k,
                "repetition": n + 1,
                "name": f"exercise {k}",
                "duration_s": 1.5,
            }
            outlet.process("repetition", event("repetition", 9.0 * k + 2, moves=f"ankle_{n}", **fields))
        outlet.process("activity", event("activity", 9.0 * k + 3, repeats=True, activity=k, repetitions=2))
    kept = outlet.state.training
    assert (kept.n_sets, kept.n_repetitions, kept.left_out) == (500, 1000, 20 + 40)
    assert kept.n_words == len(kept.words) and not kept.repetitions["activity"][1000:].any()
    outlet.close()
    page = (tmp_path / "training.html").read_text()
    assert "exercise 497" in page and "ankle_0" in page and "exercise 501" not in page
    assert len((tmp_path / "training.csv").read_text().splitlines()) == 1 + 2 * 520
