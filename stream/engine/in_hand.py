"""Which call of an operator is under way, and since when: read off the threads' stacks, so that no sample's way is a step longer for it."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from time import perf_counter_ns
from types import FrameType

from stream.chunk import FOREVER, NS, Chunk
from stream.engine.link import given
from stream.engine.pipeline import Pipeline
from stream.errors import RunError


@dataclass(frozen=True, slots=True)
class Call:
    """A call of an operator or outlet that has not come back yet.

    since   when it began (ns, perf_counter); None: nobody noted it (it closes, or its state is taken)
    where   what it was given, in words; "" if nothing
    """

    node: str
    since: int | None = None
    where: str = ""

    def lasts_s(self, otherwise: int) -> float:
        """How long it has been at work; `otherwise` stands for a beginning that nobody noted."""
        return (perf_counter_ns() - (otherwise if self.since is None else self.since)) / NS

    def broken_off(self, lasts_s: float) -> RunError:
        """What it means that the session ended without it."""
        return RunError(
            f"node {self.node!r}: did not come back for {lasts_s:.1f} s{self.where}; the session ended without it"
        )


def longest(pipeline: Pipeline) -> Call | None:
    """The call that has been under way for longest, in any thread; None if every operator is at rest."""
    names = {id(stage.operator): name for name, stage in pipeline.stages.items()}
    calls = [call for frame in sys._current_frames().values() if (call := _call(frame, names))]
    return min(calls, key=lambda call: FOREVER if call.since is None else call.since, default=None)


def _call(innermost: FrameType, names: Mapping[int, str]) -> Call | None:
    """The innermost operator on a thread's stack, as the engine called it."""
    called: FrameType | None = None
    node = ""
    for frame in _outwards(innermost):
        name = names.get(id(_arguments(frame)[0])) if frame.f_code.co_argcount else None
        if name is not None and (called is None or name == node):
            called, node = frame, name
        elif called is not None and _is_engine(frame):
            chunk = next((a for a in _arguments(called) if isinstance(a, Chunk)), None)
            port = next((a for a in _arguments(called) if isinstance(a, str)), "")
            return Call(node, _began(frame), given(port, chunk) if chunk is not None else "")
    return None


def _outwards(frame: FrameType | None) -> Iterator[FrameType]:
    while frame is not None:
        yield frame
        frame = frame.f_back


def _arguments(frame: FrameType) -> list[object]:
    there = frame.f_locals
    return [there.get(name) for name in frame.f_code.co_varnames[: frame.f_code.co_argcount]]


def _is_engine(frame: FrameType) -> bool:
    """A module of the engine, or a chain that it has written."""
    return frame.f_code.co_filename.startswith("<chain") or str(frame.f_globals.get("__name__")).startswith(
        "stream.engine."
    )


def _began(frame: FrameType) -> int | None:
    """The last time that whoever called the operator has read or was given: a link's `start`, a chain's t0, t1, ..."""
    there = frame.f_locals.items()
    times = [v for k, v in there if (k == "start" or (k[0] == "t" and k[1:].isdigit())) and isinstance(v, int)]
    return max(times, default=None)
