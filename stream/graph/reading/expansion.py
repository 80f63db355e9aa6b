"""Parts of graphs: a node whose `use` is a YAML file is replaced by the nodes of that file, under dotted names ("left.envelope").

What comes out is a plain graph, which is what runs and what a recording keeps. A name in a part is one of its inputs, of its nodes or,
for the sources that every graph has, of the graph's. "left.closed" outside the part `left` is its output `closed`, or else its node of
that name; an output that has a node's name must be that node, so that both readings agree.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import takewhile
from pathlib import Path

from kinegraph.stream.errors import GraphError, nearest
from kinegraph.stream.graph.reading.draft import NODE_WORD, build_from
from kinegraph.stream.graph.reading.overrides import dump, place_of, put, value_at
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.yaml_lines import Located, parse
from kinegraph.stream.graph.settings import Setting
from kinegraph.stream.graph.shipped import shipped_folder

ENDINGS = (".yaml", ".yml")
KEYS = ("part", "settings", "record", "page", "nodes")
"""The keys of a part's file."""
MOST_NODES = 1000
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
class _Scope:
    """A graph, or one use of a part, in which names are looked up."""

    name: str
    top: dict[str, Located]
    files: tuple[Path, ...] = ()
    """The part's file, and before it those of the parts around it."""
    use: Located = field(default_factory=lambda: Located({}, 0))
    above: _Scope | None = None
    inputs: dict[str, PartInput] = field(default_factory=dict)
    outputs: dict[str, Located] = field(default_factory=dict)
    settings: dict[str, Setting] = field(default_factory=dict)
    parts: dict[str, _Scope] = field(default_factory=dict)
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


@dataclass(frozen=True, slots=True)
class Expanded:
    """A graph without parts: their nodes in their places; and the files of the parts."""

    root: Located
    files: tuple[Path, ...] = ()


def expand(root: Located, folder: Path, problems: Problems, implicit: Collection[str] = ()) -> Expanded:
    """The graph without parts, its settings' defaults filled in; raises GraphError.

    folder    where the graph's file is; parts are found beside the file that uses them, beside the graph and in the shipped folder
    implicit  names of sources that every graph has
    """
    if "part" in root.items():
        text = "this file is a part; a graph uses it as a node: {use: FILE.yaml, from: ...}"
        problems.add(text, root.items()["part"])
        problems.stop()
    nodes = root.items()["nodes"].items() if "nodes" in root.items() else {}
    if "settings" not in root.items() and not any(map(_used, nodes.values())):
        return Expanded(root)
    made = _Expansion(folder, problems, implicit)
    return Expanded(made.whole(root), tuple(dict.fromkeys(made.files)))


def _used(entry: Located) -> str:
    """The part's file that a node names; empty for a node of a class."""
    use = entry.items().get("use")
    return str(use.value) if use and is_part(use.value) else ""


