"""`kinegraph parts`: what a graph can be made of, and what each thing takes and gives."""

from __future__ import annotations

import inspect
import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from stream.errors import KinegraphError, nearest

if TYPE_CHECKING:
    from stream.graph.parts import Part

BOUNDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


def parts(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="a dotted path, a class, or a word that stands in the list")
    ] = "",
    package: Annotated[
        list[str] | None, typer.Option(help="a package or module of your own to look into as well")
    ] = None,
) -> None:
    """List every source, operator and outlet that a graph can use; with NAME, show its ports and parameters."""
    from pathlib import Path

    from stream.graph.parts import PACKAGES, catalogue, find, import_from

    import_from(Path())
    found, failed = catalogue((*PACKAGES, *(package or ())))
    for module, reason in failed.items():
        print(f"left out {module}: {reason}", file=sys.stderr)
    if "." in name and name not in found:
        found[name] = find(name)
    exact = [path for path in found if name in (path, path.rpartition(".")[2])]
    hits = exact or [path for path, part in found.items() if name.lower() in f"{path} {_first_line(part)}".lower()]
    if not hits:
        raise KinegraphError(f"nothing is called {name!r}; {nearest(name, {p.rpartition('.')[2] for p in found})}")
    if len(hits) == 1:
        _show(hits[0], found[hits[0]])
    else:
        _list({path: found[path] for path in hits})


def _list(found: dict[str, Part]) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from stream.graph.parts import kind_of

    table = Table(box=None, pad_edge=False)
    table.add_column("use", no_wrap=True, overflow="fold")
    table.add_column()
    table.add_column("what it does")
    for kind in ("source", "operator", "outlet"):
        for path, part in found.items():
            if kind_of(part) == kind:
                table.add_row(Text(path, style="bold"), kind, Text(_first_line(part)))
    Console().print(table)


def _show(path: str, part: Part) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from stream.graph.parts import kind_of
    from stream.operator import Operator
    from stream.params import schema

    console = Console(highlight=False)
    described = schema(part)
    console.print(Text.assemble((path, "bold"), f"  ({kind_of(part)})\n\n", inspect.getdoc(part) or "", "\n"))
    if issubclass(part, Operator):
        ports = [*(f"{p} (optional)" if p in part.optional else p for p in part.inputs)]
        console.print(Text(f"inputs   {'any number' if part.variadic else ', '.join(ports)}"))
    if part.outputs:
        console.print(Text(f"outputs  {', '.join(part.outputs)}"))
    table = Table("parameter", "default", "values", "", box=None, pad_edge=False)
    for name, entry in described.get("properties", {}).items():
        default = "(must be given)" if name in described.get("required", ()) else _shown(entry.get("default"))
        table.add_row(Text(name, style="bold"), Text(default), Text(_values(entry)), Text(entry.get("description", "")))
    if table.row_count:
        console.print()
        console.print(table)


def _values(entry: dict[str, Any]) -> str:
    """What a parameter accepts, in a few signs: "number > 0", "zero | first"."""
    if "enum" in entry:
        return " | ".join(map(str, entry["enum"]))
    if "anyOf" in entry:
        return " | ".join(filter(None, (_values(inner) for inner in entry["anyOf"] if inner.get("type") != "null")))
    bounds = [f"{sign} {entry[key]:g}" for key, sign in BOUNDS.items() if key in entry]
    return " ".join([str(entry.get("type", "")), *bounds])


def _shown(value: Any) -> str:
    return "" if value is None or value in ("", [], {}) else str(value)


def _first_line(part: Part) -> str:
    text = (inspect.getdoc(part) or "").partition("\n\n")[0].replace("\n", " ")
    return text if len(text) <= 120 else text[:117] + "..."
