"""`kinegraph record`: any sources into a recording, with no graph."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.stream.graph import Graph

EXAMPLE = "kinegraph record devices.cyton.Cyton port=/dev/serial/by-id/NAME"


def record(
    sources: Annotated[
        list[str],
        typer.Argument(
            help="each source's dotted path, followed by its parameters and engine options; NAME:PATH names it",
            metavar="SOURCE [PARAMETER=VALUE]",
        ),
    ],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="the recording's folder (default: a new one in recordings/)")
    ] = None,
    duration_s: Annotated[
        float, typer.Option("--for", metavar="SECONDS", min=0.0, help="end after this many seconds; 0: when stopped")
    ] = 0.0,
    simulate: Annotated[bool, typer.Option("--simulate", help="simulated devices in the place of real ones")] = False,
    store_frames: Annotated[
        bool, typer.Option("--store-frames", help="keep the images of cameras; otherwise only when they came")
    ] = False,
    view: Annotated[str, typer.Option(help="how the session is shown: auto, live, lines or none")] = "auto",
    json_log: Annotated[bool, typer.Option("--log-json", help="log lines as JSON")] = False,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="log more")] = False,
) -> None:
    """Record devices without a graph.

    kinegraph record devices.cyton.Cyton port=/dev/serial/by-id/NAME -o folder

    What a camera sees is private, and is kept only with --store-frames. Values are read as YAML. The recording holds a graph of these
    sources alone, so it can be replayed; exit codes are those of `run`.
    """
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.cli.commands.run import conduct, session_folder

    logs.set_up(json=json_log, verbose=verbose)
    if simulate:
        sources = with_ports(sources)
    graph = loaded(sources)
    if images := pictures(graph):
        if store_frames:
            graph = loaded(sources, images)
        else:
            say(
                f"images of {', '.join(images)} are not kept, only when they came; --store-frames keeps them",
                err=True,
            )
    elif store_frames:
        raise KinegraphError("--store-frames: these sources give no images")
    conduct(graph, session_folder(graph, out), duration_s=duration_s, view=view, simulate=simulate)


def loaded(arguments: list[str], record: Sequence[str] = ()) -> Graph:
    """The graph of these sources. Raises GraphError, without line numbers, since there is no file."""
    from kinegraph.stream.errors import GraphError
    from kinegraph.stream.graph.reading.load import load_text

    try:
        return load_text(*written(arguments, record))
    except GraphError as error:
        raise GraphError(error.text) from error


def pictures(graph: Graph) -> list[str]:
    """The outputs of sources that are images."""
    from kinegraph.stream.recording.format.image import is_picture

    return [
        f"{node.name}.{output}" for node in graph.sources for output, spec in node.specs.items() if is_picture(spec)
    ]


def with_ports(arguments: list[str]) -> list[str]:
    """The same, with something for every `port` that is not given: a simulated device has no use for it."""
    found: list[str] = []
    given = False
    for argument in reversed(arguments):
        key, equals, _ = argument.partition("=")
        given = given or key == "port"
        if not equals:
            if not given and "port" in _parameters(argument.rpartition(":")[2]):
                found.append("port=simulated")
            given = False
        found.append(argument)
    return found[::-1]


def _parameters(path: str) -> set[str]:
    """The names of a source's parameters; empty for an unknown source, which loading the graph reports."""
    from kinegraph.stream.graph.components import find

    try:
        return {field.name for field in fields(cast("Any", find(path)))}
    except KinegraphError:
        return set()


def written(arguments: list[str], record: Sequence[str] = ()) -> tuple[str, str]:
    """The graph of these sources, as YAML, and its name. `record`: outputs to name there, as images must be to be kept."""
    from ruamel.yaml import YAML

    nodes: dict[str, dict[str, Any]] = {}
    node: dict[str, Any] = {}
    for argument in arguments:
        key, equals, value = argument.partition("=")
        if equals and nodes:
            node[key] = _value(argument, value)
        elif equals:
            raise KinegraphError(f"{argument!r} stands before any source; write it as in '{EXAMPLE}'")
        else:
            name, colon, path = argument.rpartition(":")
            node = {"use": path}
            nodes[_name(name if colon else "", path, nodes)] = node
    out = io.StringIO()
    YAML(typ="safe", pure=True).dump({**({"record": [*record]} if record else {}), "nodes": nodes}, out)
    return out.getvalue(), "-".join(nodes)


def _name(given: str, path: str, taken: dict[str, Any]) -> str:
    """What the node is called: as given, else after its class, with a number if there are several."""
    if given:
        if given in taken:
            raise KinegraphError(f"two sources are called {given!r}")
        return given
    name = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", path.rpartition(".")[2]).lower() or "source"
    number = 2
    found = name
    while found in taken:
        found, number = f"{name}{number}", number + 1
    return found


def _value(argument: str, value: str) -> Any:
    from kinegraph.stream.errors import GraphError
    from kinegraph.stream.graph.reading.yaml_lines import parse

    try:
        return parse(value, "").plain()
    except GraphError as error:
        raise KinegraphError(f"{argument}: {error}") from None
