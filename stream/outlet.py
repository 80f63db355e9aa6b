"""Where streams leave a graph: the outlet, an operator without outputs that touches the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, ClassVar, Generic, TypeVar

import typing_extensions

from kinegraph.stream.operator import Operator

if TYPE_CHECKING:
    from kinegraph.stream.graph import Graph
    from kinegraph.stream.system.clock import SessionClock

S = TypeVar("S")
R = typing_extensions.TypeVar("R", default=None)


class Outlet(Operator[S], Generic[S, R]):
    """Where streams leave the graph: a file, a network, a screen. It has inputs and no outputs.

    An outlet is silent in replay unless it is asked to speak. It runs on the worker `outlets` by default, and when it fails it
    is reported and switched off while the graph goes on. `open` only checks and allocates (a graph is opened to be checked, too); what
    touches the world begins in `begin`. Whatever a running outlet needs besides its state (specs, open files, a connection) is
    its `runtime`, of the type that `Outlet[State, Runtime]` names: `set_state` keeps it, and no snapshot has it.

    durable    whether the outlet can take its words back: after a crash it is restored to its last snapshot (a file is cut back to the
               length it had) and given again what followed, so that nothing is doubled or missing. One that is not durable, a network,
               hears nothing of what is worked through a second time.
    closes_last  whether it announces what other outlets write while they close, and so closes after them
    in_order   whether samples of several inputs are brought in global time order. Off, for an outlet that passes on at once what any of
               them says: each input's own order, and no waiting for the others
    """

    __slots__ = ("runtime",)
    outputs: ClassVar[tuple[str, ...]] = ()
    is_outlet: ClassVar[bool] = True
    durable: ClassVar[bool] = False
    closes_last: ClassVar[bool] = False
    in_order: ClassVar[bool] = True

    runtime: R

    def set_state(
        self,
        state: S,
        runtime: R | None = None,
        *,
        delay_s: float = 0.0,
        decision_s: Mapping[str, float] | None = None,
    ) -> None:
        """Keep the state and what belongs to a running outlet only (see `runtime`); called by `open`."""
        super().set_state(state, delay_s=delay_s, decision_s=decision_s)
        object.__setattr__(self, "runtime", runtime)

    @property
    def file(self) -> str:
        """Where what it leaves behind lies, for people to find it at the end of a session; "" if it leaves nothing."""
        return str(getattr(self, "path", ""))

    @property
    def undelivered(self) -> str:
        """What this outlet was given and did not deliver, in words, asked after `close`; "" where nothing is missing. Then the session ends
        with exit code 5, as where an outlet fails or its queue drops."""
        return ""

    def missing(self) -> str:
        """What this outlet needs and cannot reach, with what to do about it; "" where it is there, or only `begin` can tell.

        Asked before a session compiles; takes two seconds at most. The session goes on without it.
        """
        return ""

    def meet(self, graph: Graph) -> None:
        """Receive the graph, once, before `begin`: its text, its nodes with their parameters and delays, the session's facts."""

    def keep_time(self, clock: SessionClock) -> None:
        """Receive the clock of a live session, once, before `begin`; not called in replay. For outlets with stamps that others read."""

    def follow_disk(self, handed: Callable[[], int], saved: Callable[[], int]) -> None:
        """Receive, of a live session, the newest arrival (ns) that its recording was handed and the one up to which it is on the disk;
        called once, before `begin`. For outlets whose words must not outlive what a killed session can be resumed from."""

    def let_stop(self, stop: Callable[[], None]) -> None:
        """Receive a function that ends a live session in order, from any thread; called once, before `begin`, and not in replay."""

    def begin(self) -> None:
        """Touch the world: create the file, connect. Called once, after `open` (and `restore`), before any device starts.

        Raises KinegraphError where that cannot be done: the run does not start.
        """
