"""The grammars of laboratories' programs on replicas that this test writes: what is read, what is doubted, what is refused and where."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import edfio
import ezc3d
import h5py
import numpy as np
import pytest
import scipy.io

from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.devices.formats.findings import Findings
from kinegraph.devices.formats.importer import read_files
from kinegraph.devices.formats.lab import matlab
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import InputError, RecordingError
from kinegraph.stream.recording.series import Series
from tests.files import lab_replicas as made


def read(path: Path, text: str | bytes = b"", **reported: Any) -> tuple[dict[str, Series], Findings]:
    if text:
        path.write_bytes(text.encode() if isinstance(text, str) else text)
    options = ImportOptions(**reported)
    return {s.name.removeprefix(path.stem).removeprefix("."): s for s in read_files([path], options)}, options.findings


def doubts(findings: Findings) -> str:
    return "\n".join(findings.doubts)


def test_emgworks_has_a_clock_for_each_channel(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "walk.data", made.EMGWORKS)
    assert found.keys() == {"emg_1926hz", "acc", "emg_1259hz"}
    assert [len(one) for one in found.values()] == [60, 12, 40]
    assert found["emg_1926hz"].spec.rate_hz == pytest.approx(2000 * 26 / 27) and found["emg_1926hz"].spec.units == (
        "V",
    )
    assert found["acc"].spec.channels == ("Avanti sensor 1: ACC.X 1",) and found["acc"].spec.rate_hz == pytest.approx(
        4000 / 27
    )
    assert found["emg_1259hz"].data[-1, 0] == pytest.approx(39 * 2e-5)
    assert "judged by its size to be V" in doubts(findings)
    assert read(tmp_path / "walk.data", unit={"": "mV"})[0]["emg_1926hz"].spec.units == ("mV",)


def test_discover_qualifies_names_by_sensor(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "d.csv", made.DISCOVER)
    assert found["emg"].spec.channels == ("Left TA: EMG 1", "Right TA: EMG 1") and found["emg"].spec.units == ("mV",)
    assert (
        found["emg"].spec.rate_hz == pytest.approx(1259.2593, abs=1e-4)
        and len(found["acc"]) == 8
        and found["acc"].spec.units == ("g",)
    )
    assert str(np.datetime64(int(found["emg"].time[0]), "ns"))[:19] == "2024-04-12T17:23:09"
    assert "time zone" in doubts(findings) and "taken for" in doubts(findings)


def test_noraxon_keeps_names_of_people_to_itself(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "n.csv", made.NORAXON)
    assert found["emg"].spec.rate_hz == 2000.4 and found["emg"].spec.units == ("uV",) and found["emg"].data[4, 0] == 5.0
    assert found["sensors"].spec.channels == ("ELBOW",) and found["sensors"].spec.units == ("deg",)
    assert found["marker"].data["text"].tolist() == ["up", "up"] and found["activity"].data["text"].tolist() == [
        "Lifting"
    ]
    assert found["marker"].data["onset"][0] - found["emg"].time[0] == round(7 / 2000.4 * NS)
    assert str(np.datetime64(int(found["emg"].time[0]), "ns"))[:19] == "2025-01-01T09:00:00"
    assert findings.facts["sex"] == "female" and not {"Doe", "Jane", "1980-01-01"} & set(
        map(str, findings.facts.values())
    )
    assert "announced" in doubts(read(tmp_path / "n.csv", made.NORAXON.replace('"40"', '"4000"'))[1])


def test_vicons_sections_share_one_clock(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "trial.txt", made.VICON)
    assert found.keys() == {"analog", "markers", "right_foot_strike", "left_foot_off"}
    analog, markers = found["analog"], found["markers"]
    assert (
        analog.spec.units == ("N", "Nmm", "V")
        and analog.spec.channels == ("Fz", "Mx", "EMG1")
        and analog.spec.rate_hz == 1000
    )
    assert analog.data[3, 2] == pytest.approx(-7.5e-5) and analog.time[0] == markers.time[0] == round(8.32 * NS)
    assert markers.spec.channels == ("LTOE", "RTOE") and np.isnan(markers.data[2, 1]).all()
    assert found["right_foot_strike"].data["onset"].tolist() == [8_330_000_000, 8_340_000_000]
    assert found["right_foot_strike"].spec.meta["side"] == "right" and "frame is number 833" in doubts(findings)
    europe, _ = read(tmp_path / "europe.csv", made.VICON_EUROPE)
    assert europe["analog"].data[1, 0] == 1.5 and europe["analog"].spec.rate_hz == 1000


def test_volts_and_newtons_never_share_an_emg_chain(tmp_path: Path) -> None:
    spec = read(tmp_path / "trial.csv", made.VICON)[0]["analog"].spec
    for operator in (Envelope(), SignalQuality()):
        with pytest.raises(InputError, match=r"N, Nmm, V: Fz, Mx beside voltages.*operators.Select"):
            operator.open({"in": spec})
    volts = StreamSpec((2,), rate_hz=1000.0, channels=("TA", "GM"), units=("V", "mV"))
    assert Envelope().open({"in": volts})


def test_qualisys_with_a_header_and_events(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "q.tsv", made.QUALISYS)
    assert (
        found["markers"].data.shape == (20, 2, 3)
        and found["markers"].spec.rate_hz == 100
        and found["markers"].spec.units == ("mm",)
    )
    assert np.isnan(found["markers"].data[5, 1]).all() and found["markers"].data[4, 1].tolist() == [3, 4, 5]
    assert found["events"].data["text"].tolist() == ["jump"] and "exactly 0, 0, 0" in doubts(findings)
    text = made.QUALISYS.replace("NO_OF_MARKERS\t2", "NO_OF_BODIES\t1")
    with pytest.raises(RecordingError, match=r"rigid bodies .6D., which is not read; export 3D data, or C3D"):
        read(tmp_path / "q.tsv", text)


def test_a_time_column_is_believed_before_a_rate(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "m.trc", made.TRC)
    assert found["markers"].spec.rate_hz == 25 and found["markers"].spec.units == ("m",)
    assert np.isnan(found["markers"].data[3, 1]).all() and found["markers"].data[9, 0].tolist() == [0.09, 0.5, 1]
    assert "the file says 250 Hz, but its times are 0.04 s apart" in doubts(findings)


def test_markers_saved_again_with_decimal_commas_are_the_same(tmp_path: Path) -> None:
    points = read(tmp_path / "m.trc", made.TRC.replace("\t250", "\t25.0"))[0]["markers"]
    commas = read(tmp_path / "m.trc", made.TRC.replace("\t250", "\t25.0").replace(".", ","))[0]["markers"]
    assert np.array_equal(points.data, commas.data, equal_nan=True) and points.spec == commas.spec
    with pytest.raises(RecordingError, match=r"is no number; save the file with decimal points"):
        read(tmp_path / "m.mot", made.STORAGE.replace(".", ","))


def test_storage_of_three_kinds(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "grf.mot", made.STORAGE)
    assert found["values"].spec.channels == (
        "ground_force_vy",
        "pelvis_tx",
    ) and "250 rows are announced, 20 are there" in doubts(findings)
    found, _ = read(tmp_path / "c.mot", made.COORDINATES)
    assert found["coordinates"].spec.units == ("deg", "m") and found["coordinates"].spec.rate_hz == 100
    found, _ = read(tmp_path / "q.sto", made.QUATERNIONS.replace("\n", "\r\n"))
    assert found["orientations"].data.shape == (20, 2, 4) and found["orientations"].data[3, 0].tolist() == [
        1,
        0,
        0,
        0.03,
    ]


def test_inertial_sensors(tmp_path: Path) -> None:
    found, _ = read(tmp_path / "MT_1.txt", made.MT_MANAGER)
    acc = found["acc"]
    assert (
        acc.spec.rate_hz == 100
        and acc.lost is not None
        and acc.lost.tolist() == [0, 0, 0, 0, 0, 2, 0]
        and acc.time[-1] == 8 * NS // 100
    )
    assert found["euler"].spec.channels == ("Roll",)
    for separator in ",; ":
        assert np.array_equal(
            read(tmp_path / "MT_1.txt", made.MT_MANAGER.replace("\t", separator))[0]["acc"].data, acc.data
        )
    text = made.MT_MANAGER.replace("// Update Rate: 100.0Hz\n", "")
    with pytest.raises(RecordingError, match=r"it holds neither an update rate nor times; give --rate HZ"):
        read(tmp_path / "MT_1.txt", text)
    assert "count samples" in doubts(read(tmp_path / "MT_1.txt", text, preview=True)[1])
    found, findings = read(tmp_path / "a.csv", made.APDM)
    assert found["accelerometer"].spec.channels[3] == "Ankle.x" and found[
        "accelerometer"
    ].spec.rate_hz == pytest.approx(128, abs=0.01)
    assert (
        np.isnan(found["barometer"].data[:, 0]).all()
        and found["barometer"].data[0, 1] == 101.3
        and "cannot be measurements" in doubts(findings)
    )


def test_cortex(tmp_path: Path) -> None:
    found, _ = read(tmp_path / "walk.forces", made.FORCES)
    assert found["force"].spec.units == ("N", "N", "N", "mm", "mm", "mm", "Nmm") and found["force"].spec.rate_hz == 300
    found, findings = read(tmp_path / "walk.anc", made.ANC)
    assert found["analog"].data[29, 0] == pytest.approx(2900 * 5000 / 32768 / 1000) and not doubts(findings)


def test_an_analogue_table_that_was_cut_off_is_doubted(tmp_path: Path) -> None:
    whole = made.ANC.replace("Trial#:\t1\n", "Trial#:\t1\tDuration(Sec.):\t0.100000\t#Channels:\t2          \n")
    assert not doubts(read(tmp_path / "walk.anc", whole)[1])
    cut = "".join(whole.splitlines(keepends=True)[:-25])
    found, findings = read(tmp_path / "cut.anc", cut)
    assert len(found["analog"]) == 5
    assert "30 samples (0.100000 s) are announced, 5 are there; was the file cut off?" in doubts(findings)
    assert "3 channels are announced, 2 are there" in doubts(
        read(tmp_path / "c.anc", whole.replace("#Channels:\t2", "#Channels:\t3"))[1]
    )


def test_a_packet_that_was_written_twice_costs_no_other_packet(tmp_path: Path) -> None:
    rows = made.MT_MANAGER.splitlines(keepends=True)
    found, findings = read(tmp_path / "MT_1.txt", "".join([*rows[:6], rows[5], *rows[6:]]))
    alone = read(tmp_path / "MT_1.txt", made.MT_MANAGER)[0]
    assert "1 of 8 packets have the counter of the packet before (first in row 2) and are left out" in doubts(findings)
    assert np.array_equal(found["acc"].data, alone["acc"].data) and np.array_equal(found["acc"].time, alone["acc"].time)
    often = "".join([*rows[:4], *(row for row in rows[4:] for _ in range(2))])
    with pytest.raises(
        RecordingError, match=r"stands still at 65533, as in 7 of 14 rows; .* leave the others out with --repeated"
    ):
        read(tmp_path / "MT_1.txt", often)
    assert np.array_equal(read(tmp_path / "MT_1.txt", often, repeated=True)[0]["acc"].data, alone["acc"].data)


def test_a_marker_table_is_read_whatever_number_of_markers_it_announces(tmp_path: Path) -> None:
    whole = read(tmp_path / "m.trc", made.TRC)[0]["markers"]
    found, findings = read(tmp_path / "m.trc", made.TRC.replace("\t10\t2\tm", "\t10\t4\tm"))
    assert np.array_equal(found["markers"].data, whole.data, equal_nan=True)
    assert "4 markers are announced, 2 are named, 2 are there" in doubts(findings)
    found, findings = read(tmp_path / "m.trc", made.TRC.replace("RTOE", ""))
    assert found["markers"].spec.channels == ("LTOE", "marker2") and "2 are there" in doubts(findings)
    assert np.array_equal(found["markers"].data, whole.data, equal_nan=True)


def test_a_format_of_which_no_real_file_was_at_hand_is_refused_unless_asked_for(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"w.mvnx: the reader of .* never on a real export; --untried reads it"):
        read(tmp_path / "w.mvnx", made.MVNX)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "walk.csv")
    with pytest.raises(RecordingError, match=r"walk.csv: is a pipe or a device; write what comes out of it to a file"):
        read(tmp_path / "walk.csv")
    with pytest.raises(RecordingError, match=r"/dev/zero: is a pipe or a device"):
        read(Path("/dev/zero"))


def test_mvnx_by_its_frames_time_of_day(tmp_path: Path) -> None:
    found, findings = read(tmp_path / "x.mvnx", made.MVNX, untried=True)
    position = found["position"]
    assert (
        position.data.shape == (19, 2, 3) and position.spec.rate_hz == 60 and position.spec.channels == ("Pelvis", "L5")
    )
    assert position.lost is not None and position.lost[7] == 1 and position.time[0] == 1542082631842 * 1_000_000
    assert found["orientation"].spec.channels[:2] == ("Pelvis.w", "Pelvis.x") and found["jointAngle"].spec.units == (
        "deg",
    )
    assert "Jane Doe" not in str(findings.facts)
    marked = made.MVNX.replace("<jointAngle>0 0 3<", "<marker>here</marker><jointAngle>0 0 3<")
    assert "marker holds something else" in doubts(read(tmp_path / "x.mvnx", marked, untried=True)[1])
    bomb = made.MVNX.replace("<mvnx ", '<!DOCTYPE m [<!ENTITY a "b">]><mvnx ')
    with pytest.raises(RecordingError, match=r"declares entities, which no export does"):
        read(tmp_path / "x.mvnx", bomb, untried=True)


def test_matlab_of_both_versions(tmp_path: Path) -> None:
    old, new = tmp_path / "old.mat", tmp_path / "new.mat"
    scipy.io.savemat(old, made.matlab_arrays(), do_compression=True)
    emg = made.matlab_arrays()["trial"]["emg"]  # type: ignore[index]
    with h5py.File(new, "w", userblock_size=512) as file:
        file["trial/emg"] = emg.T
        file["trial/fs"] = np.array([[1000.0]])
        file["trial/note"] = np.array([[ord(c)] for c in "walk"], np.uint16)
        file["trial/note"].attrs["MATLAB_class"] = np.bytes_("char")
        file["other"] = h5py.ExternalLink("/etc/hostname", "/")
    with new.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\0\2IM")
    for path in (old, new):
        found, _ = read(path)
        assert found["emg"].spec.rate_hz == 1000 and np.array_equal(found["emg"].data, emg.T), path
        names = {"streams": {"lab.emg": ["trial.emg"]}, "rate": {"lab.emg": "trial.fs"}}
        options = ImportOptions(**names, names={"lab.emg": "TA,GM"}, unit={"lab.emg": "mV"})
        (one,) = read_files([path], options)
        assert one.spec.channels == ("TA", "GM") and one.spec.units == ("mV",) and one.spec.rate_hz == 1000


def test_matlab_files_of_every_version_that_scipy_keeps_for_its_own_tests() -> None:
    """`testdouble`, nine numbers, written by MATLAB 4.2 to 7.4; the last one in HDF5, under a header that says 7.0."""
    folder = Path(scipy.io.matlab.__file__).parent / "tests" / "data"
    kept = sorted([*folder.glob("testdouble_*.mat"), *folder.glob("testhdf5_*.mat")])
    if not kept:
        pytest.skip("scipy came without its tests' data")
    assert len(kept) >= 5
    for path in kept:
        assert matlab.knows(path.read_bytes()[:128]) or "_4.2c_" in path.name, path
        assert np.array_equal(matlab.read_arrays(path)["testdouble"], np.linspace(0, 2 * np.pi, 9)), path


def test_matlab_structures_tell_the_rates_of_their_own(tmp_path: Path) -> None:
    """As Qualisys Track Manager nests them."""
    trajectories = {"Labels": np.array(["A", "B"], object), "Data": np.arange(2 * 4 * 50.0).reshape(2, 4, 50)}
    analog = {"Frequency": 1000.0, "Data": np.arange(3 * 500.0).reshape(3, 500)}
    scipy.io.savemat(
        tmp_path / "q.mat", {"walk": {"FrameRate": 100.0, "Trajectories": {"Labeled": trajectories}, "Analog": analog}}
    )
    found, _ = read(tmp_path / "q.mat")
    shapes = {one.spec.rate_hz: one.data.shape for one in found.values()}
    assert shapes == {100.0: (50, 2, 4), 1000.0: (500, 3)}


def test_edf_of_several_rates_is_several_streams(tmp_path: Path) -> None:
    signals = [
        edfio.EdfSignal(np.sin(np.arange(2000) / 9) * 100, 200, label="TA", physical_dimension="uV"),
        edfio.EdfSignal(np.cos(np.arange(2000) / 9) * 100, 200, label="TA", physical_dimension="uV"),
        edfio.EdfSignal(np.arange(128.0), 12.8, label="ACC", physical_dimension="g"),
    ]
    edfio.Edf(signals, annotations=[edfio.EdfAnnotation(1.5, None, "öffnen")], data_record_duration=10).write(
        tmp_path / "x.edf"
    )
    found, _ = read(tmp_path / "x.edf")
    assert found.keys() == {"signals_200hz", "signals_12_8hz", "annotations"}
    assert found["signals_200hz"].spec.channels == ("TA", "TA_2") and found["annotations"].data["text"].tolist() == [
        "öffnen"
    ]
    whole = (tmp_path / "x.edf").read_bytes()
    with pytest.raises(RecordingError, match=r"1 records are announced, 0 are there; the file was cut off"):
        read(tmp_path / "x.edf", whole[:-2000])


def test_bids_motion(tmp_path: Path) -> None:
    stem = "sub-07_task-walk_tracksys-imu"
    (tmp_path / "participants.tsv").write_text("participant_id\tname\tage\nsub-07\tJane\t31\n")
    (tmp_path / f"{stem}_channels.tsv").write_text(made.BIDS_CHANNELS)
    (tmp_path / f"{stem}_motion.json").write_text(json.dumps({"SamplingFrequency": 50}))
    found, findings = read(tmp_path / f"{stem}_motion.tsv", made.BIDS)
    assert (
        found["markers"].spec.channels == ("hip",)
        and found["markers"].spec.rate_hz == 50
        and np.isnan(found["misc"].data[3, 0])
    )
    assert findings.facts == {"subject": "07", "task": "walk", "age": "31"}
    (tmp_path / f"{stem}_channels.tsv").unlink()
    with pytest.raises(RecordingError, match=r"no sub-07_task-walk_tracksys-imu_channels.tsv beside it"):
        read(tmp_path / f"{stem}_motion.tsv")


def test_c3d_with_room_for_events_that_did_not_happen(tmp_path: Path) -> None:
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = ["LTOE"]
    c3d["data"]["points"] = np.ones((4, 1, 20))
    c3d.add_parameter("EVENT", "USED", [0])
    c3d.add_parameter("EVENT", "LABELS", [""])
    c3d.add_parameter("EVENT", "CONTEXTS", [""])
    c3d.write(str(tmp_path / "walk.c3d"))
    found, _ = read(tmp_path / "walk.c3d")
    assert found.keys() == {"markers"}
    (tmp_path / "walk.bin").write_bytes((tmp_path / "walk.c3d").read_bytes())
    assert read(tmp_path / "walk.bin")[0].keys() == {"markers"}


def test_a_plain_table_below_other_lines(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"plate\.txt"):
        read(tmp_path / "plate.txt", made.PLATE)
    found, _ = read(tmp_path / "plate.txt", made.PLATE, skip_rows=2)
    assert (
        found[""].spec.channels == ("Fz", "Mx")
        and found[""].spec.units == ("N", "N.m")
        and found[""].spec.rate_hz == 100
    )
    spaced = "Time  Fz   Mx\n" + "".join(f"{k / 100:.2f}   {700 + k}  {k}\n" for k in range(20))
    assert read(tmp_path / "plate.txt", spaced)[0][""].spec.channels == ("Fz", "Mx")
    with pytest.raises(RecordingError, match=r"the file is empty"):
        (tmp_path / "nothing_motion.tsv.gz").touch()
        read(tmp_path / "nothing_motion.tsv.gz")
    bare = "".join(made.PLATE.splitlines(keepends=True)[4:])
    found, _ = read(tmp_path / "plate.txt", "remark\n" + bare, skip_rows=1, rate={"": "100"})
    assert found[""].spec.channels == ("column1", "column2", "column3") and len(found[""]) == 20


def test_the_content_decides_and_not_the_name(tmp_path: Path) -> None:
    for name, text in made.TEXTS.items():
        by_content = read(tmp_path / f"{Path(name).stem}.dat", text, untried=True)[0]
        assert by_content.keys() == read(tmp_path / name, text, untried=True)[0].keys()
    with pytest.raises(RecordingError, match=r"its content does not show what kind of file this is"):
        read(tmp_path / "x.unknown", "nothing\n")


@pytest.mark.parametrize("name", made.TEXTS)
def test_a_file_cut_within_a_row_is_refused_by_its_line_or_read_to_there(tmp_path: Path, name: str) -> None:
    text = made.TEXTS[name]
    last = text.rstrip("\n").rfind("\n") + 1
    for at in (last + 3, len(text) // 2):
        try:
            found, _ = read(tmp_path / name, text[:at], untried=True)
        except RecordingError as error:
            assert name in str(error)
        else:
            assert all(len(one) <= 60 for one in found.values())
