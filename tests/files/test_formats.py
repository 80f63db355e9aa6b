"""Formats that another package adds to `kinegraph files import` and `kinegraph files export` by its entry points."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FORMAT = """
import numpy as np
from kinegraph.devices.formats.exporter import Exporter
from kinegraph.devices.formats.importer import Importer
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series


def read(files, options, last):
    made = []
    for file in files:
        if not file.exists():
            raise RecordingError(f"{file}: there is no such file")
        data = np.array([[float(word)] for word in file.read_text().split()])
        made.append(Series(file.stem, StreamSpec((1,), rate_hz=10.0), np.arange(len(data)) * NS // 10, data))
    return made, options


def write(wanted):
    (name,) = wanted.names
    wanted.refuse_existing(wanted.place)
    words = [str(row[0]) for chunk in wanted.recording.chunks(name) for row in chunk.data]
    wanted.place.write_text(" ".join(words))
    wanted.progress(len(words))
    return [(name, wanted.place, len(words))]


WORDS = Importer("numbers with blanks between", (".lab",), read)
OUT = Exporter("numbers with blanks between", ".lab", write)
"""
ENTRIES = """[kinegraph.importers]
lab = lab_format:{importer}
[kinegraph.exporters]
lab = lab_format:OUT
"""


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """A folder as a package's installation leaves it."""
    info = tmp_path / "site" / "lab_format-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: lab_format\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(ENTRIES.format(importer="WORDS"))
    (tmp_path / "site" / "lab_format.py").write_text(FORMAT)
    return tmp_path


def kinegraph(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    command = [str(Path(sys.executable).parent / "kinegraph"), *words]
    environment = {**os.environ, "PYTHONPATH": str(folder / "site"), "COLUMNS": "200"}
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=120)


def test_a_format_of_another_package_goes_in_and_out(installed: Path) -> None:
    (installed / "grip.lab").write_text("1 2.5 -3")
    assert "numbers with blanks between: .lab" in " ".join(
        kinegraph(installed, "files", "import", "--help").stdout.split()
    )
    assert "lab: numbers with blanks between" in " ".join(
        kinegraph(installed, "files", "export", "--help").stdout.split()
    )
    done = kinegraph(installed, "files", "import", "grip.lab", "-o", "grip.mcap")
    assert (done.returncode, done.stdout.startswith("grip: 3 samples")) == (0, True), done.stderr
    assert kinegraph(installed, "files", "export", "grip.mcap", "-o", "again.lab").returncode == 0
    assert kinegraph(installed, "files", "export", "grip.mcap", "--format", "lab", "--overwrite").returncode == 0
    texts = [(installed / name).read_text() for name in ("again.lab", "grip.lab")]
    assert texts == ["1.0 2.5 -3.0"] * 2


def test_several_kinds_of_file_become_one_recording(installed: Path) -> None:
    (installed / "grip.lab").write_text("1 2.5 -3")
    (installed / "emg.csv").write_text("t,TA\n0,1\n0.1,2\n")
    done = kinegraph(installed, "files", "import", "emg.csv", "grip.lab", "-o", "both.mcap")
    assert done.returncode == 0 and {line.split(":")[0] for line in done.stdout.splitlines()} == {"emg", "grip"}


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (
            ("files", "import", "grip.xyz", "-o", "a.mcap"),
            "must end in .agd, .amc, .anc, .asf, ",
        ),
        (("files", "import", "gone.lab", "-o", "a.mcap"), "gone.lab: there is no such file"),
        (("files", "export", "a.mcap", "--format", "labs"), "--format labs: is not one of bdf, bids, "),
    ],
)
def test_what_is_not_known_is_told_with_what_is(installed: Path, words: tuple[str, ...], complaint: str) -> None:
    done = kinegraph(installed, *words)
    assert done.returncode == 2 and complaint in " ".join(done.stderr.split())


def test_a_package_whose_importer_is_gone_is_named(installed: Path) -> None:
    (installed / "site" / "lab_format-1.0.dist-info" / "entry_points.txt").write_text(ENTRIES.format(importer="GONE"))
    done = kinegraph(installed, "files", "import", "emg.csv", "-o", "a.mcap")
    assert done.returncode == 2 and "the importer lab (lab_format:GONE) cannot be loaded" in " ".join(
        done.stderr.split()
    )
