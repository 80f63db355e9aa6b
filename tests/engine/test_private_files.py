"""What kinegraph writes is its owner's alone: files 0600 in folders 0700, whatever the umask was; and whole, or not there."""

from __future__ import annotations

import os
import stat
import subprocess
from pathlib import Path

import pytest

from kinegraph.stream.system.atomic_file import be_private, complete, private_folder, write_complete
from tests.support.command_line import KINEGRAPH, QUIET


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


def test_everything_that_commands_write_is_private(tmp_path: Path, made: Path) -> None:
    graph = made / "graph.yaml"
    listing = (
        made / "graph.yaml"
    ).read_text() + "  table: {use: devices.outlets.csv_file.CsvFile, from: rect, path: out/t/x.csv}\n"
    listing = listing.replace("record: [rect]\n", "") + "record: [rect]\n"
    (tmp_path / "graph.yaml").write_text(listing)
    for arguments in (
        ("run", "graph.yaml", "-o", "s/deep", *QUIET),
        ("files", "export", made / "s", "-o", "tables/deep"),
        ("files", "export", made / "s", "-o", "one/x.xdf"),
        ("recover", made / "s", "-o", "recovered/x.mcap"),
        ("replay", graph, made / "s", "-o", "replayed/x.mcap", "-q"),
    ):
        subprocess.run([KINEGRAPH, *map(str, arguments)], cwd=tmp_path, umask=0, check=True, capture_output=True)
    found = [path for path in tmp_path.rglob("*") if path.name != "graph.yaml"]
    assert len([path for path in found if path.is_file()]) >= 6
    open_ones = {str(p): oct(mode(p)) for p in found if mode(p) & 0o077}
    assert not open_ones


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o177])
def test_a_private_process_leaves_nothing_to_others(mask: int) -> None:
    before = os.umask(mask)
    be_private()
    assert os.umask(before) == mask | 0o077


def test_a_file_is_whole_or_as_it_was(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    write_complete(path, "before")
    with pytest.raises(RuntimeError), complete(path) as draft:
        draft.write_text("half")
        raise RuntimeError
    assert path.read_text() == "before" and [p.name for p in tmp_path.iterdir()] == ["x.json"]
    assert mode(path) == 0o600


def test_a_planted_draft_leads_nowhere(tmp_path: Path) -> None:
    """A link that waits where the draft will be is not followed."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / ".x.json.draft").symlink_to(victim)
    write_complete(tmp_path / "x.json", "new")
    assert victim.read_text() == "mine" and (tmp_path / "x.json").read_text() == "new"


def test_folders_are_private_and_those_that_are_there_stay(tmp_path: Path) -> None:
    before = os.umask(0)
    try:
        (tmp_path / "there").mkdir(0o755)
        private_folder(tmp_path / "there" / "a" / "b")
    finally:
        os.umask(before)
    assert [mode(tmp_path / "there" / d) for d in ("", "a", "a/b")] == [0o755, 0o700, 0o700]
