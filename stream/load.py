"""From YAML to a checked graph: every name resolved, every parameter built, every spec agreed, before any device opens.

Whatever is wrong is told with file and line, and all of it at once as far as one fault does not hide another.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path
from typing import Any, TypeVar

from stream.chunk import Specs, StreamSpec
from stream.errors import GraphError, InputError, ParameterError, nearest
from stream.graph import Edge, Graph, Node, NodeOptions, RecordingOptions
from stream.operator import Operator
from stream.overrides import override, rewrite
from stream.params import build, param
from stream.parts import Part, UseError, explain, find, import_from
from stream.problems import Problems
from stream.source import Source
from stream.wiring import Wires, Wiring, order
from stream.yaml_lines import Located, parse

T = TypeVar("T")

SOURCE_OPTIONS = ("queue", "policy", "required", "deadline_s", "patience_s", "silence_s", "stale_s")
OPERATOR_OPTIONS = ("lane", "queue", "policy")
IMPLICIT = {"annotations": "stream.manual.Annotations"}
"""Sources that every graph has, unless it defines a node of that name."""


@dataclass(frozen=True, slots=True)
class Settings:
    """What a graph says beside its nodes."""

    name: str = param("", help="what the graph is called; the file's name if not given")
    latency_budget_ms: float | None = param(
        None, above=0.0, help="the graph is refused if a result comes later than this after what it describes (ms)"
    )
    checkpoint_s: float = param(10.0, above=0.0, help="how often the state is saved for --resume (s)")


SECTIONS = ("session", "record", "recording", "nodes")


def load(
    path: Path, *, recorded: Mapping[str, StreamSpec] | None = None, overrides: Mapping[str, Any] | None = None
) -> Graph:
    """Read and check a graph; raises GraphError.

    recorded    specs of recorded streams by edge name ("board", "treadmill.emg"), which then stand in for the sources' own
    overrides   settings from the command line, {"envelope.cutoff_hz": 10}, which replace what the file says
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise GraphError(f"this is no text in UTF-8 (byte {error.start})", path=str(path)) from None
    except OSError as error:
        there = [p.name for p in sorted(path.parent.glob("*.y*ml"))] if path.parent.is_dir() else []
        hint = f"; {nearest(path.name, there)}" if there else ""
        raise GraphError(f"the graph cannot be read: {error.strerror}{hint}", path=str(path)) from None
    return load_text(text, path.stem, path=str(path), recorded=recorded, overrides=overrides)


def load_text(
    text: str,
    name: str = "graph",
    *,
    path: str = "",
    recorded: Mapping[str, StreamSpec] | None = None,
    overrides: Mapping[str, Any] | None = None,
) -> Graph:
    """A graph from its text, as `load` does it; modules beside `path` can be named in it."""
    import_from(Path(path).parent if path else Path())
    problems = Problems(path or name)
    root = override(parse(text, path or name), overrides or {}, problems)
    graph = _Loading(root, problems, recorded).graph(name)
    graph.text, graph.path = (rewrite(text, overrides) if overrides else text), path
    return graph


@dataclass(slots=True)
class _Draft:
    """A node on its way."""

    name: str
    entry: Located
    kind: Part
    part: Source | Operator[Any] | None = None
    options: NodeOptions = field(default_factory=NodeOptions)
    wires: Wires | None = None

    def at(self, key: str) -> Located:
        """Where a key of this node stands; the node itself if it was not given."""
        return self.entry.items().get(key.partition("[")[0].partition(".")[0], self.entry)


