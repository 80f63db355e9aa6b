"""Going on with a session that was broken off: what was logged after its last checkpoint is worked through once more."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter_ns

import structlog

from kinegraph.stream.chunk import NEVER
from kinegraph.stream.engine.flow.queues import recorded_drops
from kinegraph.stream.engine.ingress import IngressPort
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.session_log import PriorSession, SessionLog
from kinegraph.stream.engine.substitutes import Substitutes
from kinegraph.stream.engine.workers import Workers
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.system.clock import SessionClock

log = structlog.get_logger(__name__)


def catch_up(
    prior: PriorSession,
    pipeline: Pipeline,
    ports: Sequence[IngressPort],
    workers: Workers,
    session_log: SessionLog,
    clock: SessionClock,
    drain_ready: Callable[[], None],
) -> None:
    """Replay the log after the checkpoint; durable outlets write again what they had written since.

    Images that were not kept are lost to their readers; recorded output of those readers is passed on again. `drain_ready` takes the
    workers' results.
    """
    checkpoint, recording = prior.checkpoint, prior.recording
    log.info("resuming an interrupted session", folder=str(session_log.folder))
    _hush(pipeline, lambda outlet: not outlet.durable)
    pipeline.begin(clock, (session_log.handed, session_log.saved))
    workers.repeat(recorded_drops(recording.log), checkpoint.indices if checkpoint else {})
    by_name = {port.stream: port for port in ports}
    substitutes = Substitutes.of(pipeline.graph, recording.streams)
    with substitutes.at_work(pipeline) as taken:
        after = session_log.sequence
        for sequence, stream, chunk, _arrival in recording.inputs(after, also=substitutes.taken):
            session_log.sequence = sequence
            if stream in taken:
                taken[stream].send(chunk, perf_counter_ns())
            elif stream in by_name:
                by_name[stream].watermark = max(by_name[stream].watermark, chunk.until)
                pipeline.feed(stream, chunk)
            workers.settle(drain_ready)
    for port in ports:
        if port.ended:
            port.watermark = clock.utc_ns - 1  # it had ended then; now it begins again
        # also where the first chunks, which say so, come before the common start
        port.pending_gap = 0 if port.supervisor.source.continues else -1
    _hush(pipeline, lambda outlet: False)
    for edge in pipeline.edges.values():
        edge.promised = NEVER  # what had ended goes on
    pipeline.compile()
    workers.go_on()
    recording.close()
    session_log.report("session resumed", sequence=session_log.sequence)


def _hush(pipeline: Pipeline, which: Callable[[Outlet[object]], bool]) -> None:
    """Mute these outlets, and no others."""
    for stage in pipeline.outlets:
        assert isinstance(stage.operator, Outlet)
        stage.muted = which(stage.operator)
