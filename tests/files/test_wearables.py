"""Files of wearables, imitated after their makers' public descriptions: no recording of a real device was at hand."""

from __future__ import annotations

import json
import sqlite3
import struct
import zipfile
from collections.abc import Callable
from contextlib import closing
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.devices.formats.findings import Findings
from kinegraph.devices.formats.importer import read_files
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series

BEGAN = 1_427_885_221
"""2015-04-01 10:47:01."""
TICKS_1970 = 621_355_968_000_000_000


def read(file: Path, **asked: Any) -> tuple[dict[str, Series], Findings]:
    options = ImportOptions(**asked)
    found = {s.name.removeprefix(file.stem).removeprefix("."): s for s in read_files([file], options)}
    assert any("never tried on a real recording" in doubt for doubt in options.findings.doubts)
    return found, options.findings


def test_the_example_of_actigraphs_description(tmp_path: Path) -> None:
    def record(kind: int, second: int, payload: bytes) -> bytes:
        body = struct.pack("<BBIH", 0x1E, kind, second, len(payload)) + payload
        return body + bytes([~reduce(lambda a, b: a ^ b, body) & 255])

    packed = bytes.fromhex("00 60 08 EB D0 07 00 9E BF 00 70 08 EB F0")
    whole = struct.pack("<9h", *range(1, 10))
    log = record(6, BEGAN, b"{}") + record(0, BEGAN, packed) + b"\0\0" + record(26, BEGAN + 2, whole)
    broken = bytearray(record(0, BEGAN + 3, packed))
    broken[12] ^= 1
    with zipfile.ZipFile(tmp_path / "a.gt3x", "w") as archive:
        archive.writestr("info.txt", "Serial Number: NEO1C16110020\nSample Rate: 3\n")
        archive.writestr("log.bin", log + broken)
    found, findings = read(tmp_path / "a.gt3x")
    acc = found["acc"]
    assert (acc.data[:3] * 341).round().tolist() == [[8, 6, -323], [9, 7, -321], [8, 7, -321]]
    assert (acc.data[3:] * 341).round().tolist() == [[1, 2, 3], [4, 5, 6], [7, 8, 9]]
    assert acc.lost is not None and acc.lost.tolist() == [0, 0, 0, 3, 0, 0] and acc.time[0] == BEGAN * NS
    assert acc.spec.units == ("g",) and any("1 records are damaged" in doubt for doubt in findings.doubts)


def test_epochs_of_actilife(tmp_path: Path) -> None:
    with closing(sqlite3.connect(tmp_path / "a.agd")) as made:
        made.execute("CREATE TABLE settings (settingID INTEGER, settingName TEXT, settingValue TEXT)")
        made.execute("CREATE TABLE data (dataTimestamp INTEGER, axis1 INTEGER, axis2 INTEGER, steps INTEGER)")
        made.executemany("INSERT INTO settings VALUES (1, ?, ?)", [("epochlength", "60"), ("deviceserial", "NEO1")])
        rows = [(TICKS_1970 + (BEGAN + 60 * i) * 10_000_000, i, 2 * i, 1) for i in range(20) if i not in (7, 8)]
        made.executemany("INSERT INTO data VALUES (?, ?, ?, ?)", rows)
        made.commit()
    found, findings = read(tmp_path / "a.agd")
    counts = found["counts"]
    assert counts.spec.channels == ("axis1", "axis2", "steps") and counts.spec.rate_hz == pytest.approx(1 / 60)
    assert counts.lost is not None and counts.lost.sum() == 2 and counts.time[0] == BEGAN * NS
    assert findings.facts["device"] == "ActiGraph NEO1"


@pytest.mark.parametrize("delimiter", [",", ";"])
def test_actilifes_text_in_two_countries(delimiter: str, tmp_path: Path) -> None:
    header = (
        "------------ Data File Created By ActiGraph GT3X+ ActiLife v6.13.3 Firmware v2.5.0 date format dd/MM/yyyy at 30 Hz  Filter Normal "
        "-----------\nSerial Number: NEO1\nStart Time 10:47:01\nStart Date 01/04/2015\nEpoch Period (hh:mm:ss) 00:00:00\nDownload Time "
        "12:00:00\nDownload Date 02/04/2015\nCurrent Memory Address: 0\nCurrent Battery Voltage: 4.21     Mode = 12\n---------\n"
    )
    names = delimiter.join(f"Accelerometer {axis}" for axis in "XYZ")
    rows = [
        [f"{v:.3f}".replace(".", "," if delimiter == ";" else ".") for v in (0.1, -0.2, i / 100)] for i in range(30)
    ]
    text = header + names + "\n" + "\n".join(delimiter.join(row) for row in rows) + "\n"
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    acc = read(tmp_path / "a.csv")[0]["acc"]
    assert acc.data[29].tolist() == [0.1, -0.2, 0.29] and acc.spec.rate_hz == 30 and acc.time[0] == BEGAN * NS


