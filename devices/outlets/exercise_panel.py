"""What is being done now, on the terminal: which exercise, how often, since when, how sure; and what came before it."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from rich.text import Text

from devices.outlets.terminal import TerminalView
from stream.chunk import NEVER, NS, Array, Chunk, Specs
from stream.errors import InputError
from stream.outlet import Outlet
from stream.params import param
from stream.plain import one_line, say

FIELDS = {
    "provisional": ("onset", "end", "activity", "repetition"),
    "count": ("activity", "count", "certainty"),
    "believed": ("activity", "name", "sure"),
    "repetition": ("onset", "end", "activity", "repetition", "name", "sure", "duration_s"),
    "activity": ("onset", "end", "activity", "repeats", "repetitions", "cluster", "certainty"),
    "resting": ("onset",),
    "rest": ("onset", "end"),
}
"""By port: the fields that its events must have."""
PAST = np.dtype([("what", "<U24"), ("repetitions", "<i4"), ("onset", "<i8"), ("seconds", "<f8"), ("doubtful", "?")])
NAMED = np.dtype([("activity", "<i8"), ("name", "<U24"), ("first", "<i8"), ("last", "<i8"), ("told", "<i4")])
RECENT = 8
"""This many activities are remembered, with their names: an activity's end is final when the next one goes on already."""
STRIP = 6
"""This many stretches before this one are shown."""
REST = "rest"
SHORT_S = 2.0
"""Shorter rests, and what does not repeat and is shorter, are not worth a word."""


@dataclass(slots=True)
class ExerciseState:
    """What goes on. Times in ns; activity -1: none; rest_since NEVER: nobody rests; since: when it began; begun: that is when its
    first repetition did; last_s: how long the newest repetition took that is final, NaN: none; sure: of the name; certainty: of the count.

    gone: the newest activity that has ended; taken_back: whether all that was counted of this one was taken back; behind, behind_since: the
    next one, of which nothing is counted yet, while this one is corrected; -1: none

    past (STRIP,): in any order; passed: how many stretches have ended. known (RECENT,): activities by number modulo RECENT: name, how many
    repetitions are final, when the first one began and the last one ended. began: the first event's time, from which times are counted
    """

    past: Array
    known: Array
    passed: int = 0
    began: int = NEVER
    activity: int = -1
    since: int = NEVER
    count: int = 0
    final: int = 0
    begun: bool = False
    last_s: float = np.nan
    sure: float = np.nan
    certainty: float = 0.0
    rest_since: int = NEVER
    gone: int = -1
    taken_back: bool = False
    behind: int = -1
    behind_since: int = NEVER


@dataclass(frozen=True, slots=True)
class ExercisePanel(Outlet[ExerciseState, None]):
    """The exercise that is being done, how often so far and since when, rest, and what came before: live.

    provisional, count, activity, rest, resting   of `operators.segmentation.Segment`
    believed, repetition                          of `operators.segmentation.naming.NameRepetitions`: names, and how sure they are

    Any streams of events with the same fields will do. `kinegraph run` shows them in its live view; where the output is no terminal, every
    repetition and everything that has ended is a line.
    """

    inputs: ClassVar[tuple[str, ...]] = tuple(FIELDS)
    optional: ClassVar[tuple[str, ...]] = ("believed", "repetition", "resting", "rest")

    bell: bool = param(False, help="ring the terminal's bell at every repetition")

    def open(self, specs: Specs) -> Specs:
        for port, spec in specs.items():
            if not set(FIELDS[port]) <= set(spec.dtype.names or ()):
                raise InputError(port, spec.describe(), f"events with the fields {', '.join(FIELDS[port])}")
        known = np.zeros(RECENT, NAMED)
        known["activity"] = -1
        self.hold(ExerciseState(np.zeros(STRIP, PAST), known), None)
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        state, line = self.state, ""
        if state.began == NEVER and chunk.until > NEVER:
            state.began = int(chunk.time[0]) if len(chunk) else chunk.until
        before = state.count
        for stamp, event in zip(chunk.time, chunk.data, strict=True):
            line = HEAR[port](state, event, int(stamp)) or line
        if len(chunk):
            self._show(line)
        if self.bell and state.count > before:
            ring()

    def _show(self, line: str) -> None:
        if TerminalView.current is not None:
            TerminalView.current.hang_out("exercise", panel(self.state), line)
        elif line:
            with suppress(BrokenPipeError):  # nobody reads on
                say(line, flush=True)


