"""`kinegraph files import`, `files export`, `info` and `recover` in this process; errors come out as they are raised."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import FOREVER
from kinegraph.stream.cli import main as cli
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.recording import Recording
from tests.support.command_line import call_command, succeeding

DATA = Path(os.environ["KINEGRAPH_DATA"]) if os.environ.get("KINEGRAPH_DATA") else None


def kinegraph(*arguments: object) -> None:
    """A command, in this process; errors come out as they are raised."""
    with succeeding():
        call_command(*arguments)


def imported(tmp_path: Path, *arguments: object) -> Recording:
    target = tmp_path / "made.mcap"
    kinegraph("files", "import", *arguments, "-o", target)
    return Recording.open(target)


def refused(tmp_path: Path, text: str, *arguments: object) -> None:
    with pytest.raises(RecordingError, match=text):
        cli.call("files import", [*map(str, arguments), "-o", str(tmp_path / "refused.mcap")])
    assert not (tmp_path / "refused.mcap").exists()


def arrays(file: Path) -> dict[str, np.ndarray[Any, Any]]:
    with np.load(file) as opened:
        return dict(opened)


def assert_live_like(recording: Recording) -> None:
    """Every stream's `until` is kept, the streams advance side by side, and every one ends."""
    until = dict.fromkeys(recording.streams, -FOREVER)
    arrival_before, expected = -FOREVER, 0
    for sequence, name, chunk, arrival in recording.inputs():
        assert sequence == expected and arrival >= arrival_before
        expected, arrival_before = sequence + 1, arrival
        if len(chunk):
            assert chunk.time[0] > until[name] and chunk.time[-1] <= min(chunk.until, arrival)
        assert chunk.until >= until[name]
        until[name] = chunk.until
        open_ends = [u for u in until.values() if u not in (-FOREVER, FOREVER)]
        assert not open_ends or max(open_ends) - min(open_ends) <= 100_000_000 or len(open_ends) < len(until)
    assert set(until.values()) == {FOREVER}