class _Loading:
    """One graph being loaded; each step goes as far as it can, and `problems` stops them in the end."""

    def __init__(self, root: Located, problems: Problems, recorded: Mapping[str, StreamSpec] | None) -> None:
        self._root, self._problems, self._recorded = root, problems, recorded

    def graph(self, name: str) -> Graph:
        top = self._top()
        settings = self._build(Settings, {k: v for k, v in top.items() if k not in SECTIONS}) or Settings()
        recording = self._build(RecordingOptions, self._section(top, "recording"), "recording: ") or RecordingOptions()
        drafts = self._drafts(top)
        wiring = Wiring({name: draft.kind if draft else None for name, draft in drafts.items()}, self._problems)
        for draft in drafts.values():
            if draft:
                draft.wires = wiring.wires(draft.name, draft.kind, draft.entry.items().get("from"), draft.entry)
        record = self._record(top.get("record"), wiring)
        nodes = self._open(drafts)
        self._problems.stop()
        if self._recorded is not None:
            record = tuple(edge for edge in record if edge.output in nodes[edge.node].specs)
        return Graph(
            name=settings.name or name,
            nodes=nodes,
            text="",
            latency_budget_ms=settings.latency_budget_ms,
            checkpoint_s=settings.checkpoint_s,
            record=record,
            recording=recording,
            session={key: value.plain() for key, value in self._section(top, "session").items()},
        )

    def _top(self) -> dict[str, Located]:
        if not isinstance(self._root.value, dict):
            self._problems.add(f"a graph is a mapping that holds 'nodes:', not {self._root.kind}", self._root)
            self._problems.stop()
        top = self._root.items()
        known = [*(f.name for f in fields(Settings)), *SECTIONS]
        for key, at in top.items():
            if key not in known:
                self._problems.add(f"unknown key {key!r}; {nearest(key, known)}", at)
        return {key: at for key, at in top.items() if key in known}

    def _section(self, top: Mapping[str, Located], key: str) -> dict[str, Located]:
        at = top.get(key)
        if at is None or at.value is None:
            return {}
        if not isinstance(at.value, dict):
            self._problems.add(f"{key} is {at.kind}; it must be a mapping", at)
        return at.items()

    def _drafts(self, top: Mapping[str, Located]) -> dict[str, _Draft | None]:
        """Every node with its class, options and parameters; None where the class was not found."""
        if "nodes" not in top or top["nodes"].value in (None, {}):
            self._problems.add(
                "'nodes' is missing or empty; a graph needs a source at least", top.get("nodes", self._root)
            )
        written = dict(self._section(top, "nodes"))
        drafts: dict[str, _Draft | None] = {}
        for name, entry in written.items():
            if not name.replace("-", "_").isidentifier():
                self._problems.add(f"a node's name is made of letters, digits, '_' and '-', not {name!r}", entry)
            drafts[name] = self._draft(name, entry)
        if written and all(draft and issubclass(draft.kind, Operator) for draft in drafts.values()):
            self._problems.add("the graph has no source; nothing would ever flow", top["nodes"])
        for name, use in IMPLICIT.items():
            with suppress(UseError):
                kind = find(use)
                drafts.setdefault(name, _Draft(name, Located({"use": Located(use, 0)}, 0), kind, kind()))
        return drafts

    def _draft(self, name: str, entry: Located) -> _Draft | None:
        if not isinstance(entry.value, dict):
            self._problems.add(f"a node is a mapping with 'use', not {entry.kind}", entry, name)
            return None
        use = entry.value.get("use")
        if use is None or not isinstance(use.value, str):
            given = "'use' is missing" if use is None else f"use is {use.kind}"
            self._problems.add(
                f"{given}; it must be a dotted path, as in 'use: operators.emg.Envelope'", use or entry, name
            )
            return None
        try:
            kind = find(use.value)
        except UseError as error:
            self._problems.add(str(error), use, name, cause=error.__cause__)
            return None
        draft = _Draft(name, entry, kind)
        self._fill(draft, {key: at for key, at in entry.value.items() if key not in ("use", "from")})
        return draft

    def _fill(self, draft: _Draft, given: dict[str, Located]) -> None:
        """Engine options and parameters, which stand in one mapping."""
        allowed = SOURCE_OPTIONS if issubclass(draft.kind, Source) else OPERATOR_OPTIONS
        parameters = parameters_of(draft.kind)
        every = [f.name for f in fields(NodeOptions)]
        twice = [p for p in parameters if p in every or p in ("use", "from")]
        if twice:
            text = (
                f"{draft.kind.__name__} has a parameter {twice[0]!r}, which is a key of every node; it must be renamed"
            )
            self._problems.add(text, draft.entry, draft.name)
            return
        for key, at in given.items():
            if key in every and key not in allowed:
                owner = "a source's" if key in SOURCE_OPTIONS else "an operator's"
                self._problems.add(f"{key!r} is {owner} option; {draft.kind.__name__} is none", at, draft.name)
            elif key not in every and key not in parameters:
                hint = nearest(key, [*parameters, *allowed, "use", "from"])
                self._problems.add(f"{draft.kind.__name__} has no parameter {key!r}; {hint}", at, draft.name)
        options = self._build(NodeOptions, {k: v for k, v in given.items() if k in allowed}, node=draft.name)
        draft.options = options or NodeOptions()
        if issubclass(draft.kind, Operator) and not draft.options.lane:
            for key in {"queue", "policy"} & given.keys():
                self._problems.add(f"{key!r} needs a 'lane'; without one nothing waits here", given[key], draft.name)
        values = {k: v for k, v in given.items() if k in parameters}
        draft.part = self._build(draft.kind, values, node=draft.name, entry=draft.entry)

    def _build(
        self,
        cls: type[T],
        given: Mapping[str, Located],
        section: str = "",
        node: str = "",
        entry: Located | None = None,
    ) -> T | None:
        """An instance of `cls`; None if a value is wrong, and then every wrong one is reported."""
        known = parameters_of(cls)
        for key in [k for k in given if k not in known]:
            self._problems.add(f"{section}unknown key {key!r}; {nearest(key, known)}", given[key], node)
        left = {key: at.plain() for key, at in given.items() if key in known}
        complete = len(left) == len(given)
        required = {f.name for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING}  # type: ignore[arg-type]
        while True:
            try:
                made = build(cls, left)
                return made if complete else None
            except ParameterError as error:
                self._problems.add(f"{section}{error}", given.get(error.parameter, entry), node)
                complete = False
                if error.parameter not in left or error.parameter in required:
                    return None
                del left[error.parameter]

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

    def _open(self, drafts: dict[str, _Draft | None]) -> dict[str, Node]:
        """Nodes in the order in which samples pass, each opened with its inputs' specs."""
        reads = {
            name: {edge.node for edge, _ in draft.wires.values()} if draft and draft.wires else set()
            for name, draft in drafts.items()
        }
        names, cycles = order(reads)
        for cycle in cycles:
            way = " -> ".join([*cycle, cycle[0]])
            first = drafts[cycle[0]]
            assert first is not None
            self._problems.add(f"the graph runs in a circle: {way}", first.at("from"))
        nodes: dict[str, Node] = {}
        for name in names:
            draft = drafts[name]
            if draft is None or draft.part is None or draft.wires is None:
                continue
            specs = self._specs(draft, draft.part, draft.wires, nodes)
            if specs is not None:
                nodes[name] = _node(draft, draft.part, draft.wires, specs)
        return nodes

    def _specs(
        self, draft: _Draft, part: Source | Operator[Any], wires: Wires, nodes: Mapping[str, Node]
    ) -> Specs | None:
        """What flows out of a node; None if something is wrong with it or with what it reads."""
        inputs: Specs = {}
        for port, (edge, at) in wires.items():
            if edge.node not in nodes:
                return None
            if edge.output not in nodes[edge.node].specs:
                has = ", ".join(map(repr, sorted(self._recorded or ()))) or "none"
                text = f"the recording lacks the stream {str(edge)!r}, which is read here; it has {has}"
                self._problems.add(text, at, draft.name)
                return None
            inputs[port] = nodes[edge.node].specs[edge.output]
        if isinstance(part, Source) and self._recorded is not None:
            return _recorded(draft, self._recorded)
        try:
            specs = part.specs() if isinstance(part, Source) else part.open(inputs)
        except ParameterError as error:
            self._problems.add(str(error), draft.at(error.parameter), draft.name)
            return None
        except InputError as error:
            wire = wires.get(error.port)
            text = f"{error} (it comes from {str(wire[0])!r})" if wire else str(error)
            self._problems.add(text, wire[1] if wire else draft.at("from"), draft.name)
            return None
        except GraphError:
            raise
        except Exception as error:  # noqa: BLE001  (a fault in anyone's operator is told like any other, with its place)
            text = f"{draft.kind.__name__} failed while it was being opened: {explain(error)}"
            self._problems.add(text, draft.entry, draft.name, cause=error)
            return None
        return self._promised(draft, part, specs)

    def _promised(self, draft: _Draft, part: Source | Operator[Any], specs: Specs) -> Specs | None:
        """Whether a part gave the specs of the outputs that it declares."""
        given = list(specs) if isinstance(specs, dict) else []
        if sorted(given) != sorted(part.outputs):
            text = f"{draft.kind.__name__} declares the outputs {list(part.outputs)} but gave specs for {given}"
            self._problems.add(text, draft.entry, draft.name)
            return None
        if isinstance(part, Operator) and not hasattr(part, "state"):
            self._problems.add(
                f"{draft.kind.__name__}.open() must call hold(state, delay_s=...)", draft.entry, draft.name
            )
            return None
        return {output: specs[output] for output in part.outputs}


def parameters_of(cls: Any) -> list[str]:
    """The names of a part's parameters."""
    return [f.name for f in fields(cls) if f.init]


def _recorded(draft: _Draft, recorded: Mapping[str, StreamSpec]) -> Specs:
    """The recorded specs of a source; an output that was not recorded has none."""
    specs: Specs = {}
    for output in draft.kind.outputs:
        for name in (str(Edge(draft.name, output)), f"{draft.name}.{output}"):
            if name in recorded:
                specs[output] = recorded[name]
    return specs


def _node(draft: _Draft, part: Source | Operator[Any], wires: Wires, specs: Specs) -> Node:
    options = {f.name for f in fields(NodeOptions)} | {"use", "from"}
    entry = draft.entry.items()
    return Node(
        name=draft.name,
        part=part,
        use=str(entry["use"].value),
        inputs={port: edge for port, (edge, _) in wires.items()},
        specs=specs,
        options=draft.options,
        line=draft.entry.line,
        given={key: at.plain() for key, at in entry.items() if key not in options},
    )
