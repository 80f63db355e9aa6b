"""`kinegraph check`: whether a graph can run, what flows in it, how late its results are, and what it holds in memory."""

from __future__ import annotations

from pathlib import Path as File
from textwrap import fill
from typing import Annotated, Any

import typer
from rich.table import Table
from rich.text import Text

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.cli.commands.graph_options import GraphFile, Settings, TrustedOnly
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.domain.axes import describe_axes
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph import Edge, Graph, Node
from kinegraph.stream.graph.components import beside, import_from
from kinegraph.stream.graph.drawing import shown
from kinegraph.stream.graph.plan import Decision, Plan, plan, refuse_late
from kinegraph.stream.graph.reading import overrides
from kinegraph.stream.graph.reading.load import load, read_expanded
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.screen import Screen
from kinegraph.stream.text.time_text import delay

WIDE = 120
"""Columns from which nodes and paths are tables."""


def check(
    config: GraphFile,
    settings: Settings = None,
    recording: Annotated[
        File | None, typer.Option(help="check it against the streams of this recording, as for a replay")
    ] = None,
    as_json: AsJson = False,
    trusted_only: TrustedOnly = False,
) -> None:
    """Check a graph without opening any device: names, parameters, streams, delay and memory. Exit code 2 if it cannot run."""
    recorded = None
    if recording:
        from kinegraph.stream.recording import Recording

        with Recording.open(recording) as opened:
            recorded = {name: stream.spec for name, stream in opened.streams.items()}
    _report_local_modules(config)
    graph = load(config, recorded=recorded, overrides=overrides.read(settings or ()), trusted_only=trusted_only)
    planned = plan(graph, enforce=False)
    if as_json:
        print_json(_facts(graph, planned))
        refuse_late(graph, planned.paths)
        return
    console = Screen()
    if console.width >= WIDE:
        console.print(_nodes(graph))
        console.print(_paths(planned))
        if planned.decisions:
            console.print(_events(planned))
    else:
        console.print(_narrow(graph, planned, console.width))
    for hint in _unread(graph):
        console.print(f"note: {hint}", style="dim")
    refuse_late(graph, planned.paths)
    console.print(_verdict(graph, planned))


def _facts(graph: Graph, planned: Plan) -> dict[str, Any]:
    """What `check` finds, for programs."""
    slowest = planned.slowest
    return {
        "graph": graph.name,
        "nodes": [
            {
                "name": node.name,
                "use": node.use,
                "reads": {port: str(edge) for port, edge in node.inputs.items()},
                "gives": {output: spec.describe() for output, spec in node.specs.items()},
            }
            for node in shown(graph)
        ],
        "paths": [
            {"nodes": [s.node for s in p.steps], "delay_s": p.delay_s, "memory_bytes": p.memory_bytes}
            for p in planned.paths
        ],
        "events": [{"output": str(d.origin), "after_s": d.after_s, "total_s": d.total_s} for d in planned.decisions],
        "delay_s": slowest.delay_s if slowest else 0.0,
        "latency_budget_ms": graph.latency_budget_ms,
        "memory_bytes": planned.memory_bytes,
        "notes": _unread(graph),
    }


def _report_local_modules(config: File) -> None:
    """Say, before it is done, which files beside the graph are run because it names them."""
    try:
        nodes = read_expanded(config).items()["nodes"].items().values()
    except (KeyError, KinegraphError):
        return  # which loading it tells
    import_from(config.parent)
    named = [str(node.items()["use"].value) for node in nodes if "use" in node.items()]
    for path in dict.fromkeys(filter(None, map(beside, named))):
        say(f"note: the graph runs code that is not installed: {path}", err=True)


