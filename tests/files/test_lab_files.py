"""Every file of the folder of real exports against what an independent reader found in it (truth.json; its README names the readers)."""

from __future__ import annotations

import json
import os
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
from tests.support.real import DATA_MARKS

FILES = Path(os.environ.get("KINEGRAPH_DATA", "/nonexistent")) / "files"
pytestmark = DATA_MARKS
TRUTH: dict[str, dict[str, Any]] = json.loads((FILES / "truth.json").read_text()) if FILES.is_dir() else {"": {}}
MT_HZ = 100.0


def read(name: str, **reported: Any) -> tuple[dict[str, Series], Findings]:
    """The streams of a file by what stands behind its own name."""
    options = ImportOptions(**reported)
    file = FILES / name
    series = read_files([file], options)
    return {one.name.removeprefix(file.stem).removeprefix("."): one for one in series}, options.findings


def of_reader(*readers: str) -> list[str]:
    return [
        name for name, truth in TRUTH.items() if truth.get("reader", "").split(",")[0].split(" (")[0] in readers
    ] or [""]


def numbers(values: list[Any]) -> np.ndarray:
    return np.array([np.nan if v is None or str(v).strip().lower() in ("", "nan") else float(v) for v in values])


def test_no_file_of_the_folder_is_left_out() -> None:
    tried = {
        *of_reader(
            "pyedflib", "token scan", "ezc3d", "text", "split", "scipy.io", "tab split", "csv split", "pandas", "pyxdf"
        )
    }
    untold = {name for name in TRUTH if "pyedflib_error" in TRUTH[name]} | {"c3d/sgi_int.c3d"}
    tried |= {name for name in TRUTH if name.startswith("delsys/")}
    assert tried | untold == set(TRUTH)


@pytest.mark.parametrize("name", of_reader("ezc3d"))
def test_c3d(name: str) -> None:
    truth = TRUTH[name]
    found, findings = read(name)
    markers = found["markers"]
    assert markers.data.shape == (truth["n_frames"], truth["n_points"], 3)
    assert (
        markers.spec.rate_hz == pytest.approx(truth["point_rate"]) and list(markers.spec.units) == truth["point_units"]
    )
    assert markers.time[0] == round((truth["first_frame"] - 1) / truth["point_rate"] * NS)
    np.testing.assert_allclose(markers.data[0, 0], numbers(truth["point0_first"]), atol=1e-3)
    assert np.isnan(markers.data).any(axis=2).sum() == truth["missing_points"]
    labels = [label.rpartition(":")[2] for label in truth["point_labels"]]
    assert [channel.rpartition(":")[2] for channel in markers.spec.channels[:6]] == labels
    if truth["n_analog"]:
        analog = found["analog"]
        assert analog.data.shape == (truth["n_analog_samples"], truth["n_analog"])
        assert analog.spec.rate_hz == pytest.approx(truth["analog_rate"])
        assert list(analog.spec.channels[:20]) == truth["analog_labels"][: truth["n_analog"]]
        np.testing.assert_allclose(analog.data[0, :8], truth["analog_first"], rtol=1e-5, atol=1e-6)
        np.testing.assert_allclose(analog.data[-1, :4], truth["analog_last"], rtol=1e-5, atol=1e-6)
        spelt = {"nt": "N", "ntmm": "Nmm"}
        assert {spelt.get(unit, unit) for unit in truth["analog_units"]} == set(analog.spec.units)
        assert (len(set(truth["analog_units"])) > 1) == any(
            "choose those of one kind" in doubt for doubt in findings.doubts
        )
    else:
        assert "analog" not in found
    lines = [(f"{side} {label}".lower().replace(" ", "_"), t) for side, label, t in truth.get("events", [])]
    lines += [(label.lower(), t) for label, t in truth.get("header_events", [])]
    mine = [(part, t / NS) for part, one in found.items() if one.spec.is_event for t in one.data["onset"].tolist()]
    if lines or name != "c3d/dec_real.c3d":  # its header holds events that the truth's reader does not see
        assert sorted(part for part, _ in mine) == sorted(part for part, _ in lines)
        np.testing.assert_allclose([t for _, t in sorted(mine)], [t for _, t in sorted(lines)], atol=1e-5)
    assert "subject" not in findings.facts, "names are private"


