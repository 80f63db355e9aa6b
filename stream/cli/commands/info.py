"""`kinegraph info`: what a recording holds."""

from __future__ import annotations

import json
import sys
from collections import Counter
from itertools import combinations
from pathlib import Path as File
from textwrap import fill
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.text.time_text import duration, moment, rate

if TYPE_CHECKING:
    from rich.table import Table

    from kinegraph.stream.recording import RecordedStream, Recording
    from kinegraph.stream.text.screen import Screen

ANNOTATIONS = "annotations"
"""The stream of marks that a session always has."""
WIDE = 120
"""Columns from which the table says what a stream holds; in fewer it stands below."""
SHOWN = 20
"""Lines of the log, and annotations, that are shown; --all shows the rest."""


def info(
    recording: Annotated[File, typer.Argument(help="the recording: a file or a session's folder", metavar="FILE")],
    as_json: Annotated[bool, typer.Option("--json", help="everything as JSON")] = False,
    everything: Annotated[bool, typer.Option("--all", help="every line of the log and every annotation")] = False,
    graph: Annotated[bool, typer.Option("--graph", help="only the graph that made it, as YAML")] = False,
) -> None:
    """Show a recording's streams, rates, durations, gaps, drops, annotations, log, versions, and the graph that made it."""
    from kinegraph.stream.data.bounded import reading
    from kinegraph.stream.recording import Recording
    from kinegraph.stream.text.safe_text import plain
    from kinegraph.stream.text.screen import Screen

    with reading(recording, "a recording"), Recording.open(recording) as opened:
        if graph:
            text = str(opened.header.get("graph", ""))
            typer.echo(plain(text) if sys.stdout.isatty() else text, nl=False)
        elif as_json:
            typer.echo(json.dumps(facts(opened), indent=2))
        else:
            _show(Screen(), opened, None if everything else SHOWN)


def facts(recording: Recording) -> dict[str, Any]:
    """What `info` knows, as JSON-like values; times in ns UTC."""
    from kinegraph.stream.domain.finding import recorded_findings

    return {
        "path": str(recording.path),
        "finished": recording.finished,
        "missing": recording.missing.to_json() if recording.missing else None,
        "parts": [{"path": str(p.file.path), "bytes": p.file.size, "finished": p.finished} for p in recording.parts],
        "duration_s": recording.duration_ns / 1e9,
        "header": recording.header,
        "streams": {name: _stream_facts(stream) for name, stream in recording.streams.items()},
        "devices": devices(recording),
        "clocks": clocks(recording),
        "annotations": marks(recording),
        "findings": [{**finding.facts(), "text": finding.text} for finding in recorded_findings(recording)],
        "log": recording.log,
    }


def _stream_facts(stream: RecordedStream) -> dict[str, Any]:
    return {
        "role": stream.role,
        "kept": stream.kept,
        **stream.spec.to_json(),
        **{
            name: getattr(stream, name)
            for name in ("samples", "chunks", "first", "last", "gaps", "lost", "dropped", "begin", "end")
        },
        "duration_s": stream.duration_s,
        "measured_hz": stream.rate_hz,
    }


def devices(recording: Recording) -> dict[str, dict[str, Any]]:
    """By source: its last report on its device, {"device": kind, "serial": ..., "firmware": ...}."""
    entries = [entry for entry in recording.log if entry["kind"] == "device"]
    hidden = ("time", "kind", "node", "level")
    return {str(e.get("node")): {k: v for k, v in e.items() if k not in hidden} for e in entries}


def clocks(recording: Recording) -> dict[str, dict[str, Any]]:
    """By source: what was known last of its device's clock, {"offset_s", "drift_ppm", "uncertainty_s", "settling", ...}.

    settled_within_s: as far off stamps may be from before its drift was known, at the start and after each jump.
    """
    known: dict[str, dict[str, Any]] = {}
    sources = {str(entry["node"]) for entry in recording.log if entry.get("node")}
    for entry in recording.metrics():
        for stream, row in entry["table"].items():
            if clock := row.get("clock"):
                node = next((n for n in sources if stream == n or stream.startswith(f"{n}.")), stream.partition(".")[0])
                before = known.get(node, {}).get("settled_within_s", 0.0)
                now = clock["uncertainty_s"] if clock["settling"] else 0.0
                known[node] = {**clock, "settled_within_s": max(before, now)}
    return known


def agreement(known: dict[str, dict[str, Any]]) -> list[str]:
    """How far apart the stamps of two devices may be beside the constant parts of their delays, in words, for each pair."""
    rows = []
    for (a, first), (b, second) in combinations(known.items(), 2):
        apart = first["uncertainty_s"] + second["uncertainty_s"]
        unsure = " (still settling)" if first["settling"] or second["settling"] else ""
        rows.append(f"{a} and {b} agree within {1e3 * apart:.1f} ms{unsure}")
    return rows


