"""Commands as a reader types them, in one folder: kinegraph is imported once, then every command runs in a fork of that process.

A fork starts as a new process does, but for the imports, which would take most of its time. What is no plain `kinegraph ...` or
`python FILE.py` goes to the shell.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import runpy
import shlex
import subprocess
import sys
import traceback
from pathlib import Path
from typing import Self

HOUSE = Path(__file__).resolve().parents[2]
OF_SHELL = re.compile(r"[|<>&;$`~]")
ASSIGNED = re.compile(r"\w+=")
SERVER = f"import sys; sys.path[0] = {str(HOUSE)!r}; from tests.support.typed_commands import serve; serve()"
"""Run by `-c`: a process that a command starts by multiprocessing finds no main module that it would import again."""


class Typist:
    """Runs commands in a folder, one after the other."""

    def __init__(self, folder: Path) -> None:
        programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        self._server = subprocess.Popen(
            [sys.executable, "-c", SERVER],
            cwd=folder,
            env={**os.environ, "PATH": programs, "COLUMNS": "120", "MPLBACKEND": "agg"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        with self._server:  # closes its input, at which it ends
            pass

    def type(self, command: str) -> tuple[int, str]:
        """(exit code, all that it printed)"""
        assert self._server.stdin and self._server.stdout
        print(json.dumps(command), file=self._server.stdin, flush=True)
        code, printed = json.loads(self._server.stdout.readline())
        return code, printed


def serve() -> None:
    """Read commands, a line each; answer each with its exit code and what it printed."""
    import matplotlib  # noqa: F401

    import kinegraph.stream.api
    import kinegraph.stream.cli.main
    import kinegraph.stream.engine  # noqa: F401

    del sys.path[0]
    answers = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        command = json.loads(line)
        output = Path(".printed")
        with output.open("wb") as file:
            code = _run(command, file.fileno())
        printed = output.read_text(encoding="utf-8", errors="replace")
        output.unlink()
        print(json.dumps([code, printed]), file=answers, flush=True)


def _run(command: str, output: int) -> int:
    words = [] if OF_SHELL.search(re.sub(r"'[^']*'", "", command)) else shlex.split(command, comments=True)
    is_script = len(words) == 2 and words[0] == "python" and words[1].endswith(".py")
    if not words or not (words[0] == "kinegraph" or is_script):
        return subprocess.run(
            ["bash", "-c", command], stdin=subprocess.DEVNULL, stdout=output, stderr=output, timeout=300
        ).returncode
    if child := os.fork():
        return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    code = 70
    with contextlib.suppress(BaseException):
        code = _in_this_process(words, output, is_script=is_script)
    os._exit(code)


def _in_this_process(words: list[str], output: int, *, is_script: bool) -> int:
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.dup2(output, 1)
    os.dup2(output, 2)
    sys.stdin = open(0)  # noqa: SIM115
    sys.stdout, sys.stderr = os.fdopen(1, "w", 1), os.fdopen(2, "w", 1)
    code: object = 1
    try:
        if is_script:
            sys.argv = words[1:]
            sys.path.insert(0, str(Path.cwd()))
            runpy.run_path(words[1], run_name="__main__")
        else:
            from kinegraph.stream.cli.main import main

            sys.argv = [word for given in words for word in (_files(given) or [given])]
            main()
        code = 0
    except SystemExit as end:
        code = end.code or 0
    finally:
        if error := sys.exception():
            traceback.print_exception(error)
        sys.stdout.flush()
        sys.stderr.flush()
    return code if isinstance(code, int) else 1


def _files(word: str) -> list[str]:
    """What the shell makes of `walks/*`."""
    return sorted(map(str, Path().glob(word))) if "*" in word and not ASSIGNED.match(word) else []
