"""The files of parts: found, read, and given the settings of a graph that uses them."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from kinegraph.stream.errors import GraphError, nearest
from kinegraph.stream.graph.reading.draft import NODE_WORD, build_from
from kinegraph.stream.graph.reading.overrides import place_of, put, value_at
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.yaml_lines import Located, parse
from kinegraph.stream.graph.settings import GraphSetting
from kinegraph.stream.graph.shipped import shipped_folder

ENDINGS = (".yaml", ".yml")
KEYS = ("part", "settings", "record", "page", "nodes")
"""The keys of a part's file."""
MAX_NODES = 1000
"""A graph with more is refused before any of them is made."""


@dataclass(frozen=True, slots=True)
class PartInput:
    """One input of a part.

    help      what flows in
    optional  may be left out: what reads it in the part does without
    """

    help: str = ""
    optional: bool = False


@dataclass(slots=True)
class Scope:
    """A graph, or one use of a part, in which names are looked up."""

    name: str
    top: dict[str, Located]
    files: tuple[Path, ...] = ()
    """The part's file, and before it those of the parts around it."""
    use: Located = field(default_factory=lambda: Located({}, 0))
    above: Scope | None = None
    inputs: dict[str, PartInput] = field(default_factory=dict)
    outputs: dict[str, Located] = field(default_factory=dict)
    settings: dict[str, GraphSetting] = field(default_factory=dict)
    parts: dict[str, Scope] = field(default_factory=dict)
    bound: dict[str, Located] = field(default_factory=dict)
    """What feeds the inputs, in names of the scope above."""

    @property
    def nodes(self) -> dict[str, Located]:
        return self.top["nodes"].items() if "nodes" in self.top else {}

    def called(self, name: str) -> str:
        """A name of this scope as the whole graph has it."""
        return f"{self.name}.{name}" if self.name else name

    def knows(self, text: str, implicit: Collection[str]) -> bool:
        """Whether an edge begins with a node, a part or an input of this scope."""
        names = (*self.nodes, *self.inputs, *implicit)
        return any(text == name or text.startswith(f"{name}.") for name in names)


def is_part(use: object) -> bool:
    """Whether a node's `use` names a part's file, not a class."""
    return isinstance(use, str) and use.endswith(ENDINGS)


def part_of(entry: Located) -> str:
    """The part's file that a node names; empty for a node of a class."""
    use = entry.items().get("use")
    return str(use.value) if use and is_part(use.value) else ""


