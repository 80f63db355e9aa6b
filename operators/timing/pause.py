"""A pause: while it lasts nothing passes, as if it had never been measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinegraph.stream.chunk import Array, Chunk, Specs, StreamSpec, add_lost, empty
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Case, Input, Operator, grid


@dataclass(slots=True)
class PauseState:
    """`paused`: now. `dropped`: how many samples were kept back, for the next one that passes."""

    paused: bool
    dropped: int


class _Gate(Operator[PauseState]):
    __slots__ = ("nothing",)
    nothing: Array


@dataclass(frozen=True, slots=True)
class Pause(_Gate):
    """Drops samples of any kind while the switch is on; dropped samples count as lost.

    in       any stream
    switch   a signal of one channel (0 is off) or events with a field `on`: `devices.mqtt.MqttSwitch`, `stream.manual.Value`

    Put it before everything else, and nothing in the graph, on the disk or in the network knows what was before the camera meanwhile; what
    follows sees a gap. Samples wait until the switch is known at their time (its heartbeat). No delay otherwise.

    >>> switch = series(np.array([0.0, 1.0, 0.0]), time=10**7 * np.array([0, 102, 105]))
    >>> apply(Pause(), switch=switch, **{"in": series(np.arange(8.0), rate_hz=100)})[:, 0]
    array([0., 1., 2., 6., 7.])
    """

    inputs = {"in": Input(), "switch": Input(trigger=True)}

    def open(self, specs: Specs) -> Specs:
        switch = specs["switch"]
        if not (switch.is_signal and switch.shape == (1,)) and "on" not in (switch.dtype.names or ()):
            raise InputError("switch", switch.describe(), "a signal of one channel, or events with a field `on`")
        object.__setattr__(self, "nothing", empty(specs["in"], 0).data)
        self.set_state(PauseState(False, 0))
        return {"out": specs["in"]}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        if port == "switch":
            if len(chunk):
                last = chunk.data[-1]
                s.paused = bool(last["on"]) if chunk.data.dtype.names else last.item(0) != 0
            return Chunk(chunk.time[:0], self.nothing, chunk.until)
        if s.paused:
            s.dropped = add_lost(s.dropped, add_lost(chunk.lost, len(chunk)))
            return Chunk(chunk.time[:0], self.nothing, chunk.until)
        if not len(chunk):
            return chunk
        lost, s.dropped = add_lost(s.dropped, chunk.lost), 0
        return Chunk(chunk.time, chunk.data, chunk.until, lost)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        rng = np.random.default_rng(31)
        frames = StreamSpec((4, 5), np.dtype(np.uint16), rate_hz=20.0, units=("mm",))
        images = rng.integers(0, 4000, (120, 4, 5)).astype(np.uint16)
        times = np.array([2_100_000_000, 3_020_000_000, 5_000_000_000])
        button = (StreamSpec((1,), channels=("value",)), times, np.array([[1.0], [0.0], [1.0]]))
        events = np.array([(True,), (False,), (True,)], [("on", "?")])
        signal = StreamSpec((2,), rate_hz=100.0)
        return [
            Case(cls(), {"in": (frames, grid(20.0, 120), images), "switch": button}, least=50),
            Case(
                cls(),
                {
                    "in": (signal, grid(100.0, 600), rng.random((600, 2))),
                    "switch": (StreamSpec((), events.dtype), times, events),
                },
                least=250,
            ),
        ]
