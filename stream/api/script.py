"""A graph as the Python program that builds it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kinegraph.stream.graph import Node
from kinegraph.stream.graph.reading.part_files import is_part
from kinegraph.stream.system.names import module_of

SETTINGS = ("latency_budget_ms", "checkpoint_s", "session", "recording")


def script(document: Mapping[str, Any], nodes: Mapping[str, Node]) -> str:
    """Python that builds the graph which `document` (a graph's file as plain values) describes; `nodes` in topological order."""
    written = document["nodes"]
    files = [name for name, entry in written.items() if is_part(entry["use"])]
    names = [name for name in (written if files else nodes) if name in written]
    classes = {name: type(nodes[name].part) for name in names if name not in files}
    called = _called({classes[name]: str(written[name]["use"]).rpartition(".")[0] for name in classes})
    lines = [""]
    facts = [repr(document.get("name") or "graph")]
    facts += [f"{key}={document[key]!r}" for key in SETTINGS if document.get(key)]
    lines.append(f"graph = kinegraph.Graph({', '.join(facts)})")
    for name in names:
        if name in files:
            lines.append(_part(name, written[name]))
        else:
            lines.append(_added(name, called[classes[name]], written[name], nodes[name]))
    for name, entry in (document.get("settings") or {}).items():
        lines.append(
            f"graph.setting({', '.join([repr(name), *(f'{key}={value!r}' for key, value in (entry or {}).items())])})"
        )
    if document["record"]:
        lines.append(f"graph.record({', '.join(map(repr, document['record']))})")
    return "\n".join(["import kinegraph", *_imports(called, written, classes), *lines, ""])


def _called(modules: Mapping[type[Any], str]) -> dict[type[Any], str]:
    """A name for each class: its own, with a number where another module has one of that name."""
    called: dict[type[Any], str] = {}
    for cls in modules:
        name, number = cls.__name__, 2
        while name in called.values():
            name, number = f"{cls.__name__}{number}", number + 1
        called[cls] = name
    return called


def _imports(
    called: Mapping[type[Any], str], written: Mapping[str, Any], classes: Mapping[str, type[Any]]
) -> list[str]:
    modules = {cls: module_of(str(written[name]["use"]).rpartition(".")[0]) for name, cls in classes.items()}
    own = {cls: "" if name == cls.__name__ else f" as {name}" for cls, name in called.items()}
    return sorted(f"from {modules[cls]} import {cls.__name__}{own[cls]}" for cls in called)


def _part(name: str, entry: Mapping[str, Any]) -> str:
    """The call that adds a part."""
    given = [repr(name), repr(entry["use"]), *([repr(entry["from"])] if "from" in entry else [])]
    given += [f"{key}={value!r}" for key, value in entry.items() if key not in ("use", "from")]
    return f"graph.add({', '.join(given)})"


def _added(name: str, cls: str, entry: Mapping[str, Any], node: Node) -> str:
    """The call that adds one node."""
    parameters = ", ".join(f"{key}={node.given[key]!r}" for key in node.given)
    options = {key: value for key, value in entry.items() if key not in node.given and key not in ("use", "from")}
    given = [repr(name), f"{cls}({parameters})"]
    if "from" in entry:
        given.append(repr(entry["from"]))
    given += [f"{key}={value!r}" for key, value in options.items()]
    return f"graph.add({', '.join(given)})"
