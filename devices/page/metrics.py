"""A session's metrics as OpenMetrics text, for Prometheus and whatever else reads it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple


class Family(NamedTuple):
    """name, kind   as OpenMetrics says
    key             in the session's table
    scale           from the table's unit to OpenMetrics' base unit
    """

    name: str
    kind: str
    key: str
    help: str
    scale: float = 1.0


FAMILIES = (
    Family("samples", "counter", "samples", "Samples that a stream or a node has given."),
    Family("rate_hertz", "gauge", "rate_hz", "Samples per second over the last ten seconds of sample time."),
    Family("age_seconds", "gauge", "age_s", "Time since a source's last chunk."),
    Family("call_p50_seconds", "gauge", "p50_us", "Median time of a node's call.", 1e-6),
    Family("call_p99_seconds", "gauge", "p99_us", "99th percentile of the time of a node's call.", 1e-6),
    Family("call_cpu_ratio", "gauge", "cpu_pct", "Part of a core that a node's calls take.", 0.01),
    Family("queue_chunks", "gauge", "queue", "Chunks that wait."),
    Family("dropped", "counter", "dropped", "Chunks dropped because a queue was full."),
    Family("late_samples", "counter", "late", "Samples dropped because they came after their watermark."),
    Family("gaps", "counter", "gaps", "Places in a stream where samples are missing."),
    Family("openings", "counter", "openings", "How often a source was opened."),
    Family("recorded_bytes", "counter", "bytes", "Bytes written to the recording."),
    Family("recording_behind_seconds", "gauge", "behind_s", "How far the recorder is behind."),
)


def openmetrics(session: str, table: Mapping[str, Mapping[str, Any]], clients: int, dropped: int) -> str:
    """The text behind `/metrics`."""
    lines: list[str] = []
    for family in FAMILIES:
        rows = {name: row[family.key] for name, row in table.items() if isinstance(row.get(family.key), int | float)}
        if rows:
            _add(lines, family.name, family.kind, family.help, {
                f'{{session="{_label(session)}",node="{_label(name)}"}}': value * family.scale for name, value in rows.items()
            })  # fmt: skip
    failed = {
        f'{{session="{_label(session)}",node="{_label(n)}"}}': 1.0 for n, row in table.items() if row.get("error")
    }
    _add(lines, "failed", "gauge", "Nodes that report an error: 1.", failed)
    _add(lines, "page_clients", "gauge", "Browsers that look at the page.", {"": float(clients)})
    _add(
        lines,
        "page_dropped_views",
        "counter",
        "Chunks that the page did not get in time; the graph did.",
        {"": float(dropped)},
    )
    return "\n".join([*lines, "# EOF", ""])


def _add(lines: list[str], name: str, kind: str, text: str, values: Mapping[str, float]) -> None:
    ending = "_total" if kind == "counter" else ""
    lines += [f"# TYPE kinegraph_{name} {kind}", f"# HELP kinegraph_{name} {text}"]
    lines += [f"kinegraph_{name}{ending}{labels} {value:.12g}" for labels, value in values.items()]


def _label(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
