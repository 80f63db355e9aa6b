"""Files from strangers that declare, or unpack to, more than they hold: an error that names the file, and never much memory."""

from __future__ import annotations

import gzip
import io
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import numpy as np
import pytest
import zstandard
from mcap.opcode import Opcode

from kinegraph.stream.chunk import NS, StreamSpec
from kinegraph.stream.data import bounded
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.measured import MOST_MB, MOST_S, measured
from tests.support.real import DATA_MARKS, real_file
from tests.support.tiers import rest_nightly


def zeros_zstd(size: int) -> bytes:
    made = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(made, size=size, closefd=False) as writer:
        for _ in range(size >> 20):
            writer.write(bytes(1 << 20))
    return made.getvalue()


def zeros_lz4(size: int) -> bytes:
    with lz4.frame.LZ4FrameCompressor() as compressor:
        parts = [compressor.begin()]
        parts += [compressor.compress(bytes(1 << 20)) for _ in range(size >> 20)]
        return b"".join([*parts, compressor.flush()])


def bomb(whole: bytes, compression: str, data: bytes, declared: int, count: int = 1) -> bytes:
    """A recording with more chunks of records before its first, as they would stand in an unfinished file."""
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 1, declared, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    record = struct.pack("<BQ", Opcode.CHUNK, len(body)) + body
    at = 8
    while whole[at] != Opcode.CHUNK:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    return whole[:at] + record * (count + 1)


@pytest.mark.parametrize("command", rest_nightly("info", "recover"))
@pytest.mark.parametrize(
    ("compression", "make", "size", "declared"),
    [
        ("lz4", zeros_lz4, 1 << 30, 1 << 30),
        ("zstd", zeros_zstd, 1 << 30, 1 << 10),
        ("zstd", lambda size: zeros_zstd(1 << 20), 0, 1 << 62),
        pytest.param("zstd", zeros_zstd, 1 << 30, 1 << 30, marks=pytest.mark.nightly),
        pytest.param("lz4", zeros_lz4, 1 << 30, 1 << 10, marks=pytest.mark.nightly),
    ],
)
def test_a_recording_unpacks_within_bounds(
    made: Path, tmp_path: Path, command: str, compression: str, make: Callable[[int], bytes], size: int, declared: int
) -> None:
    whole = (made / "s" / "session.0000.mcap").read_bytes()
    (tmp_path / "bomb.mcap").write_bytes(bomb(whole, compression, make(size), declared))
    reported = measured(command, "bomb.mcap", folder=tmp_path)
    assert "Traceback" not in reported.err and reported.code in (0, 2), reported.err
    assert "bomb.mcap" in reported.out + reported.err
    assert reported.peak_mb < MOST_MB


