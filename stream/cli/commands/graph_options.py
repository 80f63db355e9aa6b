"""Arguments and options of every command that takes a graph."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

GraphFile: TypeAlias = Annotated[Path, typer.Argument(help="the graph, a YAML file", metavar="CONFIG")]
Settings: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="NAME=VALUE",
        help="change a setting of the graph (CONFIG --help lists them) or NODE.PARAMETER; NODE. may be left out where it is plain",
    ),
]
TrustedOnly: TypeAlias = Annotated[
    bool, typer.Option("--trusted-only", help="run installed code only, no files next to the graph")
]
Quiet: TypeAlias = Annotated[bool, typer.Option("-q", "--quiet", help="no progress bar")]
