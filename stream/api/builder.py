"""A graph in Python: built by calls or loaded from YAML, written as either, run on arrays, recordings and devices."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, Self

from ruamel.yaml import YAML

from kinegraph.stream.api.results import Results
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph import Edge, Graph, Node, RecordingOptions
from kinegraph.stream.graph.components import UseError, find
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.add_node import add_node
from kinegraph.stream.graph.reading.load import Settings, load, load_text
from kinegraph.stream.graph.reading.part_files import is_part
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.wiring import Wiring
from kinegraph.stream.graph.reading.yaml_lines import locate, parse
from kinegraph.stream.manual import Annotations
from kinegraph.stream.operator import Operator
from kinegraph.stream.params import build, plain
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Source
from kinegraph.stream.system import names
from kinegraph.stream.text.html import as_html


class GraphBuilder:
    """A graph. Each node is checked when it is added, by what checks a YAML file; whatever is wrong raises GraphError there.

    graph = kinegraph.Graph("low")
    graph.add("emg", kinegraph.Input(channels=["TA", "SO"], rate_hz=1000, units=["uV"]))
    graph.add("smooth", Lowpass(cutoff_hz=6), "emg")
    results = graph.run(array)
    results["smooth"].to_pandas()
    """

    def __init__(
        self,
        name: str = "graph",
        *,
        latency_budget_ms: float | None = None,
        checkpoint_s: float = 10.0,
        session: Mapping[str, Any] | None = None,
        recording: Mapping[str, Any] | None = None,
    ) -> None:
        """The keys of a graph's file beside `nodes` and `record`, with the same meanings (docs/use/graphs.md)."""
        settings = {"name": name, "latency_budget_ms": latency_budget_ms, "checkpoint_s": checkpoint_s}
        given = build(Settings, settings)
        build(RecordingOptions, recording or {})
        self._path, self._text = "", ""
        self._document: dict[str, Any] = {
            **{f.name: value for f in fields(given) if (value := getattr(given, f.name)) != f.default},
            **({"session": _written("session", session)} if session else {}),
            **({"recording": _written("recording", recording)} if recording else {}),
            "record": [],
            "nodes": {},
        }
        entry = {"use": names.use_of(Annotations)}
        self._nodes: dict[str, Node] = {"annotations": add_node({}, "annotations", entry)}

    @classmethod
    def load(cls, path: Path | str, overrides: Mapping[str, Any] | None = None) -> Self:
        """A graph from a YAML file, or by a shipped graph's bare name; `overrides`: {"envelope.cutoff_hz": 10}. Raises GraphError."""
        checked = load(Path(path), overrides=overrides)
        return cls._of(checked)

    @classmethod
    def from_yaml(cls, text: str, name: str = "graph") -> Self:
        """A graph from its text."""
        return cls._of(load_text(text, name))

    @classmethod
    def _of(cls, checked: Graph) -> Self:
        graph = cls(checked.name)
        graph._path, graph._text, graph._nodes = checked.path, checked.text, checked.nodes
        for node in checked.nodes.values():
            node.opened = None  # what runs is another graph, read from this one's text
        written = parse(checked.text, checked.path).plain()
        record = written.get("record") or []
        graph._document = {"name": checked.name, **written, "record": [record] if isinstance(record, str) else record}
        return graph

    @property
    def name(self) -> str:
        """What the graph is called."""
        return str(self._document.get("name") or "graph")

    @property
    def specs(self) -> dict[str, StreamSpec]:
        """What flows on every edge: {"smooth": StreamSpec, "active.interval": ...}."""
        return {str(Edge(n.name, out)): spec for n in self._nodes.values() for out, spec in n.specs.items()}

    @property
    def nodes(self) -> dict[str, Source | Operator[Any]]:
        """The sources, operators and outlets, by name; those of a part as "part.node"."""
        hidden = "annotations" if "annotations" not in self._document["nodes"] else ""
        return {name: node.part for name, node in self._nodes.items() if name != hidden}

    def add(
        self,
        name: str,
        part: Source | Operator[Any] | str | Path,
        reads: str | Sequence[str] | Mapping[str, str] | None = None,
        *,
        record: bool = False,
        **options: Any,
    ) -> str:
        """Add a node and return its name; raises GraphError for whatever is wrong with it.

        part      a source, operator or outlet, or the file of a part ("parts/emg_cycles.yaml"), which adds that part's nodes
        reads     where its input comes from: "node", "node.output", a list of these, or a mapping {port: "node.output"}
        record    keep what comes out of it (its first output) in recordings and results; see `record`
        options   the engine's: queue, policy, worker, required, ... (docs/use/graphs.md); of a part, its settings
        """
        entry = _entry(name, part, reads, options)
        written = self._document["nodes"]
        if isinstance(part, str | Path) or _has_parts(written):
            if name in written:
                raise GraphError("the graph already has a node of this name", node=name)
            self._check_with(nodes={**written, name: entry})
        else:
            node = add_node({n: known for n, known in self._nodes.items() if n != name or n in written}, name, entry)
            self._nodes[name] = node
            self._document["nodes"][name] = entry
            self._text = ""
        if record:
            self.record(name)
        return name

    def setting(self, name: str, feeds: str | Sequence[str] = (), **facts: Any) -> None:
        """Declare what a person may set: `--set NAME=VALUE`, the overrides of `load`.

        feeds   the parameters that get the value ("envelope.cutoff_hz"); left out: the session's fact of this name
        facts   label, unit, help, type, default, min, max, choices (docs/use/graphs.md)
        """
        entry = {**({"feeds": _written("feeds", feeds)} if feeds else {}), **facts}
        self._check_with(settings={**self._document.get("settings", {}), name: entry})

    def _check_with(self, **sections: Any) -> None:
        """Put these sections in place of those that are there, if the graph is right with them."""
        document = {**self._document, **sections}
        checked = load_text(self._dumped(document["record"], document), self.name, path=self._path)
        for node in checked.nodes.values():
            node.opened = None  # what runs is another graph, read from this one's text
        self._document, self._nodes, self._text = document, checked.nodes, ""

    def record(self, *edges: str) -> None:
        """Name edges ("smooth", "active.interval") that are recorded, and kept in results."""
        if _has_parts(self._document["nodes"]):
            self._check_with(record=list(dict.fromkeys([*self._document["record"], *edges])))
            return
        problems = Problems("")
        wiring = Wiring({name: node.part.outputs for name, node in self._nodes.items()}, problems)
        found = [str(edge) for name in edges if (edge := wiring.edge(locate(name, 0)))]
        problems.stop()
        self._document["record"] += [edge for edge in dict.fromkeys(found) if edge not in self._document["record"]]
        self._text = ""

    def check(self) -> Graph:
        """The engine's graph, checked as a whole, its latency budget included; raises GraphError."""
        graph = load_text(self.to_yaml(), self.name, path=self._path)
        plan(graph)
        return graph

    def fed_from(self, recorded: Mapping[str, StreamSpec]) -> Graph:
        """The engine's graph for a recording; the specs of its streams replace those of the sources. Raises GraphError."""
        return load_text(self.to_yaml(), self.name, path=self._path, recorded=recorded)

    def to_yaml(self) -> str:
        """The graph as a file; a loaded one keeps its comments until something is added."""
        return self._text or self._dumped(self._document["record"])

    def save(self, path: Path | str) -> None:
        """Write the graph as a YAML file."""
        Path(path).write_text(self.to_yaml(), encoding="utf-8")

    def to_python(self) -> str:
        """The graph as a Python program that builds it."""
        from kinegraph.stream.api.script import script

        return script(self._document, self._nodes)

    def run(
        self,
        data: Any,
        *,
        rate_hz: float | None = None,
        time: Any = None,
        keep: Iterable[str] = (),
        outlets: Iterable[str] = (),
    ) -> Results:
        """What the graph makes of arrays or of a recording, as fast as it goes.

        data      a recording (or its path); an array (n, ...) for a graph with one source; or {"emg": array, "contacts.touchdown": Series}
        rate_hz   of an array; left out: what its source declares
        time      stamps of an array (n,) int64 ns; left out: from the rate
        keep      edges that come back; left out: those that the graph records, or else all outputs of operators
        outlets   names of outlets that take part; the others stay silent
        """
        from kinegraph.stream.api.feeding import on_arrays, on_recording

        if isinstance(data, Recording | Path | str):
            return on_recording(self, data, keep, outlets)
        return on_arrays(self, data, keep, outlets, rate_hz=rate_hz, time=time)

    def _dumped(self, record: Sequence[str], document: Mapping[str, Any] | None = None) -> str:
        document = {**(document or self._document), "record": list(record)}
        document = {key: value for key, value in document.items() if key != "record" or value}
        yaml = YAML()
        yaml.width, yaml.default_flow_style = 120, None
        yaml.indent(mapping=2, sequence=4, offset=2)
        out = io.StringIO()
        yaml.dump(document, out)
        if parse(out.getvalue(), "").plain() != document:
            raise GraphError("this graph holds what YAML cannot write")
        return out.getvalue()

    def _repr_html_(self) -> str:
        """The drawing of `kinegraph draw`, in a notebook."""
        from kinegraph.stream.graph.drawing import tree

        return as_html(tree(self.check()))

    def __repr__(self) -> str:
        rows = [f"  {name}: {type(part).__name__}" for name, part in self.nodes.items()]
        return "\n".join([f"Graph {self.name!r}", *rows])


