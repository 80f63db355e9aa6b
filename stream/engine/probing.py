"""Before anything compiles: which devices of a graph are not there."""

from __future__ import annotations

import threading
import time
from importlib.metadata import entry_points

import structlog

from kinegraph.stream.errors import DeviceError, blaming
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.source import Source
from kinegraph.stream.system.names import use_of

PROBE_S = 2.0
"""All sources are asked at once, and waited for no longer than this; the session then finds out by opening them."""

log = structlog.get_logger(__name__)


def probe(graph: Graph) -> None:
    """Ask every live source whether its device is there. Raises DeviceError that names all required ones that are missing.

    What may appear by itself (a stream of another program) is named, too, and the session waits for it until its deadline.
    """
    simulated = graph.session.get("simulated_sources", ())
    nodes = [node for node in graph.sources if node.name not in simulated]
    missing: dict[str, str] = {}
    failures: list[BaseException] = []

    def ask(node: Node) -> None:
        assert isinstance(node.part, Source)
        try:
            with blaming(node.name, "missing"):
                missing[node.name] = node.part.missing()
        except DeviceError as error:  # its library is not installed
            missing[node.name] = str(error)
        except BaseException as error:  # noqa: BLE001 - raised in the thread of the session
            failures.append(error)

    asked = [n for n in nodes if type(n.part).missing is not Source.missing]  # type: ignore[union-attr]
    threads = [threading.Thread(target=ask, args=(node,), name=f"source {node.name}", daemon=True) for node in asked]
    end = time.monotonic() + PROBE_S
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    if failures:
        raise failures[0]
    gone = [node for node in asked if missing.get(node.name)]
    ends = [n for n in gone if n.options.required and not n.part.may_appear]  # type: ignore[union-attr]
    for node in gone:
        if node not in ends:
            log.warning("source is missing", node=node.name, error=missing[node.name] + _hint([node]))
    if ends:
        text = "; ".join(f"source {node.name!r}: {missing[node.name]}" for node in ends)
        raise DeviceError(f"{text}; connect it, or set `required: false` to start before it is there{_hint(ends)}")


def _hint(nodes: list[Node]) -> str:
    """What to do without the devices, where there are simulated ones."""
    return "; `--simulate` runs the graph without it" if any(map(_has_simulator, nodes)) else ""


def _has_simulator(node: Node) -> bool:
    known = entry_points(group="kinegraph.simulators").names
    return any(use_of(cls) in known for cls in type(node.part).__mro__)
