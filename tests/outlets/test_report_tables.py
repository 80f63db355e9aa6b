"""The report's tables as Excel and MATLAB hold what the CSV files hold."""

from __future__ import annotations

import csv
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from tests.support.command_line import KINEGRAPH

openpyxl = pytest.importorskip("openpyxl")
GRAPH = """
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, muscles: [TA, SO], realtime: false, duration_s: 12}
  envelope: {use: operators.emg.Envelope, from: treadmill.emg}
  cycles:
    use: operators.cycles.cycles.Cycles
    from: {signal: envelope, touchdown: treadmill.touchdown, liftoff: treadmill.liftoff}
  statistics: {use: operators.cycles.statistics.CycleStatistics, from: {closed: cycles.closed, cycles: cycles.cycles}}
  report:
    use: devices.reports.session.SessionReport
    from: {closed: cycles.closed, cycles: cycles.cycles, statistics: statistics}
    path: r.html
    tables: [xlsx, mat]
"""


def test_excel_and_matlab_hold_what_the_csv_files_hold(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH)
    command = [KINEGRAPH, "run", "g.yaml", "--view", "none", "--no-record"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    book = openpyxl.load_workbook(tmp_path / "r.xlsx", read_only=True)
    matlab = loadmat(tmp_path / "r.mat", simplify_cells=True)
    for name, table in (("cycles", "r.csv"), ("curves", "r-curves.csv")):
        with (tmp_path / table).open(newline="") as file:
            head, *rows = csv.reader(file)
        first, *cells = book[name].iter_rows(values_only=True)
        assert list(first) == head == list(matlab[name]["columns"]) and len(cells) == len(rows) > 5
        field = {"cycles": "TA_peak_uV", "curves": "mean_uV"}[name]
        column = head.index({"cycles": "TA peak (uV)", "curves": "mean (uV)"}[name])
        expected = [float(row[column]) for row in rows]
        assert np.allclose(np.array([row[column] for row in cells], float), expected, rtol=1e-14, equal_nan=True)
        assert np.array_equal(matlab[name][field], expected, equal_nan=True)
        text = head.index({"cycles": "amplitudes", "curves": "muscle"}[name])
        assert [row[text] for row in cells] == [row[text] for row in rows] == list(matlab[name][head[text]])
