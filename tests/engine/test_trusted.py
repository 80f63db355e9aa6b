"""What is run: only from folders that nobody else may write; and of files beside a graph it is said before, or they are refused."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from stream.errors import KinegraphError
from stream.model import ModelError, read_model, write_model
from stream.owners import refuse_shared
from tests.support.command_line import BOARD, QUIET, Command, refused

MINE = """
from pathlib import Path
from operators.rectify import Rectify
Path({ran!r}).touch()
"""


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    """A graph that names a file beside it, which leaves a trace when it is run."""
    name = f"mine_{os.getpid()}_{abs(hash(tmp_path))}"
    (tmp_path / f"{name}.py").write_text(MINE.format(ran=str(tmp_path / "ran")))
    path = tmp_path / "graph.yaml"
    path.write_text(BOARD % 1 + f"  own: {{use: {name}.Rectify, from: board.emg}}\n")
    return path


def test_check_says_what_runs_beside_the_graph(kinegraph: Command, graph: Path) -> None:
    code, _, err = kinegraph("check", graph)
    assert code == 0 and "runs code that is not installed" in err and str(graph.parent / "mine_") in err
    assert (graph.parent / "ran").exists()


@pytest.mark.parametrize("command", [("check",), ("run", *QUIET)])
def test_trusted_only_runs_nothing_beside_it(kinegraph: Command, graph: Path, command: tuple[str, ...]) -> None:
    refused(kinegraph(command[0], graph, "--trusted-only", *command[1:]), "is not installed", "--trusted-only")
    assert not (graph.parent / "ran").exists()


@pytest.mark.skipif(os.name != "posix" or os.getuid() != 0, reason="only root can give files away")
def test_a_graph_of_another_user_runs_nothing_beside_it(kinegraph: Command, graph: Path) -> None:
    os.chown(graph, 12345, 12345)
    refused(kinegraph("check", graph), "is not installed")
    assert not (graph.parent / "ran").exists()


@pytest.mark.skipif(os.name != "posix", reason="owners as POSIX has them")
def test_a_folder_that_others_may_write_is_not_run_from(kinegraph: Command, graph: Path) -> None:
    graph.parent.chmod(0o777)
    refused(kinegraph("check", graph), "may be written by others", "chmod go-w")
    assert not (graph.parent / "ran").exists()


@pytest.mark.skipif(os.name != "posix", reason="owners as POSIX has them")
def test_the_kernel_cache_is_nobody_elses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from stream import kernel

    monkeypatch.setenv("KINEGRAPH_CACHE", str(tmp_path / "cache"))
    kernel.cache_folder.cache_clear()
    try:
        assert kernel.cache_folder().stat().st_mode & 0o077 == 0
        for shared in (tmp_path / "cache", tmp_path / "cache" / "kernels"):
            shared.chmod(0o777)
            kernel.cache_folder.cache_clear()
            with pytest.raises(KinegraphError, match="may be written by others"):
                kernel.cache_folder()
            shared.chmod(0o700)
    finally:
        kernel.cache_folder.cache_clear()


def test_ones_own_folder_is_taken(tmp_path: Path) -> None:
    refuse_shared(tmp_path, "this")


@pytest.mark.skipif(os.name != "posix", reason="owners as POSIX has them")
@pytest.mark.parametrize("shared", ["folder", "file"])
def test_a_model_that_others_may_write_is_not_believed(tmp_path: Path, shared: str) -> None:
    path = tmp_path / "pose.model"
    write_model(path, "pose", {}, {"a": np.zeros(3)})
    assert read_model(path, "pose").kind == "pose"
    (tmp_path if shared == "folder" else path).chmod(0o777)
    with pytest.raises(
        ModelError, match=r"may be written by others, and results follow from what it holds.*chmod go-w"
    ):
        read_model(path, "pose")


@pytest.mark.skipif(os.name != "posix", reason="owners as POSIX has them")
def test_a_model_of_ones_own_in_a_folder_as_of_temporary_files_is_believed(tmp_path: Path) -> None:
    path = tmp_path / "pose.model"
    write_model(path, "pose", {}, {"a": np.zeros(3)})
    tmp_path.chmod(0o1777)
    assert read_model(path, "pose").kind == "pose"
