"""The contenders as processes: their environments, made once, and the orders sent to them."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import venv
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

HERE = Path(__file__).resolve().parent
NEEDED = ["numba", "scipy", "platformdirs", "msgspec", "lz4", "zstandard", "typing-extensions"]
"""What the shared work itself needs in a peer's environment."""
MODULES = {
    "bare": "bare",
    "kinegraph": "kinegraph_graph",
    "csp": "csp_graph",
    "streamz": "streamz_pipe",
    "timeflux": "timeflux_nodes",
    "ezmsg": "ezmsg_system",
}
OURS = ("bare", "kinegraph")
LIFE = 2
"""After so many rounds contenders are started again."""


class EngineError(Exception):
    """A contender cannot take part, or failed at an order."""


@dataclass(slots=True)
class Engine:
    """One contender at work in a process of its own."""

    name: str
    python: Path
    versions: dict[str, str] = field(default_factory=dict)
    _process: subprocess.Popen[str] | None = None

    def start(self) -> Self:
        command = [str(self.python), "-m", f"bench.contenders.{MODULES[self.name]}"]
        quiet = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore"}
        self._process = subprocess.Popen(
            command,
            cwd=HERE.parent,
            env=os.environ | quiet,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
        )
        self.versions = self._answer(120.0)
        return self

    def ask(self, *, timeout_s: float = 180.0, **order: Any) -> dict[str, Any]:
        """Send an order, wait for what came of it. Raises EngineError."""
        assert self._process and self._process.stdin
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()
        answer = self._answer(timeout_s)
        if "error" in answer:
            raise EngineError(f"{self.name}: {answer['error'].strip().splitlines()[-1]}")
        return answer

    def _answer(self, timeout_s: float) -> dict[str, Any]:
        assert self._process and self._process.stdout
        if not select.select([self._process.stdout], [], [], timeout_s)[0]:
            self.stop()
            raise EngineError(f"{self.name}: no answer within {timeout_s:g} s")
        line = self._process.stdout.readline()
        if not line:
            raise EngineError(f"{self.name}: it ended without an answer (exit code {self._process.wait()})")
        answer: dict[str, Any] = json.loads(line)
        return answer

    def stop(self) -> None:
        if self._process:
            self._process.kill()
            self._process.wait()


def peers() -> dict[str, list[str]]:
    """The peers and the packages that make them, from peers.txt."""
    lines = [line.split("#")[0].strip() for line in (HERE / "peers.txt").read_text(encoding="utf-8").splitlines()]
    return {name.strip(): packages.split() for name, _, packages in (line.partition(":") for line in lines if line)}


def environment(name: str, packages: list[str]) -> Path:
    """The Python of a peer's environment, made and filled if need be. Raises EngineError where it does not install."""
    folder = Path(sys.prefix) / "peers" / name
    python, done, wanted = folder / "bin" / "python", folder / "installed", " ".join([*packages, *NEEDED])
    if done.exists() and done.read_text(encoding="utf-8") == wanted:
        return python
    print(f"installing {name} ({' '.join(packages)}) ...", file=sys.stderr, flush=True)
    venv.create(folder, with_pip=True, clear=True)
    pip = [str(python), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--prefer-binary"]
    made = subprocess.run([*pip, *packages, *NEEDED], capture_output=True, text=True, check=False)
    if made.returncode:
        errors = [line for line in made.stderr.splitlines() if line.startswith("ERROR")]
        raise EngineError(f"{name}: does not install ({(errors or ['no reason given'])[-1]})")
    done.write_text(wanted, encoding="utf-8")
    return python


@dataclass(slots=True)
class Field:
    """All contenders of a run.

    absent   why who does not take part
    """

    engines: dict[str, Engine] = field(default_factory=dict)
    absent: list[str] = field(default_factory=list)

    @classmethod
    def gather(cls, *, with_peers: bool = True) -> Field:
        """Start everyone who can be started."""
        made = cls()
        candidates: dict[str, list[str]] = {name: [] for name in OURS}
        for name, packages in (candidates | (peers() if with_peers else {})).items():
            try:
                python = Path(sys.executable) if name in OURS else environment(name, packages)
                made.engines[name] = Engine(name, python).start()
            except (EngineError, OSError, subprocess.SubprocessError) as error:
                made.absent.append(str(error))
                print(f"left out: {error}", file=sys.stderr)
        return made

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for engine in self.engines.values():
            engine.stop()

    def rounds(self, count: int) -> Iterator[bool]:
        """So many rounds, and whether each counts: two do not, in which everyone warms up.

        Now and then all are started again, for how fast a process is depends on where its memory happens to lie, as long as it lives.
        """
        for i in range(count):
            if i % LIFE == 0:
                if i:
                    self._renew()
                yield from (False, False)
            yield True

    def _renew(self) -> None:
        for name, engine in list(self.engines.items()):
            engine.stop()
            try:
                engine.start()
            except EngineError as error:
                self.drop(name, error)

    def drop(self, name: str, error: Exception) -> None:
        """Go on without an engine that failed; our own must not."""
        if name in OURS:
            raise error
        self.absent.append(str(error))
        print(f"goes on without: {error}", file=sys.stderr)
        self.engines.pop(name).stop()