def test_an_awd_file_keeps_no_name(tmp_path: Path) -> None:
    lines = ["Jane Doe", "01-Apr-2015", "10:47:01", "4", "33", "V123456", "F", *("12", "0", "7 M", "3")]
    (tmp_path / "a.AWD").write_text("\r\n".join(lines), encoding="cp1252")
    found, findings = read(tmp_path / "a.AWD")
    assert found["activity"].data[:, 0].tolist() == [12, 0, 7, 3] and found["activity"].spec.rate_hz == pytest.approx(
        1 / 60
    )
    assert found["markers"].data["onset"].tolist() == [(BEGAN + 120) * NS] and "Doe" not in str(findings.facts)


@pytest.mark.parametrize(
    ("names", "date", "comma"),
    [
        (["Line", "Date", "Time", "Off-Wrist Status", "Activity", "Marker", "White Light"], "{m}/{d}/2015", False),
        (["Ligne", "Date", "Heure", "Statut", "Activité", "Marqueur", "Lumière blanche"], "{d}/{m}/2015", True),
        (["Zeile", "Datum", "Zeit", "Status", "Aktivität", "Markierung", "Weißes Licht"], "{d}.{m}.2015", True),
    ],
)  # fmt: skip
def test_actiwares_exports_in_several_languages(names: list[str], date: str, comma: bool, tmp_path: Path) -> None:
    delimiter, point = (";", ",") if comma else (",", ".")
    rows = [["", f"Actiware {names[1]}"], [""], names]
    for i in range(40):
        minute = 47 + i
        clock = f"{10 + minute // 60:02d}:{minute % 60:02d}:01" + ("" if comma else " AM")
        rows.append([str(i), date.format(d=13, m=4), clock, "0", str(i), "1" if i == 5 else "0", f"1{point}5"])
    text = "\n".join(delimiter.join(f'"{cell}"' for cell in row) for row in rows)
    (tmp_path / "a.csv").write_text(text, encoding="utf-8-sig")
    found, _ = read(tmp_path / "a.csv")
    epochs = found["epochs"]
    assert epochs.spec.rate_hz == pytest.approx(1 / 60) and epochs.data[3].tolist() == [0, 3, 1.5]
    assert epochs.time[0] == (BEGAN + 12 * 86_400) * NS and len(found["markers"].data) == 1


