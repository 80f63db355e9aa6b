"""Runs a graph as a process that can be killed, with a wall clock that can be set back: python bedside_process.py CONFIG FOLDER [--resume].

While a file `set-back` lies beside CONFIG, the wall clock is an hour slow.
"""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

from kinegraph.stream.cli.commands import logs
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load

HOUR_NS = 3_600_000_000_000


def main() -> None:
    config, folder, *options = sys.argv[1:]
    wall_ns, wall_s, flag = time.time_ns, time.time, Path(config).with_name("set-back")
    time.time_ns = lambda: wall_ns() - HOUR_NS * flag.exists()
    time.time = lambda: wall_s() - 3600 * flag.exists()
    logs.set_up()
    session = Session(load(Path(config)), Path(folder), resume="--resume" in options)
    signal.signal(signal.SIGTERM, lambda *_: session.stop())
    print("going", flush=True)
    outcome = session.run()
    if outcome.error:
        raise outcome.error
    sys.exit(outcome.exit_code)


if __name__ == "__main__":
    main()
