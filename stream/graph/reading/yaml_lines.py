"""YAML as plain values that know their line: texts, numbers, switches, lists and mappings, nothing else; never an object.

The text is composed, not constructed: tags that would make objects are refused, names given twice too, and what is no YAML is reported
in a plain sentence with its line.
"""

from __future__ import annotations

import io
import re
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, TypeAlias

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError, YAMLError
from ruamel.yaml.nodes import MappingNode, ScalarNode, SequenceNode
from ruamel.yaml.reader import ReaderError

from kinegraph.stream.errors import GraphError

Scalar: TypeAlias = str | int | float | bool | None

_TAG = "tag:yaml.org,2002:"
_SCALARS = {_TAG + kind for kind in ("str", "int", "float", "bool", "null")}
_MOST_VALUES = 100_000
"""Anchors can make a short text grow without end; no graph needs more values than this."""
_MOST_LETTERS = 512 << 10
"""A longer text is refused before it is read, which takes seconds."""
_DEEPEST = 50
_BRACKET = re.compile(r"[][{}]")
_MOST_OPEN = 500
"""Brackets that are open at a time, also those within texts; the parser takes seconds for more."""
NESTED = "lists and mappings are nested too deeply; no graph needs more than a few levels"


@dataclass(frozen=True, slots=True)
class Located:
    """A value and the line of its name (of itself, in a list); `origin` is where it stands if not in the file.

    `file` is the file of a part, empty for the graph's own; `written` is a number as the file spells it.
    """

    value: Scalar | list[Located] | dict[str, Located]
    line: int
    origin: str = ""
    file: str = ""
    written: str = ""

    def fact(self) -> Any:
        """The value as a fact about a session: a number that is spelt as an identifier is (010, 1e3) stays the text that it is."""
        if isinstance(self.value, list):
            return [item.fact() for item in self.value]
        if isinstance(self.value, dict):
            return {name: item.fact() for name, item in self.value.items()}
        is_number = isinstance(self.value, int | float) and not isinstance(self.value, bool)
        return self.written if is_number and self.written and is_identifier(self.written) else self.value

    def plain(self) -> Any:
        """The value without its lines."""
        if isinstance(self.value, list):
            return [item.plain() for item in self.value]
        if isinstance(self.value, dict):
            return {name: item.plain() for name, item in self.value.items()}
        return self.value

    def items(self) -> dict[str, Located]:
        """The entries of a mapping; empty for anything else."""
        return self.value if isinstance(self.value, dict) else {}

    @property
    def kind(self) -> str:
        """What it is, for people."""
        match self.value:
            case None:
                return "empty"
            case bool():
                return f"{str(self.value).lower()}"
            case int() | float():
                return f"the number {self.value}"
            case str():
                return f"the text {self.value!r}"
            case list():
                return "a list"
        return "a mapping"


def is_identifier(text: str) -> bool:
    """Whether a number's spelling would be lost in reading it as a number: 010, +5, 1e3, 0x1F; not so 1.40 or 1.5e-3.

    >>> is_identifier("010"), is_identifier("1.40")
    (True, False)
    """
    return not re.fullmatch(r"-?(0|[1-9]\d*)(\.\d*([eE][+-]?\d+)?)?|-?\.\d+|[+-]?\.(inf|nan)", text, re.IGNORECASE)


def locate(value: Any, line: int, origin: str = "") -> Located:
    """Plain values (from the command line) as Located ones."""
    if isinstance(value, list | tuple):
        return Located([locate(item, line, origin) for item in value], line, origin)
    if isinstance(value, dict):
        return Located({str(name): locate(item, line, origin) for name, item in value.items()}, line, origin)
    return Located(value, line, origin)


def parse(text: str, path: str, *, is_part: bool = False) -> Located:
    """The whole text as one value; raises GraphError with the line of what is no YAML, or not plain."""
    if len(text) > _MOST_LETTERS:
        raise GraphError(f"the graph has {len(text)} characters; it must have at most {_MOST_LETTERS}", path=path)
    if max(accumulate(1 if sign in "[{" else -1 for sign in _BRACKET.findall(text)), default=0) > _MOST_OPEN:
        raise GraphError(NESTED, path=path)
    yaml = YAML(typ="safe", pure=True)
    try:
        root = yaml.compose(io.StringIO(text))
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise GraphError(_sentence(error), path=path, line=mark.line + 1 if mark else None) from None
    except ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise GraphError(f"the character {error.character!r} is not allowed in YAML", path=path, line=line) from None
    except YAMLError as error:
        raise GraphError(f"this is not YAML: {error}", path=path) from None
    except RecursionError:
        raise GraphError(NESTED, path=path) from None
    if root is None:
        return Located(None, 1)
    return _YamlReading(yaml, path, path if is_part else "").value(root, root.start_mark.line + 1)


