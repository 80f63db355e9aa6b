"""A graph that grows node by node, each checked as it is added, by what checks a graph that is read from a file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph.model import Node
from kinegraph.stream.graph.reading.draft import read_node
from kinegraph.stream.graph.reading.opening import open_node
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.wiring import Wiring
from kinegraph.stream.graph.reading.yaml_lines import locate


def add_node(nodes: Mapping[str, Node], name: str, entry: Mapping[str, Any]) -> Node:
    """One more node, given as a graph's file writes it, which may read those that are there; raises GraphError."""
    problems = Problems("")
    if name in nodes:
        raise GraphError("the graph already has a node of this name", node=name)
    draft = read_node(name, locate(dict(entry), 0), problems)
    problems.stop()
    assert draft is not None
    wiring = Wiring({known: node.part.outputs for known, node in nodes.items()}, problems)
    draft.wires = wiring.wires(name, draft.kind, draft.entry.items().get("from"), draft.entry)
    problems.stop()
    node = open_node(draft, problems, nodes)
    problems.stop()
    assert node is not None
    node.opened = None  # what runs is another graph, read from this one's text
    return node