class _Expansion:
    """One graph being expanded."""

    def __init__(self, folder: Path, problems: Problems, implicit: Collection[str]) -> None:
        self._folder, self._problems, self._implicit = folder, problems, implicit
        self._count = 0
        self.files: list[Path] = []

    def whole(self, root: Located) -> Located:
        scope = _Scope("", dict(root.items()))
        scope.settings = read_settings(scope.top.get("settings"), self._problems)
        for name, setting in scope.settings.items():
            if not setting.targets:
                setting = scope.settings[name] = replace(setting, feeds=(f"session.{name}",))
            self._feed(scope, name, setting, None)
        self._read_parts(scope)
        self._problems.stop()
        self._bind_parts(scope)
        top = dict(scope.top)
        if "nodes" in top:
            top["nodes"] = replace(top["nodes"], value=dict(self._emitted(scope)))
        if settings := dict(self._settings(scope)):
            top["settings"] = Located(settings, top["settings"].line if "settings" in top else 0)
        top |= self._record(scope) | self._page(scope)
        self._problems.stop()
        return replace(root, value=top)

    # ------------------------------------------------------------------------------------------------------- files

    def _read_parts(self, scope: _Scope) -> None:
        self._count += len(scope.nodes)
        if self._count > MOST_NODES:
            text = f"the graph and its parts have more than {MOST_NODES} nodes"
            self._problems.add(text, scope.top.get("nodes"), scope.name)
            self._problems.stop()
        for name, entry in scope.nodes.items():
            if use := _used(entry):
                if not re.fullmatch(NODE_WORD, name):
                    text = f"a part's name is made of letters (a-z), digits, '_' and '-', not {name!r}"
                    self._problems.add(text, entry, scope.name)
                    continue
                self._problems.places[scope.called(name)] = entry
                if (part := self._part(scope, name, entry, use)) is not None:
                    scope.parts[name] = part

    def _part(self, scope: _Scope, name: str, entry: Located, use: str) -> _Scope | None:
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
        part = _Scope(whole, dict(root.items()), (*scope.files, path), entry, scope)
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

    def _folders(self, scope: _Scope) -> Iterator[Path]:
        """Where parts are looked for: beside the file that uses them, beside the graph, among the shipped ones."""
        yield from [scope.files[-1].parent] if scope.files else []
        yield self._folder
        if shipped := shipped_folder():
            yield shipped

    def _found(self, use: str, scope: _Scope) -> Path | None:
        return next((path for folder in self._folders(scope) if (path := folder / use).is_file()), None)

    def _read_head(self, part: _Scope) -> None:
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

    # ---------------------------------------------------------------------------------------------------- settings

    def _feed(self, scope: _Scope, name: str, setting: Setting, given: Located | None) -> None:
        """Write a setting's value, or its default where the parameter has none, into the parameters that it feeds."""
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

    def _settings(self, scope: _Scope) -> Iterator[tuple[str, Located]]:
        """The settings of a graph and of its parts, by their names in the graph, with the parameters that they feed there."""
        for name, setting in scope.settings.items():
            entry = scope.top["settings"].items()[name]
            feeds = [Located(target, entry.line) for t in setting.targets for target in self._targets(scope, t)]
            yield scope.called(name), replace(entry, value={**entry.items(), "feeds": replace(entry, value=feeds)})
        for part in scope.parts.values():
            yield from self._settings(part)

    def _targets(self, scope: _Scope, target: str) -> Iterator[str]:
        head, _, key = target.partition(".")
        if head not in scope.parts:
            yield scope.called(target)
            return
        setting = scope.parts[head].settings.get(key)
        for inner in setting.targets if setting else ():
            yield from self._targets(scope.parts[head], inner)

    # -------------------------------------------------------------------------------------------------------- edges

    def _bind_parts(self, scope: _Scope) -> None:
        for part in scope.parts.values():
            self._bind(scope, part)
            self._bind_parts(part)

    def _bind(self, scope: _Scope, part: _Scope) -> None:
        """What a use's `from` connects to the inputs of its part."""
        written, add = part.use.items().get("from"), partial(self._problems.add, node=part.name)
        required = [name for name, one in part.inputs.items() if not one.optional]
        if written is None or written.value is None:
            written = Located({}, part.use.line, file=part.use.file)
        elif not part.inputs:
            add("this part has no inputs; it takes no 'from'", written)
            return
        match written.value:
            case dict():
                part.bound = dict(written.value)
            case list():
                part.bound = self._by_name(scope, part, written.value)
            case _:
                part.bound = {(required or list(part.inputs))[0]: written}
        for name, at in part.bound.items():
            if name not in part.inputs:
                add(f"this part has no input {name!r}; {nearest(name, part.inputs)}", at)
            elif isinstance(at.value, str) and not scope.knows(at.value, self._implicit):
                head = at.value.partition(".")[0]
                add(f"there is no node {head!r}; {nearest(head, [*scope.inputs, *scope.nodes, *self._implicit])}", at)
        if missing := [name for name in required if name not in part.bound]:
            add(f"nothing is connected to {' and '.join(map(repr, missing))} of this part", written)

    def _by_name(self, scope: _Scope, part: _Scope, items: list[Located]) -> dict[str, Located]:
        """In a list stand parts, each of which feeds the inputs that have the names of its outputs; mappings in it come first."""
        named = {name: at for item in items for name, at in item.items().items()}
        bound: dict[str, Located] = {}
        for at in items:
            if isinstance(at.value, dict):
                continue
            other = scope.parts.get(at.value) if isinstance(at.value, str) else None
            if other is None:
                text = "a list in a part's 'from' names parts, whose outputs feed the inputs of the same names, or {input: edge}"
                self._problems.add(f"{text}; {nearest(str(at.value), scope.parts)}", at, part.name)
                continue
            for name in [name for name in part.inputs if name not in named]:
                if name in other.outputs and name in bound:
                    text = f"{bound[name].value!r} and '{at.value}.{name}' would both feed {name!r}"
                    self._problems.add(text, at, part.name)
                elif name in other.outputs:
                    bound[name] = replace(at, value=f"{at.value}.{name}")
        return bound | named

    def _emitted(self, scope: _Scope) -> Iterator[tuple[str, Located]]:
        """Every node, in the files' order, with what it reads in names of the whole graph."""
        for name, entry in scope.nodes.items():
            if name in scope.parts:
                yield from self._emitted(scope.parts[name])
            elif "from" not in entry.items():
                yield scope.called(name), entry
            else:
                keys = dict(entry.items())
                if (reads := self._reads(scope, keys["from"], scope.called(name))) is None:
                    del keys["from"]
                else:
                    keys["from"] = reads
                yield scope.called(name), replace(entry, value=keys)

    def _reads(self, scope: _Scope, written: Located, node: str = "") -> Located | None:
        """Edges in names of the whole graph, without those to inputs that are not connected."""
        match written.value:
            case dict() as ports:
                found = {port: edge for port, at in ports.items() if (edge := self._edge(scope, at, node))}
                return replace(written, value=found)
            case list() as items:
                return replace(written, value=[edge for at in items if (edge := self._edge(scope, at, node))])
        return self._edge(scope, written, node)

    def _edge(self, scope: _Scope, at: Located, node: str, way: tuple[str, ...] = ()) -> Located | None:
        """One edge in names of the whole graph; None if it leads to an input that is not connected, or is wrong."""
        if not isinstance(at.value, str):
            return at  # which the loader refuses
        head, _, rest = at.value.partition(".")
        here = scope.called(at.value)
        if head in scope.inputs and scope.above:
            if here in way:
                self._problems.add(f"parts feed each other in a circle: {' -> '.join((*way, here))}", at, node)
                return None
            if rest:
                self._problems.add(f"{head!r} is an input of this part, one stream; it has no outputs", at, node)
            outer = scope.bound.get(head)
            return self._edge(scope.above, outer, node, (*way, here)) if outer and not rest else None
        if head in scope.parts:
            return self._output(scope.parts[head], rest, at, node, way)
        if not scope.name or head in scope.nodes:
            return replace(at, value=here)
        if head in self._implicit:
            return at
        known = [*scope.inputs, *scope.nodes, *self._implicit]
        self._problems.add(f"this part has no input or node {head!r}; {nearest(head, known)}", at, node or scope.name)
        return None

    def _output(self, part: _Scope, rest: str, at: Located, node: str, way: tuple[str, ...]) -> Located | None:
        """What a part's output is, or one of its nodes."""
        name = rest or next(iter(part.outputs), "")
        if name in part.outputs:
            return self._edge(part, part.outputs[name], node, way)
        if name.partition(".")[0] in part.nodes:
            return self._edge(part, replace(at, value=name), node, way)
        has = nearest(name, [*part.outputs, *part.nodes]) if part.outputs or rest else "it has no outputs"
        self._problems.add(f"the part {part.name!r} has no output {name!r}; {has}", at, node)
        return None

    # ----------------------------------------------------------------------------------------------- record and page

    def _recorded(self, scope: _Scope) -> list[Located]:
        """What a graph and its parts record; what several of them name stands there once."""
        own = scope.top.get("record")
        items = [] if own is None or own.value is None else own.value if isinstance(own.value, list) else [own]
        found = [edge for at in items if (edge := self._edge(scope, at, scope.name))]
        known = [edge.value for edge in found]
        for part in scope.parts.values():
            for edge in self._recorded(part):
                found += [edge] if edge.value not in known else []
                known.append(edge.value)
        return found

    def _record(self, scope: _Scope) -> dict[str, Located]:
        found, own = self._recorded(scope), scope.top.get("record")
        return {"record": Located(list(found), own.line if own else 0)} if found else {}

    def _panels(self, scope: _Scope) -> list[Located]:
        """The panels of a graph; without any of its own, those of its parts."""
        page = scope.top.get("page")
        own = page.items().get("panels") if page else None
        if own is not None:
            return [self._panel(scope, at) for at in own.value] if isinstance(own.value, list) else []
        return [panel for part in scope.parts.values() for panel in self._panels(part)]

    def _page(self, scope: _Scope) -> dict[str, Located]:
        found, page = self._panels(scope), scope.top.get("page")
        if not found:
            return {}
        line = page.line if page else 0
        return {"page": Located({**(page.items() if page else {}), "panels": Located(list(found), line)}, line)}

    def _panel(self, scope: _Scope, at: Located) -> Located:
        of = at.items().get("of")
        reads = self._reads(scope, of, scope.name) if of and of.value is not None else None
        return replace(at, value={**at.items(), "of": reads}) if reads else at


def plain_text(root: Located, header: str) -> str:
    """An expanded graph as a file: the comment that the graph's own begins with, then what it amounts to."""
    lines = list(takewhile(lambda line: line.startswith("#"), header.splitlines()))
    return "\n".join([*lines, dump(root.plain())])
