"""Graphs at work for Python: live on devices, on a recording; and operators held to the laws."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import Any

from kinegraph.stream.api.builder import GraphBuilder
from kinegraph.stream.api.feeding import on_recording
from kinegraph.stream.api.live import LiveSession
from kinegraph.stream.api.results import Results
from kinegraph.stream.cli.commands.ending import Ending
from kinegraph.stream.cli.commands.logs import to_logging
from kinegraph.stream.cli.commands.run import simulated
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome
from kinegraph.stream.laws import hold, trials
from kinegraph.stream.operator import Operator
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.format.paths import refuse_taken_folder


def load(path: Path | str, overrides: Mapping[str, Any] | None = None) -> GraphBuilder:
    """A graph from a YAML file, or by a shipped graph's bare name ("treadmill_emg"); raises GraphError.

    `overrides` replace what the file says: {"envelope.cutoff_hz": 10}.
    """
    return GraphBuilder.load(path, overrides)


def run(
    graph: GraphBuilder | Path | str,
    folder: Path | str | None = None,
    *,
    duration_s: float = 0.0,
    simulate: bool = False,
) -> Outcome:
    """Run a graph on its devices, live; returns when every source has ended, after `duration_s`, or at Ctrl-C.

    folder     where the session is recorded, a new one; None: not at all
    simulate   simulated devices in the place of real ones

    Raises where an operator fails or a device is missing; the outcome's `exit_code` is 5 where an outlet or the recording lost something.
    """
    to_logging()
    checked = _builder(graph).check()
    if folder is not None:
        refuse_taken_folder(Path(folder))
    with simulated(checked) if simulate else nullcontext(), ExitStack() as stack:
        session = Session(checked, Path(folder) if folder is not None else None, duration_s=duration_s)
        if threading.current_thread() is threading.main_thread():
            stack.enter_context(Ending(session, lambda outcome: None))
        outcome = session.run()
    if outcome.error is not None:
        raise outcome.error
    return outcome


def live(
    graph: GraphBuilder | Path | str,
    edges: Iterable[str] = (),
    folder: Path | str | None = None,
    *,
    duration_s: float = 0.0,
    outlets: Iterable[str] = (),
    simulate: bool = False,
) -> LiveSession:
    """A session that runs in the background and hands over every chunk of these edges (left out: those that the graph records).

    with kinegraph.live("treadmill_emg", ["cycles.closed"]) as session:
        for piece in session:                                    # in a notebook: async for
            piece.series.to_pandas()

    folder     where the session is recorded, a new one; None: not at all
    outlets    those that take part ("all": each of them); the others write, send and print nothing
    simulate   simulated devices in the place of real ones

    What is logged goes to Python's `logging`, under "kinegraph", and is shown where that is set up.
    """
    checked = _builder(graph).check()
    wanted = [*edges] or [str(edge) for edge in checked.record]
    return LiveSession(
        checked, wanted, None if folder is None else Path(folder), duration_s, outlets=outlets, simulate=simulate
    )


def replay(
    graph: GraphBuilder | Path | str,
    recording: Recording | Path | str,
    *,
    keep: Iterable[str] = (),
    outlets: Iterable[str] = (),
) -> Results:
    """Run a graph on a recording; its streams replace the sources of the same names.

    `Results.differing` names the edges that came out otherwise than they were recorded.
    """
    return on_recording(_builder(graph), recording, keep, outlets)


def _builder(graph: GraphBuilder | Path | str) -> GraphBuilder:
    return graph if isinstance(graph, GraphBuilder) else GraphBuilder.load(graph)


def try_(operator: type[Operator[Any]], *, examples: int = 50, seed: int = 1) -> None:
    """Hold an operator's class to the laws on its `cases`; raises `Broken`: which law is broken, where, and what to do."""
    for make in trials(operator):
        hold(make(), examples, seed)
