"""Whether the parts of a graph suit the session: one that holds what was measured of one person is not for another."""

from __future__ import annotations

from kinegraph.stream.errors import GraphError, KinegraphError, asked_to_end, explain
from kinegraph.stream.graph.model import Graph
from kinegraph.stream.operator import Operator


def refuse_unsuited(graph: Graph) -> None:
    """Raise GraphError for the first operator that does not suit the session's facts."""
    for node in graph.nodes.values():
        if isinstance(node.part, Operator):
            try:
                node.part.check_session(graph.session)
            except BaseException as error:
                if asked_to_end(error):
                    raise
                text = str(error) if isinstance(error, KinegraphError) else f"check_session failed: {explain(error)}"
                raise GraphError(text, path=node.file or graph.path, line=node.line or None, node=node.name) from error
