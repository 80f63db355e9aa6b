"""How late events come, measured: at each event of a running graph, what its operator had been given by then."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any
from unittest.mock import patch

import numpy as np

from kinegraph.stream.chunk import FOREVER, NS, Chunk, Samples, Times
from kinegraph.stream.domain.alarm import OVER
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph import Graph
from kinegraph.stream.operator import Emitted, Operator
from kinegraph.stream.source import Source

Late = dict[tuple[str, str], list[float]]
"""By node and output: of each event, how much newer (s) its operator's newest input was than the event's `end`, else its `onset`."""


@contextmanager
def watched(graph: Graph, names: dict[int, str], late: Late) -> Iterator[None]:
    """Within: every call of an operator of this graph that gives events is noted in `late`; `names`: of nodes, by their operator's id."""
    kinds = {type(n.part): type(n.part).process for n in graph.nodes.values() if _gives_events(n)}

    def noting(process: Any) -> Any:
        def call(part: Operator[Any], port: str, chunk: Chunk) -> Emitted:
            emitted: Emitted = process(part, port, chunk)
            if emitted is not None and id(part) in names and chunk.until < FOREVER:
                pairs = [(part.outputs[0], emitted)] if isinstance(emitted, Chunk) else emitted
                for output, given in pairs:
                    late[names[id(part)], output].extend(lateness(given, chunk.until).tolist())
            return emitted

        return call

    for kind, process in kinds.items():
        kind.process = noting(process)
    try:
        yield
    finally:
        for kind, process in kinds.items():
            kind.process = process


def _gives_events(node: Any) -> bool:
    return not isinstance(node.part, Source) and any(spec.is_event for spec in node.specs.values())


def lateness(given: Chunk, newest: int | Times) -> Samples:
    """(n,) s from what each event describes to the newest input; empty for what has no such field. Alarms that are over count as 0."""
    names = given.data.dtype.names or ()
    over = given.data["state"] == OVER if "state" in names else np.zeros(len(given.data), np.bool_)
    for field in ("end", "onset"):
        if field in names:
            return np.where(over, 0.0, (newest - given.data[field]) / NS)
    return np.empty(0)


def measured(graph: Graph) -> Late:
    """Run a graph to its end, and note how late every event came."""
    late: Late = defaultdict(list)
    names: dict[int, str] = {}
    with watched(graph, names, late):
        session = Session(graph, None)
        open_ = session._open

        def tried() -> None:
            """The events of the trial on made-up samples do not count; later ones do."""
            names.update({id(stage.operator): name for name, stage in session.pipeline.stages.items()})
            open_()

        with patch.object(session, "_open", tried):
            outcome = session.run()
    assert outcome.error is None, outcome.error
    return late
