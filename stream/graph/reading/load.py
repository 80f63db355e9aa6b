"""From YAML to a checked graph: every name resolved, every parameter built, every spec agreed, before any device opens.

Whatever is wrong is reported with file and line, and all of it at once as far as one fault does not hide another.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import GraphError, blaming, nearest
from kinegraph.stream.graph import Edge, Graph, RecordingOptions
from kinegraph.stream.graph.components import Part, import_from, registered
from kinegraph.stream.graph.page_options import PageOptions
from kinegraph.stream.graph.reading.draft import Draft, build_from, read_node
from kinegraph.stream.graph.reading.expansion import expand, plain_text
from kinegraph.stream.graph.reading.opening import open_nodes
from kinegraph.stream.graph.reading.overrides import override, placed, rewrite
from kinegraph.stream.graph.reading.page_section import read_page
from kinegraph.stream.graph.reading.part_files import MAX_NODES
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.wiring import Wiring
from kinegraph.stream.graph.reading.yaml_lines import Located, parse
from kinegraph.stream.graph.session_check import refuse_unsuited
from kinegraph.stream.graph.shipped import resolve, shipped
from kinegraph.stream.manual import Annotations
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import param
from kinegraph.stream.source import Source
from kinegraph.stream.system.file_permissions import is_foreign
from kinegraph.stream.system.names import use_of

IMPLICIT = {"annotations": Annotations}
"""Sources that every graph has, unless it defines a node of that name."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a graph says beside its nodes."""

    name: str = param("", help="the graph's name; default: the file's name")
    latency_budget_ms: float | None = param(
        None, above=0.0, help="the graph is refused if the delay of a result exceeds this (ms)"
    )
    checkpoint_s: float = param(10.0, above=0.0, help="how often the state is saved for --resume (s)")
    memory_mb: float = param(
        0.0,
        least=0.0,
        help="the graph is refused, or its session ended, if it takes more (MB); 0: three quarters of the machine's",
    )


SECTIONS = ("session", "settings", "record", "recording", "page", "nodes")
KEYS = (*(f.name for f in fields(Settings)), *SECTIONS)


def load(
    path: Path,
    *,
    recorded: Mapping[str, StreamSpec] | None = None,
    overrides: Mapping[str, Any] | None = None,
    trusted_only: bool = False,
) -> Graph:
    """Read and check a graph; raises GraphError. A bare name that is no file here is that of a shipped graph (`kinegraph configs`).

    trusted_only   only what is installed is run, no file beside the graph; it is so for a graph that another user owns
    recorded    specs of recorded streams by edge name ("board", "treadmill.emg"), which then replace the sources' own
    overrides   settings from the command line, {"envelope.cutoff_hz": 10}, which replace what the file says
    """
    path, text = read_text(Path(path))
    trusted_only = trusted_only or is_foreign(path)
    return load_text(text, path.stem, path=str(path), recorded=recorded, overrides=overrides, trusted_only=trusted_only)


def read_text(path: Path) -> tuple[Path, str]:
    """Where a graph's file is, and what it says; a bare name may be that of a shipped graph. Raises GraphError."""
    path = resolve(path)
    try:
        return path, path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise GraphError(f"this is not UTF-8 text (byte {error.start})", path=str(path)) from None
    except OSError as error:
        there = [p.name for p in sorted(path.parent.glob("*.y*ml"))] if path.parent.is_dir() else []
        there += shipped() if path.parent == Path() else ()
        begun = [repr(name) for name in there if name.startswith(f"{path.name}_")]
        meant = f"did you mean {' or '.join(begun)}?" if begun else nearest(path.name, there)
        hint = f"; {meant}" if there and not path.exists() else ""
        raise GraphError(f"the graph cannot be read: {error.strerror}{hint}", path=str(path)) from None


def read_expanded(path: Path) -> Located:
    """What a graph's file says, with the nodes of its parts in their places; nothing is made of it. Raises GraphError."""
    path, text = read_text(Path(path))
    problems = Problems(str(path))
    return expand(parse(text, str(path)), path.parent, problems, IMPLICIT).root


