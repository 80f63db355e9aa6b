"""Recordings that are none, are cut off or damaged: told by name, and recovered as far as they go."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import Writer

from kinegraph.stream.recording import Recording
from tests.support.command_line import Command, refused


@pytest.fixture
def broken(made: Path, tmp_path: Path) -> Callable[..., Path]:
    """A copy of the recording, changed by a function of its bytes."""
    whole = (made / "s" / "session.0000.mcap").read_bytes()

    def make(change: Callable[[bytes], bytes], name: str = "broken.mcap") -> Path:
        path = tmp_path / name
        path.write_bytes(change(whole))
        return path

    return make


def test_recordings_that_cannot_be_read(
    kinegraph: Command, made: Path, tmp_path: Path, broken: Callable[..., Path]
) -> None:
    for name, profile in (("ros.mcap", "ros2"), ("other.mcap", "")):
        with (tmp_path / name).open("wb") as file:
            writer = Writer(file)
            writer.start(profile)
            writer.finish()  # type: ignore[no-untyped-call]
    newer = (b"\x06\x00\x00\x00format\x01\x00\x00\x001", b"\x06\x00\x00\x00format\x01\x00\x00\x009")
    (tmp_path / "empty").mkdir()
    cases = [
        (tmp_path / "none.mcap", "there is no such recording"),
        (tmp_path / "empty", "the folder holds no recording"),
        (made / "graph.yaml", "not an MCAP recording; CSV, NPZ and XDF files are read by `kinegraph files import`"),
        (tmp_path / "ros.mcap", "not a kinegraph recording (profile 'ros2')"),
        (tmp_path / "other.mcap", "not a kinegraph recording (written by"),
        (broken(lambda b: b"", "nothing.mcap"), "the file is empty"),
        (broken(lambda b: b[:100], "short.mcap"), "truncated before anything was recorded"),
        (broken(lambda b: b.replace(*newer), "newer.mcap"), "format 9; this kinegraph reads formats up to 1"),
        (broken(lambda b: flipped(b, 150), "header.mcap"), "`kinegraph recover` rewrites what can be read"),
        (broken(lambda b: flipped(b, len(b) // 2), "middle.mcap"), "damaged at byte"),
    ]
    for path, words in cases:
        for arguments in (
            ("info", path),
            ("files", "export", path, "-o", "out"),
            ("replay", made / "graph.yaml", path),
        ):
            refused(kinegraph(*arguments), str(path), words)
    assert not any((tmp_path / "out").glob("*"))


def flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :]


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(
    kinegraph: Command, made: Path, broken: Callable[..., Path]
) -> None:
    for change in (lambda b: b[:-1], lambda b: b[:-1200], lambda b: flipped(b, len(b) - 2000)):
        path = broken(change)
        code, shown, _ = kinegraph("info", path)
        assert code == 0 and "kinegraph recover" in shown
        assert kinegraph("replay", made / "graph.yaml", path, "--verify", "-q")[0] == 0
        assert kinegraph("recover", path)[0] == 0
        with Recording.open(path) as recording:
            assert recording.finished and recording.streams["rect"].samples == 2000


def test_damage_anywhere_is_told_and_recovered_from(
    kinegraph: Command, broken: Callable[..., Path], tmp_path: Path
) -> None:
    """Recordings with bytes changed in their header, data or end: an error that names the file, never another."""
    chance = random.Random(5)
    recovered = 0
    for _ in range(60):
        n = (tmp_path / "broken.mcap").stat().st_size if (tmp_path / "broken.mcap").exists() else 10_000
        region = chance.choice([(8, 1400), (n - 4000, n - 8), (8, n - 8)])
        places = [chance.randrange(*region) for _ in range(chance.choice([1, 1, 3]))]

        def spoil(data: bytes, places: list[int] = places) -> bytes:
            for place in places:
                data = flipped(data, min(place, len(data) - 1))
            return data

        path = broken(spoil)
        code, _, complaint = kinegraph("info", path, "--json")
        assert code == 0 or (code == 2 and str(path) in complaint), complaint
        (tmp_path / "out.mcap").unlink(missing_ok=True)
        code, _, complaint = kinegraph("recover", path, "-o", "out.mcap")
        assert code == 0 or (code == 2 and str(path) in complaint), complaint
        recovered += code == 0
    assert recovered > 50


def test_a_recording_that_lacks_a_stream(kinegraph: Command, made: Path, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("time,a\n" + "".join(f"{k / 100},{k}\n" for k in range(50)))
    assert kinegraph("files", "import", "t.csv", "-o", "t.mcap", "--stream", "other=a", "--time", "other=time")[0] == 0
    refused(kinegraph("replay", made / "graph.yaml", "t.mcap"), "node 'rect'", "lacks the stream 'board.emg'")
    refused(
        kinegraph("files", "export", "t.mcap", "--stream", "othre", "-o", "x"),
        "no stream 'othre'",
        "did you mean 'other'?",
    )
