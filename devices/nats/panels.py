"""A bed's panels as its graph arranges them, for the page of the bed at the centre: streams are named as they are sent."""

from __future__ import annotations

from dataclasses import fields
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Any

from kinegraph.stream.graph.page_options import PANEL_KINDS, Panel

if TYPE_CHECKING:
    from kinegraph.stream.chunk import Specs
    from kinegraph.stream.graph import Graph

KEYS = {field.name for field in fields(Panel)} - {"show"}


def panels_sent(graph: Graph, outlet: object, specs: Specs) -> list[dict[str, Any]]:
    """The panels of the graph's page that show what this outlet sends; what it does not send is left out of them."""
    from kinegraph.devices.page.transfer.catalogue import panels_of

    inputs = next(
        (node.inputs for node in graph.nodes.values() if node.part == outlet and node.inputs.keys() == specs.keys()), {}
    )
    ports = {str(edge): port for port, edge in inputs.items()}
    return _renamed(panels_of(graph, {edge: specs[port] for edge, port in ports.items()}), ports)


def panels_here(sent: Any, nodes: dict[str, str]) -> list[dict[str, Any]]:
    """A bed's panels with the nodes of a graph here, by stream. A panel that is not installed here is left out: no bed brings code."""
    known = [
        panel
        for panel in sent
        if panel["kind"] in PANEL_KINDS or entry_points(group="kinegraph.panels", name=str(panel["kind"]))
    ]
    return _renamed(known, nodes)


def _renamed(panels: list[dict[str, Any]], names: dict[str, str]) -> list[dict[str, Any]]:
    """Panels with their streams called otherwise, without the streams that have no name."""
    found = []
    for panel in panels:
        of = [names[one] for one in panel["of"] if one in names]
        show = [{**one, "of": names[one["of"]]} for one in panel.get("show", ()) if one["of"] in names]
        if of:
            kept = {key: value for key, value in panel.items() if key in KEYS}
            found.append({**kept, "of": of, **({"show": show} if show else {})})
    return found