def ring() -> None:
    """The terminal's bell, where there is a terminal: past the live view, which keeps what is written until its line ends."""
    terminal = sys.__stderr__
    if terminal is not None and terminal.isatty():
        with suppress(OSError):
            terminal.write("\a")
            terminal.flush()


def _provisional(state: ExerciseState, event: Any, stamp: int) -> str:
    """An activity is believed to have begun, or a repetition to have ended."""
    if corrects_earlier(state, int(event["activity"])):
        return ""
    if event["activity"] != state.activity:
        _turn_to(state, int(event["activity"]), int(event["onset"]))
    state.rest_since = NEVER
    onset = int(event["onset"])
    if event["repetition"] == 0:
        state.since = state.since if state.begun else min(state.since, onset)
    elif not state.final:  # a repetition is believed before it has quite ended, and then looks short
        state.last_s = (int(event["end"]) - onset) / NS
        if event["repetition"] == 1:
            state.since, state.begun = onset, True
    return ""


def _count(state: ExerciseState, event: Any, stamp: int) -> str:
    """This many repetitions so far; a lower number corrects the last one."""
    if event["activity"] != state.activity:
        if event["count"] == 0 or corrects_earlier(state, int(event["activity"])):
            return ""
        _turn_to(state, int(event["activity"]), stamp)
    state.taken_back = event["count"] == 0
    state.count, state.certainty = int(event["count"]), float(event["certainty"])
    return now_line(state)


def corrects_earlier(state: ExerciseState, activity: int) -> bool:
    """Whether what is said of this activity is about an earlier one than is under way, of which something is counted."""
    return activity <= state.gone or (activity < state.activity and state.count > 0 and not state.taken_back)


def _believed(state: ExerciseState, event: Any, stamp: int) -> str:
    if event["name"]:
        _known(state, int(event["activity"]))["name"] = event["name"]
        if event["activity"] == state.activity:
            state.sure = float(event["sure"])
    return ""


def _repetition(state: ExerciseState, event: Any, stamp: int) -> str:
    """A repetition is final, or one of its two steps: then both together are as long as it took."""
    one, number = _known(state, int(event["activity"])), int(event["repetition"])
    onset, end = int(event["onset"]), int(event["end"])
    step = number == one["told"]
    if event["activity"] == state.activity:
        state.last_s = float(event["duration_s"]) + (state.last_s if step else 0.0)
        if number == 1 and not step:
            state.since, state.begun = onset, True
        state.final = max(state.final, number)
    one["first"], one["last"] = (onset if number == 1 and not step else one["first"]), end
    one["told"] = number
    return _believed(state, event, stamp)


def _known(state: ExerciseState, activity: int) -> Any:
    """What is known of an activity: a row, blank at first."""
    one = state.known[activity % RECENT]
    if one["activity"] != activity:
        one["activity"], one["name"], one["told"] = activity, "", 0
        one["first"] = one["last"] = NEVER
    return one


def _activity(state: ExerciseState, event: Any, stamp: int) -> str:
    """A stretch is over: it goes into the strip, from its first repetition to its last one, or without the rests that lie in it."""
    onset, end = int(event["onset"]), int(event["end"])
    one = _known(state, int(event["activity"]))
    state.gone = max(state.gone, int(event["activity"]))
    if event["activity"] == state.activity:
        _turn_to(state, state.behind, state.behind_since)
    if not event["repeats"]:
        seconds = (end - onset) / NS - rested_s(state, onset, end)
        return "" if seconds < SHORT_S else _past(state, "other motion", 0, onset, seconds)
    if one["first"] > NEVER and one["told"] == event["repetitions"]:
        onset, end = int(one["first"]), int(one["last"])
    number = f" {event['cluster'] + 1}" if event["cluster"] >= 0 else ""
    what, doubtful = one["name"] or f"exercise{number}", bool(event["certainty"] <= 0.0)
    return _past(state, what, int(event["repetitions"]), onset, (end - onset) / NS, doubtful)


