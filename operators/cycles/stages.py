"""Stages of a session (warm-up, 1.2 m/s, ...): a protocol that leads through them, and each cycle's stage and belt speed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, TypeAlias

import numpy as np

from kinegraph.operators.cycles.cycle import CLOSED, is_closed
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Samples, Specs, StreamSpec, Times
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param

Began: TypeAlias = list[tuple[int, tuple[Any, ...]]]
"""Stages that have begun, with the stamps of their events."""
STAGE = np.dtype(
    [("onset", "<i8"), ("stage", "<U32"), ("number", "<i8"), ("speed_m_s", "<f8"), ("cycles", "<i8"), ("say", "<U120")]
)
"""A stage has begun (`onset`): its name, its number, its belt speed (NaN: not known), how many good cycles the stage before
it had, and the text to show. An empty name: the protocol has ended."""
MAX = 64
SPEEDS = 64


@dataclass(frozen=True, slots=True)
class ProtocolStage:
    """A stage of a protocol. It ends after `for_s`, or after `cycles` good cycles (of all limbs together), whichever is given; with
    neither, when somebody types "next"."""

    __pydantic_config__: ClassVar[Any] = {"extra": "forbid"}

    stage: str = param(help="its name, e.g. warm-up")
    for_s: float = param(0.0, least=0.0, help="how long it lasts; 0: see cycles")
    cycles: int = param(0, least=0, help="after how many good cycles it ends; 0: see for_s")
    speed_m_s: float = param(0.0, least=0.0, help="the belt's speed; 0: not given")
    say: str = param("", help="what the operator tells the person")


@dataclass(slots=True)
class StagesState:
    """
    begins, speeds (64,), names   the latest stages, rings; `count` in all;  at: how many of the protocol's have begun
    good, numbers (128,)          accepted cycles of the stage under way; the latest cycles' numbers, a ring;  cycles: of all
    began, newest                 1: the signal has begun; its newest stamp
    since, led                    when the stage under way began; 1: it is the protocol's, which is not over
    paused, waits, spent          the number of the stage that is paused, 0: no stage is; whether it is the protocol's; how long the
                                  stage under way lasted before its pauses (ns)
    stamps, measured (64,)        the latest belt speeds, rings, m/s; heard in all;  unit: m/s in one of the input's
    blank                         no cycle
    """

    begins: Times
    speeds: Samples
    names: Array
    count: int
    at: int
    good: int
    numbers: Times
    cycles: int
    since: int
    led: int
    began: int
    newest: int
    stamps: Times
    measured: Samples
    heard: int
    unit: float
    blank: Array
    paused: int = 0
    waits: int = 0
    spent: int = 0


@dataclass(frozen=True, slots=True)
class Stages(Operator[StagesState]):
    """Cycles' events in, the same out with the fields `stage` and `speed_m_s`; and an event per stage as it begins.

    closed   with the stage that the whole cycle lies in ("" outside a stage or across two), and the belt's speed in m/s: typed or
             given with the stage, or the mean of what input `speed` measured during the cycle; NaN where it is not known
            (a measured speed that is NaN is passed over)
    stages   `STAGE`, stamped when it is decided; the screen shows its text

    A stage begins by an annotation, "stage warm-up" or "stage 1.2 m/s" (a name that is a speed sets it, as "speed 1.2" does for the stage
    under way), or by `protocol`: the first with the session's first sample, the next when the one before it has lasted `for_s`, has its
    number of good `cycles`, or at "next". "end stage" ends the stage under way, and begins no other; at "next" a protocol then goes on.
    "pause stage" leaves it until "resume stage": what lies between counts neither as its time nor as its cycles.
    Annotations are recorded, so a replay has the same stages. A cycle that is reported again keeps its stage, and is not counted twice.

    >>> notes = events([2.5], [("onset", "<i8"), ("text", "<U64")], text=["stage slow"])
    >>> closed = events([2, 5], CLOSED, onset=[1, 4], end=[2, 5], number=[1, 2])
    >>> apply(Stages(), annotations=notes, closed=closed)["closed"][["number", "stage"]].tolist()
    [(1, ''), (2, 'slow')]
    """

    inputs = {
        "signal": Input(optional=True),
        "speed": Input(optional=True),
        "annotations": Input(trigger=True, optional=True),
        "closed": Input(trigger=True),
    }
    outputs: ClassVar[tuple[str, ...]] = ("closed", "stages")

    protocol: tuple[ProtocolStage, ...] = param((), help="the stages, in order: {stage: warm-up, for_s: 120, say: ...}")

    def open(self, specs: Specs) -> Specs:
        closed = specs["closed"]
        if not is_closed(closed.dtype) or "stage" in (closed.dtype.names or ()):
            raise InputError(
                "closed", closed.describe(), "cycles' events (operators.cycles.cycles.Cycles), without stages"
            )
        if "annotations" in specs and "text" not in (specs["annotations"].dtype.names or ()):
            raise InputError("annotations", specs["annotations"].describe(), "events with a field 'text'")
        speed = specs.get("speed")
        if speed is not None and (not speed.is_signal or speed.units[0] not in ("m/s", "km/h")):
            raise InputError("speed", speed.describe(), "the belt's speed in m/s or km/h")
        if self.protocol and "signal" not in specs:
            raise InputError(
                "signal", "not connected", "connected where there is a protocol: its first sample begins it"
            )
        if any(not stage.stage for stage in self.protocol):
            raise ParameterError("protocol", "", "stages with names")
        kind = np.dtype([*closed.dtype.descr, ("stage", "<U32"), ("speed_m_s", "<f8")])
        unit = 1 / 3.6 if speed is not None and speed.units[0] == "km/h" else 1.0
        self.set_state(
            StagesState(
                np.zeros(MAX, np.int64), np.full(MAX, np.nan), np.zeros(MAX, "<U32"), 0, 0, 0, np.full(128, -1), 0, NEVER, 0, 0, NEVER,
                np.zeros(SPEEDS, np.int64), np.zeros(SPEEDS), 0, unit, np.empty(0, kind),
            ),
            decision_s={"closed": 0.0, "stages": 0.0},
        )  # fmt: skip
        units = closed.units if len(closed.units) > 1 else closed.units * len(closed.channels)
        return {
            "closed": closed.derive(dtype=kind, channels=(), units=(*units, "", "m/s")),
            "stages": StreamSpec((), STAGE, units=("ns", "", "", "m/s", "", ""), meta=closed.meta),
        }

    def annotations_understood(self) -> list[str]:
        led = [*(f"stage {stage.stage}" for stage in self.protocol), "next"] if self.protocol else []
        return [*led, "stage ", "end stage", "pause stage", "resume stage"]

    def process(self, port: str, chunk: Chunk) -> list[tuple[str, Chunk]]:
        s = self.state
        began: Began = []
        rows = []
        if port == "signal":
            if len(chunk.time) and not s.began:
                s.began = 1
                self._next(began, int(chunk.time[0]))
            s.newest = int(chunk.time[-1]) if len(chunk.time) else s.newest
        else:
            for i, stamp in enumerate(chunk.time.tolist()):
                self._pass(began, stamp)
                if port == "annotations":
                    self._said(began, stamp, str(chunk.data["text"][i]).strip())
                elif port == "speed" and np.isfinite(chunk.data[i, 0]):
                    k = s.heard % SPEEDS
                    s.stamps[k], s.measured[k] = stamp, float(chunk.data[i, 0]) * s.unit
                    s.heard += 1
                elif port == "closed":
                    rows.append((*chunk.data[i].item(), *self._place(chunk.data[i])))
                    self._count(began, stamp, chunk.data[i])
        self._pass(began, s.newest if chunk.until == FOREVER else chunk.until)
        lost = -1 if chunk.lost and port == "closed" else 0
        closed = np.array(rows, s.blank.dtype) if rows else s.blank
        stages = np.array([row for _, row in began], STAGE)
        stamps = np.array([stamp for stamp, _ in began], np.int64)
        when = chunk.time if rows else chunk.time[:0]
        return [("closed", Chunk(when, closed, chunk.until, lost)), ("stages", Chunk(stamps, stages, chunk.until))]

    @classmethod
    def cases(cls) -> list[Case]:
        n = 40
        rows = np.zeros(n, CLOSED)
        onset = NS + np.arange(n) * NS
        rows["onset"], rows["end"], rows["number"] = onset, onset + NS, np.arange(1, n + 1)
        rows["rejected"][7] = "gap"
        text = np.dtype([("onset", "<i8"), ("text", "U64")])
        annotations = np.array(
            [(0, "stage 1.2 m/s"), (0, "speed 1.4"), (0, "next"), (0, "coffee"), (0, "stage"), (0, "end stage")], text
        )
        when = np.linspace(9 * NS, 36 * NS, len(annotations)).astype(np.int64)
        inputs = {
            "annotations": (StreamSpec((), text, units=("",)), when, annotations),
            "closed": (StreamSpec((), CLOSED, units=("",)), onset + NS + 20_000_000, rows),
        }
        more = {
            "signal": (StreamSpec((1,), rate_hz=10.0), grid(10.0, 10 * n), np.zeros((10 * n, 1))),
            "speed": (StreamSpec((1,), units=("km/h",)), onset[::3], np.full((len(onset[::3]), 1), 4.0)),
        }
        plan = (
            ProtocolStage("warm-up", for_s=6.5, say="as you like"),
            ProtocolStage("fast", cycles=5, speed_m_s=1.6),
            ProtocolStage("end", for_s=3),
        )
        return [Case(cls(), inputs, least=40), Case(cls(plan), {**more, **inputs}, least=40)]

    def _pass(self, began: Began, until: int) -> None:
        """Time has come to `until`: begin what follows stages that are over by then."""
        s = self.state
        while s.led and (for_s := self.protocol[s.at - 1].for_s):
            over = s.since + round(for_s * NS) - s.spent
            if over > until:
                return
            self._next(began, over)

    def _next(self, began: Began, stamp: int) -> None:
        """The protocol's next stage begins, or its end has come."""
        s = self.state
        if s.at < len(self.protocol):
            stage = self.protocol[s.at]
            s.at += 1
            self._begin(began, stamp, (stage.stage, stage.speed_m_s or np.nan, stage.say))
            s.led = 1
        elif s.led:
            self._begin(began, stamp, ("", np.nan, "that was the last stage"))

    def _begin(self, began: Began, stamp: int, stage: tuple[str, float, str]) -> None:
        s, (name, speed, say) = self.state, stage
        k = s.count % MAX
        s.begins[k], s.names[k], s.speeds[k] = stamp, name, speed
        s.count += 1
        began.append((stamp, (stamp, name, s.count, speed, s.good, say)))
        s.since, s.led, s.good = stamp, 0, 0
        s.paused, s.waits, s.spent = 0, 0, 0

    def _said(self, began: Began, stamp: int, text: str) -> None:
        """A person's word; all but those of `annotations_understood` and "speed NUMBER" is for others."""
        s = self.state
        word, _, rest = text.partition(" ")
        if text == "next":
            self._next(began, stamp)
        elif text == "end stage":
            if s.count and s.names[(s.count - 1) % MAX]:
                self._begin(began, stamp, ("", np.nan, ""))
        elif text in ("pause stage", "resume stage"):
            self._hold(began, stamp, text == "pause stage")
        elif word == "stage" and rest.strip():
            self._begin(began, stamp, (rest.strip()[:32], _speed(rest), ""))
        elif word == "speed" and np.isfinite(_speed(rest)):
            name = str(s.names[(s.count - 1) % MAX]) if s.count else ""
            kept = s.good, s.paused, s.waits, s.spent
            self._begin(began, stamp, (name, _speed(rest), ""))
            s.good, s.paused, s.waits, s.spent = kept

    def _hold(self, began: Began, stamp: int, pause: bool) -> None:
        """Pause the stage under way, or go on with the one that is paused: its time and its good cycles are kept."""
        s = self.state
        number = s.count if pause else s.paused
        k, good, led, spent = (number - 1) % MAX, s.good, s.led, s.spent
        if pause and number and s.names[k]:
            spent += stamp - s.since
            self._begin(began, stamp, ("", np.nan, f"{s.names[k]} is paused"))
            s.paused, s.waits, s.good, s.spent = number, led, good, spent
        elif not pause and number:
            led = s.waits
            self._begin(began, stamp, (str(s.names[k]), float(s.speeds[k]), ""))
            s.led, s.good, s.spent = led, good, spent

    def _place(self, row: np.void) -> tuple[str, float]:
        """The stage that a cycle lies in, and the belt's speed in it."""
        s, onset, end = self.state, int(row["onset"]), int(row["end"])
        inside = (s.stamps >= onset) & (s.stamps <= end) & (np.arange(SPEEDS) < s.heard)
        name, speed = "", np.nan
        for i in range(max(0, s.count - MAX), s.count):
            stop = s.begins[(i + 1) % MAX] if i + 1 < s.count else FOREVER
            if s.begins[i % MAX] <= onset and end <= stop:
                name, speed = str(s.names[i % MAX]), float(s.speeds[i % MAX])
        return name, float(s.measured[inside].mean()) if inside.any() else speed

    def _count(self, began: Began, stamp: int, row: np.void) -> None:
        """Count a good cycle of the stage under way, once."""
        s, number = self.state, int(row["number"])
        if s.paused or row["rejected"] or int(row["onset"]) < s.since or (s.numbers == number).any():
            return
        s.numbers[s.cycles % len(s.numbers)] = number
        s.cycles += 1
        s.good += 1
        if s.led and 0 < self.protocol[s.at - 1].cycles <= s.good:
            self._next(began, stamp)


def _speed(text: str) -> float:
    """The number before "m/s" or "km/h", or alone, in m/s; NaN without a number."""
    words = text.replace("m/s", " m/s").replace("km/h", " km/h").split()
    try:
        value = float(words[0])
    except (IndexError, ValueError):
        return float("nan")
    unit = words[1] if len(words) > 1 else "m/s"
    return {"m/s": value, "km/h": value / 3.6}.get(unit, float("nan"))