def marks(recording: Recording) -> list[dict[str, Any]]:
    """The marks that were set: {"time": ns, field: value, ...}."""
    if ANNOTATIONS not in recording.streams or not recording.streams[ANNOTATIONS].spec.is_event:
        return []
    times, data = recording.read(ANNOTATIONS)
    names = data.dtype.names or ()
    return [
        {"time": t, **dict(zip(names, row, strict=True))} for t, row in zip(times.tolist(), data.tolist(), strict=True)
    ]


def _show(console: Screen, recording: Recording, most: int | None) -> None:
    from rich.text import Text

    from kinegraph.stream.domain.finding import REPORT, recorded_findings

    header = recording.header
    lacking = f"; missing: {recording.missing.words}" if recording.missing else ""
    broken_off = not all(part.finished for part in recording.parts)
    how = f"not closed cleanly{lacking}; `kinegraph recover` finishes it" if broken_off else f"not complete{lacking}"
    state = "" if recording.finished else f" ({how})"
    size = sum(part.file.size for part in recording.parts) / 1e6
    parts = f", {len(recording.parts)} parts" if len(recording.parts) > 1 else ""
    text = f": {duration(recording.duration_ns / 1e9)}, {size:.1f} MB{parts}"
    console.print(Text.assemble((str(recording.path), "bold"), (state, "yellow"), text))
    if (
        recording.streams
        and (first := min((s.first for s in recording.streams.values() if s.first is not None), default=None))
        is not None
    ):
        console.print(f"begins {moment(first)}")
    for title in ("session", "imported", "versions"):
        if header.get(title):
            known = {k: v for k, v in header[title].items() if k != "findings"}
            console.print(f"{title}: " + ", ".join(f"{k} {_listed(v)}" for k, v in known.items()))
    if header.get("graph"):
        console.print(f"graph: {header.get('name') or header.get('graph_path') or ''} (--graph prints it)")
    for node, known in devices(recording).items():
        console.print(f"device {node}: " + ", ".join(f"{k} {v}" if k != "device" else str(v) for k, v in known.items()))
    for line in _clock_lines(clocks(recording)):
        console.print(line)
    wide = console.width >= WIDE
    console.print(_streams(recording, wide))
    for name, stream in recording.streams.items() if not wide else ():
        console.print(fill(f"{name}: {_what(stream)}", console.width, subsequent_indent="    "))
    _list(console, "findings", [finding.text for finding in recorded_findings(recording)], None)
    _list(console, "annotations", [_line(a) for a in marks(recording)], most)
    log = [entry for entry in recording.log if entry["kind"] != REPORT]
    _list(console, "log", [_line(entry) for entry in log], most)
    if most is not None and len(log) > most:
        console.print(
            "  in total: " + ", ".join(f"{kind} {n}" for kind, n in Counter(entry["kind"] for entry in log).items())
        )


def _clock_lines(known: dict[str, dict[str, Any]]) -> list[str]:
    lines = []
    for node, clock in known.items():
        before = clock["settled_within_s"]
        settling = (
            ", still settling"
            if clock["settling"]
            else f" (until it had settled: {1e3 * before:.1f} ms)"
            if before
            else ""
        )
        jumps = f", set or restarted {clock['jumps']} times" if clock["jumps"] else ""
        lines.append(
            f"clock {node}: within {1e3 * clock['uncertainty_s']:.1f} ms{settling}, drift {clock['drift_ppm']:.1f} ppm, "
            f"offset {clock['offset_s']:.6f} s{jumps}"
        )
    return lines + agreement(known)


def _streams(recording: Recording, wide: bool) -> Table:
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0))
    for heading, justify in (
        *(("stream", "left"), ("role", "left"), ("samples", "right"), ("duration", "right"), ("measured Hz", "right")),
        *(("gaps", "right"), ("lost", "right"), ("dropped", "right"), *([("what", "left")] if wide else [])),
    ):
        table.add_column(heading, justify="right" if justify == "right" else "left", overflow="fold")
    for name, s in recording.streams.items():
        measured = rate(s.rate_hz, 2) if s.spec.rate_hz and s.rate_hz else ""
        table.add_row(
            *(
                name,
                s.role,
                str(s.samples),
                duration(s.duration_s),
                measured,
                str(s.gaps),
                str(s.lost),
                str(s.dropped),
                *([_what(s)] if wide else []),
            )
        )
    return table


def _listed(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)


def _what(stream: RecordedStream) -> str:
    return stream.spec.describe() + (" (only their stamps are recorded)" if stream.kept == "outline" else "")


def _list(console: Screen, title: str, lines: list[str], most: int | None) -> None:
    if not lines:
        return
    console.print(f"{title}: {len(lines)}")
    for line in lines[:most]:
        console.print(f"  {line}")
    if most is not None and len(lines) > most:
        console.print(f"  ... and {len(lines) - most} more (--all)")


def _line(entry: dict[str, Any]) -> str:
    rest = {k: v for k, v in entry.items() if k not in ("time", "kind", "onset", "level")}
    words = " ".join(f"{k}={v}" if k != "text" else str(v) for k, v in rest.items())
    return " ".join(filter(None, [moment(int(entry.get("onset", entry["time"]))), entry.get("kind", ""), words]))
