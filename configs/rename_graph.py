"""`python configs/rename_graph.py OLD.yaml > NEW.yaml`: a graph from before the rooms moved, with the names of today.

A recording holds the graph that made it; with the renamed graph, `kinegraph replay NEW.yaml RECORDING --verify` gives what it gave then.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

RENAMED = {
    "devices.actigraph.": "devices.simulators.actigraph.",
    "devices.bedside.": "devices.simulators.bedside.",
    "devices.csv_file.": "devices.outlets.csv_file.",
    "devices.cycle_table.": "devices.outlets.cycle_table.",
    "devices.depthai_replay.": "devices.files.depthai_replay.",
    "devices.exerciser.": "devices.simulators.exerciser.",
    "devices.lsl.LslOutlet": "devices.outlets.lsl.LslOutlet",
    "devices.lsl.outlet.": "devices.outlets.lsl.",
    "devices.mqtt.MqttOutlet": "devices.outlets.mqtt.MqttOutlet",
    "devices.mqtt.outlet.": "devices.outlets.mqtt.outlet.",
    "devices.night.": "devices.outlets.night.",
    "devices.report.": "devices.outlets.report.",
    "devices.treadmill.": "devices.simulators.treadmill.",
    "devices.walkway.": "devices.simulators.walkway.",
}


def renamed(text: str) -> str:
    """The text of a graph with today's dotted names."""
    for old, new in RENAMED.items():
        text = re.sub(rf"(?<![\w.]){re.escape(old)}", new, text)
    return text


if __name__ == "__main__":
    sys.stdout.write(renamed(Path(sys.argv[1]).read_text(encoding="utf-8")))
