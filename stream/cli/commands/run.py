"""`kinegraph run`: a live session, with its recording, its metrics on the screen, and a clean end."""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from importlib.metadata import entry_points
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from kinegraph.stream.cli.commands.graph_options import GraphFile, Settings, TrustedOnly
from kinegraph.stream.cli.commands.page_options import NoToken, PageAt, PageAvatar, PageCertificate, PageKey
from kinegraph.stream.errors import Interrupted, KinegraphError, RecordingError
from kinegraph.stream.source import Source
from kinegraph.stream.system.entry_points import loaded
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.time_text import for_names

if TYPE_CHECKING:
    from kinegraph.stream.engine.session import SessionPage
    from kinegraph.stream.engine.status import Outcome
    from kinegraph.stream.graph import Graph


def run(
    config: GraphFile,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option("-o", "--out", help="the session's folder (default: a new one in the graph's recording folder)"),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="continue the interrupted session in --out, or else the newest one")
    ] = False,
    record: Annotated[bool, typer.Option("--record/--no-record", help="keep a recording of the session")] = True,
    duration_s: Annotated[
        float,
        typer.Option(
            "--for", metavar="SECONDS", min=0.0, help="end after this many seconds; 0: when stopped or all sources end"
        ),
    ] = 0.0,
    simulate: Annotated[
        bool, typer.Option("--simulate", help="use simulated devices instead of real ones, with the real protocols")
    ] = False,
    view: Annotated[str, typer.Option(help="how the session is shown: auto, live, lines or none")] = "auto",
    page: Annotated[bool, typer.Option("--page", help="show the session in a browser; prints the address")] = False,
    page_at: PageAt = "",
    page_certificate: PageCertificate = "",
    page_key: PageKey = "",
    no_token: NoToken = False,
    avatar: PageAvatar = None,
    foxglove: Annotated[
        bool, typer.Option("--foxglove", help="serve the session to Foxglove on this machine (extra `foxglove`)")
    ] = False,
    json_log: Annotated[bool, typer.Option("--log-json", help="log lines as JSON")] = False,
    verbose: Annotated[bool, typer.Option("-v", "--verbose", help="log more")] = False,
    trusted_only: TrustedOnly = False,
) -> None:
    """Run a graph on live devices, and record the session.

    With --page on a terminal, and without --for, the page stays when the session has ended, with its report, until Ctrl-C. With --for, or
    where standard input or output is no terminal, the command ends with the session.

    While it runs: type a word and Enter to annotate a moment, a digit or the space bar to mark it at once, name=number to set a value.
    Ctrl-C ends the session cleanly; a second one aborts whatever hangs.

    Exit codes: 0 success; 2 the graph or an argument is wrong; 3 a device is missing; 4 an operator stopped the graph; 5 an outlet or the
    recording lost data; 7 the session took more memory than memory_mb.
    """
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.graph.plan import plan
    from kinegraph.stream.graph.reading.load import load
    from kinegraph.stream.graph.reading.overrides import read
    from kinegraph.stream.recording.format.paths import SUFFIX, refuse_taken_folder
    from kinegraph.stream.system.malloc_tuning import map_large_pieces

    map_large_pieces()
    logs.set_up(json=json_log, verbose=verbose)
    if not isfinite(duration_s):
        raise KinegraphError(f"--for {duration_s}: it must be a number of seconds")
    if out and out.suffix == SUFFIX:
        raise RecordingError(f"--out {out}: a session's recording is a folder; name it without {SUFFIX}")
    graph = load(config, overrides=read(settings or []), trusted_only=trusted_only)
    plan(graph)
    folder = session_folder(graph, out, resume) if record or resume else None
    if folder and not resume:
        refuse_taken_folder(folder)
    asked = page or page_at or avatar or graph.page.serve
    pages = [page_of(graph, page_at, page_certificate, page_key, avatar=avatar, no_token=no_token)] if asked else []
    pages += [page_of(graph, name="foxglove")] if foxglove else []
    conduct(graph, folder, resume=resume, duration_s=duration_s, view=view, simulate=simulate, pages=pages)


