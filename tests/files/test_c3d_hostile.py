"""C3D files that are made to crash or to hold up whoever reads them, and such as are only unusual."""

from __future__ import annotations

import struct
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.formats.c3d.reader import read_c3d
from kinegraph.devices.formats.findings import Findings
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import RecordingError
from tests.files.c3d_made import Made, but, c3d_bytes, real, texts, usual, whole
from tests.support.measured import MOST_S

HOLLOW = bytes([255, 255, 255, 255, 255, 255, 0])
"""Extents of nothing: whoever goes through all but the last takes 2.7e14 steps."""


def read(tmp_path: Path, *others: Made, **counts: int) -> dict[str, np.ndarray]:
    path = tmp_path / "made.c3d"
    path.write_bytes(c3d_bytes(but(usual(**counts), *others), **counts))
    return {one.name.partition(".")[2]: one.data for one in read_c3d(path)}


@pytest.mark.parametrize(
    "made",
    [
        Made("POINT", "NOTE", 2, [], b"\x00\x00", bytes(200)),
        Made("POINT", "NOTE", 2, HOLLOW, b""),
        Made("POINT", "NOTE", 4, HOLLOW, b""),
        Made("POINT", "NOTE", -1, HOLLOW[::-1], b""),
        *(Made("ANALOG", name, 2, [0], b"") for name in ("OFFSET", "FORMAT", "NOTE")),
    ],
)
def test_what_no_sample_depends_on_changes_none(tmp_path: Path, made: Made) -> None:
    """ezc3d asks for 4 GB at a long description, never ends at hollow extents, and crashes at some that are missing."""
    usual_ones = read(tmp_path)
    assert usual_ones["markers"].shape == (3, 2, 3) and usual_ones["analog"].shape == (15, 2)
    assert usual_ones["markers"][1, 0].tolist() == [18, 19, 20] and usual_ones["analog"][5].tolist() == [26, 27]
    found = read(tmp_path, made)
    assert found.keys() == usual_ones.keys()
    assert all(np.array_equal(found[name], data) for name, data in usual_ones.items())


@pytest.mark.parametrize("name", ["USED", "FRAMES", "RATE", "SCALE", "DATA_START"])
@pytest.mark.parametrize("kind", [1, 2, 4])
def test_a_parameter_without_values_is_told_by_the_header(tmp_path: Path, name: str, kind: int) -> None:
    found = read(tmp_path, Made("POINT", name, kind, [0], b""))
    assert found["markers"].shape == (3, 2, 3) and found["markers"][2, 1, 0] == 40


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (real("POINT:RATE", float("inf")), "frame rate is inf Hz"),
        (real("POINT:SCALE", 0.0), "the scale of its markers is 0"),
        (real("POINT:SCALE", float("nan")), None),  # the header's
        (whole("POINT:USED", 0xFFFF), "3 frames are announced, 0 are there"),
        (real("POINT:USED", 3e38), "3 frames are announced, 0 are there"),
        (whole("POINT:FRAMES", 2), "3 frames are announced, 2 are there"),
        (whole("ANALOG:USED", 0xFFFF), "3 frames are announced, 0 are there"),
        (real("ANALOG:RATE", 1e12), "3 frames are announced, 0 are there"),
        (real("ANALOG:RATE", float("inf")), None),
        (real("POINT:RATE", 1e-30), "3 frames are announced, 0 are there"),
        (Made("POINT", "USED", 7, [], b"\x02\x00"), "its parameters end abruptly at byte"),
        (Made("POINT", "USED", 2, [255, 255], b"\x02\x00"), "its parameters end abruptly at byte"),
    ],
)
def test_counts_that_cannot_be_are_refused(tmp_path: Path, made: Made, message: str | None) -> None:
    if message is None:
        assert read(tmp_path, made)["markers"].shape == (3, 2, 3)
        return
    with pytest.raises(RecordingError, match=rf"made\.c3d: .*{message}"):
        read(tmp_path, made)


def test_very_many_channels_and_kinds_of_events_are_named_in_time(tmp_path: Path) -> None:
    begun = time.process_time()
    found = read(tmp_path, texts("ANALOG:LABELS", "EMG", "EMG"), channels=65_000, per_frame=1, markers=0)
    assert found["analog"].shape == (3, 65_000)
    count = 3000
    events = (
        whole("EVENT:USED", count),
        Made("EVENT", "LABELS", -1, [4, 200, 15], "".join(f"{i:04}" for i in range(count)).encode()),
        Made("EVENT", "TIMES", 4, [2, 200, 15], np.arange(2.0 * count, dtype="<f4").tobytes()),
    )
    found = read(tmp_path, *events)
    assert len(found) == 2 + count and found["2999"]["onset"].tolist() == [round((5998 * 60 + 5999) * NS)]
    assert time.process_time() - begun < MOST_S


