"""`python -m kinegraph.stream.engine.compile_process`: compiles operators that come in by line, and returns each line when it is done."""

from __future__ import annotations

import importlib
import os
import signal
import sys
from contextlib import suppress

from kinegraph.stream.engine.warmup import run_cases


def main() -> None:
    """A signal from the terminal ends the process at once, as does the end of its input."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    answers = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what an operator prints is not an answer
    for line in sys.stdin:
        module, _, name = line.strip().partition(":")
        with suppress(Exception):  # the session tries it again, and reports what is wrong
            run_cases(getattr(importlib.import_module(module), name))
        answers.write(line)


if __name__ == "__main__":
    main()
