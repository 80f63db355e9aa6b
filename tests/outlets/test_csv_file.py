"""CSV files: exact numbers, names with units, and nothing doubled or missing whatever happens to disk and process."""

from __future__ import annotations

import csv
import errno
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.outlets import append_file
from kinegraph.devices.outlets.csv_file import CsvFile
from kinegraph.stream.chunk import NS, Chunk, StreamSpec, empty
from kinegraph.stream.errors import DeviceError, InputError, ParameterError

START = 1_767_225_600 * NS
EMG = StreamSpec((2,), rate_hz=1000.0, channels=("TA", "SO"), units=("uV",))


def chunk(first: int, n: int, spec: StreamSpec = EMG, lost: int = 0) -> Chunk:
    """Samples with values that follow from their number."""
    index = np.arange(first, first + n)
    time = START + index * 1_000_000
    values = np.sin(index[:, None] + np.arange(spec.shape[0])) * 100
    return Chunk(time, values.astype(spec.dtype), int(time[-1]), lost)


def opened(path: Path, spec: StreamSpec = EMG, **given: str) -> CsvFile:
    outlet = CsvFile(str(path), **given)  # type: ignore[arg-type]
    assert outlet.open({"in": spec}) == {}
    return outlet


def begun(path: Path, spec: StreamSpec = EMG, **given: str) -> CsvFile:
    outlet = opened(path, spec, **given)
    outlet.begin()
    return outlet


def read(path: Path) -> tuple[list[str], list[list[str]]]:
    with path.open(newline="") as file:
        head, *table = csv.reader(file)
    return head, table


def test_a_signal_is_written_exactly(tmp_path: Path) -> None:
    outlet = begun(tmp_path / "emg.csv")
    outlet.process("in", chunk(0, 5))
    outlet.process("in", empty(EMG, START + NS))
    outlet.process("in", chunk(8, 4, lost=3))
    outlet.close()
    head, table = read(tmp_path / "emg.csv")
    assert head == ["time (UTC)", "seconds (s)", "lost", "TA (uV)", "SO (uV)"]
    assert table[0][:3] == ["2026-01-01T00:00:00.000000000Z", "0.000000000", "0"]
    assert [row[2] for row in table] == ["0"] * 5 + ["3", "0", "0", "0"]
    assert table[5][:2] == ["2026-01-01T00:00:00.008000000Z", "0.008000000"]
    values = np.array([row[3:] for row in table], float)
    assert values.tobytes() == np.concatenate([chunk(0, 5).data, chunk(8, 4).data]).tobytes()


def test_rows_are_there_at_once(tmp_path: Path) -> None:
    outlet = begun(tmp_path / "emg.csv")
    for i in range(3):
        outlet.process("in", chunk(10 * i, 10))
        assert len(read(tmp_path / "emg.csv")[1]) == 10 * (i + 1)
    outlet.close()


def test_events_give_a_column_per_field(tmp_path: Path) -> None:
    dtype = np.dtype([("onset", "<i8"), ("end", "<i8"), ("why", "U16"), ("peak", "<f8", (2,)), ("ok", "?")])
    spec = StreamSpec((), dtype, units=("ns", "ns", "", "uV", ""))
    event = np.array([(START - NS, 0, 'too "long", sir', (1.5, np.nan), True)], dtype)
    outlet = begun(tmp_path / "cycles.csv", spec)
    outlet.process("in", Chunk(np.array([START]), event, START))
    outlet.close()
    head, table = read(tmp_path / "cycles.csv")
    assert head[3:] == ["onset (s)", "end (s)", "why", "peak[0] (uV)", "peak[1] (uV)", "ok"]
    assert table == [
        ["2026-01-01T00:00:00.000000000Z", "0.000000000", "0", "-1.000000000", "", 'too "long", sir', "1.5", "nan", "1"]
    ]