def test_the_same_recording_of_three_kinds_of_processors() -> None:
    pc, sgi, dec = (read(f"c3d/{name}.c3d")[0] for name in ("pc_int", "sgi_int", "dec_real"))
    assert pc.keys() == sgi.keys() == dec.keys()
    for part, one in pc.items():
        assert one.spec == sgi[part].spec and np.array_equal(one.time, sgi[part].time)
        assert one.data.tobytes() == sgi[part].data.tobytes()
        assert np.array_equal(one.time, dec[part].time)
    assert np.array_equal(pc["analog"].data, dec["analog"].data)
    assert np.nanmax(np.abs(pc["markers"].data - dec["markers"].data)) <= 0.2812
    np.testing.assert_allclose(pc["markers"].data[0, 3], (406.589, -259.812, 424.022), atol=0.3)


@pytest.mark.parametrize("name", of_reader("token scan"))
def test_bvh(name: str) -> None:
    truth = TRUTH[name]
    found, _ = read(name)
    positions, angles = found[""], found["angles"]
    assert angles.data.shape == (truth["frames"], truth["channels"])
    assert positions.data.shape == (truth["frames"], truth["joints"] + truth["end_sites"], 3)
    assert angles.spec.rate_hz == round(1 / truth["frame_time"])
    np.testing.assert_allclose(angles.data[0, :6], truth["first_values"], atol=1e-4)


@pytest.mark.parametrize("name", of_reader("pyedflib"))
def test_edf(name: str) -> None:
    truth = TRUTH[name]
    found, findings = read(name)
    signals = {
        (float(one.spec.rate_hz), k, label): (one.data[:, k], one.spec.unit_of(label))
        for one in found.values()
        if one.spec.rate_hz
        for k, label in enumerate(one.spec.channels)
    }
    assert len(signals) == len(truth["labels"])
    for i, (label, rate, n, unit) in enumerate(
        zip(truth["labels"], truth["rates"], truth["n"], truth["dims"], strict=True)
    ):
        mine = [
            v
            for (r, _, name), v in signals.items()
            if r == pytest.approx(rate) and name.startswith(label) and len(v[0]) == n
        ]
        assert mine and mine[0][1] == unit, (label, rate)
        if i < len(truth["first"]):
            assert any(np.allclose(data[:3], truth["first"][i], atol=1e-4) for data, _ in mine)
    started = np.datetime64(int(next(one for one in found.values() if one.spec.rate_hz).time[0]), "ns")
    seconds = str(started.astype("datetime64[s]")).replace("T", " ")
    assert seconds == truth["start"][:19]
    texts = [text for _, _, text in truth["annotations"]]
    assert texts == ([str(text) for text in found["annotations"].data["text"]] if "annotations" in found else [])
    if texts:
        onsets = (found["annotations"].data["onset"] - found["signals"].time[0]) / NS
        np.testing.assert_allclose(onsets, [t for t, _ in truth["mne"]["annotations"]], atol=1e-4)
    assert any("time zone" in doubt for doubt in findings.doubts)


def test_an_edf_that_begins_within_a_second() -> None:
    """The first annotation list says +0.3945312. (truth.json has .039453: that is what pyedflib's getStartdatetime makes of it.)"""
    found, findings = read("edf/subsecond.edf")
    assert found["signals"].time[0] % NS == pytest.approx(0.3945312e9, abs=1000)
    assert findings.facts == {"sex": "F"}, "neither name nor day of birth"


@pytest.mark.parametrize("name", [name for name, truth in TRUTH.items() if "pyedflib_error" in truth] or [""])
def test_what_breaks_the_rules_is_refused_with_the_reason(name: str) -> None:
    with pytest.raises(RecordingError, match=r"breaks the rules of EDF: its number of signals \(bytes 252 to 255\) is"):
        read(name)


@pytest.mark.parametrize("name", [name for name in TRUTH if name.startswith("imu/")] or [""])
def test_inertial_sensors(name: str) -> None:
    truth = TRUTH[name]
    if "columns" not in truth:
        found, findings = read(name)
        assert found.keys() == {"accelerometer", "gyroscope", "magnetometer", "barometer", "orientation"}
        assert found["accelerometer"].spec.rate_hz == 128 and len(found["accelerometer"]) == 3
        assert found["accelerometer"].spec.channels[:4] == ("Lumbar.x", "Lumbar.y", "Lumbar.z", "Right Ankle.x")
        assert found["orientation"].spec.channels[:4] == ("Lumbar.w", "Lumbar.x", "Lumbar.y", "Lumbar.z")
        assert found["orientation"].data.shape[1] == 24 and np.isnan(found["barometer"].data).all()
        assert found["accelerometer"].time[0] == pytest.approx(1550879504438281000, abs=1e6)
        assert any("cannot be measurements" in doubt for doubt in findings.doubts)
        return
    with pytest.raises(RecordingError, match="it holds neither an update rate nor times"):
        read(name)
    found, _ = read(name, rate={"": str(MT_HZ)})
    columns = {channel: one.data[:, k] for one in found.values() for k, channel in enumerate(one.spec.channels)}
    known = [
        c for c in truth["columns"] if c not in ("PacketCounter", "SampleTimeFine", "Year", "Month", "Day", "Second")
    ]
    assert list(columns) == known and all(len(column) == truth["n_rows"] for column in columns.values())
    facts = dict(zip(truth["columns"], truth["first_row"], strict=False))
    shown = [column for column in known if column in facts]
    np.testing.assert_allclose([columns[c][0] for c in shown], numbers([facts[c] for c in shown]), atol=1e-9)
    assert all(one.spec.rate_hz == MT_HZ for one in found.values())


