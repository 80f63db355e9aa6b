"""C3D files of PCs, DEC and SGI machines: read as the library ezc3d reads them, as far as it does."""

from __future__ import annotations

import os
import struct
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from kinegraph.devices.formats.c3d.parameters import MIPS
from kinegraph.devices.formats.c3d.reader import read_c3d
from kinegraph.stream.errors import RecordingError
from tests.support.real import needs_data

FILES = Path(os.environ.get("KINEGRAPH_DATA", "/nonexistent")) / "files" / "c3d"
READ = sorted(path.name for path in FILES.glob("*.c3d") if path.name != "sgi_int.c3d")


@needs_data
@pytest.mark.parametrize("name", READ or [""])
def test_the_library_reads_the_same_bits(name: str) -> None:
    """Real files, of whole numbers and floating-point ones."""
    reported = ezc3d.c3d(str(FILES / name))
    found = {one.name.rpartition(".")[2]: one for one in read_c3d(FILES / name)}
    points = np.array(reported["data"]["points"][:3].transpose(2, 1, 0))
    points[reported["data"]["meta_points"]["residuals"][0].T < 0] = np.nan
    np.testing.assert_array_equal(found["markers"].data, points, strict=True)
    analogue = reported["data"]["analogs"][0].T
    assert ("analog" in found) == bool(analogue.size)
    if analogue.size:
        np.testing.assert_array_equal(found["analog"].data, analogue, strict=True)


def high_byte_first(data: bytes) -> bytes:
    """A PC's file of floating-point numbers, as an SGI machine has it."""
    made = bytearray(data)

    def swap(start: int, stop: int, width: int) -> None:
        for at in range(start, stop - width + 1, width):
            made[at : at + width] = data[at : at + width][::-1]

    for start, stop, width in ((2, 12, 2), (12, 16, 4), (16, 20, 2), (20, 24, 4), (24, 304, 2), (304, 376, 4)):
        swap(start, stop, width)
    begin = (data[0] - 1) * 512
    at, start = begin + 4, 0
    while data[at]:
        length, group = struct.unpack_from("bb", data, at)
        offset = at + 2 + abs(length)
        (step,) = struct.unpack_from("<h", data, offset)
        swap(offset, offset + 2, 2)
        if group > 0:
            kind, dimensions = struct.unpack_from("bB", data, offset + 2)
            first = offset + 4 + dimensions
            size = abs(kind) * int(np.prod(list(data[offset + 4 : first]), dtype=int))
            if kind in (2, 4):
                swap(first, first + size, kind)
            if data[at + 2 : offset] == b"DATA_START" and not start:  # that of POINT
                (start,) = struct.unpack_from("<H", data, first)
        if not step:
            break
        at = offset + step
    swap((start - 1) * 512, len(data), 4)
    made[begin + 3] = MIPS
    return bytes(made)


def test_an_sgi_machines_file_is_read_as_a_pcs(tmp_path: Path) -> None:
    c3d = ezc3d.c3d()
    c3d["parameters"]["POINT"]["RATE"]["value"] = [100.0]
    c3d["parameters"]["POINT"]["LABELS"]["value"] = ["LTOE", "RTOE"]
    c3d["parameters"]["POINT"]["UNITS"]["value"] = ["mm"]
    c3d["parameters"]["ANALOG"]["RATE"]["value"] = [1000.0]
    c3d["parameters"]["ANALOG"]["LABELS"]["value"] = ["TA", "Fz"]
    c3d["parameters"]["ANALOG"]["UNITS"]["value"] = ["V", "N"]
    random = np.random.default_rng(1)
    points = np.ones((4, 2, 30))
    points[:3] = random.normal(500, 100, (3, 2, 30))
    c3d["data"]["points"] = points
    c3d["data"]["analogs"] = random.normal(0, 1, (1, 2, 300))
    c3d.add_event(time=[0, 0.1], context="Right", label="Foot Strike")
    c3d.write(str(tmp_path / "pc.c3d"))
    whole = high_byte_first((tmp_path / "pc.c3d").read_bytes())
    (tmp_path / "sgi.c3d").write_bytes(whole)
    pc, sgi = read_c3d(tmp_path / "pc.c3d"), read_c3d(tmp_path / "sgi.c3d")
    assert [one.name.partition(".")[2] for one in pc] == [one.name.partition(".")[2] for one in sgi] and len(pc) == 3
    for one, other in zip(pc, sgi, strict=True):
        assert (
            one.spec == other.spec
            and np.array_equal(one.time, other.time)
            and one.data.tobytes() == other.data.tobytes()
        )
    (tmp_path / "sgi.c3d").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError, match=r"sgi\.c3d"):
        read_c3d(tmp_path / "sgi.c3d")
