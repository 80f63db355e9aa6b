"""A laboratory's own normative bands: read from its table, held against each cycle, shown on the screen and in the report."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.cycles.cycle import some_cycles
from kinegraph.operators.cycles.statistics.norm_file import NormError, read_bands
from kinegraph.operators.cycles.statistics.norms import NormativeBands
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.recording import Recording
from tests.support.command_line import KINEGRAPH
from tests.support.emg_run import drive

HEAD = "muscle,cycle_pct,low [% MVC],high [% MVC]\n"


def written(folder: Path, text: str) -> Path:
    (folder / "bands.csv").write_text(text)
    return folder / "bands.csv"


def test_bands_are_interpolated_across_the_touch_down(tmp_path: Path) -> None:
    unit, bands = read_bands(
        written(tmp_path, "# ours\n" + HEAD + "TA,10,0,20\nTA,90,20,40\nSO,0,1,2\nSO,100,3,6\n"), 2.0
    )
    low, high = bands["TA"]
    assert unit == "% MVC" and low[10] == 0 and low[50] == 10 and low[90] == 20 and low[0] == low[99] - 1 == 10
    assert np.allclose(high - low, 20)
    assert np.allclose(bands["SO"], [1 + np.arange(100) / 50, 2 + np.arange(100) / 25])


def test_the_curves_that_a_report_wrote_are_bands(tmp_path: Path) -> None:
    text = "stage,limb,muscle,cycles,cycle_pct,mean (uV),sd (uV)\n"
    text += "".join(f",left,L_TA,20,{p},{50 + p},{p / 10}\n" for p in range(100))
    unit, bands = read_bands(written(tmp_path, text), 2.0)
    assert unit == "uV" and np.allclose(bands["L_TA"], [50 + 0.8 * np.arange(100), 50 + 1.2 * np.arange(100)])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("muscle,cycle_pct,low [uV]\nTA,0,1\n", "line 1: has muscle, cycle_pct, low; it needs"),
        ("# x\nmuscle,cycle_pct,low [uV],high [mV]\n", "line 2: low and high have the units mV, uV"),
        (HEAD + "TA,0,1,2\nTA,10,a,2\n", "line 3"),
        (HEAD + "TA,0,1,2\nTA,0,1,2\n", "line 3: TA at 0 % stands twice"),
        (HEAD + "TA,101,1,2\n", "line 2: needs a muscle, 0 to 100 %"),
        (HEAD + "TA,0,nan,2\n", "finite"),
        (HEAD + "TA,0,3,2\n", "band of TA has a low above its high"),
        (HEAD, "no muscles in it"),
    ],
)
def test_what_is_wrong_in_a_table_is_named_by_line(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(NormError, match=re.escape(message)):
        read_bands(written(tmp_path, text), 2.0)


def test_each_cycle_is_held_against_the_bands(tmp_path: Path) -> None:
    inputs = some_cycles(20, 3, 4)
    path = written(tmp_path, HEAD + "TA,0,30,60\nGM,0,0,10\n")
    made = drive(NormativeBands(str(path)), inputs)
    rows = made["against"][2]
    spec, numbers = inputs["cycles"][0], iter(rows)
    for curve in inputs["cycles"][2]:
        for name, low, high in (("TA", 30, 60), ("GM", 0, 10)):
            x = curve[:, spec.channels.index(name)]
            if np.isnan(x).any():
                continue
            row = next(numbers)
            above, below = int((x > high).sum()), int((x < low).sum())
            over = np.maximum(x - high, 0) + np.minimum(x - low, 0)
            furthest = int(np.abs(over).argmax())
            assert (row["name"], row["above_pct"], row["below_pct"]) == (name, above, below)
            assert (row["outside_pct"], row["beyond"]) == (above + below, over[furthest])
            assert row["furthest_pct"] == furthest if over.any() else np.isnan(row["furthest_pct"])
    assert next(numbers, None) is None and len(rows) > 25
    assert np.isnan(made["low"][2][:, :, 1]).all() and (made["high"][2][:, :, 0] == 60).all()
    for text, says in (
        (HEAD.replace("% MVC", "uV") + "TA,0,1,2\n", "bands in % MVC"),
        (HEAD + "XX,0,1,2\n", "TA, SO, GM"),
    ):
        with pytest.raises(ParameterError, match=says):
            drive(NormativeBands(str(written(tmp_path, text))), inputs)
    with pytest.raises(ParameterError, match="cannot be read"):
        drive(NormativeBands(str(tmp_path / "none.csv")), inputs)


def test_a_cycle_within_its_band_is_furthest_from_it_nowhere(tmp_path: Path) -> None:
    rows = drive(NormativeBands(str(written(tmp_path, HEAD + "TA,0,-1e9,1e9\n"))), some_cycles(20, 3, 4))["against"][2]
    assert len(rows) > 10 and not rows["beyond"].any() and np.isnan(rows["furthest_pct"]).all()


def test_without_a_table_there_are_no_bands() -> None:
    made = drive(NormativeBands(), some_cycles(20, 3, 4))
    assert np.isnan(made["low"][2]).all() and np.isnan(made["high"][2]).all() and not len(made["against"][2])


GRAPH = """
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, muscles: [TA, SO], realtime: false, duration_s: 16}
  envelope: {use: operators.emg.Envelope, from: treadmill.emg}
  cycles:
    use: operators.cycles.cycles.Cycles
    from: {signal: envelope, touchdown: treadmill.touchdown, liftoff: treadmill.liftoff}
  statistics: {use: operators.cycles.statistics.CycleStatistics, from: {closed: cycles.closed, cycles: cycles.cycles}}
  norms: {use: operators.cycles.statistics.norms.NormativeBands, from: {closed: cycles.closed, cycles: cycles.cycles}, file: bands.csv}
  screen:
    use: devices.outlets.terminal.cycle_table.CycleTable
    from: {closed: cycles.closed, statistics: statistics, norms: norms.against}
  report:
    use: devices.reports.session.SessionReport
    from: {closed: cycles.closed, cycles: cycles.cycles, statistics: statistics, low: norms.low, high: norms.high}
    path: r.html
record: [norms.against, norms.low, norms.high, cycles.cycles]
"""


def test_the_screen_and_the_report_show_what_lies_outside(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH)
    written(tmp_path, HEAD.replace("% MVC", "uV") + "TA,0,0,20\n")
    command = [KINEGRAPH, "run", "g.yaml", "-o", "w", "--view", "lines"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "r.html").read_text()
    with Recording.open(tmp_path / "w") as recording:
        _, rows = recording.read("norms.against")
        _, curves = recording.read("cycles.cycles")
    assert f"norm TA: {rows[-1]['outside_pct']:.0f} % of the cycle" in done.stdout
    assert "Beside the normative bands" in page and "bands.csv" in page and 'id="TA-norm"' in page
    assert "No norm values are shown" not in page and 'id="SO-norm"' not in page
    mean = curves[:, :, 0].mean(axis=0)
    row = re.search(
        r"<td>TA</td>(.*?)</tr>", page[page.index("Beside the normative bands") :].replace('class="num"', ""), re.DOTALL
    )
    numbers = [int(n) for n in re.findall(r">\s*(\d+)\s*<", row[1] if row else "")]
    assert numbers[:3] == [round(float((mean > 20).sum())), round(float((mean > 20).sum())), 0]