def rewritten(path: Path, overrides: Mapping[str, Any]) -> str:
    """A graph's text with settings written into it, as a file of its own; parts are written out. Raises GraphError."""
    path, text = read_text(path)
    problems = Problems(str(path))
    written = parse(text, str(path))
    expanded = expand(written, path.parent, problems, IMPLICIT)
    found = placed(expanded.root, overrides, KEYS)
    root = override(expanded.root, found, problems)
    problems.stop()
    return plain_text(root, text) if expanded.files else rewrite(text, found, override(written, found, problems))


def load_text(
    text: str,
    name: str = "graph",
    *,
    path: str = "",
    recorded: Mapping[str, StreamSpec] | None = None,
    overrides: Mapping[str, Any] | None = None,
    trusted_only: bool = False,
) -> Graph:
    """A graph from its text, as `load` does it; modules beside `path` can be named in it."""
    folder = Path(path).parent if path else Path()
    problems = Problems(path or name)
    written = parse(text, path or name)
    expanded = expand(written, folder, problems, IMPLICIT)
    import_from(folder, trusted_only=trusted_only or any(map(is_foreign, expanded.files)))
    overrides = placed(expanded.root, overrides or {}, KEYS)
    root = override(expanded.root, overrides, problems)
    graph = _Loading(root, problems, recorded).graph(name)
    if expanded.files:
        text = plain_text(root, text)
    elif overrides:
        text = rewrite(text, overrides, override(written, overrides, problems))
    graph.text, graph.path = text, path
    if recorded is None:
        refuse_unsuited(graph)
    return graph


@dataclass(frozen=True, slots=True)
class RecordedPage:
    """What the graph of a recording says of its page.

    parts    the classes of its nodes, as far as they are ours or registered (`stream.graph.components.registered`); no instance is made
    reads    the outputs that each of these nodes reads
    options  the section `page`
    """

    parts: dict[str, Part] = field(default_factory=dict)
    reads: dict[str, list[str]] = field(default_factory=dict)
    options: PageOptions = field(default_factory=PageOptions)


def load_page(text: str, streams: Iterable[str]) -> RecordedPage:
    """The page of a recorded graph, of which nothing is run: anybody may have written it.

    What cannot be understood without other nodes is left out. Raises KinegraphError where the text is no graph.
    """
    problems, outputs = Problems("recorded"), dict[str, tuple[str, ...]]()
    for name in streams:
        node, dot, output = name.rpartition(".")
        node, output = (node, output) if dot else (name, "out")
        outputs[node] = (*outputs.get(node, ()), output)
    root = parse(text, "recorded")
    nodes = {name: at.items() for name, at in root.items().get("nodes", Located({}, 0)).items().items()}
    if len(nodes) > MAX_NODES:
        return RecordedPage()
    used = {name: at["use"].value for name, at in nodes.items() if "use" in at}
    parts = {name: part for name, use in used.items() if isinstance(use, str) and (part := registered(use))}
    outputs |= {name: part.outputs for name, part in parts.items() if part.outputs}
    wiring = Wiring(outputs, problems)
    reads = {name: [str(edge) for at in _named(nodes[name].get("from")) if (edge := wiring.edge(at))] for name in parts}
    section = root.items().get("page", Located({}, 0)).items()
    return RecordedPage(parts, reads, read_page(section, wiring, problems, parts.values()))


def _named(written: Located | None) -> list[Located]:
    """The outputs that a `from` names."""
    match written and written.value:
        case dict(ports):
            return [*ports.values()]
        case list(items):
            return items
    return [written] if written and written.value else []


