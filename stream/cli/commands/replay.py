"""`kinegraph replay`: a recording through a graph, with a progress bar and a comparison with what was recorded."""

from __future__ import annotations

import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.cli.commands.graph_options import GraphFile, Quiet, Settings, TrustedOnly
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.cli.commands.page_options import NoToken, PageAt, PageAvatar
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.short_names import whole_name

if TYPE_CHECKING:
    from kinegraph.stream.engine.pace import Pace
    from kinegraph.stream.engine.replay import Replay, Replayed
    from kinegraph.stream.engine.substitutes import Substitutes
    from kinegraph.stream.graph import Graph
    from kinegraph.stream.recording import Recording


def replay(
    config: GraphFile,
    recording: Annotated[
        Path, typer.Argument(help="a recording: an .mcap file, or a session's folder", metavar="FILE")
    ],
    settings: Settings = None,
    speed: Annotated[float, typer.Option(help="how many times real time; 0: as fast as possible", min=0.0)] = 0.0,
    out: Annotated[
        Path | None, typer.Option("-o", "--out", help="record the graph's edges into this folder or .mcap file")
    ] = None,
    speak: Annotated[
        list[str] | None, typer.Option("--speak", metavar="OUTLET", help="let this outlet speak; 'all': every outlet")
    ] = None,
    verify: Annotated[
        bool,
        typer.Option(
            "--verify",
            help="exit with 1 unless every recorded edge is reproduced bit for bit, and every node keeps its spec",
        ),
    ] = False,
    page: Annotated[
        bool,
        typer.Option("--page", help="show the replay in a browser, at --speed 1 by default; prints the address"),
    ] = False,
    page_at: PageAt = "",
    no_token: NoToken = False,
    avatar: PageAvatar = None,
    as_json: AsJson = False,
    quiet: Quiet = False,
    trusted_only: TrustedOnly = False,
) -> None:
    """Run a graph on a recording: its streams replace the sources of the same names.

    The graph gives what it gave live, bit for bit. Outlets (files, networks) stay silent unless asked with --speak.
    """
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.cli.commands.run import page_of
    from kinegraph.stream.engine.pace import Pace
    from kinegraph.stream.engine.replay import Replay
    from kinegraph.stream.graph.reading.overrides import read
    from kinegraph.stream.recording import Recording

    logs.set_up()
    with Recording.open(recording) as source:
        asked = read(settings or [])
        recorded = _recorded(source, recording, verify)

        def graph_again(quiet: bool) -> Graph:
            graph = _graph_of(config, source, asked, trusted_only)
            _take_facts(graph, source.header.get("session") or {}, asked, quiet=quiet)
            return graph

        graph = graph_again(quiet or as_json)
        speaking = _speaking(graph, speak or [])
        shown = (
            page_of(graph, page_at, mode="replay", avatar=avatar, no_token=no_token)
            if page or page_at or avatar
            else None
        )
        pace = Pace(speed or 1.0, forwards_only=out is not None) if shown else speed or None

        def replay_of(graph: Graph) -> Replay:
            return Replay(graph, source, speaking=speaking, speed=pace, output=out, strict=verify)

        run = replay_of(graph)
        if not as_json:
            _report_missing(run.substitutes)
        if shown and isinstance(pace, Pace):
            run, result = _on_page(shown, pace, run, lambda: replay_of(graph_again(True)), quiet)
        else:
            result = _with_progress(run, quiet)
    if as_json:
        print_json(_facts_of(result, run.substitutes))
    else:
        _report(result)
    if verify and not _same(recorded, result, run, source, err=as_json):
        sys.exit(1)
    _check_whole(result, run, source)


def _facts_of(result: Replayed, of: Substitutes) -> dict[str, Any]:
    """How a replay went, for programs."""
    outputs = {
        name: {"recorded": recorded, "replayed": replayed, "identical": recorded == replayed}
        for name, (recorded, replayed) in result.digests.items()
    }
    return {
        "seconds": result.seconds,
        "took_s": result.took_s,
        "stopped": result.stopped,
        "outputs": outputs,
        "broken": result.broken,
        "not_recorded": list(of.missing),
        "from_recording": list(of.taken),
        "not_computed": list(of.silent),
    }


def _on_page(shown: Any, pace: Pace, run: Replay, again: Callable[[], Replay], quiet: bool) -> tuple[Replay, Replayed]:
    """Replay on a page, once more whenever somebody there goes back; the last run, and how it went."""
    shown.replays(run)
    with shown:
        while True:
            result = _with_progress(run, quiet)
            if pace.again is None:
                return run, result
            pace.begin_again()
            run = again()
            shown.replays(run)


def _recorded(source: Recording, path: Path, verify: bool) -> list[str]:
    """The outputs of a graph that the recording holds. Raises KinegraphError if there is nothing to verify."""
    found = [name for name, stream in source.streams.items() if stream.role == "edge"]
    if verify and not found:
        raise KinegraphError(
            f"--verify: {path} holds no output of a graph, so there is nothing to compare with; name some under `record`"
        )
    return found


def _check_whole(result: Replayed, run: Replay, source: Recording) -> None:
    """Raises NotDelivered, or Incomplete where the recording was not closed cleanly."""
    from kinegraph.stream.engine.shortfall import NotDelivered, shortfalls
    from kinegraph.stream.recording.format.paths import is_running

    if missing := shortfalls(run.pipeline.outlets):
        raise NotDelivered(missing)
    if source.missing and not is_running(source.path):
        raise Incomplete(source.path, result.seconds, source.missing.words)


