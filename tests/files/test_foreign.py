"""Files as other programs and careless senders write them: what a file claims is checked against what it holds."""

from __future__ import annotations

import gzip
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from kinegraph.devices.formats.column_table import ImportOptions
from kinegraph.devices.formats.findings import Findings
from kinegraph.devices.formats.importer import read_files
from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.graph.reading import overrides
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import BOARD, Command

FOREIGN = Path(__file__).parent / "foreign"


def read(path: Path | str, **asked: Any) -> tuple[dict[str, Series], Findings]:
    file = FOREIGN / path
    options = ImportOptions(**asked)
    return {s.name.removeprefix(file.stem).removeprefix("."): s for s in read_files([file], options)}, options.findings


def test_movella_dot_has_a_time_in_microseconds_that_wraps_and_a_hole_in_its_counter() -> None:
    found, findings = read("dot.csv")
    acc = found["acc"]
    assert findings.kinds[FOREIGN / "dot.csv"] == "Movella DOT table"
    assert acc.spec.rate_hz == 60 and acc.spec.channels == ("Acc_X", "Acc_Y", "Acc_Z") and acc.spec.units == ("m/s2",)
    assert acc.lost is not None and acc.lost[acc.lost > 0].tolist() == [10]
    assert (np.diff(acc.time) > 0).all()


def test_consensys_has_a_separator_line_and_a_unit_row() -> None:
    found, _ = read("consensys.csv")
    assert {name: (s.spec.rate_hz, s.spec.units, len(s.data)) for name, s in found.items()} == {
        "accel_ln": (512.0, ("m/s2",), 500),
        "emg": (512.0, ("mV",), 500),
    }
    assert found["emg"].time[0] == 1_556_600_000 * NS


def test_polar_sensor_logger_gives_the_signal_beside_its_text_columns() -> None:
    ecg = read("polar_ecg.txt")[0]["ecg"]
    assert (ecg.spec.rate_hz, ecg.spec.units, len(ecg.data)) == (130.0, ("uV",), 650)
    assert ecg.data[:2, 0].tolist() == [-150.0, -149.0]


def test_the_openbci_gui_leaves_out_rows_that_its_counter_misses() -> None:
    found, findings = read("OpenBCI-RAW.txt")
    exg = found["exg"]
    assert exg.spec.rate_hz == 250 and exg.spec.channels == ("EXG Channel 0", "EXG Channel 1")
    assert exg.lost is not None and exg.lost[exg.lost > 0].tolist() == [10] and exg.time[0] == 1_700_000_000 * NS
    assert findings.facts["device"] == "BoardCytonSerial"


def test_times_of_day_are_read_and_their_zone_is_doubted() -> None:
    found, findings = read("iso_times.csv")
    x = found[""]
    assert x.spec.rate_hz == 100 and len(x.data) == 400
    assert np.datetime64(int(x.time[0]), "ns") == np.datetime64("2019-12-23T21:04:06.000")
    assert "unknown time zone" in findings.doubts[0]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("2024-01-01T00:00:00+02:00;1\n2024-01-01T00:00:01+02:00;2\n", [1704060000.0, 1704060001.0]),
        ("23:59:59,5;1\n0:00:00,0;2\n0:00:00,5;3\n", [86399.5, 86400.0, 86400.5]),
    ],
)
def test_times_have_zones_or_pass_midnight(text: str, seconds: list[float], tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"% a remark\ntime;x\n{text}")
    found, _ = read(tmp_path / "t.csv")
    assert (found[""].time / NS).tolist() == seconds


