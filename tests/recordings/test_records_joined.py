"""The records of a file are the library's own, byte by byte, though they are joined once instead of copied into a buffer that grows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType

import kinegraph.stream.recording.write.file_segment as module
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.recording.format.layout import LOG


def written(path: Path, *, live: bool) -> bytes:
    """A file of some messages, more than a chunk's worth."""
    file = module.FileSegment(path, 0, {"name": "a session"}, CompressionType.ZSTD, live=live)
    channel = file.declare("board.emg", StreamSpec((4,), rate_hz=1000.0), "input")
    rng = np.random.default_rng(0)
    for k in range(30):
        file.add(channel, 1000 * k, 1000 * k - 7, k, rng.bytes(200_000 + k))
        if k % 7 == 6:
            file.save()
    file.add(file.channel_of(LOG), 31_000, 31_000, 31, b"{}")
    file.finish({"board.emg": {"samples": 30}}, {"board.emg": b"from afar"})
    return path.read_bytes()


@pytest.mark.parametrize("live", [False, True])
def test_records_are_those_of_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, live: bool) -> None:
    joined: list[Any] = []
    join_once = module._join_once

    def join_and_note(writer: Any) -> None:
        join_once(writer)
        joined.append(vars(writer))

    monkeypatch.setattr(module, "_join_once", join_and_note)
    ours = written(tmp_path / "ours.mcap", live=live)
    assert isinstance(joined[0]["_Writer__record_builder"], module._Records), "another version of the library?"
    monkeypatch.setattr(module, "_join_once", lambda _: None)
    assert ours == written(tmp_path / "theirs.mcap", live=live)


@pytest.mark.parametrize("saved", [False, True])
def test_a_file_that_is_given_up_holds_what_was_saved_or_is_removed(tmp_path: Path, saved: bool) -> None:
    file = module.FileSegment(tmp_path / "a.mcap", 0, {"name": "a session"}, CompressionType.ZSTD)
    assert file.saved == 0
    if saved:
        file.save()
        assert file.saved == (tmp_path / "a.mcap").stat().st_size > 0
    file.abandon()
    assert (tmp_path / "a.mcap").exists() == saved