class _Loading:
    """One graph being loaded; each step goes as far as it can, and `problems` stops them in the end."""

    def __init__(self, root: Located, problems: Problems, recorded: Mapping[str, StreamSpec] | None) -> None:
        self._root, self._problems, self._recorded = root, problems, recorded

    def graph(self, name: str) -> Graph:
        top = self._top()
        own = {key: at for key, at in top.items() if key not in SECTIONS}
        settings = build_from(Settings, own, self._problems) or Settings()
        folder = self._section(top, "recording")
        recording = build_from(RecordingOptions, folder, self._problems, "recording: ") or RecordingOptions()
        session = self._facts(top)
        if any(sign in settings.name for sign in "/\\:\0\n") or len(settings.name) > 100:
            self._problems.add(
                "name: it names the session's folder; it must be short, without '/', '\\' or ':'", own["name"]
            )
        drafts = self._drafts(top)
        wiring = Wiring({name: draft.outputs if draft else None for name, draft in drafts.items()}, self._problems)
        for draft in drafts.values():
            if draft:
                draft.wires = wiring.wires(draft.name, draft.kind, draft.entry.items().get("from"), draft.entry)
        record = self._record(top.get("record"), wiring)
        parts = [draft.kind for draft in drafts.values() if draft]
        page = read_page(self._section(top, "page"), wiring, self._problems, parts)
        nodes = open_nodes(drafts, self._problems, self._recorded)
        offered = read_settings(top.get("settings"), self._problems)
        self._problems.stop()
        for node in nodes.values():
            if self._recorded is None and isinstance(node.part, Source):
                with blaming(node.name, "facts"):
                    session |= node.part.facts()
        if self._recorded is not None:
            record = tuple(edge for edge in record if edge.output in nodes[edge.node].specs)
        return Graph(
            name=settings.name or name,
            nodes=nodes,
            text="",
            latency_budget_ms=settings.latency_budget_ms,
            checkpoint_s=settings.checkpoint_s,
            memory_mb=settings.memory_mb,
            record=record,
            recording=recording,
            page=page,
            session=session,
            settings=offered,
        )

    def _top(self) -> dict[str, Located]:
        if not isinstance(self._root.value, dict):
            self._problems.add(f"a graph is a mapping that holds 'nodes:', not {self._root.kind}", self._root)
            self._problems.stop()
        top = self._root.items()
        for key, at in top.items():
            if key not in KEYS:
                nodes = ", ".join(sorted(top["nodes"].items())) if "nodes" in top else ""
                of_node = f"a node's is set as NODE.{key}, with one of the nodes {nodes}"
                self._problems.add(f"unknown key {key!r}; {of_node if at.origin and nodes else nearest(key, KEYS)}", at)
        return {key: at for key, at in top.items() if key in KEYS}

    def _section(self, top: Mapping[str, Located], key: str) -> dict[str, Located]:
        at = top.get(key)
        if at is None or at.value is None:
            return {}
        if not isinstance(at.value, dict):
            self._problems.add(f"{key} is {at.kind}; it must be a mapping", at)
        return at.items()

    def _facts(self, top: Mapping[str, Located]) -> dict[str, Any]:
        """What the graph says about the session: anything that JSON can hold."""
        facts: dict[str, Any] = {}
        for key, at in self._section(top, "session").items():
            facts[key] = at.fact()
            try:
                json.dumps(facts[key], allow_nan=False)
            except ValueError:
                self._problems.add(f"session: {key} is {facts[key]}; a number here must be finite", at)
        return facts

    def _drafts(self, top: Mapping[str, Located]) -> dict[str, Draft | None]:
        """Every node with its class, options and parameters; None where the class was not found."""
        if "nodes" not in top or top["nodes"].value in (None, {}):
            self._problems.add(
                "'nodes' is missing or empty; a graph needs a source at least", top.get("nodes", self._root)
            )
        written = dict(self._section(top, "nodes"))
        if len(written) > MAX_NODES:
            self._problems.add(f"the graph has {len(written)} nodes; it must have at most {MAX_NODES}", top["nodes"])
            self._problems.stop()
        drafts: dict[str, Draft | None] = {}
        for name, entry in written.items():
            if inner := [other for other in written if other.startswith(f"{name}.")]:
                text = f"the name of the node {inner[0]!r} begins with that of the node {name!r}; rename one of them"
                self._problems.add(text, entry)
            drafts[name] = read_node(name, entry, self._problems)
        if written and all(draft and issubclass(draft.kind, Operator) for draft in drafts.values()):
            self._problems.add("the graph has no source; nothing would ever flow", top["nodes"])
        for name, kind in IMPLICIT.items():
            use = Located(use_of(kind), 0)
            drafts.setdefault(name, Draft(name, Located({"use": use}, 0), kind, kind()))
        return drafts

    def _record(self, written: Located | None, wiring: Wiring) -> tuple[Edge, ...]:
        if written is None or written.value is None:
            return ()
        items = written.value if isinstance(written.value, list) else [written]
        edges: list[Edge] = []
        for item in items:
            edge = wiring.edge(item)
            if edge in edges:
                self._problems.add(f"record names {str(edge)!r} twice", item)
            elif edge:
                edges.append(edge)
        return tuple(edges)
