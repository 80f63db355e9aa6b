"""`kinegraph emg check-electrodes`: what each electrode is worth, before the session, with what to do."""

from __future__ import annotations

import sys
import time
from dataclasses import asdict
from pathlib import Path as File
from tempfile import TemporaryDirectory
from threading import Event, Thread
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kinegraph.operators.emg.commands.electrode_check import Electrode
    from kinegraph.stream.domain.impedance import Impedance
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.graph import Graph

Span = tuple[float, float]
Stage = tuple[float, float, str]
"""Begin and end in s from the first sample, and what is to be done."""
REST_S, CONTRACTION_S = 5.0, 10.0


def check_electrodes(
    source: Annotated[
        File, typer.Argument(help="the graph with the EMG to check live, or a recording", metavar="GRAPH|FILE")
    ],
    rest: Annotated[
        str, typer.Option(metavar="A-B", help="seconds of rest from the beginning [default: the first 5 s]")
    ] = "",
    contraction: Annotated[
        str,
        typer.Option(metavar="A-B", help="seconds in which every muscle is contracted [default: the 10 s after rest]"),
    ] = "",
    emg: Annotated[str, typer.Option(metavar="STREAM", help="the raw EMG [default: the only one in volts]")] = "",
    impedance: Annotated[
        bool, typer.Option("--impedance/--no-impedance", help="measure impedances first, where the device can")
    ] = True,
    max_kohm: Annotated[
        float,
        typer.Option(metavar="KOHM", min=0.1, help="an impedance above this is doubtful, ten times as much is bad"),
    ] = 50.0,
    simulate: Annotated[bool, typer.Option("--simulate", help="simulated devices in the place of real ones")] = False,
    as_json: AsJson = False,
) -> None:
    """Check the electrodes before a session.

    Rest, then contract every muscle. It shows noise, contraction, crosstalk and hum per channel, the electrodes' impedances where the
    device measures them (OpenBCI Cyton: 1.5 s an electrode), and what to do about each fault.
    Exit code 0 if every channel is good, 1 if one is doubtful or bad.
    """
    from kinegraph.stream.recording.format.paths import SUFFIX, parts_of

    quiet = _span(rest, "--rest", (0.0, REST_S))
    strong = _span(contraction, "--contraction", (quiet[1], quiet[1] + CONTRACTION_S))
    if source.suffix == SUFFIX or (source.is_dir() and parts_of(source)):
        found, unit = _judge(source, emg, quiet, strong)
    else:
        with TemporaryDirectory(prefix="kinegraph-") as folder:
            ohm = _measure(source, File(folder) / "check", quiet, strong, simulate=simulate, impedance=impedance)
            found, unit = _judge(File(folder) / "check", emg, quiet, strong, ohm, 1000 * max_kohm)
    if as_json:
        print_json({"unit": unit, "electrodes": [{**asdict(one), "advice": one.advice} for one in found]})
    else:
        _show(found, unit)
    if poor := [f"{e.name} {e.reason}" for e in found if e.flag != "good"]:
        say(f"{len(poor)} of {len(found)} electrodes need a look: {', '.join(poor)}", err=True)
        sys.exit(1)
    say(f"all {len(found)} electrodes are good", err=as_json)


def _span(text: str, option: str, default: Span) -> Span:
    if not text:
        return default
    try:
        begin, end = (float(part) for part in text.split("-"))
    except ValueError:
        raise KinegraphError(f"{option} {text}: it must be two times in seconds, such as 0-5") from None
    if not 0 <= begin < end:
        raise KinegraphError(f"{option} {text}: the second time must be after the first")
    return begin, end


def _measure(
    config: File, folder: File, quiet: Span, strong: Span, *, simulate: bool, impedance: bool
) -> list[Impedance]:
    """Run the graph as long as the stages last, without its outlets, and say what is to be done meanwhile; before, measure impedances."""
    from contextlib import nullcontext

    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.cli.commands.run import simulated
    from kinegraph.stream.graph.reading.load import load

    logs.set_up()
    graph = load(config)
    for name in graph.outlets:
        del graph.nodes[name]
    stages = sorted([(*quiet, "rest: no muscle works"), (*strong, "contract every muscle in turn, strongly")])
    with simulated(graph) if simulate else nullcontext():
        ohm = _impedances(graph) if impedance else []
        code = run_stages(graph, folder, stages)
    if code:
        raise KinegraphError(f"the electrodes could not be measured: the session ended with exit code {code}")
    return ohm


def run_stages(graph: Graph, folder: File, stages: Sequence[Stage]) -> int:
    """Run a graph as long as the stages last, and say what is to be done meanwhile; its exit code."""
    from kinegraph.stream.engine.session import Session

    session, over = Session(graph, folder), Event()
    prompter = Thread(target=_prompt, args=(session, stages, over), name="prompts", daemon=True)
    prompter.start()
    try:
        return session.run().exit_code
    finally:
        over.set()


def _impedances(graph: Graph) -> list[Impedance]:
    """Of every source that measures them, one electrode after the other."""
    from kinegraph.stream.domain.impedance import LoneFeed
    from kinegraph.stream.source import Source

    found: list[Impedance] = []
    for node in graph.sources:
        assert isinstance(node.part, Source)
        measured = node.part.impedances(LoneFeed())
        if measured is None:
            continue
        say(f"first, keep still: {node.name} measures the electrodes' impedances one after the other", err=True)
        found += measured
    return found


def _prompt(session: Session, stages: Sequence[Stage], over: Event) -> None:
    """Say what is to be done from the first sample on, and end the session after it."""
    while not session.turn.open:
        if over.wait(0.02):
            return
    begun = time.monotonic()
    for begin, end, what in stages:
        if over.wait(max(0.0, begin - (time.monotonic() - begun))):
            return
        say(f"now, for {end - begin:g} s: {what}", err=True)
    if not over.wait(max(end for _, end, _ in stages) + 0.5 - (time.monotonic() - begun)):
        session.stop()


def _judge(
    path: File, emg: str, quiet: Span, strong: Span, ohm: Sequence[Impedance] = (), max_ohm: float = 0.0
) -> tuple[list[Electrode], str]:
    from kinegraph.operators.emg.commands.calibrate import raw_emg
    from kinegraph.operators.emg.commands.electrode_check import check_electrodes as judge
    from kinegraph.stream.recording import Recording

    with Recording.open(path) as recording:
        name = emg or raw_emg(recording)
        spec = recording.stream(name).spec
        times, data = recording.read(name)
    return judge(spec, times, data, quiet, strong, ohm, max_ohm), spec.units[0]


def _show(found: list[Electrode], unit: str) -> None:
    from rich.table import Table

    from kinegraph.stream.text.screen import Screen

    table = Table(box=None)
    measured = any(e.ohm for e in found)
    ohm = ["impedance (kOhm)"] if measured else []
    for heading in (
        "muscle", f"rest ({unit})", f"contraction ({unit})", "hum", "shared", *ohm, "verdict", "what to do",
    ):  # fmt: skip
        table.add_column(
            heading, justify="left" if heading in ("muscle", "verdict", "what to do") else "right", overflow="fold"
        )
    for e in found:
        shared = f"{e.shared:.2f} {e.with_}" if e.with_ else ""
        verdict = f"{e.flag}: {e.reason}" if e.reason else e.flag
        kohm = ["/".join(f"{z / 1000:.0f}" if z < float("inf") else "open" for z in e.ohm)] if measured else []
        table.add_row(e.name, f"{e.rest:.1f}", f"{e.contraction:.1f}", f"{e.hum:.0%}", shared, *kohm, verdict, e.advice)
    Screen().print(table)