@pytest.mark.parametrize("name", of_reader("tab split"))
def test_opensim_markers(name: str) -> None:
    truth = TRUTH[name]
    found, findings = read(name)
    markers = found["markers"]
    assert markers.data.shape == (truth["n_rows"], truth["n_markers"], 3)
    assert list(markers.spec.channels[:8]) == truth["names"] and markers.spec.units == (truth["header"]["Units"],)
    assert int(np.isnan(markers.data).sum()) == truth["empty_or_nan_cells"]
    np.testing.assert_allclose(markers.data[0].ravel()[:3], numbers(truth["first_row"][2:5]))
    assert markers.time[-1] / NS == pytest.approx(float(truth["t_last"]), abs=1e-5)
    decimated = name.endswith("walking5.trc")
    assert decimated == any("250 Hz, but its times are 0.04 s apart" in doubt for doubt in findings.doubts)
    assert markers.spec.rate_hz == (None if decimated else pytest.approx(float(truth["header"]["DataRate"]), rel=1e-4))


@pytest.mark.parametrize("name", of_reader("csv split"))
def test_opensim_storage(name: str) -> None:
    truth = TRUTH[name]
    found, findings = read(name)
    (one,) = found.values()
    labels = [label for label in truth["labels"][1:] if label]
    assert list(one.spec.channels[:7]) == labels and len(one) == truth["n_rows"]
    first = truth["first_row"][1:]
    if "," in first[0]:
        assert one.name.endswith(".orientations")
        np.testing.assert_allclose(one.data[0, :4], [[float(v) for v in cell.split(",")] for cell in first])
    else:
        np.testing.assert_allclose(one.data[0, :4] if len(first) > 3 else one.data[0, : len(first)], numbers(first))
    assert one.time[-1] / NS == pytest.approx(float(truth["last_time"]), abs=1e-6)
    announced = [line.strip(",") for line in truth["header"] if line.startswith(("nRows", "datarows"))]
    wrong = any(int(line.replace("datarows", "=").partition("=")[2]) != truth["n_rows"] for line in announced)
    assert wrong == any("rows are announced" in doubt for doubt in findings.doubts)


@pytest.mark.parametrize("name", of_reader("pandas"))
def test_vicon_tables(name: str) -> None:
    truth = TRUTH[name]
    found, _ = read(name)
    (one,) = found.values()
    flat = one.data.reshape(len(one), -1)
    assert flat.shape == (truth["shape"][0], truth["shape"][1] - 2)
    assert one.spec.rate_hz == truth["rate"] and list(one.spec.units) == truth["units"]
    assert int(np.isnan(flat).sum()) == truth["nan_cells"]
    np.testing.assert_allclose(flat[0, :4], truth["first_row"][2:], rtol=1e-9)
    np.testing.assert_allclose(flat[-1, : len(truth["last_row"]) - 2], truth["last_row"][2:], rtol=1e-9)


def test_vicons_table_is_vicons_c3d() -> None:
    table, c3d = read("vicon/markers.csv")[0]["markers"], read("c3d/nexus_markers_emg.c3d")[0]["markers"]
    assert table.spec.channels == c3d.spec.channels and np.array_equal(table.time, c3d.time[:200])
    np.testing.assert_allclose(table.data, c3d.data[:200], atol=0.005)
    devices, analog = read("vicon/analogs.csv")[0]["analog"], read("c3d/nexus_markers_emg.c3d")[0]["analog"]
    for number in range(1, 17):
        mine = next(
            k for k, name in enumerate(devices.spec.channels) if name.endswith(f"EMG{number}") and "IM" not in name
        )
        theirs = next(k for k, name in enumerate(analog.spec.channels) if name.endswith(f".EMG{number}"))
        np.testing.assert_allclose(devices.data[:, mine], analog.data[:2000, theirs], atol=1e-7)


