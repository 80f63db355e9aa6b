"""What a lab offers to begin with: the uses, the other shipped graphs, and graphs and presets of one's own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.shipped import resolve, shipped, summary

USES = {
    "treadmill_both_legs": (
        "Treadmill, both legs",
        "Muscle activity of every gait cycle, stage by stage, and left beside right",
    ),
    "treadmill_emg": ("Treadmill, one leg", "Muscle activity of every gait cycle, as the cycle ends"),
    "cyton_emg": (
        "EMG with a Cyton",
        "Muscle activity of every gait cycle, from an OpenBCI Cyton and a sensor on the foot",
    ),
    "bedside_sleep": ("Night", "Asleep or awake, breathing and movement, from a depth camera over the bed"),
    "bedside_simulated": ("Night, simulated", "A whole night in half a minute"),
    "count_repetitions": ("Repetitions", "Exercises found, named and counted, from one sensor"),
    "segment_mocap": (
        "Repetitions, whole body",
        "Squats, arm raises and more, of a simulated person's skeleton",
    ),
    "step_biometrics": ("Steps", "Every step from one sensor, and the manner of walking"),
    "avatar": ("Avatar, with a camera", "An avatar that follows a person before a depth camera"),
    "avatar_markers": ("Avatar, with markers", "An avatar that follows motion capture"),
    "webcam_avatar": ("Avatar, with a webcam", "An avatar that follows a person before any camera"),
    "steer_mesh": ("Mesh", "A mesh that follows a few markers"),
}
"""Shipped graphs with what people call them, in the order in which they are offered."""

OWN, PRESETS = "graphs", "presets"
ENDINGS = (".yaml", ".yml")


def titled(name: str) -> str:
    """What people call a graph."""
    return USES[name][0] if name in USES else name.replace("_", " ")


def offered(home: Path) -> dict[str, list[dict[str, Any]]]:
    """Every graph that can be set up, by kind."""
    known = shipped()
    uses = [{"graph": name, "title": title, "what": what} for name, (title, what) in USES.items() if name in known]
    more = [{"graph": name, "title": name, "what": summary(path)} for name, path in known.items() if name not in USES]
    return {"uses": uses, "more": more, PRESETS: _in(home, PRESETS), OWN: _in(home, OWN)}


def _in(home: Path, folder: str) -> list[dict[str, Any]]:
    found = sorted(p for p in (home / folder).glob("*") if p.suffix in ENDINGS)
    return [{"graph": f"{folder}/{p.name}", "title": p.stem, "what": summary(p)} for p in found]


def graph_file(home: Path, graph: str) -> Path:
    """The file of a graph that is offered, by what the browser calls it. Raises KinegraphError for any other."""
    if graph in shipped():
        return resolve(Path(graph))
    folder, _, name = graph.partition("/")
    path = home / folder / name
    if folder in (OWN, PRESETS) and name == Path(name).name and path.suffix in ENDINGS and path.is_file():
        return path
    raise KinegraphError(f"there is no graph {graph!r} in this lab")


def argument(home: Path, graph: str) -> str:
    """The graph as `kinegraph run` takes it in the lab's folder: a shipped one by its bare name."""
    return graph if graph in shipped() else str(graph_file(home, graph).relative_to(home))
