"""Where a report lies: with the recording of its session, unless a path is given."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path

from kinegraph.stream.graph import Graph

ELSEWHERE = Path("reports")
"""The folder of reports on what is not recorded."""
SUFFIXES = (".html", ".csv", "-curves.csv", "-remarks.csv", ".xlsx", ".mat")


def page_of(given: str, graph: Graph | None, node: str) -> Path:
    """The page's file, absolute: as `given`; else NODE.html in the session's folder, RECORDING-NODE.html beside a recording of one file.

    Without a recording, it is reports/GRAPH-NODE.html. A node that is called like its part ("report.report") stands for the part.
    """
    node = ".".join(word for word, _ in groupby(node.split(".")))
    if given:
        return Path(given).absolute()
    recorded = Path(graph.recorded_in) if graph and graph.recorded_in else None
    if recorded is None:
        return (ELSEWHERE / f"{graph.name if graph else 'session'}-{node}.html").absolute()
    if recorded.suffix == ".mcap":
        return recorded.with_name(f"{recorded.stem}-{node}.html").absolute()
    return (recorded / f"{node}.html").absolute()


def recording_of(graph: Graph | None) -> str:
    """What the recording is called that a report is about: the one replayed, else the one being made, or ""."""
    return graph.replays or Path(graph.recorded_in).name if graph else ""


def free_stem(stem: Path) -> Path:
    """`stem`, or the first of stem-2, stem-3, ... of which neither page nor table exists."""
    number, free = 1, stem
    while any(free.with_name(free.name + suffix).exists() for suffix in SUFFIXES):
        number += 1
        free = stem.with_name(f"{stem.name}-{number}")
    return free
