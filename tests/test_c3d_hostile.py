"""C3D files that are made to crash or to hold up whoever reads them."""

from __future__ import annotations

from pathlib import Path

import pytest

from devices.files.c3d_read import read_c3d
from stream.errors import RecordingError
from tests.c3d_made import Made, but, c3d_bytes, usual

HOLLOW = bytes([255, 255, 255, 255, 255, 255, 0])


@pytest.mark.parametrize(
    "made",
    [
        Made("POINT", "NOTE", 2, [], b"\x00\x00", bytes(200)),  # a library that counts in signed bytes asks for 4 GB
        Made("POINT", "NOTE", 2, HOLLOW, b""),
        Made("POINT", "NOTE", 4, HOLLOW, b""),
        Made("POINT", "NOTE", -1, HOLLOW[::-1], b""),
    ],
    ids=["long description", "hollow numbers", "hollow reals", "hollow texts"],
)
def test_a_parameter_that_would_hold_up_the_reader_is_refused(tmp_path: Path, made: Made) -> None:
    path = tmp_path / "made.c3d"
    path.write_bytes(c3d_bytes(usual()))
    assert [one.data.shape for one in read_c3d(path)] == [(3, 2, 3), (15, 2)]
    path.write_bytes(c3d_bytes(but(usual(), made)))
    with pytest.raises(RecordingError, match=r"made\.c3d: .*its parameters break off at byte"):
        read_c3d(path)
