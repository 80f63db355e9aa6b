"""A node as the graph writes it, on its way: its class found, its engine options and parameters checked and built."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, TypeVar

from kinegraph.stream.errors import ParameterError, asked_to_end, explain, nearest
from kinegraph.stream.graph import NodeOptions
from kinegraph.stream.graph.components import Part, UseError, find
from kinegraph.stream.graph.moved import parameter_today
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.wiring import Wires
from kinegraph.stream.graph.reading.yaml_lines import Located
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import build
from kinegraph.stream.source import Source

T = TypeVar("T")

NODE_WORD = "[A-Za-z_][A-Za-z0-9_-]*"
NODE_NAME = rf"^{NODE_WORD}(\.{NODE_WORD})*$"
"""Dots separate a part of the graph from the nodes in it: "left.envelope"."""
SOURCE_OPTIONS = ("queue", "policy", "required", "deadline_s", "patience_s", "silence_s", "stale_s", "claims")
OPERATOR_OPTIONS = ("worker", "queue", "policy")


@dataclass(slots=True)
class Draft:
    """A node on its way."""

    name: str
    entry: Located
    kind: Part
    part: Source | Operator[Any] | None = None
    options: NodeOptions = field(default_factory=NodeOptions)
    wires: Wires | None = None

    @property
    def outputs(self) -> tuple[str, ...] | None:
        """The names of its outputs; None where they depend on parameters (`devices.frames.Binary`) and one of these is wrong."""
        if self.part is not None:
            return self.part.outputs
        return self.kind.outputs or (None if issubclass(self.kind, Source) else ())

    def at(self, key: str) -> Located:
        """Where a key of this node stands; the node itself if it was not given."""
        return self.entry.items().get(key.partition("[")[0].partition(".")[0], self.entry)


def read_node(name: str, entry: Located, problems: Problems) -> Draft | None:
    if not re.fullmatch(NODE_NAME, name):
        problems.add(f"a node's name is made of letters (a-z), digits, '_' and '-', not {name!r}", entry)
    if not isinstance(entry.value, dict):
        problems.add(f"a node is a mapping with 'use', not {entry.kind}", entry, name)
        return None
    use = entry.value.get("use")
    if use is None or not isinstance(use.value, str):
        given = "'use' is missing" if use is None else f"use is {use.kind}"
        problems.add(f"{given}; it must be a dotted path, as in 'use: operators.emg.Envelope'", use or entry, name)
        return None
    try:
        kind = find(use.value)
    except UseError as error:
        problems.add(str(error), use, name, cause=error.__cause__)
        return None
    draft = Draft(name, entry, kind)
    _fill(
        draft,
        {parameter_today(kind, key): at for key, at in entry.value.items() if key not in ("use", "from")},
        problems,
    )
    return draft


def _fill(draft: Draft, given: dict[str, Located], problems: Problems) -> None:
    """Engine options and parameters, which stand in one mapping."""
    allowed = SOURCE_OPTIONS if issubclass(draft.kind, Source) else OPERATOR_OPTIONS
    parameters = parameters_of(draft.kind)
    every = [f.name for f in fields(NodeOptions)]
    ours = Source if issubclass(draft.kind, Source) else Outlet if issubclass(draft.kind, Outlet) else Operator
    for name in parameters:
        if name in every or name in ("use", "from"):
            taken = "which is a key of every node"
        elif hasattr(ours, name):
            taken = f"which means something else to every {ours.__name__}"
        else:
            continue
        text = f"{draft.kind.__name__} has a parameter {name!r}, {taken}; it must be renamed"
        problems.add(text, draft.entry, draft.name)
        return
    for key, at in given.items():
        if key in every and key not in allowed:
            owner = "a source" if key in SOURCE_OPTIONS else "an operator"
            problems.add(f"{key!r} is an option of {owner}, not of {draft.kind.__name__}", at, draft.name)
        elif key not in every and key not in parameters:
            hint = nearest(key, [*parameters, *allowed, "use", "from"])
            problems.add(f"{draft.kind.__name__} has no parameter {key!r}; {hint}", at, draft.name)
    options = build_from(NodeOptions, {k: v for k, v in given.items() if k in allowed}, problems, node=draft.name)
    draft.options = options or NodeOptions()
    if issubclass(draft.kind, Operator) and not issubclass(draft.kind, Outlet) and not draft.options.worker:
        for key in {"queue", "policy"} & given.keys():
            problems.add(f"{key!r} needs a 'worker'; without one nothing waits here", given[key], draft.name)
    values = {k: v for k, v in given.items() if k in parameters}
    draft.part = build_from(draft.kind, values, problems, node=draft.name, entry=draft.entry)


def build_from(
    cls: type[T],
    given: Mapping[str, Located],
    problems: Problems,
    section: str = "",
    node: str = "",
    entry: Located | None = None,
) -> T | None:
    """An instance of `cls`; None if a value is wrong, and then every wrong one is reported."""
    known = parameters_of(cls)
    for key in [k for k in given if k not in known]:
        problems.add(f"{section}unknown key {key!r}; {nearest(key, known)}", given[key], node)
    left = {key: at.plain() for key, at in given.items() if key in known}
    complete = len(left) == len(given)
    required = {f.name for f in fields(cls) if f.default is MISSING and f.default_factory is MISSING}  # type: ignore[arg-type]
    while True:
        try:
            made = build(cls, left)
            return made if complete else None
        except ParameterError as error:
            problems.add(f"{section}{error}", given.get(error.parameter, entry), node)
            complete = False
            if error.parameter not in left or error.parameter in required:
                return None
            del left[error.parameter]
        except BaseException as error:
            if asked_to_end(error):
                raise
            problems.add(f"{section}{cls.__name__} cannot be made: {explain(error)}", entry, node, cause=error)
            return None


def parameters_of(cls: Any) -> list[str]:
    """The names of a part's parameters."""
    return [f.name for f in fields(cls) if f.init]
