"""`kinegraph draw`: a graph as a tree in the terminal, or as Mermaid or DOT."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.graph_options import GraphFile, Settings
from kinegraph.stream.graph import drawing
from kinegraph.stream.graph.reading import overrides
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.screen import Screen


class DrawingFormat(StrEnum):
    tree = "tree"
    mermaid = "mermaid"
    dot = "dot"


def draw(
    config: GraphFile,
    format: Annotated[
        DrawingFormat, typer.Option(help="a tree for the terminal, Mermaid for Markdown, DOT for Graphviz")
    ] = DrawingFormat.tree,
    settings: Settings = None,
) -> None:
    """Draw a graph: its nodes, what flows between them, and what is recorded."""
    graph = load(config, overrides=overrides.read(settings or ()))
    match format:
        case DrawingFormat.mermaid:
            say(drawing.mermaid(graph), end="")
        case DrawingFormat.dot:
            say(drawing.dot(graph), end="")
        case DrawingFormat.tree:
            Screen().print(drawing.tree(graph))