def test_curves_and_single_precision(tmp_path: Path) -> None:
    curve = StreamSpec((3, 2), np.dtype("f4"), channels=("TA", "SO"), units=("uV", "mV"), channel_axis=1)
    data = np.arange(6, dtype="f4").reshape(1, 3, 2) / np.float32(10)
    outlet = begun(tmp_path / "curves.csv", curve)
    outlet.process("in", Chunk(np.array([START]), data, START))
    outlet.close()
    head, table = read(tmp_path / "curves.csv")
    assert head[3:] == ["TA[0] (uV)", "SO[0] (mV)", "TA[1] (uV)", "SO[1] (mV)", "TA[2] (uV)", "SO[2] (mV)"]
    assert table[0][3:] == ["0.0", "0.1", "0.2", "0.3", "0.4", "0.5"]


def test_an_existing_file_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "emg.csv"
    path.write_text("precious")
    for name in ("emg-2.csv", "emg-3.csv"):
        outlet = begun(path)
        outlet.close()
        assert read(tmp_path / name)[0][0] == "time (UTC)" and outlet.file == str(tmp_path / name)
    with pytest.raises(DeviceError, match="exists already"):
        begun(path, existing="refuse")
    assert path.read_text() == "precious"
    begun(path, existing="replace").close()
    assert "precious" not in path.read_text()


def test_a_second_instance_is_refused(tmp_path: Path) -> None:
    first = begun(tmp_path / "emg.csv")
    second = opened(tmp_path / "emg.csv")
    with pytest.raises(DeviceError, match="another session"):
        second.begin()
    first.close()
    second.begin()
    second.close()


def test_opening_alone_touches_nothing(tmp_path: Path) -> None:
    opened(tmp_path / "deep" / "emg.csv")
    assert list(tmp_path.iterdir()) == []