@pytest.mark.parametrize("name", of_reader("pyxdf"))
def test_xdf(name: str) -> None:
    found, _ = read(name)
    streams = {stream["name"]: stream for stream in TRUTH[name]["streams"]}
    assert found.keys() == streams.keys()
    for part, truth in streams.items():
        one = found[part]
        assert len(one) == truth["n"] and one.spec.is_event == (truth["fmt"] == "string")
        if truth["fmt"] == "string":
            assert [str(text) for text in one.data["text"][:1]] == (truth["first"] or [])
        else:
            assert one.spec.rate_hz == truth["rate"] and one.data.shape[1:] == (truth["n_ch"],)
            assert one.data[:1].ravel().tolist() == (truth["first"] or [])
        if truth["n"]:
            assert (one.time[-1] - one.time[0]) / NS == pytest.approx(truth["t_end"] - truth["t0"], abs=1e-6)


def test_delsys() -> None:
    truth = TRUTH["delsys/emgworks_head.csv"]
    found, _ = read("delsys/emgworks_head.csv")
    names = [channel for one in found.values() for channel in one.spec.channels]
    assert len(names) == truth["pairs"] and set(truth["names"]) <= set(names)
    rates = {part: one.spec.rate_hz for part, one in found.items()}
    expected = {
        "emg_1926hz": 1925.926,
        "emg_1259hz": 1259.259,
        "acc": 148.148,
        "gyro": 148.148,
        "fsr": 518.519,
        "analog": 2222.222,
    }
    assert all(rates[part] == pytest.approx(rate, abs=1e-3) for part, rate in expected.items())
    assert {found[part].spec.units for part in ("emg_1926hz", "acc", "gyro")} == {("V",), ("g",), ("deg/s",)}
    truth = TRUTH["delsys/discover_1_4_2_head.csv"]
    found, findings = read("delsys/discover_1_4_2_head.csv")
    assert findings.facts["software"] == truth["app"] and sum(one.data.shape[1] for one in found.values()) == 50
    assert found["emg"].spec.channels[0] == "EMG 01 04498: EMG 1" and found["emg"].data[0, 0] == -0.03910887312123293
    assert str(np.datetime64(int(found["emg"].time[0]), "ns"))[:19] == "2022-04-12T17:23:09"
    found, _ = read("delsys/biceps_two_column.csv")
    (one,) = found.values()
    assert (
        len(one) == 6534
        and one.spec.rate_hz == pytest.approx(1925.93, abs=0.1)
        and one.time[0] / NS == pytest.approx(20.6711, abs=2e-4)
    )
    assert one.time[-1] / NS == pytest.approx(24.06323, abs=1e-5 + 1e-4)


def test_matlab_and_volts_of_a_plate() -> None:
    with pytest.raises(
        RecordingError, match=r"'data' \(176000, 2\) has no times, and the file no rate; give --rate uneven.data=HZ"
    ):
        read("mat/uneven.mat")
    found, _ = read("mat/uneven.mat", rate={"": "1600"})
    assert (
        found["data"].data.shape == tuple(TRUTH["mat/uneven.mat"]["vars"]["data"][0][::-1])
        and found["data"].data.dtype == np.float32
    )
    found, _ = read("force/kistler_volts.txt")
    (plate,) = found.values()
    assert plate.data.shape == (2000, 8) and plate.spec.rate_hz == 100
    assert plate.data[-1, 0] == -0.041521 and plate.time[-1] / NS == pytest.approx(19.99)


def test_a_study_of_bids() -> None:
    found, findings = read("bids/emg_Multimodal/sub-01/motion/sub-01_task-pullstand_tracksys-mocap_motion.tsv")
    assert (
        found["markers"].data.shape == (256, 2, 3)
        and found["markers"].spec.rate_hz == 256
        and found["markers"].spec.units == ("mm",)
    )
    assert found["markers"].data[0, 0].tolist() == [89.1437, 114.9735, 112.8298]
    assert findings.facts == {"subject": "01", "task": "pullstand", "age": "28", "sex": "F", "handedness": "right"}
    assert found["events"].data["onset"][0] == 16_097_250_000
    _, findings = read("bids/emg_CustomBipolarFace/sub-01/emg/sub-01_task-talking_emg.edf")
    assert any("gives V where the file itself gives uV" in doubt for doubt in findings.doubts)
