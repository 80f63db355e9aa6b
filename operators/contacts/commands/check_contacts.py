"""`kinegraph emg check-contacts`: whether the contacts of each foot are found, before the session, with what to do."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.contacts.commands.contact_check import FootFinding, FootInput
    from kinegraph.stream.graph import Edge, Graph
    from kinegraph.stream.recording import Recording

OUTPUTS = ("touchdown", "liftoff")


def check_contacts(
    source: Annotated[Path, typer.Argument(help="the graph with the contacts to check live", metavar="GRAPH")],
    walk_s: Annotated[float, typer.Option("--for", metavar="S", min=5.0, help="how long to walk")] = 15.0,
    simulate: Annotated[bool, typer.Option("--simulate", help="simulated devices in the place of real ones")] = False,
    as_json: AsJson = False,
) -> None:
    """Check the foot contacts before a session.

    Walk as in the session. It shows of each foot how many contacts were found, how long a stride and its stance last, and where contacts
    are missing, why and what to do. Nothing is kept. Exit code 0 if every foot is good, 1 if one is doubtful or bad.
    """
    from contextlib import nullcontext

    from kinegraph.operators.emg.commands.check_electrodes import run_stages
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.cli.commands.run import simulated
    from kinegraph.stream.graph.reading.load import load
    from kinegraph.stream.recording import Recording

    logs.set_up()
    graph = load(source)
    detectors = only_contacts(graph)
    with TemporaryDirectory(prefix="kinegraph-") as folder, simulated(graph) if simulate else nullcontext():
        into = Path(folder) / "check"
        code = run_stages(graph, into, [(0.0, walk_s, "walk as in the session")])
        if code:
            raise KinegraphError(f"contacts could not be checked: the session ended with exit code {code}")
        with Recording.open(into) as recording:
            found = [foot for node in detectors for foot in judged(graph, node, recording)]
    if as_json:
        print_json({"contacts": [asdict(foot) for foot in found]})
    else:
        _show(found)
    if poor := [f"{foot.name} {foot.reason}" for foot in found if foot.flag != "good"]:
        say(f"{len(poor)} of {len(found)} feet need a look: {', '.join(poor)}", err=True)
        sys.exit(1)
    feet = {1: "the foot", 2: "both feet"}.get(len(found), f"all {len(found)} feet")
    say(f"the contacts of {feet} are found", err=as_json)


def only_contacts(graph: Graph) -> list[str]:
    """Leave in a graph what contacts are found by, record it, and return the nodes that find them. Raises KinegraphError."""
    from kinegraph.stream.graph import Edge

    finding = [
        node.name
        for node in graph.nodes.values()
        if OUTPUTS[0] in node.specs and graph.readers(Edge(node.name, OUTPUTS[0]))
    ]
    if not finding:
        raise KinegraphError(
            f"{graph.path or graph.name} has no foot contacts to check: no node has a touchdown that is used"
        )
    kept: set[str] = set()
    todo = [*finding]
    while todo:
        if (name := todo.pop()) not in kept:
            kept.add(name)
            todo += [edge.node for edge in graph.nodes[name].inputs.values()]
    graph.nodes = {name: node for name, node in graph.nodes.items() if name in kept}
    edges = [Edge(name, output) for name in finding for output in OUTPUTS if output in graph.nodes[name].specs]
    edges += [edge for name in finding for edge in graph.nodes[name].inputs.values()]
    graph.record = tuple(dict.fromkeys(edges))
    return [name for name in finding if not _passes_on(graph, name)]


def _passes_on(graph: Graph, name: str) -> bool:
    """Whether a node finds no contacts, but joins those of others."""
    return bool(graph.nodes[name].inputs) and all(e.output in OUTPUTS for e in graph.nodes[name].inputs.values())


def judged(graph: Graph, name: str, recording: Recording) -> list[FootFinding]:
    """What was found of each foot of one node."""
    import numpy as np

    from kinegraph.operators.contacts.commands.contact_check import judge_foot, together
    from kinegraph.stream.graph import Edge

    node = graph.nodes[name]
    rows = {out: _read(recording, Edge(name, out))[1] for out in OUTPUTS if out in node.specs}
    downs = rows[OUTPUTS[0]]
    ups = rows.get(OUTPUTS[1], downs[:0])
    end_ns = max(stream.end for stream in recording.streams.values())
    limbs: dict[str, Any] = getattr(node.part, "limbs", {})
    if not limbs:
        side = str(graph.spec(Edge(name, OUTPUTS[0])).meta.get("side") or graph.session.get("side") or name)
        return [judge_foot(side, downs["onset"], ups["onset"], end_ns, _given(graph, name, "", recording))]
    of = {limb: downs["onset"][downs["limb"] == limb] for limb in limbs}
    feet = [
        judge_foot(
            limb, np.asarray(of[limb]), ups["onset"][ups["limb"] == limb], end_ns, _given(graph, name, limb, recording)
        )
        for limb in limbs
    ]
    return together(feet, [*of.values()])


def _given(graph: Graph, name: str, limb: str, recording: Recording) -> FootInput | None:
    """What this foot's contacts are found in; None where they come from a device."""
    from kinegraph.operators.contacts.commands.contact_check import FootInput
    from kinegraph.operators.contacts.limb_contacts import DETECTORS, LimbContacts
    from kinegraph.stream.params import build

    node = graph.nodes[name]
    if "in" not in node.inputs:
        return None
    part: Any = node.part
    if isinstance(part, LimbContacts):
        part = build(DETECTORS[part.detector], {**(part.common or {}), **part.limbs[limb]})
    edge = node.inputs["in"]
    spec, data = _read(recording, edge)
    return FootInput(edge.node, part, spec, data)


def _read(recording: Recording, edge: Edge) -> tuple[Any, Any]:
    """The spec and samples of a recorded edge."""
    spec = recording.stream(str(edge)).spec
    return spec, recording.read(str(edge))[1]


def _show(found: list[FootFinding]) -> None:
    from rich.table import Table

    from kinegraph.stream.text.screen import Screen

    table = Table(box=None)
    for heading in ("foot", "contacts", "stride (s)", "stance", "verdict", "what to do"):
        table.add_column(
            heading, justify="left" if heading in ("foot", "verdict", "what to do") else "right", overflow="fold"
        )
    for foot in found:
        stride, stance = (f"{foot.stride_s:.2f}", f"{foot.stance_pct:.0f} %") if foot.stride_s else ("", "")
        verdict = foot.flag if foot.flag == "good" else f"{foot.flag}: {foot.reason}"
        table.add_row(foot.name, str(foot.count), stride, stance, verdict, foot.advice)
    Screen().print(table)