def test_impossible_places_are_refused_when_the_graph_is_checked(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for path, reported in ((tmp_path, "not a folder"), (tmp_path / "file" / "emg.csv", "is a file")):
        with pytest.raises(ParameterError, match=reported):
            opened(path)
    with pytest.raises(InputError, match="4096"):
        opened(tmp_path / "depth.csv", StreamSpec((480, 640), np.dtype("u2")))


def test_a_place_that_turns_out_unwritable_stops_the_start(tmp_path: Path) -> None:
    outlet = opened(tmp_path / "sub" / "emg.csv")
    (tmp_path / "sub").write_text("in the way")
    with pytest.raises(DeviceError, match="cannot write"):
        outlet.begin()


def test_resume_neither_doubles_nor_misses_rows(tmp_path: Path) -> None:
    path = tmp_path / "emg.csv"
    first = begun(path)
    first.process("in", chunk(0, 10))
    checkpoint = first.snapshot()
    first.process("in", chunk(10, 7))
    with path.open("ab") as file:
        file.write(b"2026-01-01T00:00:00.0170")  # half a row, as a crash may leave it
    first.runtime.lock.release()  # type: ignore[union-attr]  # what the system does when the process dies
    again = opened(path)
    again.restore(checkpoint)
    again.begin()
    again.process("in", chunk(10, 7))
    again.process("in", chunk(17, 3))
    again.close()
    assert [row[1] for row in read(path)[1]] == [f"0.{i:03d}000000" for i in range(20)]
    assert [p.name for p in tmp_path.glob("*.csv")] == ["emg.csv"]


def test_a_file_that_lost_its_end_goes_on_after_its_last_whole_row(tmp_path: Path) -> None:
    path = tmp_path / "emg.csv"
    first = begun(path)
    first.process("in", chunk(0, 10))
    checkpoint = first.snapshot()
    first.close()
    os.truncate(path, path.stat().st_size - 5)
    again = opened(path)
    again.restore(checkpoint)
    again.begin()
    again.process("in", chunk(10, 2))
    again.close()
    assert [row[1][:5] for row in read(path)[1]] == [f"0.{i:03d}" for i in (*range(9), 10, 11)]
    path.unlink()
    gone = opened(path)
    gone.restore(checkpoint)
    gone.begin()
    gone.close()
    assert read(path)[0][0] == "time (UTC)"


class FullDisk:
    """Takes `free` bytes, then raises; `os.pwrite` while a test lasts."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.free: float = np.inf
        self._write = os.pwrite
        monkeypatch.setattr(append_file, "RETRY_S", 0.0)
        monkeypatch.setattr(append_file.os, "pwrite", self.write)

    def write(self, handle: int, data: bytes, offset: int) -> int:
        n = int(min(len(data), self.free))
        if not n:
            raise OSError(errno.ENOSPC, "No space left on device")
        self.free -= n
        return self._write(handle, data[:n], offset)


def test_rows_wait_while_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = FullDisk(monkeypatch)
    path = tmp_path / "emg.csv"
    outlet = begun(path)
    outlet.process("in", chunk(0, 5))
    disk.free = 70
    outlet.process("in", chunk(5, 5))
    outlet.process("in", chunk(10, 5))
    checkpoint = outlet.snapshot()
    disk.free = np.inf
    outlet.process("in", chunk(15, 5))
    outlet.close()
    whole = path.read_bytes()
    assert [row[1] for row in read(path)[1]] == [f"0.{i:03d}000000" for i in range(20)]
    again = opened(path)
    again.restore(checkpoint)
    again.begin()
    again.process("in", chunk(15, 5))
    again.close()
    assert path.read_bytes() == whole


def test_what_cannot_wait_is_counted_and_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = FullDisk(monkeypatch)
    monkeypatch.setattr(append_file, "PENDING_BYTES", 1000)
    path = tmp_path / "emg.csv"
    outlet = begun(path)
    disk.free = 0
    for first in range(0, 40, 4):
        outlet.process("in", chunk(first, 4))
    kept = outlet.state.rows
    assert 0 < kept < 40
    disk.free = np.inf
    outlet.process("in", chunk(40, 4))
    with pytest.raises(DeviceError, match=f"{40 - kept} rows of .* could not be written"):
        outlet.close()
    table = read(path)[1]
    assert len(table) == kept + 4
    assert [(row[1][:5], row[2]) for row in table if row[2] != "0"] == [("0.040", str(40 - kept))]


def test_a_disk_that_stays_full_is_an_error_at_the_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk = FullDisk(monkeypatch)
    outlet = begun(tmp_path / "emg.csv")
    disk.free = 0
    outlet.process("in", chunk(0, 4))
    with pytest.raises(DeviceError, match="4 rows"):
        outlet.close()
    disk.free = np.inf
    begun(tmp_path / "emg.csv").close()


def test_kill_9_loses_no_row(tmp_path: Path) -> None:
    script = (
        "import sys, numpy as np\n"
        "from kinegraph.devices.outlets.csv_file import CsvFile\n"
        "from kinegraph.stream.chunk import Chunk, StreamSpec\n"
        "outlet = CsvFile(sys.argv[1])\n"
        "outlet.open({'in': StreamSpec((1,), rate_hz=1000.0)})\n"
        "outlet.begin()\n"
        "for i in range(100000):\n"
        "    outlet.process('in', Chunk(np.array([i + 1]), np.array([[float(i)]]), i + 1))\n"
        "    print(i, flush=True)\n"
    )
    path = tmp_path / "emg.csv"
    with subprocess.Popen([sys.executable, "-c", script, str(path)], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout
        output = [int(process.stdout.readline()) for _ in range(500)][-1]
        with pytest.raises(DeviceError, match="another session"):
            begun(path)
        process.send_signal(signal.SIGKILL)
    assert path.read_bytes().endswith(b"\n")
    values = [float(row[-1]) for row in read(path)[1]]
    assert len(values) > output and values == list(range(len(values)))
    begun(path).close()
