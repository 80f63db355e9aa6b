"""Code runs only from folders that other users cannot write; files beside a graph are announced or refused."""

from __future__ import annotations

import compileall
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.file_permissions import refuse_shared
from tests.support.command_line import BOARD, KINEGRAPH, QUIET, Command, refused

MINE = """
from pathlib import Path
from kinegraph.operators.filters.rectify import Rectify
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
    from kinegraph.stream.compiler import cache

    monkeypatch.setenv("KINEGRAPH_CACHE", str(tmp_path / "cache"))
    cache.cache_folder.cache_clear()
    try:
        assert cache.cache_folder().stat().st_mode & 0o077 == 0
        for shared in (tmp_path / "cache", tmp_path / "cache" / "kernels"):
            shared.chmod(0o777)
            cache.cache_folder.cache_clear()
            with pytest.raises(KinegraphError, match="may be written by others"):
                cache.cache_folder()
            shared.chmod(0o700)
    finally:
        cache.cache_folder.cache_clear()


def doubled(x: float) -> float:
    return 2.0 * x


@pytest.mark.skipif(os.name != "posix", reason="owners as POSIX has them")
def test_a_kernels_own_folder_is_nobody_elses(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the umask of a program that imports kinegraph; and where one was left open, what may have been planted is not run."""
    from kinegraph.stream.compiler import cache
    from kinegraph.stream.kernel import kernel

    monkeypatch.setenv("KINEGRAPH_CACHE", str(tmp_path / "cache"))
    cache.cache_folder.cache_clear()
    umask = os.umask(0)
    try:
        assert kernel(doubled)(2.0) == 4.0
        (made,) = (tmp_path / "cache" / "kernels").glob("*test_trusted_folders-*")
        assert made.stat().st_mode & 0o077 == 0
        made.chmod(0o777)
        with pytest.raises(KinegraphError, match=r"may be written by others.*chmod go-w"):
            kernel(doubled)(2.0)
    finally:
        os.umask(umask)
        cache.cache_folder.cache_clear()


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


@pytest.mark.parametrize(
    "command", [("check", "--trusted-only"), ("check",), ("run", *QUIET, "--no-record", "--for", "1")]
)
def test_a_file_of_an_optional_librarys_name_beside_the_graph_is_not_run(
    kinegraph: Command, tmp_path: Path, command: tuple[str, ...]
) -> None:
    """The graph names what is ours; what that imports is looked for among what is installed."""
    (tmp_path / "brainflow").mkdir()
    (tmp_path / "brainflow" / "__init__.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    (tmp_path / "brainflow" / "board_shim.py").touch()
    (tmp_path / "g.yaml").write_text(
        "nodes:\n  board: {use: devices.brainflow.BrainflowBoard, board: SYNTHETIC_BOARD}\n"
    )
    kinegraph(command[0], "g.yaml", *command[1:])
    assert not (tmp_path / "ran").exists()


PLANTED = ("json", "numpy", "asyncio", "multiprocessing", "stream", "websockets", "matplotlib", "logging")


def test_no_process_runs_what_lies_in_the_folder_it_was_called_in(tmp_path: Path) -> None:
    """Neither kinegraph nor those that it starts: for the page, and for a report."""
    for name in PLANTED:
        (tmp_path / f"{name}.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'a').write({name!r})")
    settings = ("treadmill.duration_s=20", "treadmill.realtime=false", "report.path=report.html")
    given = [word for setting in settings for word in ("--set", setting)]
    done = subprocess.run(
        [KINEGRAPH, "run", "treadmill_emg", *given, "--no-record", *QUIET, "--page-at", ":0"],
        cwd=tmp_path, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert not (tmp_path / "ran").exists(), (tmp_path / "ran").read_text()
    assert (tmp_path / "report.html").exists()


@pytest.mark.skipif(not Path("/proc/self/cmdline").exists(), reason="processes as Linux shows them")
def test_the_pages_token_stands_in_no_list_of_processes(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text((BOARD % 0).replace("realtime: false, ", ""))
    command = [KINEGRAPH, "run", "g.yaml", "--no-record", *QUIET, "--page-at", "0.0.0.0:0"]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        try:
            token = next(line for line in process.stderr if "token=" in line).partition("token=")[2].strip()
            listed = b"".join(arguments(path) for path in Path("/proc").glob("[0-9]*/cmdline"))
        finally:
            process.terminate()
    assert len(token) > 20 and b"devices.page.server" in listed
    assert token.encode() not in listed


def arguments(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # it has ended meanwhile
        return b""


@pytest.mark.skipif(os.name != "posix", reason="owners as POSIX has them")
@pytest.mark.parametrize("shared", ["helper.py", "package/part.py", "package", "__pycache__", "late.py"])
def test_whatever_code_beside_a_graph_imports_is_nobody_elses(shared: str, tmp_path: Path) -> None:
    """A module that its module imports, a part of its package, one that it imports as it runs, and what Python compiled them to."""
    folder = tmp_path / "graph"
    (folder / "package").mkdir(parents=True, mode=0o755)
    (folder / "mine.py").write_text(
        "from dataclasses import dataclass\nimport helper\nimport package.part\nfrom kinegraph.operators.filters.rectify import Rectify\n"
        "@dataclass(frozen=True, slots=True)\nclass Mine(Rectify):\n"
        "    def open(self, specs):\n        import late\n        return Rectify.open(self, specs)\n"
    )
    for name in ("helper.py", "package/__init__.py", "package/part.py", "late.py"):
        (folder / name).write_text("")
    graph = folder / "graph.yaml"
    graph.write_text(BOARD % 1 + "  own: {use: mine.Mine, from: board.emg}\n")
    compileall.compile_dir(folder, quiet=1)
    check = [KINEGRAPH, "check", graph]
    done = subprocess.run(check, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    (folder / shared).chmod(0o777)
    done = subprocess.run(check, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and f"{folder / shared}: what a graph runs may be written by others" in done.stderr
