"""Parts of graphs: a node that uses a YAML file is replaced by the nodes of that file, under dotted names ("left.envelope").

What comes out is a plain graph, which is what runs and what a recording keeps. A name in a part is one of its inputs, of its nodes or,
for the sources that every graph has, of the graph's. "left.closed" outside the part `left` is its output `closed`, or else its node of
that name; an output that has a node's name must be that node, so that both readings agree.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import takewhile
from pathlib import Path

from kinegraph.stream.errors import nearest
from kinegraph.stream.graph.reading.overrides import dump
from kinegraph.stream.graph.reading.part_files import PartReader, Scope, offered, part_of
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.yaml_lines import Located


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
    # most graphs use no part: their text stays as it is, line for line
    if "settings" not in root.items() and not any(map(part_of, nodes.values())):
        return Expanded(root)
    reader = PartReader(folder, problems, implicit)
    scope = reader.graph(root)
    problems.stop()
    return Expanded(_Expansion(problems, implicit).whole(root, scope), tuple(dict.fromkeys(reader.files)))


class _Expansion:
    """Puts the nodes of parts in their places."""

    def __init__(self, problems: Problems, implicit: Collection[str]) -> None:
        self._problems, self._implicit = problems, implicit

    def whole(self, root: Located, scope: Scope) -> Located:
        # all parts first: a node may read a part that stands below it in the file
        self._bind_parts(scope)
        top = dict(scope.top)
        if "nodes" in top:
            top["nodes"] = replace(top["nodes"], value=dict(self._emitted(scope)))
        if settings := dict(offered(scope)):
            top["settings"] = Located(settings, top["settings"].line if "settings" in top else 0)
        top |= self._record(scope) | self._page(scope)
        self._problems.stop()
        return replace(root, value=top)

    def _bind_parts(self, scope: Scope) -> None:
        for part in scope.parts.values():
            self._bind(scope, part)
            self._bind_parts(part)

    def _bind(self, scope: Scope, part: Scope) -> None:
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

    def _by_name(self, scope: Scope, part: Scope, items: list[Located]) -> dict[str, Located]:
        """In a list stand parts, each of which feeds the inputs that have the names of its outputs; mappings in it come first."""
        named = {name: at for item in items for name, at in item.items().items()}
        bound: dict[str, Located] = {}
        for at in items:
            if isinstance(at.value, dict):
                continue
            other = scope.parts.get(at.value) if isinstance(at.value, str) else None
            if other is None:
                text = "a list in a part's 'from' names parts (their outputs feed the inputs of the same names), or {input: edge}"
                self._problems.add(f"{text}; {nearest(str(at.value), scope.parts)}", at, part.name)
                continue
            for name in [name for name in part.inputs if name not in named]:
                if name in other.outputs and name in bound:
                    text = f"{bound[name].value!r} and '{at.value}.{name}' would both feed {name!r}"
                    self._problems.add(text, at, part.name)
                elif name in other.outputs:
                    bound[name] = replace(at, value=f"{at.value}.{name}")
        return bound | named

    def _emitted(self, scope: Scope) -> Iterator[tuple[str, Located]]:
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

    def _reads(self, scope: Scope, written: Located, node: str = "") -> Located | None:
        """Edges in names of the whole graph, without those to inputs that are not connected."""
        match written.value:
            case dict() as ports:
                found = {port: edge for port, at in ports.items() if (edge := self._edge(scope, at, node))}
                return replace(written, value=found)
            case list() as items:
                return replace(written, value=[edge for at in items if (edge := self._edge(scope, at, node))])
        return self._edge(scope, written, node)

    def _edge(self, scope: Scope, at: Located, node: str, way: tuple[str, ...] = ()) -> Located | None:
        """One edge in names of the whole graph; None if it leads to an input that is not connected, or is wrong."""
        if not isinstance(at.value, str):
            return at  # which the loader refuses
        head, _, rest = at.value.partition(".")
        here = scope.called(at.value)
        if head in scope.inputs and scope.above:
            # an input bound to another part's output, that again to an input: only following the edge finds the circle
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

    def _output(self, part: Scope, rest: str, at: Located, node: str, way: tuple[str, ...]) -> Located | None:
        """What a part's output is, or one of its nodes."""
        name = rest or next(iter(part.outputs), "")
        if name in part.outputs:
            return self._edge(part, part.outputs[name], node, way)
        if name.partition(".")[0] in part.nodes:
            return self._edge(part, replace(at, value=name), node, way)
        has = nearest(name, [*part.outputs, *part.nodes]) if part.outputs or rest else "it has no outputs"
        self._problems.add(f"the part {part.name!r} has no output {name!r}; {has}", at, node)
        return None

    def _recorded(self, scope: Scope) -> list[Located]:
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

    def _record(self, scope: Scope) -> dict[str, Located]:
        found, own = self._recorded(scope), scope.top.get("record")
        return {"record": Located(list(found), own.line if own else 0)} if found else {}

    def _panels(self, scope: Scope) -> list[Located]:
        """The panels of a graph; without any of its own, those of its parts."""
        page = scope.top.get("page")
        own = page.items().get("panels") if page else None
        if own is not None:
            return [self._panel(scope, at) for at in own.value] if isinstance(own.value, list) else []
        return [panel for part in scope.parts.values() for panel in self._panels(part)]

    def _page(self, scope: Scope) -> dict[str, Located]:
        found, page = self._panels(scope), scope.top.get("page")
        if not found:
            return {}
        line = page.line if page else 0
        return {"page": Located({**(page.items() if page else {}), "panels": Located(list(found), line)}, line)}

    def _panel(self, scope: Scope, at: Located) -> Located:
        if not isinstance(at.value, dict):
            return at
        of, show = at.items().get("of"), at.items().get("show")
        reads = self._reads(scope, of, scope.name) if of and of.value is not None else None
        keys = {**at.items(), "of": reads} if reads else at.items()
        if show and isinstance(show.value, list):
            keys = {**keys, "show": replace(show, value=[self._shown(scope, one) for one in show.value])}
        return replace(at, value=keys) if reads or show else at

    def _shown(self, scope: Scope, at: Located) -> Located:
        """One thing that an answer shows, its stream in names of the whole graph."""
        of = at.items().get("of") if isinstance(at.value, dict) else None
        reads = self._reads(scope, of, scope.name) if of else None
        return replace(at, value={**at.items(), "of": reads}) if reads else at


def plain_text(root: Located, header: str) -> str:
    """An expanded graph as a file: the comment that the graph's own begins with, then what it amounts to."""
    lines = list(takewhile(lambda line: line.startswith("#"), header.splitlines()))
    return "\n".join([*lines, dump(root.plain())])
