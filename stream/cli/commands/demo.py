"""`kinegraph demo`: a simulated session in the browser, which loses a second on purpose and leaves a report."""

from __future__ import annotations

import os
import sys
import webbrowser
from dataclasses import dataclass
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.page_options import PageAt
from kinegraph.stream.cli.commands.run import conduct, on_terminal, page_of, session_folder
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.safe_text import say

UNATTENDED_S = 30.0
"""How long a demo runs where it cannot be stopped."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY")


@dataclass(frozen=True, slots=True)
class Demo:
    """One demo.

    graph      a shipped graph
    settings   as --set takes them
    watch      what to look out for
    """

    graph: str
    settings: tuple[str, ...]
    watch: str


DEMOS = {
    "treadmill": Demo(
        "treadmill_emg",
        ("treadmill.faults=[{kind: lost, from_s: 12, for_s: 1}]",),
        "somebody walks on a treadmill. After 12 s one second of the signals is lost on purpose: the curves show a gap, and the cycles "
        "in it do not count",
    ),
    "night": Demo(
        "bedside_simulated",
        ("camera.faults=[[gone, 7200, 600]]",),
        "a night in about half a minute. After two hours the camera is gone for ten minutes on purpose: the hypnogram leaves them out",
    ),
    "avatar": Demo(
        "avatar_markers",
        ("performer.lost=[12, 1]",),
        "an avatar follows somebody's markers. After 12 s one second is lost on purpose: the avatar stands still, the curves show a gap",
    ),
    "repetitions": Demo(
        "count_repetitions",
        (),
        "somebody with a sensor on the foot: repetitions are found and counted",
    ),
}  # fmt: skip


def demo(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="treadmill, night, avatar or repetitions")
    ] = "treadmill",
    duration_s: Annotated[
        float,
        typer.Option("--for", metavar="SECONDS", min=0.0, help="end after this many seconds; 0: at Ctrl-C"),
    ] = 0.0,
    page_at: PageAt = "",
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open the page in a browser")] = True,
) -> None:
    """Show a simulated session in the browser: treadmill, night, avatar or repetitions.

    It runs until Ctrl-C, and all but `repetitions` lose data on purpose. Then the page stays, with the report, until the next Ctrl-C. It
    is recorded like any session. With --for, or where standard input or output is no terminal (there it runs for 30 s), it ends with the
    session.
    """
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.graph.plan import plan
    from kinegraph.stream.graph.reading.load import load
    from kinegraph.stream.graph.reading.overrides import read
    from kinegraph.stream.graph.shipped import shipped
    from kinegraph.stream.system.malloc_tuning import map_large_pieces

    if name not in DEMOS:
        raise KinegraphError(f"there is no demo {name!r}; {nearest(name, DEMOS)}")
    chosen = DEMOS[name]
    map_large_pieces()
    logs.set_up()
    path = shipped().get(chosen.graph)
    if path is None:
        raise KinegraphError("no graphs are installed with kinegraph; install it from a wheel, or work in a checkout")
    graph = load(path, overrides=read(list(chosen.settings)))
    plan(graph)
    folder = session_folder(graph, None)
    page = page_of(graph, page_at)
    say(f"demo {name}: {chosen.watch}.", err=True)
    conduct(
        graph,
        folder,
        duration_s=duration_s or (0.0 if on_terminal() else UNATTENDED_S),
        simulate=True,
        pages=[page],
        begun=(lambda: show(page.address)) if browser else None,
        farewell=(
            f"its recording in a browser:          kinegraph view {folder}",
            f"the session again, with your marks:  kinegraph replay {chosen.graph} {folder} --page",
        ),
    )


def show(address: str) -> None:
    """Open a page in the browser, where there is one with windows. Others on this machine may see the address: a demo has no secrets."""
    if not sys.platform.startswith(("win", "darwin")) and not any(map(os.environ.get, DISPLAYS)):
        return  # what would open there is a browser of text, in this terminal
    try:
        opened = webbrowser.open(address)
    except webbrowser.Error:
        opened = False
    if not opened:
        say(f"no browser could be opened; open {address} in one", err=True)