@pytest.mark.parametrize("command", ["info", "recover"])
def test_a_recording_of_nothing_but_zeros_is_refused_at_once(made: Path, tmp_path: Path, command: str) -> None:
    whole = (made / "s" / "session.0000.mcap").read_bytes()
    packed = zeros_zstd(bounded.LEAST)
    (tmp_path / "bomb.mcap").write_bytes(bomb(whole, "zstd", packed, bounded.LEAST, 10_000_000 // len(packed)))
    reported = measured(command, "bomb.mcap", folder=tmp_path)
    assert reported.code == 2 and "bomb.mcap: it claims to hold" in reported.err
    assert reported.peak_mb < MOST_MB and reported.cpu_s < MOST_S


@pytest.mark.parametrize("command", ["info", "view"])
def test_a_stream_of_very_many_channels_is_looked_at_within_bounds(tmp_path: Path, command: str) -> None:
    wide = StreamSpec((60_000,), np.dtype("<f4"))
    stamps = np.array([NS, 3601 * NS])
    write_recording(tmp_path / "wide.mcap", [Series("wide", wide, stamps, np.zeros((2, 60_000), "<f4"))], {"graph": ""})
    assert (tmp_path / "wide.mcap").stat().st_size < 10_000
    options = ("--for", "1", "--page-at", ":0") if command == "view" else ()
    reported = measured(command, "wide.mcap", *options, folder=tmp_path)
    assert reported.code == 0 and "Traceback" not in reported.err
    assert reported.peak_mb < MOST_MB and reported.cpu_s < MOST_S


def npz(path: Path, header: bytes, zeros: int) -> None:
    """An NPZ file with one array; written in pieces, for the memory of who starts a process counts as that process's."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("emg.npy", "w") as file:
        file.write(b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header)
        for left in range(zeros, 0, -(1 << 20)):
            file.write(bytes(min(left, 1 << 20)))


@pytest.mark.parametrize(
    ("shape", "size"),
    rest_nightly(("(134217728,)", 1 << 30), ("(1000000000000,)", 64), ("(0, 9000000000000000000)", 64), ("(-1,)", 64)),
)
def test_arrays_are_read_within_bounds(tmp_path: Path, shape: str, size: int) -> None:
    head = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode().ljust(117) + b"\n"
    npz(tmp_path / "x.npz", head, size)
    reported = measured(
        "files", "import", "x.npz", "-o", "x.mcap", "--stream", "emg=emg", "--rate", "emg=100", folder=tmp_path
    )
    assert (
        reported.code == 2
        and "x.npz" in reported.err
        and "Traceback" not in reported.err
        and reported.peak_mb < MOST_MB
    )


def test_a_compressed_xdf_file_is_read_within_bounds(tmp_path: Path) -> None:
    with gzip.open(tmp_path / "x.xdf", "wb", compresslevel=1) as file:
        file.write(b"XDF:")
        for _ in range(1 << 10):
            file.write(bytes(1 << 20))
    reported = measured("files", "import", "x.xdf", "-o", "x.mcap", folder=tmp_path)
    assert (
        reported.code == 2
        and "x.xdf" in reported.err
        and "Traceback" not in reported.err
        and reported.peak_mb < MOST_MB
    )


@pytest.mark.parametrize(
    "name", ["pc_int", pytest.param("dec_real", marks=DATA_MARKS), pytest.param("gait_bmc", marks=DATA_MARKS)]
)
@pytest.mark.parametrize(
    ("used", "frames"), rest_nightly((0x7FFF, 0x7FFF), (None, 0x7FFF), (0x7FFF, None), (255, 0x7FFF))
)
def test_a_c3d_file_is_read_within_bounds(tmp_path: Path, name: str, used: int | None, frames: int | None) -> None:
    """Counts in its head that the file is much too short for."""
    data = bytearray(real_file(f"files/c3d/{name}.c3d").read_bytes())
    if frames:
        struct.pack_into("<HH", data, 6, 1, frames)
    if used:
        struct.pack_into("<H", data, 2, used)
    for group, value in ((b"USED", used), (b"FRAMES", frames)):
        at = data.find(group, 512) if value else -1
        while 0 <= at < 0x8000:
            struct.pack_into("<h", data, at + len(group) + 4, value or 0)
            at = data.find(group, at + 1)
    (tmp_path / "x.c3d").write_bytes(data)
    reported = measured("files", "import", "x.c3d", "-o", "x.mcap", folder=tmp_path)
    assert reported.code == 2 and "x.c3d" in reported.err and "Traceback" not in reported.err
    assert reported.peak_mb < MOST_MB


def test_what_is_unpacked_is_what_was_declared() -> None:
    for pack, unpack in ((zstandard.compress, bounded.unpack_zstd), (lz4.frame.compress, bounded.unpack_lz4)):
        assert unpack(pack(bytes(100)), 100) == bytes(100)
        for wrong in (99, 101, 1 << 40, -1):
            with pytest.raises((ValueError, zstandard.ZstdError)):
                unpack(pack(bytes(100)), wrong)


@pytest.mark.parametrize(
    "failed", [KeyError("x"), StopIteration(), RecursionError("deep"), MemoryError(), UnicodeError("u")]
)
def test_whatever_a_library_raises_becomes_an_error_that_names_the_file(tmp_path: Path, failed: Exception) -> None:
    with pytest.raises(RecordingError, match=r"strange\.bin"), bounded.reading(tmp_path / "strange.bin", "a file"):
        raise failed
