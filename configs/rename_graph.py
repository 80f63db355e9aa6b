"""`python configs/rename_graph.py OLD.yaml > NEW.yaml`: a graph of an earlier version, with the names of today.

A recording holds the graph that made it; with the renamed graph, `kinegraph replay NEW.yaml RECORDING --verify` gives what it gave then.

`python configs/rename_graph.py --before-parts treadmill_emg > FLAT.yaml`: a shipped graph of today, with the names that its nodes had
before shipped graphs used parts (`envelope` for `leg.chain.envelope`); with it, today's graph is verified against a recording made before.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any

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
    """The text of a graph with today's dotted names and parameters."""
    from kinegraph.stream.graph.moved import MOVED, PARAMETERS

    for old, new in RENAMED.items():
        text = re.sub(rf"(?<![\w.]){re.escape(old)}", new, text)
    for old, new in PARAMETERS.items():
        text = re.sub(rf"\b{old}(?=:)", new, text)
    return re.sub(r"(?<![\w.])(?:stream|devices|operators)(?:\.\w+)+", lambda use: MOVED.get(use[0], use[0]), text)


NODES = {
    "bedside_two": {
        f"{side}.{node}": f"{side}_{node}"
        for side in ("left", "right")
        for node in ("scorer", "nights", "statistics", "log", "past")
    },
    "count_repetitions": {"repetitions.segment": "repetitions"},
}
"""What a node was called where that is not the last word of its name today."""


def before_parts(graph: str) -> str:
    """A shipped graph without parts, with its nodes' names of old. Raises ValueError where two nodes would have one name."""
    from kinegraph.stream.graph.reading.load import read_expanded
    from kinegraph.stream.graph.reading.overrides import dump

    whole = read_expanded(Path(graph)).plain()
    special = NODES.get(Path(graph).stem, {})
    old = {node: special.get(node, node.rpartition(".")[2]) for node in whole["nodes"]}
    if twice := [name for name in old.values() if list(old.values()).count(name) > 1]:
        raise ValueError(f"several nodes of {graph} would be called {twice[0]!r}")

    def edges(written: Any) -> Any:
        """What names nodes, with the old names."""
        if isinstance(written, dict):
            return {key: edges(value) for key, value in written.items()}
        if isinstance(written, list):
            return [edges(value) for value in written]
        text = str(written)
        node = next((node for node in old if text == node or text.startswith(f"{node}.")), "")
        return old.get(node, node) + text.removeprefix(node)

    nodes = {
        old[name]: entry | ({"from": edges(entry["from"])} if "from" in entry else {})
        for name, entry in whole["nodes"].items()
    }
    sections = {key: value for key, value in whole.items() if key not in ("nodes", "settings", "page", "record")}
    return dump({"name": Path(graph).stem, **sections, "record": edges(whole.get("record", [])), "nodes": nodes})


if __name__ == "__main__":
    if sys.argv[1] == "--before-parts":
        sys.stdout.write(before_parts(sys.argv[2]))
    else:
        sys.stdout.write(renamed(Path(sys.argv[1]).read_text(encoding="utf-8")))