def _same(recorded: list[str], result: Replayed, run: Replay, source: Recording, *, err: bool = False) -> bool:
    """Whether every recorded edge was reproduced; says which was not compared, and why some may differ."""
    unseen = _not_compared(recorded, result, run.substitutes)
    for name in unseen:
        say(f"  {name}: NOT COMPARED: this graph has no such output", err=err)
    if (result.differing or unseen) and source.header.get("graph") != run.graph.text:
        say(
            f"this graph is not the one that made the recording: `kinegraph info {source.path} --graph` prints it",
            err=err,
        )
    return not (result.differing or result.stopped or result.broken or unseen)


def _graph_of(config: Path, source: Recording, asked: dict[str, Any], trusted_only: bool) -> Graph:
    from kinegraph.stream.graph.reading.load import load

    recorded = {name: stream.spec for name, stream in source.streams.items()}
    return load(config, recorded=recorded, overrides=asked, trusted_only=trusted_only)


class Incomplete(KinegraphError):
    """A recording was replayed that was not closed cleanly: its results are right as far as they go."""

    exit_code = 6

    def __init__(self, path: Path, seconds: float, words: str) -> None:
        super().__init__(
            f"{path}: was not closed cleanly; {seconds:.1f} s were replayed; missing: {words}. `kinegraph recover` completes it"
        )


def _listed(facts: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in facts.items())


def _take_facts(graph: Graph, known: dict[str, Any], asked: dict[str, Any], *, quiet: bool) -> None:
    """Let the graph say of its session what its recording says, and tell where that is something else."""
    written, graph.session = graph.session, _facts(graph.session, known, asked)
    if quiet:
        return
    if written and not known:
        say("the recording holds no facts about its session, and those of the graph are not used:", end=" ")
        say(f"{_listed(written)} (--set session.NAME=VALUE adds one)")
    elif passed_over := {name: value for name, value in written.items() if graph.session.get(name) != value}:
        say("facts about the session come from the recording, not from the graph:", end=" ")
        say(f"{_listed(passed_over)} (--set session.NAME=VALUE overrides one)")


@contextmanager
def _interruptible(run: Replay) -> Iterator[None]:
    """Within: Ctrl-C stops the replay cleanly; a second one breaks it off."""
    before = signal.getsignal(signal.SIGINT)

    def stop(*_: object) -> None:
        run.stop()
        signal.signal(signal.SIGINT, before)

    signal.signal(signal.SIGINT, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _facts(written: dict[str, Any], recorded: dict[str, Any], overrides: dict[str, Any]) -> dict[str, Any]:
    """What is known of the session: what its recording says; the command line has the last word. What the graph says is of others."""
    asked = {name.partition(".")[2] for name in overrides if name.startswith("session.")}
    return recorded | {name: written[name] for name in asked if name in written}


def _speaking(graph: Graph, asked: list[str]) -> set[str]:
    outlets = graph.outlets
    asked = [whole_name(name, outlets) for name in asked]
    for name in asked:
        if name != "all" and name not in outlets:
            raise KinegraphError(f"--speak: there is no outlet {name!r}; {nearest(name, outlets)}")
    return outlets if "all" in asked else set(asked)


def _report_missing(of: Substitutes) -> None:
    """What cannot be computed, for want of images, and what is taken from the recording instead."""
    if of.missing:
        say(
            f"the images of {', '.join(of.missing)} were not recorded (a graph records images that it names under `record`)"
        )
    if of.taken:
        say(f"  taken from the recording: {', '.join(of.taken)}")
    if of.silent:
        say(f"  not computed: {', '.join(of.silent)}")


def _with_progress(run: Replay, quiet: bool) -> Replayed:
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    from kinegraph.stream.text.progress import FirstAndLast
    from kinegraph.stream.text.screen import Screen

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.completed:.0f} of {task.total:.0f} s"),
        TimeRemainingColumn(),
    )
    console = Screen(stderr=True)
    off = quiet or not console.is_terminal
    with _interruptible(run), Progress(*columns, console=console, disable=off) as bar:
        task = bar.add_task("replay", total=max(run.recording.duration_ns / 1e9, 1e-9))
        if not off:
            run.starting = lambda text, over: bar.update(task, description="replay" if over else text)
        elif not quiet:
            run.starting = FirstAndLast()
        return run.run(lambda done_s: bar.update(task, completed=done_s))


def _not_compared(recorded: list[str], result: Replayed, of: Substitutes) -> list[str]:
    """Recorded edges that the graph did not compute again, though no image is missing for them."""
    return [
        name for name in recorded if name not in result.digests and not {name, name.rpartition(".")[0]} & of.idle.keys()
    ]


def _report(result: Replayed) -> None:
    pace = f", {result.seconds / result.took_s:.0f} times real time" if result.took_s > 0 else ""
    say(f"replayed {result.seconds:.1f} s in {result.took_s:.2f} s{pace}{' (stopped)' if result.stopped else ''}")
    for name, (recorded, replayed) in result.digests.items():
        say(
            f"  {name}: {'identical to the recording' if recorded == replayed else 'DIFFERS from the recording'} ({replayed})"
        )
    for name, what in result.broken.items():
        say(f"  {name}: BREAKS ITS SPEC: gave {what}")
