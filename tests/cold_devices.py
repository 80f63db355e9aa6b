"""`python -m tests.cold_devices GRAPH...`: each graph with simulated devices in a process of its own; what compiled once it ran.

A kernel that meets types for the first time counts, whether its code is found on disk or not: with an empty cache it would compile.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from contextlib import ExitStack
from pathlib import Path

import kinegraph.stream.engine.session as engine
from kinegraph.stream.cli.commands.run import simulated
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.laws.watch import compiling

RUN_S = 1.5


class Watching:
    """Takes the place of the session's own count, which is of real compilations only."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self.names = self._stack.enter_context(compiling())

    def stop(self) -> None:
        self._stack.close()


def met(path: Path) -> list[str]:
    """The kernels that were met after the warm-up; an error's words, if the session failed."""
    graph = load(path)
    with simulated(graph), tempfile.TemporaryDirectory() as folder:
        outcome = engine.Session(graph, Path(folder) / "s", duration_s=RUN_S).run()
    return [str(outcome.error)] if outcome.error else list(outcome.compiled)


def apart(path: Path) -> list[str]:
    """The same in a forked process, so that no graph finds what another one has compiled."""
    out, into = os.pipe()
    if not (child := os.fork()):
        os.close(out)
        with os.fdopen(into, "w") as output:
            json.dump(met(path), output)
        os._exit(0)
    os.close(into)
    with os.fdopen(out) as output:
        text = output.read()
    os.waitpid(child, 0)
    return [str(name) for name in json.loads(text)] if text else ["it ended without a word"]


def main() -> None:
    engine.__dict__["Compilations"] = Watching
    print(json.dumps({path: apart(Path(path)) for path in sys.argv[1:]}))


if __name__ == "__main__":
    main()
