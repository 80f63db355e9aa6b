"""Every operator and source runs somewhere that a user sees: in a shipped graph, in a page of the docs, or on its own page."""

from __future__ import annotations

import re
from pathlib import Path

from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.graph.shipped import shipped, shipped_parts

HOUSE = Path(__file__).resolve().parents[2]
USE = re.compile(r"use: *[\"']?([\w.]+)")
NEEDS_A_DEVICE = {
    "LabJack", "AzureKinect", "Orbbec", "RealSense", "Ganglion", "HeartRate", "BrainflowBoard", "NatNet", "Qualisys",
    "Vmc", "VrchatTrackers", "OscPoints", "TriggerOutlet",
}  # fmt: skip
"""Another device or program of a kind that is in a shipped graph, with its own page or row in docs/devices, docs/use/outlets.md or
docs/method/steering.md; it takes the place of a source or outlet there."""
OF_OURS = {
    "DepthCamera",
    "StreamInlet",
    "StreamOutlet",
    "OscOutlet",
    "SimulatedOak",
    "BeforeCamera",
    "DepthClip",
    "PoseAnswers",
    "PoseQueries",
    "SessionEnd",
}
"""What others are made of; sources and outlets of commands, of several machines, of the lab and of tests."""


def class_name(use: str) -> str:
    return use.rpartition(".")[2]


def test_every_component_runs_in_a_shipped_graph_or_in_the_docs() -> None:
    graphs = "".join(path.read_text(encoding="utf-8") for path in (*shipped().values(), *shipped_parts().values()))
    pages = "".join(
        path.read_text(encoding="utf-8") for end in ("md", "ipynb") for path in (HOUSE / "docs").rglob(f"*.{end}")
    )
    seen = {class_name(use) for use in USE.findall(graphs + pages)}
    missing = []
    for use, kind in catalogue()[0].items():
        name, example = class_name(use), ">>> " in (kind.__doc__ or "")
        if name not in seen | NEEDS_A_DEVICE | OF_OURS and not (use.startswith("operators.") and example):
            missing.append(use)
    assert missing == [], (
        "an operator shows its example, with numbers, on its page in the catalogue; the others run in a graph"
    )


def test_what_is_excepted_is_named_in_the_docs_and_there() -> None:
    pages = "".join(path.read_text(encoding="utf-8") for path in (HOUSE / "docs").rglob("*.md"))
    names = {class_name(use) for use in catalogue()[0]}
    assert {name for name in NEEDS_A_DEVICE if name not in names or name not in pages} == set()
    assert names >= OF_OURS
