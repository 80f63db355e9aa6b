"""The page: how old a sample is when a client has it, what the page costs the session, meshes, and how soon an hour can be looked at.

    python -m bench.page

A board of 16 channels at 2000 Hz in 10-sample chunks, its envelope, and an operator that notes how old samples are there; the
session is a process of its own; the client with timed messages is a headless WebSocket client in this one, those beside it are in
another of low priority, for people look from machines of their own. Rounds without a page (twice: what these differ by is noise), with
one client, five, twenty, one that reads nothing, and a server that is killed every second take turns; so do timeflux_ui and the Foxglove
SDK's server, where they install. Processor time is of the session's process and of the server's, by their own clocks. `--write` puts it
all into docs/lab/page.md.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Iterable
from typing import Any

import numpy as np

from bench import page_peers, page_recording, page_screen
from bench.page_session import GRAPH, MESH, MESHES_HZ, VERTICES
from bench.page_turns import Turn, both, take_turn
from bench.report import Goal, Section, marks, publish, short, whole

KINDS: dict[str, dict[str, Any]] = {
    "no page": {"page": False, "clients": 0},
    "a page, no client": {"clients": 0},
    "one client": {"clients": 1},
    "five clients": {"clients": 5},
    "twenty clients": {"clients": 20},
    "one client, and one that reads nothing": {"clients": 1, "harm": "stalls"},
    "the server killed every second": {"clients": 0, "harm": "killed"},
    "no page, again": {"page": False, "clients": 0},
}


def live(rounds: int, seconds: float) -> Section:
    """Every kind of company, in turns."""
    turns: dict[str, list[Turn]] = {name: [] for name in KINDS}
    for _ in range(rounds):
        for name, kind in KINDS.items():
            turns[name].append(take_turn(GRAPH, "signal", seconds=seconds, **kind))
    without_page = [float(np.percentile(t.graph, 99)) for t in turns["no page"]]
    against = {
        name: float(np.median([np.percentile(t.graph, 99) / p99 for t, p99 in zip(taken, without_page, strict=True)]))
        for name, taken in turns.items()
    }
    header = [
        "",
        "graph ms p50, p99",
        "p99 against no page",
        "client ms p50, p99",
        "updates/s",
        "session %",
        "server %",
    ]
    rows = [row(name, taken, against[name]) for name, taken in turns.items()]
    noise = apart(float(np.percentile(turn.graph, 99)) for turn in [*turns["no page"], *turns["no page, again"]])
    cost = apart(turn.session for turn in [*turns["no page"], *turns["no page, again"]])
    notes = [
        f"Without a page the turns' p99 differ by up to {short(noise)} times, their processor time by up to {short(cost)} times."
    ]
    return Section(
        f"The page of 16 channels at 2000 Hz, {rounds} rounds of {seconds:g} s",
        header,
        rows,
        notes,
        promises(turns, against, noise),
    )


def apart(values: Iterable[float]) -> float:
    """How many times the largest is the smallest."""
    found = [*values]
    return max(found) / min(found)


def row(name: str, taken: list[Turn], against: float) -> list[str]:
    """A line of the table."""
    ages, graph = np.concatenate([t.ages for t in taken]), np.concatenate([t.graph for t in taken])
    middle = [100 * float(np.median([getattr(t, what) for t in taken])) for what in ("session", "server")]
    seen = [both(ages), short(float(np.median([t.updates for t in taken])))] if len(ages) else ["", ""]
    return [name, both(graph), short(against), *seen, *map(short, middle)]


def promises(turns: dict[str, list[Turn]], against: dict[str, float], noise: float) -> list[Goal]:
    """What was promised of all that."""
    without_page, one, five = (turns[name] for name in ("no page", "one client", "five clients"))
    ages = np.concatenate([t.ages for t in one])
    ratio = float(np.median([a.session / b.session for a, b in zip(one, without_page, strict=True)]))
    harmless = [name for name in KINDS if name.startswith(("twenty", "one client, and", "the server killed"))]
    return [
        Goal("page: sample to message, p50", float(np.percentile(ages, 50)), 40, "ms"),
        Goal("page: sample to message, p99", float(np.percentile(ages, 99)), 100, "ms"),
        Goal("page: updates", float(np.median([t.updates for t in one])), 29.0, "/s", least=True),
        Goal("page: session's processor time with one client, against no page", ratio, 1.1, "times"),
        Goal("page: graph's p99 latency with one client, against no page", against["one client"], 1.1, "times"),
        *(
            Goal(f"page: graph's p99 latency, {name}, against no page", against[name], max(1.1, noise), "times")
            for name in harmless
        ),
        Goal("page: server, one client", 100 * float(np.median([t.server for t in one])), 10, "% of a core"),
        Goal("page: server, five clients", 100 * float(np.median([t.server for t in five])), 25, "% of a core"),
    ]


def meshes(seconds: float) -> Section:
    """One client, every mesh."""
    turn = take_turn(MESH, "mesh", 1, seconds)
    ages = [short(float(np.percentile(turn.ages, q))) for q in (50, 99)]
    row = [
        f"{VERTICES} vertices at {MESHES_HZ:g}/s",
        ", ".join(ages),
        short(turn.updates),
        short(100 * turn.session),
        short(100 * turn.server),
    ]
    goal = Goal("page: meshes to a client", turn.updates, 29.0, "/s", least=True)
    return Section("Meshes", ["", "client ms p50, p99", "updates/s", "session %", "server %"], [row], goals=[goal])


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.page", description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=10.0, help="of each turn")
    parser.add_argument("--minutes", type=float, default=60.0, help="of the recording that is looked at")
    parser.add_argument("--no-peers", action="store_true", help="without timeflux_ui and the Foxglove SDK's server")
    parser.add_argument("--write", action="store_true", help="write goals and tables into docs/lab/page.md")
    given = parser.parse_args()
    load = os.getloadavg()[0]
    sections = [live(given.rounds, given.seconds), meshes(given.seconds)]
    sections += [] if given.no_peers else [page_peers.beside(given.rounds, given.seconds)]
    sections += [page_screen.drawn(given.seconds), page_recording.looked(given.minutes, 50)]
    about = f"Load average at the start {load:.1f}, at the end {os.getloadavg()[0]:.1f}, on {os.cpu_count()} cores."
    print(whole(sections, about))
    if given.write:
        publish(sections, about, "lab/page.md", *marks("bench.page"))


if __name__ == "__main__":
    main()