def _has_parts(nodes: Mapping[str, Any]) -> bool:
    return any(is_part(entry["use"]) for entry in nodes.values())


def _entry(
    name: str,
    part: Source | Operator[Any] | str | Path,
    reads: str | Sequence[str] | Mapping[str, str] | None,
    options: Mapping[str, Any],
) -> dict[str, Any]:
    """A node as a graph's file writes it."""
    edges = {} if reads is None else {"from": _written("reads", reads, name)}
    if isinstance(part, str | Path):
        return {"use": str(part), **edges, **{key: _written(key, value, name) for key, value in options.items()}}
    return {"use": use_of(part), **edges, **options, **parameters_given(name, part)}


def use_of(part: object) -> str:
    """The shortest dotted path at which a graph finds a part's class. Raises GraphError where it cannot be found by name."""
    cls = type(part)
    if not isinstance(part, Source | Operator):
        raise GraphError(f"{part!r} is not a source, operator or outlet")
    use = names.use_of(cls)
    try:
        found: object = find(use)
    except UseError as error:
        found = error
    if found is not cls:
        raise GraphError(
            f"{cls.__qualname__} cannot be found as {use!r}; a graph names classes at the top level of a module"
        )
    return use


def parameters_given(name: str, part: Source | Operator[Any]) -> dict[str, Any]:
    """The parameters of a part that are not the defaults, as a graph's file writes them."""
    given: dict[str, Any] = {}
    for f in fields(part):  # type: ignore[arg-type]
        value = getattr(part, f.name)
        default = f.default if f.default_factory is MISSING else f.default_factory()
        if f.init and (default is MISSING or repr(value) != repr(default)):
            given[f.name] = _written(f.name, value, name)
    return given


def _written(what: str, value: Any, node: str = "") -> Any:
    """A value as a graph's file writes it; raises GraphError where that is impossible."""
    try:
        return plain(value)
    except TypeError as error:
        raise GraphError(f"{what}: {error}", node=node) from None
