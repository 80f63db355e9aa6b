"""Commands called in this process, through the same `main` that `kinegraph` calls, by hostile and clumsy users.

A user's mistake never shows a traceback: whatever `main` lets through but SystemExit fails the test.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import structlog

from kinegraph.stream.cli import main, registry

KINEGRAPH = Path(sys.executable).parent / "kinegraph"
BOARD = "nodes:\n  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: %s}\n"
GRAPH = BOARD % 2 + "  rect: {use: operators.filters.rectify.Rectify, from: board.emg}\nrecord: [rect]\n"
QUIET = ("--view", "none")

CommandResult = tuple[int, str, str]
Command = Callable[..., CommandResult]


@contextmanager
def succeeding() -> Iterator[None]:
    """Within: a command that is called in this process; it returns, or exits with code 0."""
    try:
        yield
    except SystemExit as end:
        assert not end.code, f"exit code {end.code}"


@pytest.fixture
def kinegraph(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Iterator[Command]:
    """Call a command in an empty folder: (exit code, what it printed, what it complained of)."""
    import kinegraph.stream.cli.main

    monkeypatch.chdir(tmp_path)

    def call(*arguments: object) -> CommandResult:
        monkeypatch.setattr(sys, "argv", ["kinegraph", *map(str, arguments)])
        capsys.readouterr()
        code: Any = 0
        try:
            kinegraph.stream.cli.main.main()
        except SystemExit as end:
            code = end.code or 0
        output = capsys.readouterr()
        assert "Traceback" not in output.out + output.err
        return code, output.out, output.err

    yield call
    structlog.reset_defaults()


def call_command(*words: object) -> None:
    """A command in this process, with its group; errors come out as they are raised."""
    arguments = [*map(str, words)]
    name = registry.command_in(arguments)
    assert name, f"there is no command in {arguments}"
    main.call(name, arguments[len(name.split()) :])


def refused(reported: CommandResult, *words: str, code: int = 2) -> None:
    """The command ended with `code`, and its complaint holds all these words."""
    assert reported[0] == code, reported
    assert not [word for word in words if word not in reported[2]], reported[2]


@cache
def _made_once(top: Path) -> Path:
    folder = top / "made once"
    folder.mkdir()
    (folder / "graph.yaml").write_text(GRAPH)
    subprocess.run([KINEGRAPH, "run", "graph.yaml", "-o", "s", *QUIET], cwd=folder, check=True, capture_output=True)
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a graph and a whole recording of it: a copy of one that is made once in a process."""
    folder = tmp_path_factory.mktemp("made")
    shutil.copytree(_made_once(tmp_path_factory.getbasetemp()), folder, dirs_exist_ok=True)
    return folder


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.02)


def shell(command: str, folder: Path, env: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        ["bash", "-c", command], cwd=folder, capture_output=True, text=True, env={**os.environ, **(env or {})}
    )
    assert "Traceback" not in done.stderr, done.stderr
    return done