class PartReader:
    """Reads the parts of one graph, and those in them; what is wrong is added to `problems`."""

    def __init__(self, folder: Path, problems: Problems, implicit: Collection[str]) -> None:
        self._folder, self._problems, self._implicit = folder, problems, implicit
        self._count = 0
        self.files: list[Path] = []

    def graph(self, root: Located) -> Scope:
        """The graph itself, with its settings' defaults and its parts."""
        scope = Scope("", dict(root.items()))
        scope.settings = read_settings(scope.top.get("settings"), self._problems)
        for name, setting in scope.settings.items():
            if not setting.targets:
                setting = scope.settings[name] = replace(setting, feeds=(f"session.{name}",))
            self._feed(scope, name, setting, None)
        self._read_parts(scope)
        return scope

    def _read_parts(self, scope: Scope) -> None:
        self._count += len(scope.nodes)
        if self._count > MAX_NODES:
            text = f"the graph and its parts have more than {MAX_NODES} nodes"
            self._problems.add(text, scope.top.get("nodes"), scope.name)
            self._problems.stop()
        for name, entry in scope.nodes.items():
            if use := part_of(entry):
                if not re.fullmatch(NODE_WORD, name):
                    text = f"a part's name is made of letters (a-z), digits, '_' and '-', not {name!r}"
                    self._problems.add(text, entry, scope.name)
                    continue
                self._problems.places[scope.called(name)] = entry
                if (part := self._part(scope, name, entry, use)) is not None:
                    scope.parts[name] = part

    def _part(self, scope: Scope, name: str, entry: Located, use: str) -> Scope | None:
        whole, at = scope.called(name), entry.items()["use"]
        path = self._found(use, scope)
        if path is None:
            there = sorted({f"{p.parent.name}/{p.name}" for d in self._folders(scope) for p in d.glob("parts/*.y*ml")})
            self._problems.add(f"there is no part {use!r}; {nearest(use, there)}", at, whole)
            return None
        if path.resolve() in map(Path.resolve, scope.files):
            way = " -> ".join(str(file) for file in (*scope.files, path))
            self._problems.add(f"a part uses itself: {way}", at, whole)
            return None
        try:
            root = parse(path.read_text(encoding="utf-8"), str(path), is_part=True)
        except GraphError as error:
            self._problems.keep(error)
            return None
        except (OSError, UnicodeDecodeError) as error:
            self._problems.add(f"{use} cannot be read: {error}", at, whole)
            return None
        if "part" not in root.items():
            self._problems.add(f"{path} is not a part; it lacks 'part:' with inputs and outputs", at, whole)
            return None
        self.files.append(path)
        part = Scope(whole, dict(root.items()), (*scope.files, path), entry, scope)
        self._read_head(part)
        part.settings = read_settings(part.top.get("settings"), self._problems, whole)
        given = {key: at for key, at in entry.items().items() if key not in ("use", "from")}
        for key, at in given.items():
            if key not in part.settings:
                self._problems.add(f"{use} has no setting {key!r}; {nearest(key, part.settings)}", at, whole)
        for key, setting in part.settings.items():
            if not setting.targets:
                self._problems.add(f"settings: {key} feeds nothing", part.top["settings"], whole)
            self._feed(part, key, setting, given.get(key))
        for inner, at in part.nodes.items():
            self._problems.places[part.called(inner)] = at
        self._read_parts(part)
        return part

    def _folders(self, scope: Scope) -> Iterator[Path]:
        """Where parts are looked for: beside the file that uses them, beside the graph, among the shipped ones."""
        yield from [scope.files[-1].parent] if scope.files else []
        yield self._folder
        if shipped := shipped_folder():
            yield shipped

    def _found(self, use: str, scope: Scope) -> Path | None:
        return next((path for folder in self._folders(scope) if (path := folder / use).is_file()), None)

    def _read_head(self, part: Scope) -> None:
        """The section `part`: inputs and outputs."""
        add = partial(self._problems.add, node=part.name)
        for key, at in part.top.items():
            if key not in KEYS:
                add(f"a part has no key {key!r}; {nearest(key, KEYS)}", at)
        head = part.top["part"]
        if not isinstance(head.value, dict | None):
            add(f"part is {head.kind}; it must be a mapping with 'inputs' and 'outputs'", head)
        for key, at in head.items().items():
            if key not in ("inputs", "outputs"):
                add(f"part has no key {key!r}; {nearest(key, ('inputs', 'outputs'))}", at)
            elif not isinstance(at.value, dict | None):
                add(f"part: {key} is {at.kind}; it must be a mapping, as in {{emg: ...}}", at)
        for name, at in head.items().get("inputs", head).items().items() if "inputs" in head.items() else ():
            given = {"help": at} if isinstance(at.value, str) else at.items()
            part.inputs[name] = (
                build_from(PartInput, given, self._problems, f"input {name}: ", part.name) or PartInput()
            )
            if name in part.nodes:
                add(f"{name!r} is an input and a node; give one of them another name", at)
        if "outputs" in head.items():
            part.outputs = dict(head.items()["outputs"].items())
        for name, at in part.outputs.items():
            if not re.fullmatch(NODE_WORD, name):
                add(f"an output's name is made of letters (a-z), digits, '_' and '-', not {name!r}", at)
            if name in part.nodes and at.value != name:
                add(f"the output {name!r} has the name of a node; it must be that node, or have another name", at)
        if not part.nodes:
            add("a part needs 'nodes'", part.top.get("nodes", head))
        for name in self._implicit:
            if name in part.nodes:
                add(f"{name!r} belongs to the graph; a part reads it without a node of its own", part.nodes[name])

    def _feed(self, scope: Scope, name: str, setting: GraphSetting, given: Located | None) -> None:
        """Write a setting's value, or its default if the parameter has no value, into the parameters that it feeds."""
        section = scope.top["settings"].items()[name]
        if given is not None and (why := setting.refusal(name, given.plain())):
            self._problems.add(why, given, scope.name)
        default = section.items().get("default")
        for target in setting.targets:
            place = place_of(target, scope.top)
            if place is None or (scope.name and place[0] != "nodes"):
                text = f"settings: {name} feeds {target!r}; it must be NODE.PARAMETER, with one of the nodes"
                self._problems.add(f"{text} {', '.join(scope.nodes)}", section, scope.name)
            elif given is not None:
                put(scope.top, place, given)
            elif default is not None and value_at(scope.top, target) is None:
                put(scope.top, place, default)


def offered(scope: Scope) -> Iterator[tuple[str, Located]]:
    """The settings of a graph and of its parts, by their names in the graph, with the parameters that they feed there."""
    for name, setting in scope.settings.items():
        entry = scope.top["settings"].items()[name]
        feeds = [Located(target, entry.line) for t in setting.targets for target in _targets(scope, t)]
        yield scope.called(name), replace(entry, value={**entry.items(), "feeds": replace(entry, value=feeds)})
    for part in scope.parts.values():
        yield from offered(part)


def _targets(scope: Scope, target: str) -> Iterator[str]:
    head, _, key = target.partition(".")
    if head not in scope.parts:
        yield scope.called(target)
        return
    setting = scope.parts[head].settings.get(key)
    for inner in setting.targets if setting else ():
        yield from _targets(scope.parts[head], inner)
