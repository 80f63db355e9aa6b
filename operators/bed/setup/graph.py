"""The part of a bedside graph that a setup check needs: the camera, and what finds the bed."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.operators.bed.bed import BedRegion
from kinegraph.operators.bed.frames.simplify import Simplify
from kinegraph.operators.bed.frames.view import View
from kinegraph.operators.bed.presence import Presence
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.graph.reading.load import load, load_text
from kinegraph.stream.graph.reading.overrides import read
from kinegraph.stream.system.names import use_of


@dataclass(frozen=True, slots=True)
class SetupGraph:
    """The graph of `camera`, `simplify`, `view` and `bed`; rise_mm and min_share are those of the whole graph's presence.

    brokers   hosts and ports that the graph publishes to
    """

    graph: Graph
    rise_mm: float
    min_share: float
    brokers: tuple[tuple[str, int], ...] = ()


def small(config: Path, settings: Sequence[str]) -> SetupGraph:
    """Raises GraphError if the graph lacks a depth camera or all of these operators."""
    whole = load(config, overrides=read(settings))
    cameras = [
        (node, output)
        for node in whole.sources
        for output, spec in node.specs.items()
        if len(spec.shape) == 2 and spec.dtype == np.dtype(np.uint16)
    ]
    if len(cameras) != 1:
        raise GraphError(f"{config} has {len(cameras)} depth cameras; a bedside graph has one")
    node, output = cameras[0]
    presence = _one(whole, Presence, config).part
    assert isinstance(presence, Presence)
    nodes = {
        "camera": _written(node),
        "simplify": {**_written(_one(whole, Simplify, config)), "from": f"camera.{output}"},
        "view": {**_written(_one(whole, View, config)), "from": "simplify.blocks"},
        "bed": {**_written(_one(whole, BedRegion, config)), "from": {"view": "view", "in": "simplify.blocks"}},
    }
    brokers = [getattr(node.part, "broker", None) for node in whole.nodes.values()]
    hosts = sorted({(str(b.host), int(b.port)) for b in brokers if b is not None and b.host})
    graph = load_text(json.dumps({"nodes": nodes}), str(config))
    return SetupGraph(graph, presence.rise_mm, presence.min_share, tuple(hosts))


def _one(graph: Graph, kind: type, config: Path) -> Node:
    for node in graph.nodes.values():
        if isinstance(node.part, kind):
            return node
    raise GraphError(f"{config} has no {use_of(kind)}, so it is not a bedside graph")


def _written(node: Node) -> dict[str, Any]:
    return {"use": node.use, **node.given}
