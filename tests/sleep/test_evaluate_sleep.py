"""Agreement of two scorings: against plain formulas, through EDF+, CSV and the command itself."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import edfio
import numpy as np
import pytest

from kinegraph.operators.sleep.evaluation import command
from kinegraph.operators.sleep.evaluation.agreement import Confusion, interval, limits
from kinegraph.operators.sleep.evaluation.command import _rows, evaluate
from kinegraph.operators.sleep.evaluation.comparison import agreement, pair, total
from kinegraph.operators.sleep.evaluation.pictures import draw
from kinegraph.operators.sleep.evaluation.reference import Hypnogram, read_hypnogram, stage
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE
from kinegraph.stream.errors import KinegraphError
from tests.sleep.sleep_data import sleep_file
from tests.support.real import needs_data

START = np.datetime64("2026-03-01T22:00:00")
STAGES = {0: "W", 1: "N1", 2: "N2", 3: "N3", 5: "R", -1: "?"}


def write_edf(path: Path, stages: Array, start: np.datetime64 = START) -> None:
    """A hypnogram as EDF+ has it, beside a signal."""
    when = start.astype("datetime64[s]").item()
    notes = [edfio.EdfAnnotation(30.0 * k, 30.0, f"Sleep stage {STAGES[int(s)]}") for k, s in enumerate(stages)]
    signal = edfio.EdfSignal(np.zeros(30 * len(stages)), 1.0, label="EEG", physical_range=(-1, 1))
    edf = edfio.Edf(
        [signal], recording=edfio.Recording(startdate=when.date()), starttime=when.time(), annotations=notes
    )
    edf.write(path)


def write_csv(path: Path, states: list[str], start: np.datetime64 = START, epoch_s: int = 30) -> None:
    rows = [f"{start + np.timedelta64(k * epoch_s, 's')}Z,{state}" for k, state in enumerate(states)]
    path.write_text("\n".join(["time (UTC),state", *rows]) + "\n")


def hypnogram(states: Array, start: int = 0, epoch_s: int = 30) -> Hypnogram:
    onset = start + np.arange(len(states)) * epoch_s * NS
    return Hypnogram(onset, onset + epoch_s * NS, np.asarray(states, np.int8), True)


def test_confusion_by_hand() -> None:
    estimate = np.array([SLEEP] * 50 + [WAKE] * 20 + [SLEEP] * 20 + [WAKE] * 10 + [UNKNOWN] * 7, np.int8)
    reference = np.array([SLEEP] * 50 + [WAKE] * 20 + [WAKE] * 20 + [SLEEP] * 10 + [SLEEP] * 7, np.int8)
    found = Confusion.of(estimate, reference)
    assert (found.sensitivity, found.specificity, found.unknown, found.epochs) == (50 / 60, 0.5, 7, 100)
    chance = 0.7 * 0.6 + 0.3 * 0.4
    assert found.kappa == pytest.approx((0.7 - chance) / (1 - chance))
    assert (found + found).kappa == pytest.approx(found.kappa)


def test_a_night_without_wake_has_no_specificity() -> None:
    states = np.full(10, SLEEP, np.int8)
    found = Confusion.of(states, states)
    assert found.sensitivity == 1.0 and np.isnan(found.specificity) and np.isnan(found.kappa)


def test_limits_with_one_night_each_are_bland_and_altmans() -> None:
    d = np.random.default_rng(1).normal(5, 12, 30)
    found = limits(d, [f"P{k}" for k in range(30)])
    assert found.bias == pytest.approx(d.mean())
    assert found.high == pytest.approx(d.mean() + 1.959964 * d.std(ddof=1)) and found.persons == 30
    assert found.bias_interval[1] - found.bias == pytest.approx(2.04523 * d.std(ddof=1) / 30**0.5, rel=1e-4)


def test_nights_nested_in_persons_by_simulation() -> None:
    """Balanced and not: the true limits (sd between 8, within 6: total 10) lie in their 95 % intervals about 95 times in 100."""
    rng = np.random.default_rng(7)
    hits = {"bias": 0, "low": 0, "high": 0}
    for _ in range(400):
        nights = rng.integers(1, 8, 25)
        who = np.repeat(np.arange(25), nights).astype(str)
        d = np.repeat(rng.normal(3, 8, 25), nights) + rng.normal(0, 6, nights.sum())
        found = limits(d, who.tolist())
        for name, truth in (("bias", 3.0), ("low", 3.0 - 19.6), ("high", 3.0 + 19.6)):
            low, high = getattr(found, f"{name}_interval")
            hits[name] += low <= truth <= high
    assert all(0.91 <= count / 400 <= 0.985 for count in hits.values()), hits


def test_nested_nights_are_not_taken_as_independent() -> None:
    """One person with many nights must not pull the bias to himself."""
    found = limits(np.array([20.0] * 30 + [0.0, 0.0, 0.0]), ["A"] * 30 + ["B", "C", "D"])
    assert found.bias == 5.0 and found.nights == 33 and found.persons == 4


def test_few_nights_give_no_limits() -> None:
    assert np.isnan(limits(np.array([3.0]), ["A"]).high) and limits(np.array([3.0]), ["A"]).bias == 3.0
    assert limits(np.array([3.0, 5.0, np.nan]), ["A", "A", "A"]).nights == 2


@pytest.mark.parametrize(
    ("text", "state"),
    [
        ("Sleep stage W", WAKE),
        ("N2", SLEEP),
        ("sleep stage R", SLEEP),
        ("5", SLEEP),
        ("Sleep stage ?", UNKNOWN),
        ("lights", None),
    ],
)
def test_names_of_stages(text: str, state: int | None) -> None:
    assert stage(text) == state


def test_edf_and_csv_give_the_same_hypnogram(tmp_path: Path) -> None:
    stages = np.repeat([0, 1, 2, 3, 5, -1, 0], [20, 10, 100, 60, 40, 4, 10])
    write_edf(tmp_path / "psg.edf", stages)
    write_csv(tmp_path / "psg.csv", [STAGES[int(s)] for s in stages])
    one, other = read_hypnogram(tmp_path / "psg.edf"), read_hypnogram(tmp_path / "psg.csv")
    assert (one.onset == other.onset).all() and (one.state == other.state).all() and (one.end == other.end).all()
    assert one.onset[0] == START.astype("datetime64[ns]").astype(np.int64)


def test_a_clock_offset_is_undone() -> None:
    truth = np.repeat(np.array([WAKE, SLEEP, WAKE, SLEEP, WAKE], np.int8), [20, 200, 10, 300, 30])
    late = pair("n", "p", hypnogram(truth), hypnogram(truth, start=-90 * NS))
    right = pair("n", "p", hypnogram(truth), hypnogram(truth, start=-90 * NS), offset_s=90.0)
    assert right.confusion.kappa == 1.0 > late.confusion.kappa


def test_minutes_against_half_minutes_and_epochs_that_one_side_lacks() -> None:
    truth = np.repeat(np.array([WAKE, SLEEP, WAKE], np.int8), [20, 400, 20])
    estimate = hypnogram(truth[::2], epoch_s=60)
    estimate.state[50:60] = UNKNOWN
    found = pair("n", "p", estimate, hypnogram(truth))
    assert found.confusion.unknown == 20 and found.confusion.kappa == 1.0
    assert found.found.tst == found.truth.tst == 190.0 and agreement([found])["tst"].bias == 0.0
    with pytest.raises(KinegraphError, match="do not overlap"):
        pair("n", "p", estimate, hypnogram(truth, start=10**6 * NS))


def test_epochs_that_never_both_know_are_not_called_apart() -> None:
    truth = np.repeat(np.array([WAKE, SLEEP], np.int8), [20, 20])
    estimate = hypnogram(truth)
    estimate.state[:10] = UNKNOWN
    with pytest.raises(KinegraphError, match="no epoch in common that both know"):
        pair("n", "p", estimate, hypnogram(truth[:10]))


@pytest.mark.parametrize(("night", "warning"), [("night.csv", "--offset -3600"), ("night.edf", "")])
def test_a_clock_without_a_zone_beside_one_with(
    tmp_path: Path, night: str, warning: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A laboratory's EDF goes by the clock on its wall; our table by UTC, our EDF by the wall's clock, too."""
    stages = np.repeat([0, 2, 0], [20, 200, 20])
    write_edf(tmp_path / "psg.edf", stages)
    write_edf(tmp_path / "night.edf", stages)
    write_csv(tmp_path / "night.csv", [STAGES[int(s)] for s in stages])
    evaluate(tmp_path / night, tmp_path / "psg.edf")
    assert warning in (warned := capsys.readouterr().err) and bool(warning) == bool(warned)