def rested_s(state: ExerciseState, onset: int, end: int) -> float:
    """How much of onset..end somebody rested, of the rests in the strip."""
    total = 0.0
    for one in state.past[: state.passed]:
        if one["what"] == REST:
            first, last = int(one["onset"]), int(one["onset"]) + round(float(one["seconds"]) * NS)
            total += max(0, min(last, end) - max(first, onset)) / NS
    return total


def _resting(state: ExerciseState, event: Any, stamp: int) -> str:
    state.rest_since = int(event["onset"])
    return ""


def _rest(state: ExerciseState, event: Any, stamp: int) -> str:
    state.rest_since = NEVER
    seconds = (int(event["end"]) - int(event["onset"])) / NS
    return _past(state, REST, 0, int(event["onset"]), seconds) if seconds >= SHORT_S else ""


HEAR = {
    "provisional": _provisional,
    "count": _count,
    "believed": _believed,
    "repetition": _repetition,
    "activity": _activity,
    "resting": _resting,
    "rest": _rest,
}


def _turn_to(state: ExerciseState, activity: int, since: int) -> None:
    waits = activity >= 0 and activity < state.activity and not state.taken_back
    state.behind, state.behind_since = (state.activity, state.since) if waits else (-1, NEVER)
    state.taken_back = False
    state.activity, state.since = activity, since
    state.count, state.final, state.begun = 0, 0, False
    state.last_s, state.sure, state.certainty = np.nan, np.nan, 0.0


def _past(state: ExerciseState, what: str, repetitions: int, onset: int, seconds: float, doubtful: bool = False) -> str:
    place = state.passed if state.passed < STRIP else int(state.past["onset"].argmin())
    state.past[place] = (what, repetitions, onset, seconds, doubtful)
    state.passed += 1
    return f"ended: {past_text(state.past[place])}"


def name_of(state: ExerciseState, activity: int) -> str:
    """What an activity is called; "" if nobody has said."""
    one = state.known[activity % RECENT]
    return str(one["name"]) if one["activity"] == activity else ""


def past_text(one: Any) -> str:
    """A stretch that has ended: "squat x 6, 12.9 s", "C x 2, 3.1 s, not sure"."""
    times = f" x {one['repetitions']}" if one["repetitions"] else ""
    return f"{one_line(one['what'])}{times}, {one['seconds']:.1f} s" + (", not sure" if one["doubtful"] else "")


def now_line(state: ExerciseState) -> str:
    """What is being done: "squat x 7, last 1.8 s, since 0:14"; "motion" before anything of it is counted."""
    if state.activity < 0:
        return "nothing that repeats"
    name = one_line(name_of(state, state.activity))
    parts = [f"{name or 'exercise'} x {state.count}" if state.count else name or "motion"]
    if np.isfinite(state.last_s):
        parts.append(f"last {state.last_s:.1f} s")
    if state.since > NEVER and state.began > NEVER:
        seconds = max(0, (state.since - state.began) // NS)
        parts.append(f"since {seconds // 60}:{seconds % 60:02d}")
    if np.isfinite(state.sure) and state.sure > 0.0:
        parts.append(f"{state.sure:.0%} sure")
    if state.final > 1 and state.certainty <= 0.0:
        parts.append("not sure that it repeats")
    return ", ".join(parts)


def panel(state: ExerciseState) -> Text:
    """What is being done, large enough to be seen from a mat; below it what came before, the newest first."""
    shown = Text()
    if state.rest_since > NEVER:
        shown.append(REST, style="bold")
    elif state.activity < 0:
        shown.append("nothing that repeats", style="dim")
    else:
        shown.append(now_line(state), style="bold green")
        shown.append(f"\n{state.final} final, {max(0, state.count - state.final)} may still be corrected", style="dim")
    past = state.past[: state.passed]
    if len(past):
        order = np.argsort(-past["onset"], kind="stable")
        shown.append("\nbefore: " + " · ".join(past_text(past[k]) for k in order), style="dim")
    return shown