def conduct(
    graph: Graph,
    folder: Path | None,
    *,
    resume: bool = False,
    duration_s: float = 0.0,
    view: str = "auto",
    simulate: bool = False,
    pages: Sequence[SessionPage] = (),
    begun: Callable[[], None] | None = None,
    farewell: Sequence[str] = (),
) -> NoReturn:
    """Run a session from start to end, with its view and its console, and exit with its code.

    begun      called when the pages are served, before anything compiles
    farewell   further lines for the end of a session that was recorded
    """
    from kinegraph.stream.cli.commands.console import Console
    from kinegraph.stream.cli.commands.ending import Ending
    from kinegraph.stream.engine.session import Session
    from kinegraph.stream.engine.status import Views

    with simulated(graph) if simulate else nullcontext():
        screen = _screen(view, graph)
        views = Views((screen, *pages))
        session = Session(graph, folder, resume=resume, duration_s=duration_s, view=views)
        session.probe()
        for page in pages:
            page.attach(session)
        ending = Ending(session, _report_end)
        with ending, ending.shown as shown:
            served = shown.enter_context(ExitStack())
            for page in pages:
                served.enter_context(page)
            if begun:
                begun()
            shown.enter_context(Console(session).listening())
            shown.enter_context(screen)
            outcome = session.run()
            stays = bool(pages) and not duration_s and on_terminal() and session.asked_by in ("", "SIGINT")
            served = served.pop_all() if stays else served
    _report_end(outcome)
    for line in farewell if _is_recorded(outcome) else ():
        say(line, err=True)
    if stays:
        with served, suppress(Interrupted):
            for page in pages:
                page.rest(outcome)
            say("the session has ended; its page stays until Ctrl-C", err=True)
            _wait_for_interrupt()
    _leave(outcome.exit_code)


def on_terminal() -> bool:
    """Whether a person is there to end what stays."""
    return bool(sys.stdin and sys.stdin.isatty() and sys.stdout.isatty())


def _wait_for_interrupt() -> None:
    threading.Event().wait()


def _leave(code: int) -> NoReturn:
    """Exit, at once where a source's thread is still in a library's call: taken down within it, C++ would end the process by a signal."""
    if any(thread.name.startswith("source ") for thread in threading.enumerate()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


@contextmanager
def simulated(graph: Graph) -> Iterator[None]:
    """Within: every source that has a simulated device reads that one; the recording says which they are."""
    with ExitStack() as devices:
        for node in graph.sources:
            assert isinstance(node.part, Source)
            device = node.part.simulated()
            if device is not None:
                node.part = devices.enter_context(device)
                graph.session.setdefault("simulated_sources", []).append(node.name)
        yield


def session_folder(graph: Graph, out: Path | None, resume: bool = False) -> Path:
    """Where the session's recording goes: `out`, else a new folder in the graph's own, or the newest one there to resume."""
    if out:
        return out
    name, recordings = graph.name, Path(graph.recording.folder)
    if not resume:
        return recordings / f"{name}-{for_names()}"
    sessions = sorted(recordings.glob(f"{name}-*Z"))
    if not sessions:
        raise RecordingError(f"there is no session of {name!r} in {recordings} to resume; name its folder with --out")
    return sessions[-1]


def _screen(view: str, graph: Any) -> Any:
    """The view by its name; they come from the entry-point group `kinegraph.views`."""
    if view == "auto":
        view = "live" if sys.stdout.isatty() else "lines"
    for entry in entry_points(group="kinegraph.views", name=view):
        return loaded(entry, "view")(graph)
    names = ", ".join(sorted(e.name for e in entry_points(group="kinegraph.views")))
    raise KinegraphError(f"there is no view {view!r}; valid are auto, {names}")


def page_of(graph: Graph, *address: str, name: str = "page", **more: str | Path | bool | None) -> Any:
    """The page of a graph; from the entry-point group `kinegraph.pages`. Raises KinegraphError if no package provides one."""
    for entry in entry_points(group="kinegraph.pages", name=name):
        return loaded(entry, "page")(graph, *address, **more)
    raise KinegraphError("no page is installed: `pip install kinegraph` has one")


def _is_recorded(outcome: Outcome) -> bool:
    """Whether a recording is left: one that is `rolling` is not."""
    return bool(outcome.folder and any(outcome.folder.glob("*.mcap")))


def _report_end(outcome: Outcome) -> None:
    say(f"session of {outcome.seconds:.1f} s ended{'' if outcome.error is None else ' with an error'}", err=True)
    for name, row in outcome.table.items():
        if row.get("error") and row.get("behind_s"):
            say(f"  {name}: the last {row['behind_s']:.1f} s could not be written and are lost", err=True)
        troubles = {
            k: row[k]
            for k in ("dropped", "late", "gaps", "dropped_chunks", "error", "problems", "findings")
            if row.get(k)
        }
        if troubles.get("error") and str(troubles["error"]) in str(outcome.error):
            troubles["error"] = "as below"
        if row.get("openings", 0) > 1:
            troubles["openings"] = row["openings"]
        if troubles:
            say(f"  {name}: {json.dumps(troubles)}", err=True)
    for name, why in outcome.missing.items():
        say(f"not delivered: {name}: {why}", err=True)
    for node, file in outcome.files.items():
        say(f"{node}: {file}", err=True)
    if _is_recorded(outcome):
        say(f"recording: {outcome.folder}", err=True)
    if outcome.error:
        say(f"kinegraph: {outcome.error}", err=True)
