"""The report of a validation: made-up nights with figures computed by hand, and what it must leave open."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.sleep.evaluation.checklist import NOT_GIVEN, STUDY, Evaluated, checklist
from kinegraph.operators.sleep.evaluation.command import evaluate
from kinegraph.operators.sleep.evaluation.comparison import Pair, pair
from kinegraph.operators.sleep.evaluation.persons import METRICS, by_person, normality, spread, trend
from kinegraph.operators.sleep.evaluation.reference import Hypnogram
from kinegraph.stream.chunk import NS
from kinegraph.stream.data.csv_writer import sheet_text
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE
from kinegraph.stream.errors import KinegraphError


def states(*counts: tuple[int, int]) -> Hypnogram:
    """Stretches of (state, epochs), 30 s each."""
    state = np.repeat([s for s, _ in counts], [n for _, n in counts]).astype(np.int8)
    onset = np.arange(len(state)) * 30 * NS
    return Hypnogram(onset, onset + 30 * NS, state, True)


TRUTH = states((WAKE, 20), (SLEEP, 160), (WAKE, 20))


def night(name: str, person: str, late: int, unknown: int = 0) -> Pair:
    """Sleep begins `late` epochs later than it did; so many of the last epochs are not scored."""
    return pair(
        name, person, states((WAKE, 20 + late), (SLEEP, 160 - late), (WAKE, 20 - unknown), (UNKNOWN, unknown)), TRUTH
    )


def answers(pairs: list[Pair], **study: str) -> dict[str, str]:
    return {i.item: i.answer for i in checklist(Evaluated(pairs, study))}


def test_a_persons_metrics_by_hand() -> None:
    """Two nights of A: of 320 epochs of sleep 40 are called wake, all 70 of wake that were scored are found, 10 are not known."""
    a, b = by_person([night("1", "A", 10), night("2", "B", 0), night("3", "A", 30, unknown=10)])
    assert (a.name, a.nights, a.confusion.epochs, a.confusion.unknown, b.nights) == ("A", 2, 390, 10, 1)
    expected = (280 / 320, 1.0, 350 / 390, 1.0, 70 / 110, None, 2 * 350 / 390 - 1, 210 / 390, 40 / 390)
    for name, value in zip(METRICS, expected, strict=True):
        if value is not None:
            assert a.metric(name) == pytest.approx(value), name
    chance = (280 * 320 + 110 * 70) / 390**2
    assert a.metric("kappa") == pytest.approx((350 / 390 - chance) / (1 - chance))
    assert a.differences[0] == pytest.approx(-10.0) and a.differences[2] == pytest.approx(10.0), (
        "minutes of TST and SOL"
    )
    assert a.differences[1] == pytest.approx(-10.0), "per cent of all 100 minutes in bed"


def test_spread_trend_and_normality() -> None:
    s = spread(np.array([1.0, 3.0, 5.0, np.nan]))
    assert (s.mean, s.sd, s.persons) == (3.0, 2.0, 3) and s.high - 3 == pytest.approx(4.30265 * 2 / 3**0.5)
    x = np.array([1.0, 2.0, 3.0, 4.0])
    line = trend(x, 7 - 2 * x)
    assert line and (line.at_zero, line.slope) == (pytest.approx(7), pytest.approx(-2)) and line.high < 0
    assert trend(x[:3], x[:3]) is None and trend(np.ones(5), np.arange(5.0)) is None
    assert normality(np.ones(9)) is None
    assert (normality(np.r_[np.zeros(30), 100.0]) or 1.0) < 0.001 < 0.05 < (normality(np.linspace(-1, 1, 9)) or 0.0)


def test_the_checklist_has_the_known_figures() -> None:
    answer = answers([night(str(k), f"P{k}", late) for k, late in enumerate((0, 4, 8, 12))], device="a camera")
    assert answer["nights and persons"] == "4 nights of 4 persons, 1 to 1 each"
    assert answer["one epoch length on both sides"] == "30 s"
    assert answer["the same time in bed on both sides"] == "100.0 (0.0) min"
    assert answer["error matrix, epochs"] == "sleep as sleep 616, sleep as wake 24, wake as wake 160, wake as sleep 0"
    assert answer["bias, with 95 % intervals"].startswith("TST -3.0 min (-7.1 to 1.1); SE -3.0 %")
    sd = np.std([0, 2, 4, 6], ddof=1)
    assert f"TST {-3 - 1.95996 * sd:.1f} (" in answer["limits of agreement, with 95 % intervals"]
    assert answer["error matrix, shares"].startswith(
        "sensitivity 0.962 (0.032), 0.911 to 1.014; specificity 1.000 (0.000)"
    )
    assert answer["does the bias depend on the size"] == NOT_GIVEN, "the reference's nights are all alike"
    assert answer[STUDY["device"]] == "a camera" and answer[STUDY["sample"]] == NOT_GIVEN


def test_a_bias_that_grows_with_the_size_is_told() -> None:
    pairs = []
    for k, n in enumerate((100, 140, 180, 220, 260)):
        truth = states((WAKE, 20), (SLEEP, n), (WAKE, 20))
        pairs.append(pair(str(k), f"P{k}", states((WAKE, 20 + n // 10), (SLEEP, n - n // 10), (WAKE, 20)), truth))
    answer = answers(pairs)["does the bias depend on the size"].split("; ")[0]
    assert answer == "TST: 0.00 - 0.100 x reference, slope -0.100 to -0.100: it does" or answer.startswith(
        "TST: -0.00 - 0.100"
    )


def test_one_night_answers_little_and_says_so() -> None:
    answer = answers([night("1", "A", 10)])
    for item in ("limits of agreement, with 95 % intervals", "does the bias depend on the size", "does the spread depend on the size",
                 "are the differences normal", "stages of sleep", "ROC curve", *STUDY.values()):  # fmt: skip
        assert answer[item] == NOT_GIVEN, item
    assert answer["bias, with 95 % intervals"] == "TST -5.0 min; SE -5.0 %; SOL 5.0 min; WASO 0.0 min"


def test_a_night_without_sleep_has_no_sol_and_breaks_nothing() -> None:
    answer = answers([pair("1", "A", states((WAKE, 200)), TRUTH), night("2", "B", 4)])
    assert "SOL 2.0 min" in answer["bias, with 95 % intervals"]


def write(path: Path, counts: list[tuple[str, int]]) -> None:
    names = [name for name, n in counts for _ in range(n)]
    path.write_text("onset,stage\n" + "".join(f"{30 * k},{name}\n" for k, name in enumerate(names)))


def test_the_command_writes_page_and_tables(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write(tmp_path / "psg.csv", [("W", 20), ("N2", 160), ("W", 20)])
    rows: list[tuple[str, ...]] = [("estimate", "reference", "person", "offset_s", "exclude")]
    for k, late in enumerate((0, 10, 20)):
        write(tmp_path / f"{k}.csv", [("wake", 20 + late), ("sleep", 160 - late), ("wake", 20)])
        rows.append((f"{k}.csv", "psg.csv", f"<b>P{k}</b>", "0", ""))
    rows.append(("lost.csv", "psg.csv", "P9", "0", "camera fell down"))
    (tmp_path / "nights.csv").write_text(sheet_text(rows))
    (tmp_path / "study.csv").write_text("item,answer\nsetting,at home\n")
    folder = tmp_path / "validation"
    evaluate(nights=tmp_path / "nights.csv", report=folder, study=tmp_path / "study.csv")
    assert str(folder / "report.html") in capsys.readouterr().out
    page = (folder / "report.html").read_text()
    assert "Menghini et al. 2021" in page and "quiet wakefulness" in page and "lost.csv: camera fell down" in page
    assert "<b>P0" not in page and "data:image/png;base64,iVBOR" in page
    with (folder / "persons.csv").open() as file:
        persons = list(csv.DictReader(file))
    assert [float(p["sensitivity"]) for p in persons] == [1.0, 150 / 160, 140 / 160]
    assert [float(p["TST difference (min)"]) for p in persons] == [0.0, -5.0, -10.0]
    with (folder / "checklist.csv").open() as file:
        items = {row["item"]: row["answer"] for row in csv.DictReader(file)}
    assert items[STUDY["setting"]] == "at home" and items[STUDY["device"]] == NOT_GIVEN
    assert f"{sum(a == NOT_GIVEN for a in items.values())} of {len(items)} items are not given" in page
    with pytest.raises(KinegraphError, match="--overwrite"):
        evaluate(nights=tmp_path / "nights.csv", report=folder)


@pytest.mark.parametrize(
    ("text", "message"), [("devise,x", "'devise' must be one of device, "), ("device,x\ndevice,y", "line 3.*twice")]
)
def test_a_study_that_answers_nothing_that_was_asked(tmp_path: Path, text: str, message: str) -> None:
    write(tmp_path / "a.csv", [("W", 20), ("N2", 20)])
    (tmp_path / "study.csv").write_text(f"item,answer\n{text}\n")
    with pytest.raises(KinegraphError, match=message):
        evaluate(tmp_path / "a.csv", tmp_path / "a.csv", report=tmp_path / "out", study=tmp_path / "study.csv")
    with pytest.raises(KinegraphError, match="--report names its folder"):
        evaluate(tmp_path / "a.csv", tmp_path / "a.csv", study=tmp_path / "study.csv")
    assert not (tmp_path / "out").exists()