def _narrow(graph: Graph, planned: Plan, width: int) -> str:
    """Nodes and paths below one another, for a terminal that has no room for tables."""
    lines = [f"{graph.name}: {len(shown(graph))} nodes"]
    for node in shown(graph):
        lines.append(f"{node.name}  {node.use}")
        for word, text in (("reads", _reads(graph, node)), ("gives", _gives(node))):
            for line in filter(None, text.split("\n")):
                lines.append(
                    fill(line, width, initial_indent=f"  {word} ", subsequent_indent=" " * 10, break_on_hyphens=False)
                )
    lines += ["", "paths"]
    for path in planned.paths:
        lines.append(fill(str(path), width, subsequent_indent="    ", break_on_hyphens=False))
        message = f"{path.explain()}; memory {size(path.memory_bytes)}"
        lines.append(
            fill(message, width, initial_indent="  delay ", subsequent_indent=" " * 10, break_on_hyphens=False)
        )
    if planned.decisions:
        lines += ["", "events, at the latest"]
    for decided in planned.decisions:
        lines.append(fill(f"{decided.origin}  {_after(decided)}", width, subsequent_indent="    "))
    return "\n".join(lines)


def _nodes(graph: Graph) -> Table:
    table = Table(
        title=f"{graph.name}: {len(shown(graph))} nodes", title_justify="left", box=None, padding=(0, 2, 0, 0)
    )
    for heading in ("node", "use", "reads", "gives"):
        table.add_column(heading, overflow="fold")
    for node in shown(graph):
        table.add_row(node.name, node.use, _reads(graph, node), _gives(node))
    return table


def _reads(graph: Graph, node: Node) -> str:
    if len(node.inputs) == 1:
        return ", ".join(map(str, node.inputs.values()))
    return "\n".join(f"{port}: {edge}" if port != str(edge) else port for port, edge in node.inputs.items())


def _gives(node: Node) -> str:
    if node.specs.keys() == {"out"}:
        return _described(node.specs["out"])
    return "\n".join(f"{output}: {_described(spec)}" for output, spec in node.specs.items())


def _described(spec: StreamSpec) -> str:
    """What a stream is, and of one of points, poses or a mesh which way its axes point."""
    axes = describe_axes(spec)
    return f"{spec.describe()}; {axes}" if axes else spec.describe()


def _paths(planned: Plan) -> Table:
    table = Table(title="\npaths", title_justify="left", box=None, padding=(0, 2, 0, 0))
    table.add_column("path", overflow="fold")
    table.add_column("delay", justify="right")
    table.add_column("where from", overflow="fold")
    table.add_column("memory", justify="right")
    for path in planned.paths:
        table.add_row(str(path), delay(path.delay_s), path.explain(), size(path.memory_bytes))
    return table


def _events(planned: Plan) -> Table:
    table = Table(title="\nevents", title_justify="left", box=None, padding=(0, 2, 0, 0))
    table.add_column("event", overflow="fold")
    table.add_column("comes at the latest", overflow="fold")
    for decided in planned.decisions:
        table.add_row(str(decided.origin), _after(decided))
    return table


def _after(decided: Decision) -> str:
    """When an event comes: "200 ms after its end or onset, 240 ms with the delay of its input"."""
    text = f"{delay(decided.after_s)} after its end or onset"
    return f"{text}, {delay(decided.total_s)} with the delay of what it is found in"


def _unread(graph: Graph) -> list[str]:
    """Outputs of operators that lead nowhere: no error, but often a forgotten line."""
    return [
        f"nothing reads or records {str(Edge(node.name, output))!r}"
        for node in shown(graph)
        for output in node.specs
        if not node.is_source
        and not graph.readers(Edge(node.name, output))
        and Edge(node.name, output) not in graph.record
    ]


def _verdict(graph: Graph, planned: Plan) -> Text:
    slowest = planned.slowest
    late = delay(slowest.delay_s if slowest else 0.0)
    budget = f" (budget {graph.latency_budget_ms:g} ms)" if graph.latency_budget_ms else ""
    text = f": delay at most {late}{budget}, memory about {size(planned.memory_bytes)}"
    return Text.assemble(("OK", "bold green"), text)


def size(n: int) -> str:
    """Bytes for people."""
    return f"{n / 1e6:.1f} MB" if n >= 1e6 else f"{n / 1e3:.1f} kB" if n >= 1e3 else f"{n} B"