EVENTS = (
    whole("EVENT:USED", 3),
    texts("EVENT:LABELS", "Strike", "Off", "Strike"),
    texts("EVENT:CONTEXTS", "Left", "Left", "Right"),
)


def pairs_of(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}f", *values)


@pytest.mark.parametrize("extents", [[2, 3], [6]])
def test_events_have_their_times_as_a_table_or_as_a_list_of_pairs(tmp_path: Path, extents: list[int]) -> None:
    times = Made("EVENT", "TIMES", 4, extents, pairs_of(0, 1.5, 0, 2.25, 1, 0.5))
    found = read(tmp_path, *EVENTS, times)
    assert {name: one["onset"].tolist() for name, one in found.items() if one.dtype.names} == {
        "left_strike": [round(1.5 * NS)], "left_off": [round(2.25 * NS)], "right_strike": [round(60.5 * NS)]
    }  # fmt: skip


@pytest.mark.parametrize(
    ("times", "doubt"),
    [
        (Made("EVENT", "TIMES", 4, [2, 2], pairs_of(0, 1, 0, 2)), "3 events, but times for 2: they cannot be matched"),
        (Made("EVENT", "TIMES", 4, [3, 2], pairs_of(*range(6))), "3 events, but times for 0"),
        (Made("EVENT", "TIMES", 4, [2, 3], pairs_of(0, 1, 0, np.nan, 0, 3)), "are not numbers"),
        (texts("EVENT:TIMES", "now", "then", "soon"), "3 events, but times for 0"),
    ],
)
def test_events_without_their_times_cost_no_marker(tmp_path: Path, times: Made, doubt: str) -> None:
    (tmp_path / "made.c3d").write_bytes(c3d_bytes(but(usual(), *EVENTS, times)))
    findings = Findings()
    found = read_c3d(tmp_path / "made.c3d", findings=findings)
    assert [one.name for one in found] == ["made.markers", "made.analog"]
    assert any(doubt in each and "left out" in each for each in findings.doubts), findings.doubts


def long(tmp_path: Path, *others: Made, frames: int = 70_000, fill: bytes = b"") -> tuple[int, Findings]:
    """How many frames are read of a file with overflown 16-bit counts."""
    data = c3d_bytes(but(usual(1, 70_000, 0), *others), 1, 70_000, 0)
    path, findings = tmp_path / "long.c3d", Findings()
    path.write_bytes(data[: len(data) - 16 * (70_000 - frames)] + fill)
    (markers,) = read_c3d(path, findings=findings)
    assert markers.data[frames - 1, 0, 0] == 4 * (frames - 1)
    return len(markers.data), findings


def test_a_recording_of_more_frames_than_a_header_can_count_is_read_to_its_end(tmp_path: Path) -> None:
    """TRIAL or LONG_FRAMES gives the count, otherwise the file's length."""

    def field(which: str, value: int) -> Made:
        return Made("TRIAL", f"ACTUAL_{which}_FIELD", 2, [2], struct.pack("<I", value))

    trial = field("START", 1), field("END", 70_000)
    block = bytes(512 - 70_000 * 16 % 512)
    for text in (trial, [real("POINT:LONG_FRAMES", 70_000.0)]):
        frames, findings = long(tmp_path, *text, fill=block + bytes(512))
        assert frames == 70_000 and not any("last block" in doubt for doubt in findings.doubts)
    frames, findings = long(tmp_path, fill=block)
    assert frames == 70_000 and any("nothing says how many frames" in doubt for doubt in findings.doubts)
    assert long(tmp_path, fill=bytes(8))[0] == 70_000
    with pytest.raises(RecordingError, match="70000 frames are announced, 69000 are there"):
        long(tmp_path, *trial, frames=69_000)


def test_unsigned_samples_of_an_analogue_board(tmp_path: Path) -> None:
    """As c3d.org defines them: values and offsets are 0 ... 65535 where FORMAT says UNSIGNED."""
    counts = {"markers": 0, "frames": 1, "channels": 2, "per_frame": 2}
    made = [
        *(real("POINT:SCALE", 0.1), texts("ANALOG:FORMAT", "UNSIGNED"), real("ANALOG:SCALE", 0.5, 2.0)),
        Made("ANALOG", "OFFSET", 2, [2], struct.pack("<2H", 40_000, 0)),
    ]
    data = c3d_bytes(but(usual(**counts), *made), **counts)
    (tmp_path / "made.c3d").write_bytes(data[: data[16] * 512 - 512] + struct.pack("<4H", 40_001, 50_000, 39_998, 1))
    (found,) = read_c3d(tmp_path / "made.c3d")
    assert found.data.tolist() == [[0.5, 100_000.0], [-1.0, 2.0]]
