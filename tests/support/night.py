"""Runs a graph as a process that can be killed: python night.py CONFIG FOLDER [--resume] [--slow-checkpoints]."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import Any

from kinegraph.stream.cli.commands import logs
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording.format.checkpoint import Checkpoint


def slow_checkpoints() -> None:
    """Writing a checkpoint takes so long that the process can be killed within."""
    save = Checkpoint.save

    def slowly(self: Checkpoint, folder: Path) -> None:
        import numpy as np

        savez = np.savez

        def halting(file: Any, **arrays: Any) -> None:
            savez(file, **arrays)
            file.flush()
            print("writing checkpoint", flush=True)
            time.sleep(0.4)

        np.savez = halting  # type: ignore[assignment]
        try:
            save(self, folder)
        finally:
            np.savez = savez

    Checkpoint.save = slowly  # type: ignore[method-assign]


def main() -> None:
    config, folder, *options = sys.argv[1:]
    logs.set_up()  # to standard error: what is printed is for the test
    if "--slow-checkpoints" in options:
        slow_checkpoints()
    session = Session(load(Path(config)), Path(folder), resume="--resume" in options)
    signal.signal(signal.SIGTERM, lambda *_: session.stop())
    print("going", flush=True)
    outcome = session.run()
    if outcome.error:
        raise outcome.error


if __name__ == "__main__":
    main()
