"""A cable that comes out: how long after it is in again the first sample is there, and what share of what was offered is kept.

    python -m bench.comeback

A simulated device on a pseudo-terminal, 200 lines a second, read by whole sessions: one outage of nine seconds, and a loose plug that
comes out 25 times in 90 seconds. Truth: every line holds its index, and what is sent while the plug is in is offered.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
from pathlib import Path

import numpy as np

from bench.report import Section, short, whole
from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording

RATE_HZ = 200.0
ONCE = FaultInjection(unplug_every_s=12.0, unplug_s=9.0)
LOOSE = FaultInjection(unplug_every_s=3.6, unplug_s=0.8)
GRAPH = """
nodes:
  lines: {{use: devices.lines.AsciiLines, port: {port}, columns: [index, t, n], time: t, rate_hz: {rate}}}
"""


def indices(wrong: FaultInjection, seconds: float) -> np.ndarray:
    """The true indices of all samples (n,) that a session of so many seconds has recorded."""
    with tempfile.TemporaryDirectory() as folder, Indexed(rate_hz=RATE_HZ).serving(wrong) as port:
        outcome = Session(
            load_text(GRAPH.format(port=port, rate=RATE_HZ)), Path(folder) / "s", duration_s=seconds
        ).run()
        if outcome.error:
            raise outcome.error
        with Recording.open(Path(folder) / "s") as recording:
            return recording.read("lines")[1][:, 0]


def returned(seen: np.ndarray, wrong: FaultInjection) -> np.ndarray:
    """Seconds (n,) from the plug's return to the first line made afterwards that was kept."""
    missing = np.flatnonzero(np.diff(seen) > wrong.unplug_s * RATE_HZ / 2)
    first = seen[missing + 1] / RATE_HZ
    return first - (np.floor(first / wrong.unplug_every_s) * wrong.unplug_every_s + wrong.unplug_s)


def kept(seen: np.ndarray, wrong: FaultInjection) -> float:
    """The share of the lines sent with the plug in, between the first and the last recorded one."""
    sent = np.arange(seen[0], seen[-1] + 1) / RATE_HZ
    within = (sent >= wrong.unplug_every_s) & (sent % wrong.unplug_every_s < wrong.unplug_s)
    return len(seen) / float(np.count_nonzero(~within))


def coming_back(once_s: float = 24.0, loose_s: float = 90.0) -> Section:
    """Both at the same time: they wait nearly always."""
    section = Section(
        "A cable that comes out", ["", "outages", "back after, median s", "most s", "kept of what was offered"]
    )
    cases = {"once, for 9 s": (ONCE, once_s), "a loose plug, 25 times in 90 s": (LOOSE, loose_s)}
    seen: dict[str, np.ndarray] = {}
    threads = [
        threading.Thread(target=lambda n=name, w=wrong, s=seconds: seen.update({n: indices(w, s)}))  # type: ignore[misc]
        for name, (wrong, seconds) in cases.items()
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for name, (wrong, _) in cases.items():
        after = returned(seen[name], wrong)
        section.rows.append(
            [
                name,
                str(len(after)),
                short(float(np.median(after))),
                short(float(after.max())),
                f"{kept(seen[name], wrong):.1%}",
            ]
        )
    return section


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.comeback", description=__doc__)
    parser.add_argument("--seconds", type=float, default=90.0, help="of the loose plug")
    given = parser.parse_args()
    print(whole([coming_back(loose_s=given.seconds)], "A cable that comes out, in one run."))


if __name__ == "__main__":
    main()
