"""Files from strangers that declare, or unpack to, more than they hold: an error that names the file, and never much memory."""

from __future__ import annotations

import io
import struct
from collections.abc import Callable
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from mcap.opcode import Opcode

from tests.measured import MOST_MB, measured

HUGE = 4 << 30


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


def bomb(whole: bytes, compression: str, data: bytes, declared: int) -> bytes:
    """A recording with one more chunk of records behind its first, as it would stand in an unfinished file."""
    name = compression.encode()
    body = struct.pack("<QQQII", 0, 1, declared, 0, len(name)) + name + struct.pack("<Q", len(data)) + data
    record = struct.pack("<BQ", Opcode.CHUNK, len(body)) + body
    at = 8
    while whole[at] != Opcode.CHUNK:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    return whole[:at] + record + record


@pytest.mark.parametrize("command", ["info", "recover"])
@pytest.mark.parametrize(
    ("compression", "make", "size", "declared"),
    [
        ("zstd", zeros_zstd, 1 << 30, 1 << 30),
        ("zstd", zeros_zstd, 1 << 30, 1 << 10),
        ("zstd", lambda size: zeros_zstd(1 << 20), 0, 1 << 62),
        ("lz4", zeros_lz4, 1 << 30, 1 << 30),
        ("lz4", zeros_lz4, 1 << 30, 1 << 10),
    ],
)
def test_a_recording_unpacks_within_bounds(
    made: Path, tmp_path: Path, command: str, compression: str, make: Callable[[int], bytes], size: int, declared: int
) -> None:
    whole = (made / "s" / "session.0000.mcap").read_bytes()
    (tmp_path / "bomb.mcap").write_bytes(bomb(whole, compression, make(size), declared))
    told = measured(command, "bomb.mcap", folder=tmp_path)
    assert "Traceback" not in told.err and told.code in (0, 2), told.err
    assert "bomb.mcap" in told.out + told.err
    assert told.peak_mb < MOST_MB
