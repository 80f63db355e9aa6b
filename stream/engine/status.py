"""The state of a running session as one table: what flows where, how long it takes, what waits, what was lost."""

from __future__ import annotations

import time
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, TypeAlias

from stream.engine.metrics import rounded

if TYPE_CHECKING:
    from stream.engine.intake import Intake
    from stream.engine.lanes import Lanes
    from stream.engine.pipeline import Pipeline, Stage
    from stream.recording import RecorderStatus

Table: TypeAlias = dict[str, dict[str, Any]]
"""Per stream of a source ("board.emg"), per node, and for "recording": named numbers with units in their names."""


def table_of(
    pipeline: Pipeline,
    intakes: Iterable[Intake],
    lanes: Lanes,
    recording: RecorderStatus | None,
    before: Table | None = None,
) -> Table:
    """The table now; `before` is the one read last, for rates. Reading it starts a new interval of the timings."""
    now = time.monotonic()
    pipeline.fold(least=1)
    table: Table = {}
    for intake in intakes:
        table[intake.stream] = _source_row(intake, now)
    for name, stage in pipeline.stages.items():
        table[name] = _stage_row(stage, lanes)
    for name, row in table.items():
        old = (before or {}).get(name)
        row["at_s"] = round(now, 3)
        row["rate_hz"] = (
            round((row["samples"] - old["samples"]) / (now - old["at_s"]), 2) if old and now > old["at_s"] else 0.0
        )
    if recording:
        table["recording"] = recording_row(recording)
    return table


def recording_row(recording: RecorderStatus) -> dict[str, Any]:
    """How the recorder does; once it has been closed, `behind_s` is what it could not write at the end."""
    return {
        "kind": "recording",
        "bytes": recording.bytes,
        "behind_s": round(recording.behind_s, 2),
        "dropped_chunks": sum(recording.dropped.values()),
        "error": recording.error,
    }


def _source_row(intake: Intake, now: float) -> dict[str, Any]:
    runner, wire = intake.runner, intake.wire
    channel = runner.channels[intake.output]
    first = channel is next(iter(runner.channels.values()))
    return {
        "kind": "source",
        "state": "stale" if intake.stale else runner.state,
        "samples": wire.samples,
        "age_s": round(now - intake.last, 3),
        "queue": channel.depth,
        "queue_limit": channel.limit,
        "dropped": channel.dropped,
        "late": intake.late,
        "gaps": wire.gaps,
        "lost": wire.lost,
        "openings": runner.openings,
        "problems": dict(runner.problems) if first else {},
        "clock": dict(runner.clock_facts) if first else {},
        "error": runner.error if runner.state == "failed" or not runner.ready else "",
    }


def _stage_row(stage: Stage, lanes: Lanes) -> dict[str, Any]:
    queues = [
        c for name, c in lanes.channels.items() if name.partition(" -> ")[2].rpartition(".")[0] == stage.node.name
    ]
    return {
        "kind": "outlet" if stage.node.is_outlet else "operator",
        "lane": stage.lane,
        "samples": sum(wire.samples for wire in stage.feeds),
        **rounded(stage.timing.read()),
        "queue": sum(c.depth for c in queues),
        "dropped": sum(c.dropped for c in queues),
        "gaps": sum(w.gaps for w in stage.wires.values()),
        "error": stage.failed,
    }
