"""CSV files become recordings; what is wrong with one is named, with its line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.chunk import NS
from kinegraph.stream.operator import grid
from tests.support.convert_run import imported, refused

pytestmark = pytest.mark.quick


def test_csv_with_units_and_a_time_column(tmp_path: Path) -> None:
    rows = [f"{i / 100:.2f},{i * 0.5},{-i}" for i in range(200)]
    (tmp_path / "board.csv").write_text("# a comment\ntime [s],TA [uV],angle (deg)\n" + "\n".join(rows) + "\n\n")
    with imported(tmp_path, tmp_path / "board.csv", "--start", "2024-05-01T09:30:00+02:00") as recording:
        time, data = recording.read("board")
        spec = recording.streams["board"].spec
        assert spec.channels == ("TA", "angle") and spec.units == ("uV", "deg") and spec.rate_hz == 100.0
        assert np.array_equal(time, grid(100.0, 200, 1_714_548_600 * NS))
        assert np.array_equal(data, np.stack([np.arange(200) * 0.5, -np.arange(200.0)], 1))


def test_csv_from_a_spreadsheet_with_decimal_commas_and_empty_cells(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("\ufefft_ms;x;y\n0;1,5;2\n10;;3\n20;2,5;nan\n30;1;1\n", encoding="utf-8")
    with imported(tmp_path, tmp_path / "a.csv") as recording:
        assert recording.read("a")[0].tolist() == [0, 10_000_000, 20_000_000, 30_000_000]
        assert np.array_equal(recording.read("a")[1], [[1.5, 2], [np.nan, 3], [2.5, np.nan], [1, 1]], equal_nan=True)


def test_several_csv_files_into_one_recording(tmp_path: Path) -> None:
    (tmp_path / "emg.csv").write_text("time,TA,GM\n" + "\n".join(f"{i / 100},{i},1" for i in range(100)))
    (tmp_path / "steps.csv").write_text("time\n0.25\n0.75\n")
    files = [tmp_path / "emg.csv", tmp_path / "steps.csv"]
    refused(
        tmp_path, "'time' is in several files; name one of emg:time, steps:time", *files, "--events", "b.steps=time"
    )
    lines = ["--stream", "b.emg=TA,GM", "--time", "emg:time", "--events", "b.steps=steps:time"]
    with imported(tmp_path, *files, *lines) as recording:
        assert recording.read("b.steps")[1]["onset"].tolist() == [250_000_000, 750_000_000]
        assert recording.streams["b.emg"].spec.channels == ("TA", "GM")


def test_each_stream_takes_the_times_of_its_own_file(tmp_path: Path) -> None:
    (tmp_path / "emg.csv").write_text(
        "time;TA [mV];GM [mV]\n" + "\n".join(f"{i / 100};{i};1".replace(".", ",") for i in range(100))
    )
    (tmp_path / "force.csv").write_text(
        "time;Fz [N]\n" + "\n".join(f"{i / 50};{i}".replace(".", ",") for i in range(50))
    )
    files = [tmp_path / "emg.csv", tmp_path / "force.csv"]
    with imported(tmp_path, *files, "--stream", "b.emg=TA,GM", "--stream", "b.force=Fz", "--time", "time") as recording:
        assert [recording.streams[name].spec.rate_hz for name in ("b.emg", "b.force")] == [100.0, 50.0]
    (tmp_path / "plate.csv").write_text((tmp_path / "force.csv").read_text().replace("Fz", "Fx"))
    files.append(tmp_path / "plate.csv")
    refused(tmp_path, "'time' is in several files", *files, "--stream", "b.both=Fx,Fz", "--time", "time")


def test_a_micro_sign_is_spelt_as_everywhere(tmp_path: Path) -> None:
    header = "t_ms,TA [\u00b5V],GM [\u03bcV],SO [uV]\n"
    (tmp_path / "a.csv").write_text(header + "\n".join(f"{i},{i},1,2" for i in range(100)), encoding="utf-8")
    with imported(tmp_path, tmp_path / "a.csv") as recording:
        assert recording.streams["a"].spec.units == ("uV",)


@pytest.mark.parametrize("unit", ["us", "\u00b5s", "\u03bcs", "usec"])
def test_times_are_in_the_unit_of_the_header(tmp_path: Path, unit: str) -> None:
    (tmp_path / "a.csv").write_text(
        f"time [{unit}],x\n" + "\n".join(f"{i * 1000},1" for i in range(100)), encoding="utf-8"
    )
    with imported(tmp_path, tmp_path / "a.csv") as recording:
        assert recording.streams["a"].spec.rate_hz == 1000.0


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("time,a\n0,1\n0.1,2,3\n", "bad.csv: line 3: 3 cells, but the header names 2 columns"),
        ("time,a\n0,1\n0.1\n", "bad.csv: line 3: 1 cells"),
        ("time,a\n0,1\n\n0.1,2\n", "bad.csv: line 3: 0 cells"),
        ("time,a\n0,1\n0.1,high\n", "bad.csv: line 3: 'high' in column 'a' is not a number"),
        ("time,a\n0,1\n0.2,2\n0.1,3\n", "bad.csv: line 4: time runs backwards, from 0.2 s to 0.1 s"),
        ("time,a\n0,1\n0.1,2\n0.1,3\n", "bad.csv: line 4: the time 0.1 s is repeated"),
        ("time,a\n0,1\n,2\n", "bad.csv: line 3: .*time' holds no time"),
        (
            "time [frames],a\n0,1\n1,2\n",
            "bad.csv: 'bad:time' is in 'frames', which is not a unit of time; .* --time-unit bad=UNIT",
        ),
        ("0,1\n0.1,2\n", "bad.csv: line 1: the first line must name the columns, but holds the number 0"),
        ("time,a,\n0,1,2\n", "bad.csv: line 1: every column needs a name of its own; number 3 has no name"),
        ("", "bad.csv: the file is empty"),
        ("a,b\n1,2\n", "when its samples were taken is not known; give --rate"),
        ("time,a\n", "no samples"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, complaint: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    refused(tmp_path, complaint, tmp_path / "bad.csv")


def test_a_bad_csv_ends_the_command_with_its_message_and_an_exit_code(tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("time,a\n0,1\n0.1,2,3\n")
    command = [
        sys.executable,
        "-m",
        "kinegraph",
        "files",
        "import",
        str(tmp_path / "bad.csv"),
        "-o",
        str(tmp_path / "out.mcap"),
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2 and "line 3" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "out.mcap").exists()