class _YamlReading:
    """One pass over composed nodes."""

    def __init__(self, yaml: YAML, path: str, file: str) -> None:
        self._constructor, self._path, self._file = yaml.constructor, path, file
        self._open: set[int] = set()
        self._count = 0

    def value(self, node: Any, line: int) -> Located:
        self._count += 1
        if id(node) in self._open or self._count > _MOST_VALUES:
            raise self._wrong(node, "anchors (&name, *name) that contain themselves or grow without end")
        if len(self._open) > _DEEPEST:
            raise self._wrong(node, NESTED)
        if isinstance(node, ScalarNode):
            return Located(self._scalar(node), line, file=self._file, written=str(node.value))
        if str(node.tag) not in (_TAG + "map", _TAG + "seq"):
            raise self._wrong(node, f"the tag {node.tag!r} is refused; a graph holds plain values only")
        self._open.add(id(node))
        try:
            if isinstance(node, SequenceNode):
                items = [self.value(item, item.start_mark.line + 1) for item in node.value]
                return Located(items, line, file=self._file)
            return Located(self._mapping(node), line, file=self._file)
        finally:
            self._open.discard(id(node))

    def _mapping(self, node: MappingNode) -> dict[str, Located]:
        found: dict[str, Located] = {}
        merged: dict[str, Located] = {}
        for key, item in node.value:
            line = key.start_mark.line + 1
            if key.tag == _TAG + "merge":
                merged.update(self._merged(item, line))
                continue
            name = self._scalar(key) if isinstance(key, ScalarNode) else None
            if not isinstance(name, str):
                raise self._wrong(key, "a key must be text; put it in quotes")
            if name in found:
                raise self._wrong(key, f"{name!r} is given twice, first in line {found[name].line}")
            found[name] = self.value(item, line)
        return {**{name: item for name, item in merged.items() if name not in found}, **found}

    def _merged(self, node: Any, line: int) -> dict[str, Located]:
        """What `<<: *defaults` brings in."""
        value = self.value(node, line)
        if not isinstance(value.value, dict):
            raise self._wrong(node, "'<<' takes a mapping, as in '<<: *defaults'")
        return value.value

    def _scalar(self, node: ScalarNode) -> Scalar:
        tag = str(node.tag)
        if tag == _TAG + "timestamp":
            return str(node.value)
        if tag not in _SCALARS:
            raise self._wrong(node, f"the tag {tag!r} is refused; a graph holds plain values only")
        try:
            value: Scalar = self._constructor.construct_object(node)
        except (YAMLError, ValueError):
            raise self._wrong(node, f"{shortened(node.value)!r} is not what its tag {tag!r} says") from None
        return value

    def _wrong(self, node: Any, text: str) -> GraphError:
        return GraphError(text, path=self._path, line=node.start_mark.line + 1)


def shortened(text: str, most: int = 60) -> str:
    """A text as it can stand in a message."""
    return text if len(text) <= most else f"{text[: most - 3]}..."


def _sentence(error: MarkedYAMLError) -> str:
    """The parser's complaint in words that say what to mend."""
    problem, context = str(error.problem or ""), str(error.context or "")
    since = f" opened in line {error.context_mark.line + 1}" if error.context_mark else ""
    if "'\\t'" in problem:
        return "this line is indented with a tab; YAML needs spaces"
    if "mapping values are not allowed" in problem:
        return "unexpected ':'; correct the indentation, or put text that contains ': ' in quotes"
    if "quoted scalar" in context:
        return f"the quotation mark{since} is never closed"
    if "expected ',' or ']'" in problem:
        return f"the '['{since} lacks a ',' or its ']'"
    if "expected ',' or '}'" in problem:
        return f"the '{{'{since} lacks a ',' or its '}}'"
    if "could not find expected ':'" in problem:
        return "a line without 'name: value'; is a ':' missing?"
    if "expected <block end>" in problem:
        return "the indentation does not fit the lines above"
    if "cannot start any token" in problem:
        return f"text that begins like this needs quotes ({problem})"
    if "undefined alias" in problem:
        return f"{problem.replace('found undefined alias', 'no anchor is called')}; an alias *name needs an anchor &name above it"
    if "single document" in context:
        return "a second document begins here ('---'); one file holds one graph"
    return f"this is not YAML: {' '.join(part for part in (context, problem) if part)}"