@pytest.mark.parametrize("has_one_column", [True, False])
def test_motionwares_export_has_days_before_months(has_one_column: bool, tmp_path: Path) -> None:
    join = " " if has_one_column else ","
    lines = [
        "MotionWare Data Export",
        "Serial Number,M12345",
        "",
        f"Date{'/' if has_one_column else ','}Time,Activity,Light",
    ]
    lines += [f"01/04/2015{join}{10 + (47 + i) // 60:02d}:{(47 + i) % 60:02d}:01,{i},{i / 2}" for i in range(40)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    found, findings = read(tmp_path / "a.csv")
    epochs = found["epochs"]
    assert findings.kinds[tmp_path / "a.csv"] == "MotionWare export" and epochs.spec.channels == ("Activity", "Light")
    assert epochs.spec.rate_hz == pytest.approx(1 / 60) and epochs.data[3].tolist() == [3, 1.5]
    assert epochs.time[0] == BEGAN * NS and any("day/month" in doubt for doubt in findings.doubts)


def test_a_motionwatch(tmp_path: Path) -> None:
    text = (
        "<log2><change><property><name>=Device</name><content>MW8</content></property><property><name>=StartTime</name>"
        "<content>2015-04-01 10:47:01</content></property><channel><name>motion</name><epoch>30</epoch><units>x</units>"
        "<data>1,2,3\n,4</data></channel></change></log2>"
    ).replace("3\n,4", "3,\n4")
    (tmp_path / "a.mtn").write_text(text, encoding="utf-8")
    motion = read(tmp_path / "a.mtn")[0]["motion"]
    assert (
        motion.data[:, 0].tolist() == [1, 2, 3, 4]
        and motion.spec.rate_hz == pytest.approx(1 / 30)
        and motion.time[0] == BEGAN * NS
    )


def cwa(blocks: int, *, packed: bool, gap: int = 0) -> bytes:
    """Blocks of an AX3 (packed, or as an AX6 with gyroscope) at 100 Hz; from the fourth on `gap` seconds later."""
    made = bytearray(b"MD\xfc\x03\x17" + struct.pack("<H", 4711) + bytes(1024 - 7))
    count = 120 if packed else 40
    for k in range(blocks):
        at = k * count / 100 + (gap if k > 3 else 0)
        second, fraction = int(at), at % 1
        time = 15 << 26 | 4 << 22 | 1 << 17 | 10 << 12 | (47 + (1 + second) // 60) << 6 | (1 + second) % 60
        offset = -(int(fraction * 32768) * 100 // 32768)
        if packed:
            data = np.full(count, (-256 & 1023) | 64 << 10 | 256 << 20, "<u4").tobytes()
        else:
            data = np.tile(np.array([1000, 0, -1000, 0, 2048, -2048], "<i2"), count).tobytes()
        light = (0 if packed else 3 << 13 | 2 << 10) | 100
        head = struct.pack(
            "<2sHHIIIHHBBBBhH", b"AX", 508, 0x8000 | int(fraction * 32768), 1, k, time, light, 0, 0, 200, 0x4A,
            0x30 if packed else 0x62, offset, count,
        )  # fmt: skip
        body = head + data
        total = int(np.frombuffer(body, "<u2").sum(dtype=np.int64))
        made += body + struct.pack("<H", -total & 0xFFFF)
    return bytes(made)


def test_an_axivity_ax3_and_ax6(tmp_path: Path) -> None:
    (tmp_path / "a.cwa").write_bytes(cwa(8, packed=True, gap=10))
    found, findings = read(tmp_path / "a.cwa")
    acc = found["acc"]
    assert (acc.spec.rate_hz, len(acc.data)) == (100.0, 960) and (acc.data == [-1, 0.25, 1]).all()
    assert acc.lost is not None and abs(acc.lost.sum() - 1000) <= 2 and findings.facts["device"] == "Axivity AX3 4711"
    assert abs(acc.time[0] - BEGAN * NS) < 0.02 * NS and (np.diff(acc.time) > 0).all()
    (tmp_path / "b.cwa").write_bytes(cwa(8, packed=False))
    found, _ = read(tmp_path / "b.cwa")
    assert (found["acc"].data == [0, 1, -1]).all() and found["acc"].lost is None
    assert found["gyro"].data[0, 0] == pytest.approx(1000 * 2000 / 32768) and found["gyro"].spec.units == ("deg/s",)


def test_a_geneactiv(tmp_path: Path) -> None:
    sample = (100 << 36) | ((-200 & 4095) << 24) | (255 << 12) | (50 << 2)
    pages = "".join(
        f"Recorded Data\nDevice Unique Serial Code:012967\nSequence Number:{k}\nPage Time:2015-04-01 10:47:{1 + 3 * k + (k > 1):02d}:000\n"
        f"Unassigned:\nTemperature:21,6\nBattery voltage:4.2\nDevice Status:Recording\nMeasurement Frequency:100.0\n"
        + "".join(f"{sample | (2 if k == 1 and i == 7 else 0):012X}" for i in range(300)) + "\n"
        for k in range(3)
    )  # fmt: skip
    header = (
        "Device Identity\nDevice Unique Serial Code:012967\nDevice Type:GENEActiv\n\nConfiguration Info\nMeasurement Frequency:100 Hz\n"
        "Time Zone:GMT +01:00\n\nCalibration Data\nx gain:25000\nx offset:0\ny gain:25000\ny offset:100\nz gain:25500\nz offset:0\n"
        "Volts:300\nLux:600\n\n"
    )
    (tmp_path / "a.bin").write_text(header + pages, encoding="utf-8")
    found, _ = read(tmp_path / "a.bin")
    acc = found["acc"]
    assert acc.data[0].tolist() == [0.4, -0.804, 1.0] and found["light"].data[0, 0] == 100.0
    assert acc.lost is not None and acc.lost[acc.lost > 0].tolist() == [100]
    assert found["markers"].data["onset"].tolist() == [(BEGAN - 3600) * NS + 3_070_000_000]


def test_opensignals_with_a_hole_in_its_counter(tmp_path: Path) -> None:
    device = {
        "sensor": ["EMG", "ECG"], "column": ["nSeq", "I1", "A1", "A2"], "sampling rate": 1000, "date": "2015-4-1", "time": "10:47:1.0",
        "device": "bitalino_rev", "resolution": [4, 1, 10, 10],
    }  # fmt: skip
    rows = "".join(f"{i % 16}\t0\t{i}\t512\t\n" for i in range(100) if i not in (40, 41, 42))
    text = f"# OpenSignals Text File Format. Version 1\n# {json.dumps({'20:15': device})}\n# EndOfHeader\n{rows}"
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    signals = read(tmp_path / "a.txt")[0]["signals"]
    assert signals.spec.channels == ("A1", "A2") and signals.spec.rate_hz == 1000 and signals.time[0] == BEGAN * NS
    assert (
        signals.lost is not None
        and signals.lost[signals.lost > 0].tolist() == [3]
        and signals.data[-1].tolist() == [99, 512]
    )


@pytest.mark.parametrize(
    ("name", "made"),
    [
        ("a.hpf", lambda: b"\1\2\3"), ("a.tdf", lambda: bytes(99)), ("a.asc", lambda: b"1 2 3\n"), ("a.nev", lambda: b"NEURALEV"),
        ("a.dat", lambda: bytes(40)),
    ],
)  # fmt: skip
def test_a_file_that_is_not_read_is_named_with_what_to_export(
    name: str, made: Callable[[], bytes], tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(made())
    with pytest.raises(RecordingError, match=r"this looks like .*(Delsys|BTS|AMTI|Noraxon|Kistler).*export it"):
        read_files([tmp_path / name], ImportOptions())
