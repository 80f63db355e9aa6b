"""How long after its closing touch-down a cycle stands on the screen: the shipped graph in real time, beside the delay it declares.

python -m bench.screen --seconds 60
"""

from __future__ import annotations

import argparse
import re
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.recording import Recording
from kinegraph.stream.text.safe_text import say
from tests.support.command_line import KINEGRAPH

CONFIG = Path(__file__).parent.parent / "configs" / "treadmill_emg.yaml"


def shown(folder: Path, seconds: float) -> dict[int, int]:
    """When each cycle's line came (ns, UTC), by its number."""
    sets = (f"treadmill.duration_s={seconds}", f"report.path={folder / 'r.html'}")
    settings = [part for setting in sets for part in ("--set", setting)]
    command = [KINEGRAPH, "run", str(CONFIG), *settings, "-o", str(folder / "w"), "--view", "lines"]
    came: dict[int, int] = {}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        for line in process.stdout or ():
            if found := re.match(r"cycle (\d+) ", line):
                came.setdefault(int(found[1]), time.time_ns())
    return came


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.screen", description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    declared = {str(d.origin): d for d in plan(load(CONFIG)).decisions}["statistics"]
    with tempfile.TemporaryDirectory() as place:
        came = shown(Path(place), seconds)
        with Recording.open(Path(place) / "w") as recording:
            _, closed = recording.read("cycles.closed")
    ends = {int(row["number"]): int(row["end"]) for row in closed}
    late = np.array([came[number] - ends[number] for number in came if number in ends]) / 1e6
    say(
        f"{len(late)} cycles, from the closing touch-down to the line on the screen: median {np.median(late):.0f} ms, "
        f"95 % {np.percentile(late, 95):.0f} ms, most {late.max():.0f} ms; declared: {declared.total_s * 1e3:.0f} ms"
    )


if __name__ == "__main__":
    main()
