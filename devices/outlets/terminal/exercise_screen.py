"""What the terminal shows of exercises: what is done now, how often, since when, how sure; and what came before it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.text import Text

from kinegraph.stream.chunk import NEVER, NS, Array
from kinegraph.stream.text.safe_text import one_line
from kinegraph.stream.text.time_text import elapsed

PAST = np.dtype([("what", "<U24"), ("repetitions", "<i4"), ("onset", "<i8"), ("seconds", "<f8"), ("doubtful", "?")])
NAMED = np.dtype(
    [("activity", "<i8"), ("name", "<U24"), ("first", "<i8"), ("last", "<i8"), ("told", "<i4"), ("counted", "<i4")]
)
RECENT = 8
"""This many activities are remembered, with their names: an activity's end is final when the next one goes on already."""
STRIP = 6
"""This many stretches before this one are shown."""
REST = "rest"
DOUBTED = 0.35
"""A name that is less sure is shown with a question mark: an exercise that was not shown may come as near."""


@dataclass(slots=True)
class ExerciseState:
    """What goes on. Times in ns; activity -1: no activity; rest_since NEVER: no rest; since: when it began; begun: that is when its
    first repetition did; last_s: how long the newest repetition took that is final, NaN: not yet; sure: of the name; doubtful: chance may
    have made what is counted

    paused: somebody has rested since the last repetition; named: names come, too; unsaid: the line of the newest count waits for its name

    gone: the newest activity that has ended; taken_back: whether all that was counted of this one was taken back; behind, behind_since: the
    next one, of which nothing is counted yet, while this one is corrected; -1: no activity

    past (STRIP,): in any order; passed: how many stretches have ended. known (RECENT,): activities by number modulo RECENT: name, how many
    repetitions are final and how many are counted, when the first one began and the last one ended. began: the first event's time, from
    which times are counted
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
    doubtful: bool = False
    paused: bool = False
    named: bool = True
    unsaid: bool = False
    rest_since: int = NEVER
    gone: int = -1
    taken_back: bool = False
    behind: int = -1
    behind_since: int = NEVER


def rested_s(state: ExerciseState, onset: int, end: int) -> float:
    """How much of onset..end somebody rested, of the rests in the strip."""
    total = 0.0
    for one in state.past[: state.passed]:
        if one["what"] == REST:
            first, last = int(one["onset"]), int(one["onset"]) + round(float(one["seconds"]) * NS)
            total += max(0, min(last, end) - max(first, onset)) / NS
    return total


def name_of(state: ExerciseState, activity: int) -> str:
    """The name of an activity, or ""."""
    one = state.known[activity % RECENT]
    return str(one["name"]) if one["activity"] == activity else ""


def past_text(one: Any) -> str:
    """A stretch that has ended: "squat x 6, 12.9 s", "C x 2, 3.1 s, not sure"."""
    times = f" x {one['repetitions']}" if one["repetitions"] else ""
    return f"{one_line(one['what'])}{times}, {one['seconds']:.1f} s" + (", not sure" if one["doubtful"] else "")


def now_line(state: ExerciseState) -> str:
    """What is being done: "squat x 7, last 1.8 s, since 0:14", "squat? x 7" where the name is hardly sure; "motion" before anything of
    it is counted."""
    if state.activity < 0:
        return "nothing that repeats"
    name = one_line(name_of(state, state.activity))
    name += "?" if name and 0.0 < state.sure < DOUBTED else ""
    parts = [f"{name or 'exercise'} x {state.count}" if state.count else name or "motion"]
    if np.isfinite(state.last_s):
        parts.append(f"last {state.last_s:.1f} s")
    if since := _since(state, state.since):
        parts.append(since)
    if np.isfinite(state.sure) and state.sure > 0.0:
        parts.append(f"{state.sure:.0%} sure")
    if state.doubtful:
        parts.append("not sure that it repeats")
    return ", ".join(parts)


def panel(state: ExerciseState) -> Text:
    """What is being done, large enough to be seen from a mat; below it what came before, the newest first."""
    shown = Text()
    if state.rest_since > NEVER:
        shown.append(f"{REST}, {_since(state, state.rest_since)}", style="bold")
    elif state.activity < 0:
        shown.append("nothing that repeats", style="dim")
    else:
        shown.append("motion" if state.paused else now_line(state), style="bold green")
    if state.paused and state.count:
        shown.append(f"\nso far {now_line(state)}")
    if state.activity >= 0 and (state.count or state.rest_since == NEVER):
        shown.append(f"\n{state.final} final, {max(0, state.count - state.final)} may still be corrected", style="dim")
    if before := _before(state):
        shown.append("\nbefore: " + " · ".join(before), style="dim")
    return shown


def _since(state: ExerciseState, stamp: int) -> str:
    """ "since 0:14", from the first event on; "" if that is not known."""
    if NEVER in (stamp, state.began):
        return ""
    return f"since {elapsed(max(0, stamp - state.began) / NS, hours=False)}"


def _before(state: ExerciseState) -> list[str]:
    """What came before, the newest first: what has ended, and what is not final though the next one goes on."""
    rows = [(int(one["onset"]), past_text(one)) for one in state.past[: state.passed]]
    for one in state.known:
        if state.gone < one["activity"] < state.activity and one["counted"] and one["told"]:
            onset, seconds = int(one["first"]), (one["last"] - one["first"]) / NS
            what = one["name"] or "exercise"
            rows.append((onset, past_text(np.array((what, one["counted"], onset, seconds, False), PAST))))
    return [text for _, text in sorted(rows, key=lambda row: -row[0])]
