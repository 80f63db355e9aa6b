"""`kinegraph dev compile`: compile kernels before they are needed, in as many processes as there are processors."""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.stream.engine.ahead import OperatorType
    from kinegraph.stream.graph import Graph

ALL, OPERATORS = "all", "operators"


def compile_(
    graphs: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[CONFIG...|operators|all]",
            help="graphs; `operators`: every operator of kinegraph; `all`: these and every shipped graph",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print the result as JSON")] = False,
) -> None:
    """Compile the kernels of graphs now, so that their first start does not wait for it. Without a graph: all.

    Every kernel is kept as soon as it is compiled; a command that was interrupted goes on where it stopped.
    """
    from kinegraph.stream.compiler.cache import cache_folder, kept_count
    from kinegraph.stream.engine.ahead import Compiling, compile_operators, process_count
    from kinegraph.stream.text.progress import one_line_report

    began, before = time.monotonic(), kept_count()
    loaded, skipped = _graphs(graphs or [ALL])
    parts = _parts(loaded.values(), every=bool({ALL, OPERATORS} & set(graphs or [ALL])))
    with one_line_report() as report:
        state = Compiling(parts, report)
        state.start()
        try:
            compile_operators(sorted(state.seconds, key=lambda part: -state.seconds[part]))
            for name, graph in loaded.items():
                try:
                    _compile_rest(graph)
                except KinegraphError as error:
                    skipped[name] = str(error)
        finally:
            state.stop()
    after = kept_count()
    facts = {
        "compiled": after - before,
        "kept": after,
        "seconds": round(time.monotonic() - began, 1),
        "processes": process_count(),
        "folder": str(cache_folder()),
        "skipped": skipped,
    }
    if as_json:
        say(json.dumps(facts))
        return
    for name, why in skipped.items():
        say(f"skipped {name}: {why}", err=True)
    say(f"compiled {after - before} kernels in {facts['seconds']} s; {after} are in {cache_folder()}")


def _graphs(names: list[str]) -> tuple[dict[str, Graph], dict[str, str]]:
    """The graphs of these names, and why others cannot be loaded here; of graphs that were asked for by name, all must load."""
    from kinegraph.stream.graph.plan import plan
    from kinegraph.stream.graph.reading.load import load
    from kinegraph.stream.graph.shipped import shipped

    loaded: dict[str, Graph] = {}
    skipped: dict[str, str] = {}
    for name in names:
        loaded |= {} if name in (ALL, OPERATORS) else {name: load(Path(name))}
    for name, path in shipped().items() if ALL in names else ():
        try:
            loaded[name] = load(path)
        except KinegraphError as error:
            skipped[name] = str(error)
    for graph in loaded.values():
        plan(graph)
    return loaded, skipped


def _parts(graphs: Iterable[Graph], *, every: bool) -> set[OperatorType]:
    """The operators of these graphs; with `every`, all that come with kinegraph."""
    from kinegraph.stream.engine.warmup import tried
    from kinegraph.stream.graph.components import catalogue
    from kinegraph.stream.operator import Operator

    found, _ = catalogue(("operators",)) if every else ({}, {})
    parts = {part for part in found.values() if issubclass(part, Operator)}
    return parts.union(*map(tried, graphs))


def _compile_rest(graph: Graph) -> None:
    """What the operators' cases do not reach: sources, rows, the recorder."""
    from kinegraph.stream.engine.session import Session

    with TemporaryDirectory() as folder:
        Session(graph, Path(folder) / "session").compile()
