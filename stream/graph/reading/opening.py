"""Nodes opened in the order in which samples pass: specs are checked along the way, and each error names its node."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.errors import InputError, KinegraphError, ParameterError, asked_to_end, explain
from kinegraph.stream.graph import Edge, Node, NodeDeclaration, NodeOptions, OpenedOperator
from kinegraph.stream.graph.reading.draft import Draft
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.wiring import Wires, order
from kinegraph.stream.operator import Operator, input_of
from kinegraph.stream.source import Source

TOO_LARGE = "Maximum allowed"
"""How numpy begins to say that an array has more elements than an index can count."""


def open_nodes(
    drafts: Mapping[str, Draft | None], problems: Problems, recorded: Mapping[str, StreamSpec] | None
) -> dict[str, Node]:
    """Every node that can be opened, in topological order (the file's order among those that are ready)."""
    opening = _Opening(problems, recorded)
    for name in _in_order(drafts, problems):
        draft = drafts[name]
        if draft is not None:
            opening.node(draft)
    return opening.nodes


def open_node(draft: Draft, problems: Problems, nodes: Mapping[str, Node]) -> Node | None:
    """One node that reads from `nodes`, opened; None, if something is wrong with it."""
    opening = _Opening(problems, None, dict(nodes))
    opening.node(draft)
    return opening.nodes.get(draft.name)


def _in_order(drafts: Mapping[str, Draft | None], problems: Problems) -> list[str]:
    reads = {
        name: {edge.node for edge, _ in draft.wires.values()} if draft and draft.wires else set()
        for name, draft in drafts.items()
    }
    names, cycles = order(reads)
    for cycle in cycles:
        first = drafts[cycle[0]]
        assert first is not None  # it reads something
        problems.add(f"the graph contains a cycle: {' -> '.join([*cycle, cycle[0]])}", first.at("from"))
    return names


@dataclass(frozen=True, slots=True)
class _Opening:
    """The nodes that are open so far."""

    problems: Problems
    recorded: Mapping[str, StreamSpec] | None
    nodes: dict[str, Node] = field(default_factory=dict)

    def node(self, draft: Draft) -> None:
        """Open one more; nothing, if something is wrong with it or with what it reads."""
        if draft.part is None or draft.wires is None:
            return
        inputs = self._inputs(draft, draft.wires)
        try:
            if inputs is not None and (opened := self._opened(draft, draft.part, draft.wires, inputs)):
                self.nodes[draft.name] = opened
        except BaseException as error:
            if asked_to_end(error):
                raise
            self._failed(draft, error)

    def _inputs(self, draft: Draft, wires: Wires) -> Specs | None:
        inputs: Specs = {}
        for port, (edge, at) in list(wires.items()):
            if edge.node not in self.nodes:
                return None
            if self._never_said(draft, port, edge):
                del wires[port]
                continue
            if edge.output not in self.nodes[edge.node].specs:
                has = ", ".join(map(repr, sorted(self.recorded or ()))) or "nothing"
                text = f"the recording lacks the stream {str(edge)!r}, which is read here; it has {has}"
                self.problems.add(text, at, draft.name)
                return None
            inputs[port] = self.nodes[edge.node].specs[edge.output]
        return inputs

    def _never_said(self, draft: Draft, port: str, edge: Edge) -> bool:
        """Whether an optional input listens to a person of whom the recording holds no word, as those of other programs do."""
        node = self.nodes[edge.node]
        asked = isinstance(draft.part, Operator) and input_of(draft.part.inputs, port).optional
        return asked and isinstance(node.part, Source) and node.part.background and edge.output not in node.specs

    def _opened(self, draft: Draft, part: Source | Operator[Any], wires: Wires, inputs: Specs) -> Node | None:
        """The node, with what flows out of it, if that can be had."""
        if isinstance(part, Source):
            given = (
                _recorded(draft, self.recorded)
                if self.recorded is not None
                else self._said(draft, part, part.specs, wires)
            )
            return None if given is None else _node(draft, part, wires, given)
        operator = part.unopened()
        given = self._said(draft, operator, lambda: operator.open(inputs), wires)
        if given is None:
            return None
        node = _node(draft, part, wires, given)
        node.declared = NodeDeclaration(operator.delay_s, operator.decision_s, operator.memory_bytes)
        node.opened = OpenedOperator(part, inputs, operator, given)
        return node

    def _said(self, draft: Draft, part: Source | Operator[Any], say: Callable[[], Specs], wires: Wires) -> Specs | None:
        """The specs that a part gives for its outputs."""
        try:
            specs = say()
        except ParameterError as error:
            self.problems.add(str(error), draft.at(error.parameter), draft.name)
            return None
        except InputError as error:
            wire = wires.get(error.port)
            text = f"{error} (it comes from {str(wire[0])!r})" if wire else str(error)
            self.problems.add(text, wire[1] if wire else draft.at("from"), draft.name)
            return None
        except KinegraphError as error:
            self.problems.add(str(error), draft.entry, draft.name, cause=error)
            return None
        return self._promised(draft, part, specs)

    def _failed(self, draft: Draft, error: BaseException) -> None:
        """What an exception of someone's `open` says."""
        if isinstance(error, MemoryError | OverflowError) or (
            isinstance(error, ValueError) and TOO_LARGE in str(error)
        ):
            text = f"{draft.kind.__name__} would need more memory or longer numbers than there are; make its windows and rates smaller"
            text = f"{text} ({explain(error)})"
        else:
            text = f"{draft.kind.__name__} failed while it was being opened: {explain(error)}"
        self.problems.add(text, draft.entry, draft.name, cause=error)

    def _promised(self, draft: Draft, part: Source | Operator[Any], specs: Specs) -> Specs | None:
        """Whether a part gave the specs of the outputs that it declares."""
        given = list(specs) if isinstance(specs, dict) else []
        if sorted(given) != sorted(part.outputs):
            text = f"{draft.kind.__name__} declares the outputs {list(part.outputs)} but gave specs for {given}"
            self.problems.add(text, draft.entry, draft.name)
            return None
        if isinstance(part, Operator) and not hasattr(part, "state"):
            self.problems.add(
                f"{draft.kind.__name__}.open() must call set_state(state, delay_s=...)", draft.entry, draft.name
            )
            return None
        return specs


def _recorded(draft: Draft, recorded: Mapping[str, StreamSpec]) -> Specs:
    """The recorded specs of a source; an output that was not recorded is left out."""
    specs: Specs = {}
    for output in draft.outputs or ():
        for name in (str(Edge(draft.name, output)), f"{draft.name}.{output}"):
            if name in recorded:
                specs[output] = recorded[name]
    return specs


def _node(draft: Draft, part: Source | Operator[Any], wires: Wires, specs: Specs) -> Node:
    options = {f.name for f in fields(NodeOptions)} | {"use", "from"}
    entry = draft.entry.items()
    return Node(
        name=draft.name,
        part=part,
        use=str(entry["use"].value),
        inputs={port: edge for port, (edge, _) in wires.items()},
        specs={output: specs[output] for output in part.outputs if output in specs},
        options=draft.options,
        line=draft.entry.line,
        file=draft.entry.file,
        given={key: at.plain() for key, at in entry.items() if key not in options},
    )
