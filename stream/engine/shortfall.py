"""What a run was offered and did not deliver: the one rule by which sessions, replays and batches end with exit code 5."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Protocol

from kinegraph.stream.errors import KinegraphError, blaming
from kinegraph.stream.outlet import Outlet

if TYPE_CHECKING:
    from kinegraph.stream.engine.flow.queues import BoundedQueue
    from kinegraph.stream.engine.pipeline import Stage
    from kinegraph.stream.recording import RecorderStatus

INCOMPLETE = 5
"""The exit code."""


class Port(Protocol):
    """An output of a source."""

    @property
    def queue(self) -> BoundedQueue: ...


class NotDelivered(KinegraphError):
    """Something was not written or sent; what else was is right."""

    exit_code = INCOMPLETE

    def __init__(self, shortfalls: Mapping[str, str]) -> None:
        super().__init__(
            "not everything was delivered: " + "; ".join(f"{name}: {why}" for name, why in shortfalls.items())
        )


def shortfalls(
    outlets: Iterable[Stage] = (),
    queues: Mapping[str, BoundedQueue] | None = None,
    inputs: Iterable[Port] = (),
    recording: RecorderStatus | None = None,
) -> dict[str, str]:
    """What is missing, in words, by outlet and source, and for "recording"; empty where everything was delivered.

    queues   before outlets and other nodes on workers, by name. What one before an operator drops is in the recording, and can be replayed
    inputs   the sources' outputs: what their queues drop is in no recording
    """
    found: dict[str, str] = {}
    for port in inputs:
        if port.queue.dropped:
            found[port.queue.name] = _dropped(port.queue.dropped)
    for stage in outlets:
        reasons = [stage.failed] if stage.failed else []
        dropped = sum(queue.dropped for name, queue in (queues or {}).items() if reader_of(name) == stage.node.name)
        if dropped:
            reasons.append(_dropped(dropped))
        assert isinstance(stage.operator, Outlet)
        with blaming(stage.node.name, "undelivered"):
            reasons += [stage.operator.undelivered] if stage.operator.undelivered else []
        if reasons:
            found[stage.node.name] = ", ".join(reasons)
    if recording is not None and (words := recording.shortfall):
        found["recording"] = words
    return found


def reader_of(queue: str) -> str:
    """The node that reads from a queue of this name: "csv" of "board.emg -> csv.in"."""
    return queue.partition(" -> ")[2].rpartition(".")[0]


def _dropped(samples: int) -> str:
    return (
        f"{samples} samples dropped: it was too slow for what came"
        if samples != 1
        else "1 sample dropped: it was too slow"
    )
