"""Going on with a session that was broken off: what was logged after its last checkpoint is worked through once more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter_ns

import structlog

from stream.chunk import NEVER
from stream.engine.clock import SessionClock
from stream.engine.drops import recorded_drops
from stream.engine.intake import Intake
from stream.engine.journal import Former, Journal
from stream.engine.lanes import Lanes
from stream.engine.pipeline import Pipeline
from stream.engine.stand_in import StandIns
from stream.operator import Outlet

log = structlog.get_logger(__name__)


def catch_up(
    former: Former,
    pipeline: Pipeline,
    intakes: Sequence[Intake],
    lanes: Lanes,
    journal: Journal,
    clock: SessionClock,
    pump: Callable[[], None],
) -> None:
    """Work through what was logged after the checkpoint; durable outlets write again what they had written since.

    Images that were not kept are lost to the nodes that read them; what these gave, where it was recorded, takes its way again. `pump`
    takes what lanes send home.
    """
    checkpoint, recording = former.checkpoint, former.recording
    log.info("going on with a broken-off session", folder=str(journal.folder))
    _hush(pipeline, lambda outlet: not outlet.durable)
    pipeline.begin(clock)
    lanes.repeat(recorded_drops(recording.log), checkpoint.indices if checkpoint else {})
    by_name = {intake.stream: intake for intake in intakes}
    stand_ins = StandIns.of(pipeline.graph, recording.streams)
    with stand_ins.at_work(pipeline) as taken:
        after = journal.sequence
        for sequence, stream, chunk, _arrival in recording.inputs(after, also=stand_ins.taken):
            journal.sequence = sequence
            if stream in taken:
                taken[stream].send(chunk, perf_counter_ns())
            elif stream in by_name:
                by_name[stream].promised = max(by_name[stream].promised, chunk.until)
                pipeline.feed(stream, chunk)
            lanes.settle(pump)
    for intake in intakes:
        if intake.ended:
            intake.promised = clock.utc_ns - 1  # it had ended then; now it begins again
        intake.owed = -1  # also where the first chunks, which say so, come before the common start
    _hush(pipeline, lambda outlet: False)
    for wire in pipeline.wires.values():
        wire.told = NEVER  # what had ended goes on
    lanes.go_on()
    recording.close()
    journal.report("session resumed", sequence=journal.sequence)


def _hush(pipeline: Pipeline, which: Callable[[Outlet[object]], bool]) -> None:
    """Mute these outlets, and no others."""
    for stage in pipeline.outlets:
        assert isinstance(stage.operator, Outlet)
        stage.muted = which(stage.operator)
