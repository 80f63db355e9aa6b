"""Graphs: what they are made of, how they are read from YAML and checked, planned, drawn and described to editors."""

from stream.graph.model import Declared, Edge, Graph, Node, NodeOptions, Policy, RecordingOptions

__all__ = ["Declared", "Edge", "Graph", "Node", "NodeOptions", "Policy", "RecordingOptions"]
