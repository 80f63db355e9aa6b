"""Before anything compiles: which devices and servers of a graph are not there."""

from __future__ import annotations

import threading
import time
from importlib.metadata import entry_points

import structlog

from kinegraph.stream.errors import DeviceError, blaming
from kinegraph.stream.graph import Graph, Node
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.source import Source
from kinegraph.stream.system.names import use_of

PROBE_S = 2.0
"""All are asked at once, and waited for no longer than this; the session then finds out by opening them."""

log = structlog.get_logger(__name__)


def probe(graph: Graph) -> None:
    """Ask every live source and every outlet whether what it opens is there.

    Raises DeviceError that names all required ones that are missing. What may appear by itself (a stream of another program, a broker) is
    named, too, and the session goes on.
    """
    simulated = graph.session.get("simulated_sources", ())
    asked = [node for node in graph.nodes.values() if node.name not in simulated and _can_tell(node.part)]
    missing: dict[str, str] = {}
    unusable: set[str] = set()
    failures: list[BaseException] = []

    def ask(node: Node) -> None:
        assert isinstance(node.part, Source | Outlet)
        try:
            with blaming(node.name, "missing"):
                missing[node.name] = node.part.missing()
        except DeviceError as error:  # its library is not installed
            missing[node.name] = str(error)
            unusable.add(node.name)
        except BaseException as error:  # noqa: BLE001 - raised in the thread of the session
            failures.append(error)

    threads = [threading.Thread(target=ask, args=(node,), name=f"source {node.name}", daemon=True) for node in asked]
    end = time.monotonic() + PROBE_S
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(max(0.0, end - time.monotonic()))
    if failures:
        raise failures[0]
    gone = [node for node in asked if missing.get(node.name)]
    ends = [node for node in gone if _is_needed(node) and not (_may_appear(node) and node.name not in unusable)]
    others: dict[str, list[Node]] = {}
    for node in gone:
        if node not in ends:
            others.setdefault(missing[node.name] + _hint([node]), []).append(node)
    for error, nodes in others.items():
        log.warning("not there yet", node=", ".join(node.name for node in nodes), error=error)
    if ends:
        text = "; ".join(f"source {node.name!r}: {missing[node.name]}" for node in ends)
        raise DeviceError(f"{text}; connect it, or set `required: false` to start before it is there{_hint(ends)}")


def _can_tell(part: object) -> bool:
    return isinstance(part, Source | Outlet) and type(part).missing not in (Source.missing, Outlet.missing)


def _is_needed(node: Node) -> bool:
    return isinstance(node.part, Source) and node.options.required


def _may_appear(node: Node) -> bool:
    return not isinstance(node.part, Source) or node.part.may_appear


def _hint(nodes: list[Node]) -> str:
    """What to do without the devices, where there are simulated ones."""
    return "; `--simulate` runs the graph without it" if any(map(_has_simulator, nodes)) else ""


def _has_simulator(node: Node) -> bool:
    known = entry_points(group="kinegraph.simulators").names
    return any(use_of(cls) in known for cls in type(node.part).__mro__)
