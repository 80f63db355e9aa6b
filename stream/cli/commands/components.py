"""`kinegraph components`: what a graph can be made of, and what each thing takes and gives."""

from __future__ import annotations

import inspect
import re
import textwrap
from difflib import get_close_matches
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.system.names import PACKAGES
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.stream.graph.components import Part
    from kinegraph.stream.text.screen import Screen

WIDE = 110
"""Columns from which the list is a table."""
WIDEST = 130
"""Columns beyond which no line of text goes."""
BOUNDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


def components(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="a dotted path, a class name, or a word to search for")
    ] = "",
    package: Annotated[list[str] | None, typer.Option(help="a package or module of your own to include")] = None,
    as_json: AsJson = False,
) -> None:
    """List every source, operator and outlet that a graph can use; with NAME, show its ports and parameters."""
    from pathlib import Path

    from kinegraph.stream.graph.components import catalogue, find, import_from, packages

    import_from(Path())
    found, failed = catalogue((*packages(), *(package or ())))
    for module, reason in failed.items():
        if not lacks_extra(module, reason):
            say(f"skipped {module}: {reason}", err=True)
    if "." in name and name not in found:
        found[name] = find(name)
    exact = [path for path in found if name in (path, path.rpartition(".")[2])]
    hits = exact or [path for path, part in found.items() if name.lower() in f"{path} {_first_line(part)}".lower()]
    if not hits:
        classes = {path.rpartition(".")[2] for path in found}
        hint = (
            nearest(name, classes)
            if get_close_matches(name, classes)
            else "`kinegraph components` lists all components"
        )
        raise KinegraphError(f"no component matches {name!r}; {hint}")
    if as_json:
        print_json([_described(path, found[path], whole=len(hits) == 1) for path in hits])
    elif len(hits) == 1:
        _show(hits[0], found[hits[0]])
    else:
        _list({path: found[path] for path in hits})


def _described(path: str, part: Part, *, whole: bool) -> dict[str, Any]:
    """A component for programs; `whole`: with its ports and the JSON Schema of its parameters."""
    from kinegraph.stream.graph.components import kind_of
    from kinegraph.stream.params import schema

    described = {"use": path, "kind": kind_of(part), "what": _first_line(part)}
    if not whole:
        return described
    ports = {"inputs": list(getattr(part, "inputs", ())), "outputs": list(part.outputs)}
    return {**described, **ports, "parameters": schema(part)}


def lacks_extra(module: str, reason: str) -> bool:
    """Whether a module of ours is left out because a library that it works with is not installed: no fault, so nothing to report."""
    return module.partition(".")[0] in PACKAGES and reason.startswith("ModuleNotFoundError")


def _list(found: dict[str, Part]) -> None:
    """A line on each, as a table where there is room for one, else below its name."""
    from rich.table import Table
    from rich.text import Text

    from kinegraph.stream.graph.components import kind_of

    console = _console()
    table = Table(box=None, pad_edge=False)
    table.add_column("use", no_wrap=True, overflow="fold")
    table.add_column()
    table.add_column("what it does")
    for kind in ("source", "operator", "outlet"):
        for path, part in found.items():
            if kind_of(part) != kind:
                continue
            if console.width >= WIDE:
                table.add_row(Text(path, style="bold"), kind, Text(_first_line(part)))
            else:
                console.print(Text.assemble((path, "bold"), f"  ({kind})"))
                console.print(Text(textwrap.indent(reflowed(_first_line(part), console.width - 4), "    ")))
    if table.row_count:
        console.print(table)


def _console() -> Screen:
    """The terminal; what is no terminal (a pipe, a file) is as wide as it takes."""
    from kinegraph.stream.text.screen import Screen

    return Screen()


def reflowed(text: str, width: int) -> str:
    """A docstring's paragraphs and lists of names in lines of at most `width` characters."""
    return "\n\n".join(
        paragraph  # an example keeps its lines
        if paragraph.startswith(">>>")
        else "\n".join(
            textwrap.fill(entry, width, subsequent_indent=" " * _column(entry), break_on_hyphens=False)
            for entry in _entries(paragraph)
        )
        for paragraph in text.split("\n\n")
    )


def _entries(paragraph: str) -> list[str]:
    """A paragraph as one line; of a list, in which names stand before two spaces or items behind a dash, one line for each."""
    lines = paragraph.split("\n")
    if not any(_column(line) for line in lines):
        return [" ".join(lines)]
    entries: list[str] = []
    for line in lines:
        if entries and line.startswith("  "):
            entries[-1] += " " + line.strip()
        else:
            entries.append(line)
    return entries


def _column(line: str) -> int:
    """Where an entry's text begins, which its further lines are indented to; 0 of a line that is no entry of a list."""
    match = re.match(r"\S+(?: \S+)*  +|[-*] ", line)
    return match.end() if match else 0


def _show(path: str, part: Part) -> None:
    from rich.table import Table
    from rich.text import Text

    from kinegraph.stream.graph.components import kind_of
    from kinegraph.stream.operator import ANY, Operator
    from kinegraph.stream.params import schema

    console = _console()
    described = schema(part)
    says = reflowed(inspect.getdoc(part) or "", min(console.width, WIDEST))
    console.print(Text.assemble((path, "bold"), f"  ({kind_of(part)})\n\n", says, "\n"))
    if issubclass(part, Operator):
        ports = [f"{name} (optional)" if port.optional else name for name, port in part.inputs.items()]
        console.print(Text(f"inputs   {'any number' if ANY in part.inputs else ', '.join(ports)}"))
    if part.outputs:
        console.print(Text(f"outputs  {', '.join(part.outputs)}"))
    table = Table("parameter", "default", "values", "", box=None, pad_edge=False)
    for name, entry in described.get("properties", {}).items():
        default = "(must be given)" if name in described.get("required", ()) else shown(entry.get("default"))
        table.add_row(
            Text(name, style="bold"), Text(default), Text(accepted(entry)), Text(entry.get("description", ""))
        )
    if table.row_count:
        console.print()
        console.print(table)


def accepted(entry: dict[str, Any]) -> str:
    """What a parameter accepts, in a few signs: "number > 0", "zero | first"."""
    if "enum" in entry:
        return " | ".join(map(str, entry["enum"]))
    if "anyOf" in entry:
        return " | ".join(filter(None, (accepted(inner) for inner in entry["anyOf"] if inner.get("type") != "null")))
    bounds = [f"{sign} {entry[key]:g}" for key, sign in BOUNDS.items() if key in entry]
    return " ".join([str(entry.get("type", "")), *bounds])


def shown(value: Any) -> str:
    return "" if value is None or value in ("", [], {}) else str(value)


def _first_line(part: Part) -> str:
    text = (inspect.getdoc(part) or "").partition("\n\n")[0].replace("\n", " ")
    return text if len(text) <= 120 else text[:117] + "..."
