"""`kinegraph dev schema`: the JSON Schema with which an editor completes and checks a graph while it is written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.components import catalogue, import_from, packages
from kinegraph.stream.graph.reading.schema import graph_schema
from kinegraph.stream.system.atomic_file import write_complete
from kinegraph.stream.text.safe_text import say


def schema(
    output: Annotated[
        Path | None, typer.Option("-o", "--out", help="write it to this file instead of printing it")
    ] = None,
    package: Annotated[list[str] | None, typer.Option(help="a package or module of your own to include")] = None,
) -> None:
    """Write the JSON Schema of graphs, with every source, operator and outlet that is installed.

    In an editor with a YAML language server, begin a graph with the line: # yaml-language-server: $schema=kinegraph.schema.json
    """
    import_from(Path())
    parts, failed = catalogue((*packages(), *(package or ())))
    for module, reason in failed.items():
        say(f"skipped {module}: {reason}", err=True)
    text = json.dumps(graph_schema(parts), indent=2, ensure_ascii=False) + "\n"
    if output is None:
        say(text, end="")
        return
    try:
        write_complete(output, text)
    except OSError as error:
        raise KinegraphError(f"{output} cannot be written: {error.strerror}") from None
    say(f"{output}: {len(parts)} sources, operators and outlets")