def test_a_column_of_text_is_left_out_unless_it_is_asked_for(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,x,note,x,\n0,1,left,5,\n1,2,right,6,\n")
    found, findings = read(tmp_path / "t.csv")
    assert found[""].spec.channels == ("x", "x_2") and found[""].data.tolist() == [[1, 5], [2, 6]]
    assert findings.doubts == ["t.csv: 'note': text, not read"]
    with pytest.raises(RecordingError, match="line 2: 'left' in column 'note' is not a number"):
        read(tmp_path / "t.csv", streams={"s": ["note"]}, time={"s": "time"})


def test_a_slip_in_a_column_of_numbers_is_no_text(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,x\n0,1\n1,2.3x\n2,3\n")
    with pytest.raises(RecordingError, match=r"line 3: '2\.3x' in column 'x' is not a number"):
        read(tmp_path / "t.csv")


# EDF -----------------------------------------------------------------------------------------------------------------


def test_edf_in_latin_1_keeps_its_names_and_units() -> None:
    found, findings = read("latin1.edf")
    spec = found["signals"].spec
    assert spec.channels == ("Cânula", "Posição") and spec.units == ("uV", "°C")
    assert findings.claims[0].kind == "header" and "text is in Latin-1" in findings.claims[0].seen
    notes = read("latin1_note.edf")[0]
    assert len(notes["signals"].data) == 1200 and "ü" in str(notes["annotations"].data["text"][0])


def test_edf_without_a_range_gives_raw_numbers_without_a_unit() -> None:
    found, findings = read("zero_range.edf")
    assert found["signals"].spec.units == ("",) and "has no range" in findings.claims[0].seen
    assert (found["signals"].data == np.round(found["signals"].data)).all()


def test_edf_of_notes_alone_is_a_hypnogram() -> None:
    stages = read("only_notes.edf")[0]["annotations"].data
    start = stages["onset"][0]
    spans = [(str(s["text"]), (s["onset"] - start) // NS, (s["end"] - start) // NS) for s in stages]
    assert [span[1:] for span in spans] == [(0, 30), (30, 90), (90, 120)]
    assert [text.split()[-1] for text, *_ in spans] == ["W", "2", "R"]


def test_numbers_of_an_edf_header_may_have_decimal_commas(tmp_path: Path) -> None:
    whole = (FOREIGN / "latin1_note.edf").read_bytes()
    assert b"-1000   " in whole
    (tmp_path / "c.edf").write_bytes(whole.replace(b"-1000   ", b"-1000,0 "))
    found, findings = read(tmp_path / "c.edf")
    assert (found["signals"].data == read("latin1_note.edf")[0]["signals"].data).all()
    assert "decimal commas" in "".join(finding.seen for finding in findings.claims)


def _later(seconds: int) -> int:
    """A pause of 4 s after 5 s."""
    return seconds + 4 if seconds >= 5 else seconds


@pytest.mark.parametrize("kind", [b"EDF+C", b"EDF+D"])
def test_pauses_between_the_records_of_an_edf_file_are_gaps(kind: bytes, tmp_path: Path) -> None:
    whole = (FOREIGN / "latin1_note.edf").read_bytes().replace(b"EDF+C", kind)
    later = re.sub(
        rb"\+(\d+)\x14\x14\0\0", lambda m: (b"+%d\x14\x14" % _later(int(m[1]))).ljust(len(m[0]), b"\0"), whole
    )
    (tmp_path / "d.edf").write_bytes(later)
    found, findings = read(tmp_path / "d.edf")
    signals = found["signals"]
    assert signals.lost is not None and signals.lost[500] == 400 and len(signals.data) == 1200
    assert (signals.time[500] - signals.time[499]) / NS == pytest.approx(4.01)
    assert any("continuous" in finding.claimed for finding in findings.claims) == (kind == b"EDF+C")


# XDF -----------------------------------------------------------------------------------------------------------------


def unpacked(tmp_path: Path) -> Path:
    (tmp_path / "half.xdf").write_bytes(gzip.decompress((FOREIGN / "half.xdf.gz").read_bytes()))
    return tmp_path / "half.xdf"


def test_a_stream_that_sends_half_of_what_it_declares_is_named_and_nothing_is_called_lost(tmp_path: Path) -> None:
    found, findings = read(unpacked(tmp_path))
    eeg = found["EEG"]
    assert eeg.lost is None and eeg.spec.rate_hz == 250
    [wrong] = findings.claims
    assert (wrong.kind, wrong.stream, wrong.claimed, wrong.seen) == ("rate", "EEG", "250 Hz", "125 Hz")
    assert "--claims measured" in wrong.remedy


def test_a_measured_rate_can_be_used_or_a_wrong_one_refused(tmp_path: Path) -> None:
    found, _ = read(unpacked(tmp_path), claims="measured")
    assert found["EEG"].spec.rate_hz == 125 and found["EEG"].lost is None
    with pytest.raises(RecordingError, match="claims 250 Hz; seen: 125 Hz"):
        read(unpacked(tmp_path), claims="refuse")


def test_a_stream_of_another_epoch_is_left_out_by_name() -> None:
    found, findings = read("unix_markers.xdf")
    assert found.keys() == {"EMG"} and found["EMG"].time[-1] - found["EMG"].time[0] < 3 * NS
    [epoch] = findings.claims
    assert (epoch.kind, epoch.stream) == ("epoch", "Trig") and "another epoch" in epoch.seen
    alone, _ = read("unix_markers.xdf", streams={"marks": ["Trig"]})
    assert len(alone["marks"].data) == 10


# identifiers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["010", "08", "1e3", "+5", "0x1F", "1_000"])
def test_an_identifier_of_digits_stays_as_it_is_spelt(text: str, kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(f"session: {{subject: {text}, speed_m_s: 1.40}}\n{BOARD % 2}")
    assert load("g.yaml").session["subject"] == text and load("g.yaml").session["speed_m_s"] == 1.4
    assert load("g.yaml", overrides=overrides.read([f"session.subject={text}"])).session["subject"] == text
    (tmp_path / "t.csv").write_text("time,x\n0,1\n1,2\n")
    assert kinegraph("files", "import", "t.csv", "-o", "t.mcap", "--fact", f"subject={text}")[0] == 0
    with Recording.open(tmp_path / "t.mcap") as recording:
        assert recording.header["session"] == {"subject": text}


NAMES = """
a/b:c
P01 walk-2
2026-03-01 Müller
x,y=z[1]
'q' "d"
None
1e3
~
a|b{c}
- x
*x
#a
@x
a: b #c
a\\b
""".strip().split("\n")


@pytest.mark.parametrize("name", [*NAMES[:4], *(pytest.param(name, marks=pytest.mark.nightly) for name in NAMES[4:])])
def test_any_name_of_a_stream_and_a_channel_goes_through_every_command(
    name: str, kinegraph: Command, tmp_path: Path
) -> None:
    through_every_command(name, name, kinegraph)


def through_every_command(stream: str, channel: str, kinegraph: Command) -> None:
    """From a recording to a graph, a check, a replay, a session and back through another format, in the present folder."""
    time = np.arange(300) * (NS // 100)
    spec = StreamSpec((2,), np.dtype("f8"), 100.0, (channel, "b."), ("uV",))
    data = np.random.default_rng(0).normal(size=(300, 2))
    session: dict[str, Any] = {"graph": "", "session": {}}
    write_recording(Path("o.mcap").absolute(), [Series(stream, spec, time, data)], session, chunk_s=0.02)
    for command in (
        ("dev", "new", "graph", "o.mcap", "-o", "g.yaml"),
        ("check", "g.yaml"),
        ("replay", "g.yaml", "o.mcap", "-q", "-o", "r"),
        ("run", "g.yaml", "--view", "none", "-o", "s"),
        ("files", "export", "o.mcap", "-o", "e.xdf"),
        ("files", "import", "e.xdf", "-o", "e.mcap"),
    ):
        code, _, errors = kinegraph(*command)
        assert code == 0, (command, stream, channel, errors)
    with Recording.open(Path("e.mcap").absolute()) as recording:
        assert [*recording.streams] == [stream] and recording.stream(stream).spec.channels == (channel, "b.")


NAME = st.text(st.characters(exclude_categories=("Cc", "Cs", "Cf", "Zl", "Zp")), min_size=1, max_size=30).filter(
    lambda name: name.strip() == name
)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@settings(
    max_examples=25,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
)
@given(NAME, NAME.filter(lambda name: name != "b."))
def test_any_drawn_name_goes_through_every_command(
    kinegraph: Command, tmp_path: Path, stream: str, channel: str
) -> None:
    for made in tmp_path.iterdir():
        shutil.rmtree(made) if made.is_dir() else made.unlink()
    through_every_command(stream, channel, kinegraph)


@pytest.mark.parametrize("name", ["a:b", "P01 walk-2", "2026-03-01 Müller"])
def test_any_name_of_a_file_is_read(name: str, tmp_path: Path) -> None:
    (tmp_path / f"{name}.csv").write_text("time,x\n0,1\n1,2\n2,3\n")
    assert read(tmp_path / f"{name}.csv")[0][""].data.ravel().tolist() == [1, 2, 3]
    (tmp_path / f"{name}.edf").write_bytes((FOREIGN / "latin1.edf").read_bytes())
    assert "signals" in read(tmp_path / f"{name}.edf")[0]