def test_an_edf_file_that_breaks_off(tmp_path: Path) -> None:
    write_edf(tmp_path / "psg.edf", np.repeat([0, 2, 0], [20, 200, 20]))
    whole = (tmp_path / "psg.edf").read_bytes()
    (tmp_path / "psg.edf").write_bytes(whole[: len(whole) * 2 // 3])
    read = read_hypnogram(tmp_path / "psg.edf")
    assert 0 < len(read.state) < 240 and "records" in read.damage


@needs_data
def test_thirty_one_real_hypnograms_against_a_spoilt_copy(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every tenth epoch of wake called sleep, every twentieth of sleep called wake: the shares come back, through files and the command."""
    data = np.load(sleep_file("psg_hypnograms_walch2019.npz"))
    lines = ["estimate,reference,person"]
    wakes = sleeps = 0
    for k, name in enumerate(sorted({key.partition("_")[0] for key in data.files})):
        stages = data[f"{name}_stage"]
        write_edf(tmp_path / f"{name}.edf", np.where(stages == 4, 3, stages))
        asleep = stages > 0
        estimate = asleep.copy()
        estimate[np.flatnonzero(stages == 0)[::10]] = True
        estimate[np.flatnonzero(asleep)[::20]] = False
        write_csv(tmp_path / f"{name}.csv", np.where(estimate, "sleep", "wake").tolist())
        lines.append(f"{name}.csv,{name}.edf,P{k // 2}")
        wakes += (stages == 0).sum()
        sleeps += asleep.sum()
    (tmp_path / "nights.csv").write_text("\n".join(lines) + "\n")
    evaluate(nights=tmp_path / "nights.csv", output=tmp_path / "out")
    shown = capsys.readouterr().out
    pooled = next(line.split() for line in shown.splitlines() if line.split()[:1] == ["pooled"])
    assert int(pooled[1]) == wakes + sleeps
    assert float(pooled[3]) == pytest.approx(0.95, abs=0.01) and float(pooled[4]) == pytest.approx(0.9, abs=0.02)
    assert "quiet wakefulness is commonly scored as sleep" in " ".join(shown.split())
    assert (tmp_path / "out" / "agreement.png").read_bytes()[:4] == b"\x89PNG"
    assert len((tmp_path / "out" / "nights.csv").read_text().splitlines()) == len(lines)
    with pytest.raises(KinegraphError, match="--overwrite"):
        evaluate(nights=tmp_path / "nights.csv", output=tmp_path / "out")


def test_results_for_programs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_csv(tmp_path / "a.csv", ["wake"] * 10 + ["sleep"] * 50)
    write_csv(tmp_path / "b.csv", ["W"] * 12 + ["N2"] * 48)
    evaluate(tmp_path / "a.csv", tmp_path / "b.csv", as_json=True)
    (found,) = json.loads(capsys.readouterr().out)
    (night,) = found["nights"]
    assert night["specificity"] == pytest.approx(10 / 12) and found["agreement_min"]["tst"]["bias"] == 1.0
    assert found["agreement_min"]["tst"]["low"] is None, "of one night there are no limits"


def test_the_command_line(tmp_path: Path) -> None:
    write_csv(tmp_path / "a.csv", ["wake"] * 10 + ["sleep"] * 50)
    write_csv(tmp_path / "b.csv", ["W"] * 12 + ["N2"] * 48)
    command = [str(Path(sys.executable).parent / "kinegraph"), "sleep", "evaluate"]
    done = subprocess.run([*command, "a.csv", "b.csv"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0 and "0.833" in done.stdout, done.stdout + done.stderr
    (tmp_path / "b.csv").write_text("time,state\n0,W\n30,snoring\n")
    done = subprocess.run([*command, "a.csv", "b.csv"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and "b.csv, line 3: 'snoring' is not a stage" in done.stderr
    assert "REFERENCE" in subprocess.run([*command, "--help"], capture_output=True, text=True).stdout


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.csv", "", "header is empty"),
        ("a.csv", "x,y\n1,2\n", "must name"),
        ("a.csv", "onset,stage\n0,W\nlater,W\n", "line 3"),
        ("a.csv", "onset,stage,duration\n0,W,60\n30,W,60\n", "overlap"),
        ("a.edf", "no EDF at all", "cannot be read as EDF"),
        ("a.mcap", "no recording", "a.mcap"),
    ],
)
def test_files_that_are_none(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(KinegraphError, match=message):
        read_hypnogram(tmp_path / name)


def test_the_picture_shows_every_night() -> None:
    truth = np.repeat(np.array([WAKE, SLEEP, WAKE], np.int8), [20, 400, 20])
    pairs = [pair(f"n{k}", f"p{k % 2}", hypnogram(np.roll(truth, k)), hypnogram(truth)) for k in range(4)]
    figure = draw(pairs)
    assert len(figure.axes) == 3 + 4 and total(pairs).epochs == 4 * 440
    nights = figure.axes[3:]
    assert all(axes.get_shared_x_axes().joined(axes, nights[0]) for axes in nights)
    assert [bool(axes.get_xlabel()) for axes in nights] == [False, False, False, True]


def test_a_table_of_nights_names_who_slept_where_it_is_known(tmp_path: Path) -> None:
    table = tmp_path / "nights.csv"
    table.write_text("estimate,reference,person,offset_s\na.csv,b.csv,Kim,\nc.csv,d.csv,,-2.5\n")
    assert _rows(table) == [
        (tmp_path / "a.csv", (tmp_path / "b.csv", "Kim", 0.0)),
        (tmp_path / "c.csv", (tmp_path / "d.csv", "", -2.5)),
    ]


def test_the_interval_of_pooled_numbers_is_that_of_persons_not_of_epochs() -> None:
    good, bad = Confusion(90, 9, 1, 0, 0), Confusion(50, 5, 5, 40, 0)
    alike = interval([good] * 6, list("abcdef"), lambda c: c.sensitivity)
    assert alike == (1.0, 1.0)
    low, high = interval([good, bad] * 3, list("abcdef"), lambda c: c.sensitivity)
    pooled = (3 * 90 + 3 * 50) / (6 * 90)
    assert low < pooled - 0.1 and high > pooled + 0.1, "540 epochs taken as independent would give 0.04"
    assert np.isnan(interval([good] * 6, ["a"] * 3 + ["b"] * 3, lambda c: c.sensitivity)[0])


def test_nights_that_are_left_out_are_named_with_the_reason(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    table = tmp_path / "nights.csv"
    table.write_text("estimate,reference,person,exclude\na.csv,b.csv,p1,\nc.csv,d.csv,p2,camera fell down\n")
    assert [str(e.name) for e, *_ in _rows(table)] == ["a.csv"]
    assert "left out: c.csv: camera fell down" in capsys.readouterr().out


def test_the_report_lists_nights_that_are_left_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    table = tmp_path / "nights.csv"
    table.write_text(
        "estimate,reference,exclude\na.csv,b.csv,\nc.csv,d.csv,  camera fell down \n,e.csv,no recording\nf.csv,g.csv, \n"
    )
    reported: list[tuple[str, str]] = []
    monkeypatch.setattr(
        "kinegraph.operators.sleep.evaluation.report.write_report",
        lambda found, folder: reported.extend(found.left_out) or [],
    )
    command._report([], [], {}, table, tmp_path)
    assert reported == [("c.csv", "camera fell down"), ("", "no recording")]
