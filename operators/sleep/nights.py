"""Which night is which: from the bed, and from the lights where somebody switches them, one event per night."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

from kinegraph.operators.sleep.periods import PERIOD
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Chunk, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

NIGHTS = np.dtype([*PERIOD.descr, ("bed", "U9")])
"""A period that also says what it is by: lights, or detected."""
HOUR = 3600 * NS
Rows: TypeAlias = list[tuple[int, tuple[Any, ...]]]


@dataclass(slots=True)
class NightsState:
    """
    onset   when the open night began; NEVER if closed. by: "lights" if they went off then
    left    when the bed was left; NEVER: somebody is in it. begun, gone: the stamps at which onset and left became known
    state   of the bed, as it was reported last
    dark    when the lights went off while the bed is empty; NEVER if they are on
    lit     when the lights came on in a night by the lights, which they end unless it is joined; NEVER: they are off
    done    the lights came on and the night was reported; the next begins after the bed was left
    exits   how often the bed was left in the open night; lost: what the next emission says is missing before it
    """

    onset: int
    by: str
    left: int
    state: str
    dark: int
    lit: int
    done: bool
    exits: int
    begun: int
    gone: int
    lost: int


@dataclass(frozen=True, slots=True)
class Nights(Operator[NightsState]):
    """In bed or out of it, and the lights, in; one event per night out: onset, end, minutes, and whether it is by the `lights`.

    bed     of `operators.bed.presence.Presence`
    lights  a button, MQTT, `stream.manual.Value`: 0, or a field `on` that is false, is off. May be left out, and forgotten for a night

    A night begins when the lights go off (in bed, or at most `apart_h` before), else when somebody goes to bed. It ends when the lights
    come on, if they went off, else when the bed was left and stays empty for `apart_h`: with the moment at which it was left,
    reported that much later. Lights that go off again within `rejoin_min`, or a bed that is left and taken again within that, make it one
    night: a light at three in the morning is a part of it. So an end by the lights is reported `rejoin_min` later.
    `moving` counts the times that the bed was left. Shorter times than `shortest_h` are no night. A bed of which
    nothing is known (the camera is gone) counts as it was before; a night ends `longest_h` after its beginning at the latest. When
    everything ends while somebody is in bed, the night has no end, and is not reported.

    >>> kind = [("onset", "<i8"), ("sleeper", "<U16"), ("state", "<U7")]
    >>> bed = events([0, 3600, 32400, 46800], kind, state=["out", "in", "out", "out"])
    >>> apply(Nights(), bed=bed)["minutes"]
    array([480.])
    """

    inputs = {"bed": Input(), "lights": Input(trigger=True, optional=True)}
    exemptions: ClassVar[dict[str, str]] = {}

    apart_h: float = param(1.5, above=0.0, most=8.0, help="this long out of bed ends a night")
    rejoin_min: float = param(
        20.0, least=0.0, most=90.0, help="lights off or the bed taken again within this time: the same night; 0: never"
    )
    shortest_h: float = param(1.0, least=0.0, help="shorter times in bed are no night")
    longest_h: float = param(20.0, above=0.0, most=36.0, help="longer than this no night is")
    sleeper: str = param("", help="the sleeper, if `bed` is of several")

    def open(self, specs: Specs) -> Specs:
        bed = specs["bed"]
        if not {"onset", "sleeper", "state"} <= set(bed.dtype.names or ()):
            raise InputError("bed", bed.describe(), "events with the fields onset, sleeper, state (in, out, unknown)")
        if "lights" in specs and not (specs["lights"].is_signal or "on" in (specs["lights"].dtype.names or ())):
            raise InputError(
                "lights", specs["lights"].describe(), "a signal of one channel, or events with a field `on`"
            )
        if self.longest_h <= self.shortest_h:
            raise ParameterError(
                "longest_h", self.longest_h, f"above shortest_h, {self.shortest_h:g}: nothing else is a night"
            )
        state = NightsState(NEVER, "", NEVER, "", NEVER, NEVER, False, 0, NEVER, NEVER, 0)
        self.set_state(state, decision_s={"out": max(3600 * self.apart_h, 60 * self.rejoin_min)})
        return {"out": StreamSpec((), NIGHTS, units=("ns", "ns", "min", "", ""), meta=dict(bed.meta))}

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        emitted: list[tuple[str, Chunk]] = []
        made: Rows = []
        for k, stamp in enumerate(chunk.time.tolist()):
            self._pass(stamp - 1, made)
            if chunk.lost and k == 0:
                emitted.append(("out", self._chunk(made, stamp - 1)))
                made, s.lost = [], -1
            row = chunk.data[k]
            if port == "lights":
                on = bool(row["on"]) if chunk.data.dtype.names else row.item(0) != 0
                self._lights(stamp, on, made)
            elif self.sleeper in ("", str(row["sleeper"])):
                self._bed(stamp, int(row["onset"]), str(row["state"]))
        if chunk.until == FOREVER:
            self._end(made)
        else:
            self._pass(chunk.until, made)
        return [*emitted, ("out", self._chunk(made, chunk.until))]

    def close(self) -> Chunk:
        made: Rows = []
        self._end(made)
        return self._chunk(made, FOREVER)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        dtype = np.dtype([("onset", "<i8"), ("sleeper", "U16"), ("state", "U7")])
        start = 1_700_000_000 * NS
        minutes = np.array([0, 30, 200, 205, 420, 900, 1300, 1330, 1390, 1700, 1705, 2000])
        names = ["out", "in", "out", "in", "out", "in", "out", "unknown", "in", "unknown", "in", "out"]
        onsets = start + minutes * 60 * NS
        bed = np.array([(t, "", name) for t, name in zip(onsets.tolist(), names, strict=True)], dtype)
        beds = (StreamSpec((), dtype), onsets + 5 * NS, bed)
        pressed = start + np.array([45, 400, 910, 1290, 2600]) * 60 * NS
        on = np.array([0.0, 1.0, 0.0, 1.0, 1.0])[:, None]
        lights = (StreamSpec((1,), channels=("value",)), pressed, on)
        return [
            Case(cls(), {"bed": beds}, least=2),
            Case(cls(apart_h=1.0), {"bed": beds, "lights": lights}, least=2),
        ]

    def _bed(self, stamp: int, onset: int, state: str) -> None:
        s = self.state
        if state == "in":
            if s.onset == NEVER and not s.done:
                recent = s.dark != NEVER and stamp - s.dark <= self.apart_h * HOUR
                s.onset, s.by = (s.dark, "lights") if recent else (onset, "")
                s.dark, s.exits, s.begun = NEVER, 0, stamp
            if s.left != NEVER:
                s.lit = NEVER
            s.left = NEVER
        elif state == "out" and s.state != "out":
            s.left, s.gone, s.done, s.exits = onset, stamp, False, s.exits + 1
        if state in ("in", "out"):
            s.state = state

    def _lights(self, stamp: int, on: bool, made: Rows) -> None:
        s = self.state
        if not on:
            s.done, s.lit = False, NEVER
            if s.onset != NEVER and s.by != "lights":
                s.onset, s.by = stamp, "lights"
            elif s.onset == NEVER:
                s.onset, s.by, s.dark = (stamp, "lights", NEVER) if s.state == "in" else (NEVER, "", stamp)
                s.begun = stamp
        else:
            s.dark = NEVER
            if s.onset != NEVER and s.by == "lights" and s.lit == NEVER:
                s.lit = stamp
                if not self.rejoin_min:
                    self._emit_by_lights(made)

    def _pass(self, until: int, made: Rows) -> None:
        """End the night if it is due."""
        s = self.state
        if s.onset == NEVER:
            return
        if s.lit != NEVER:  # which is decided first, whatever else has become due meanwhile
            if until >= s.lit + round(self.rejoin_min * 60 * NS):
                self._emit_by_lights(made)
            return
        away = s.gone + round(self.apart_h * HOUR) if s.left != NEVER else FOREVER
        latest = s.begun + round(self.longest_h * HOUR)
        if until >= min(away, latest):
            s.by = ""
            self._emit(min(away, latest), s.left if s.left != NEVER else latest, made)

    def _end(self, made: Rows) -> None:
        """Nothing follows: whoever has left the bed does not come back. A night with somebody in bed has no end."""
        s = self.state
        if s.onset != NEVER and s.lit != NEVER:
            self._emit_by_lights(made)
        elif s.onset != NEVER and s.left != NEVER:
            s.by = ""
            self._emit(s.gone + round(self.apart_h * HOUR), s.left, made)

    def _emit_by_lights(self, made: Rows) -> None:
        """The lights stayed on: with them the night was over."""
        s = self.state
        s.done = s.state == "in"
        self._emit(s.lit + round(self.rejoin_min * 60 * NS), s.lit, made)

    def _emit(self, stamp: int, end: int, made: Rows) -> None:
        s = self.state
        if end - s.onset >= self.shortest_h * HOUR:
            minutes = (end - s.onset) / (60 * NS)
            made.append((stamp, (s.onset, end, minutes, s.exits, s.by or "detected")))
        s.onset, s.by, s.left, s.lit, s.exits = NEVER, "", NEVER, NEVER, 0

    def _chunk(self, made: Rows, until: int) -> Chunk:
        s = self.state
        lost, s.lost = s.lost, 0
        return Chunk(np.array([t for t, _ in made], np.int64), np.array([row for _, row in made], NIGHTS), until, lost)
