"""What is being done now, on the terminal: which exercise, how often, since when, how sure; and what came before it."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.outlets.terminal.exercise_screen import (
    NAMED,
    PAST,
    RECENT,
    REST,
    STRIP,
    ExerciseState,
    name_of,
    now_line,
    panel,
    past_text,
    rested_s,
)
from kinegraph.devices.outlets.terminal.view import TerminalView
from kinegraph.stream.chunk import NEVER, NS, Chunk, Specs
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.text.safe_text import say

FIELDS = {
    "provisional": ("onset", "end", "activity", "repetition"),
    "count": ("activity", "count", "certainty"),
    "believed": ("activity", "repetition", "name", "sure"),
    "repetition": ("onset", "end", "activity", "repetition", "name", "sure", "duration_s"),
    "activity": ("onset", "end", "activity", "repeats", "repetitions", "cluster", "certainty"),
    "resting": ("onset",),
    "rest": ("onset", "end"),
}
"""By port: the fields that its events must have."""
UNKNOWN = "unknown"
"""The name of a repetition unlike all that were shown."""
SHORT_S = 2.0
"""Shorter rests, and what does not repeat and is shorter, are not worth a word."""


@dataclass(frozen=True, slots=True)
class ExercisePanel(Outlet[ExerciseState, None]):
    """The exercise that is being done, how often so far and since when, rest, and what came before: live.

    provisional, count, activity, rest, resting   of `operators.segmentation.Segment`
    believed, repetition                          of `operators.segmentation.names.naming.NameRepetitions`: names, and how sure they are

    Any streams of events with the same fields will do. `kinegraph run` shows them in its live view; where the output is no terminal, every
    repetition and everything that has ended is a line.
    """

    inputs = {port: Input(optional=port in ("believed", "repetition", "resting", "rest")) for port in FIELDS}

    bell: bool = param(False, help="ring the terminal's bell at every repetition")

    def open(self, specs: Specs) -> Specs:
        for port, spec in specs.items():
            if not set(FIELDS[port]) <= set(spec.dtype.names or ()):
                raise InputError(port, spec.describe(), f"events with the fields {', '.join(FIELDS[port])}")
        known = np.zeros(RECENT, NAMED)
        known["activity"] = -1
        self.set_state(ExerciseState(np.zeros(STRIP, PAST), known, named="believed" in specs), None)
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        state, line = self.state, ""
        if state.began == NEVER and chunk.until > NEVER:
            state.began = int(chunk.time[0]) if len(chunk) else chunk.until
        rung = 0
        for stamp, event in zip(chunk.time, chunk.data, strict=True):
            activity, count = state.activity, state.count
            line = HEAR[port](state, event, int(stamp)) or line
            rung += state.count > (count if state.activity == activity else 0)
        if len(chunk):
            self._show(line)
        for _ in range(rung if self.bell else 0):
            ring()

    def _show(self, line: str) -> None:
        if TerminalView.current is not None:
            TerminalView.current.hang_out("exercise", panel(self.state), line)
        elif line:
            with suppress(BrokenPipeError):  # the output was closed
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
    if event["activity"] > state.gone:
        _known(state, int(event["activity"]))["counted"] = event["count"]
    if event["activity"] != state.activity:
        if event["count"] == 0 or corrects_earlier(state, int(event["activity"])):
            return ""
        _turn_to(state, int(event["activity"]), stamp)
    state.taken_back = event["count"] == 0
    state.paused = state.paused and state.rest_since > NEVER
    state.unsaid = bool(state.named and event["count"] > state.count and not name_of(state, state.activity))
    state.count = int(event["count"])
    state.doubtful = state.final > 1 and bool(event["certainty"] <= 0.0)
    return "" if state.unsaid else now_line(state)


def corrects_earlier(state: ExerciseState, activity: int) -> bool:
    """Whether this event is about an earlier activity that has a count."""
    return activity <= state.gone or (activity < state.activity and state.count > 0 and not state.taken_back)


def _believed(state: ExerciseState, event: Any, stamp: int) -> str:
    """What a repetition is called that is not final yet: one that has not quite ended is less like what was shown. So if those of the
    activity that are final have a name, this one is not unknown, nor less sure; and before any is final, unknown is no answer yet."""
    one = _known(state, int(event["activity"]))
    if one["told"]:
        says = event["repetition"] <= one["told"] or event["name"] not in (one["name"], UNKNOWN)
    else:
        says = event["name"] != UNKNOWN or one["name"] != ""
    if says:
        _call(state, one, event)
    if state.unsaid and event["activity"] == state.activity:
        state.unsaid = False
        return now_line(state)
    return ""


def _call(state: ExerciseState, one: Any, event: Any) -> None:
    """An activity of which one is known is called as this event says."""
    if event["name"]:
        one["name"] = event["name"]
        if event["activity"] == state.activity:
            state.sure = float(event["sure"])


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
    _call(state, one, event)
    return ""


def _known(state: ExerciseState, activity: int) -> Any:
    """What is known of an activity: a row, blank at first."""
    one = state.known[activity % RECENT]
    if one["activity"] != activity:
        one["activity"], one["name"], one["told"], one["counted"] = activity, "", 0, 0
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


def _resting(state: ExerciseState, event: Any, stamp: int) -> str:
    state.rest_since, state.paused = int(event["onset"]), True
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
    state.last_s, state.sure = np.nan, np.nan
    state.doubtful = state.paused = state.unsaid = False


def _past(state: ExerciseState, what: str, repetitions: int, onset: int, seconds: float, doubtful: bool = False) -> str:
    place = state.passed if state.passed < STRIP else int(state.past["onset"].argmin())
    state.past[place] = (what, repetitions, onset, seconds, doubtful)
    state.passed += 1
    return f"ended: {past_text(state.past[place])}"
