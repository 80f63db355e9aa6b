"""Graphs: what they are made of, how they are read from YAML and checked, planned, drawn and described to editors."""

from kinegraph.stream.graph.model import (
    Edge,
    Graph,
    Node,
    NodeDeclaration,
    NodeOptions,
    OpenedOperator,
    RecordingOptions,
    is_live,
    policy_of,
)

__all__ = [
    "Edge",
    "Graph",
    "Node",
    "NodeDeclaration",
    "NodeOptions",
    "OpenedOperator",
    "RecordingOptions",
    "is_live",
    "policy_of",
]
