"""Steps and what they say about who walks, on the terminal: a panel in the live view, a line wherever the vote changes elsewhere."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.text import Text

from kinegraph.devices.outlets.terminal.view import TerminalView
from kinegraph.stream.chunk import Array, Chunk, Specs
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.text.safe_text import one_line, say

FIELDS = {
    "steps": ("number", "kind", "duration_s", "length_m"),
    "activity": ("activity", "before", "lasted_s"),
    "judgement": ("told", "vote", "share", "low", "high", "decided", "settles", "steps"),
}
"""By port: the fields that its events must have."""


@dataclass(slots=True)
class StepPanelState:
    """Of the newest step: number, kind, duration, length; how many were turns or came after a pause; judged: the newest judgement (1,).

    activity   what the person does; empty: unknown
    """

    number: int
    kind: str
    duration_s: float
    length_m: float
    turns: int
    pauses: int
    judged: Array
    decided: str
    worth: str
    activity: str


@dataclass(frozen=True, slots=True)
class StepPanel(Outlet[StepPanelState, None]):
    """Every step as it comes, and the running vote on what the person is taken for, with its interval and what the model is worth.

    steps       of `operators.steps.steps.Steps`
    activity    of `operators.steps.activity.StepActivity`
    judgement   of `operators.steps.classifier.StepClassifier`
    """

    inputs = {port: Input(optional=port in ("activity", "judgement")) for port in FIELDS}

    every: int = param(
        20, least=1, help="where the output is no terminal: a line after this many steps, and when a vote is decided"
    )

    def open(self, specs: Specs) -> Specs:
        for port, spec in specs.items():
            if not set(FIELDS[port]) <= set(spec.dtype.names or ()):
                raise InputError(port, spec.describe(), f"events with the fields {', '.join(FIELDS[port])}")
        accuracy = dict(specs["judgement"].meta.get("accuracy") or {}) if "judgement" in specs else {}
        worth = ""
        if "subject_wise" in accuracy:
            worth = f"right for {accuracy['subject_wise']:.0%} of steps of people it had never seen"
        judged = np.zeros(0, specs["judgement"].dtype if "judgement" in specs else np.float64)
        self.set_state(StepPanelState(0, "", np.nan, np.nan, 0, 0, judged, "", worth, ""), None)
        return {}

    def process(self, port: str, chunk: Chunk) -> None:
        state = self.state
        for k, event in enumerate(chunk.data):
            if port == "judgement":
                state.judged = chunk.data[k : k + 1].copy()
                changed = str(event["decided"]) != state.decided
                state.decided = str(event["decided"])
                self._show(judged_line(event) if changed else "")
                continue
            if port == "activity":
                state.activity = str(event["activity"])
                self._show(activity_line(event))
                continue
            state.number, state.kind = int(event["number"]), str(event["kind"])
            state.turns += state.kind == "turn"
            state.pauses += state.kind in ("first", "slow")
            if np.isfinite(event["duration_s"]):
                state.duration_s, state.length_m = float(event["duration_s"]), float(event["length_m"])
            self._show(steps_line(state) if state.number % self.every == 0 else "")

    def _show(self, line: str) -> None:
        if TerminalView.current is not None:
            TerminalView.current.hang_out("steps", panel(self.state), line)
        elif line:
            with suppress(BrokenPipeError):  # the output was closed
                say(line, flush=True)


def steps_line(state: StepPanelState) -> str:
    """ "40 steps, 2 turning, 1 after a pause; the last took 0.53 s, 0.71 m"."""
    line = f"{state.number} steps, {state.turns} turning, {state.pauses} after a pause"
    if state.activity:
        line = f"{state.activity}; {line}"
    if np.isfinite(state.duration_s):
        line += f"; the last took {state.duration_s:.2f} s, {state.length_m:.2f} m"
    return line


def activity_line(event: Any) -> str:
    """ "standing, after 12.4 s of walking"."""
    if np.isfinite(event["lasted_s"]) and event["before"] != "unknown":
        return f"{event['activity']}, after {event['lasted_s']:.1f} s of {event['before']}"
    return str(event["activity"])


def judged_line(event: Any) -> str:
    """ "brisk: 93 % of 38 steps (80-98 %)", or "uncertain" and after how many steps the vote would settle."""
    if not np.isfinite(event["share"]):
        return f"uncertain after {event['steps']} steps"
    interval = f"{event['low']:.0%}-{event['high']:.0%}"
    vote = f"{one_line(event['vote'])}: {event['share']:.0%} of sure steps ({interval}), {event['steps']} in all"
    if event["decided"] != event["vote"]:
        after = f", would settle after {event['settles']}" if event["settles"] > event["steps"] else ""
        return f"{one_line(event['decided'])}; {vote}{after}"
    return vote


def panel(state: StepPanelState) -> Text:
    shown = Text(steps_line(state))
    if len(state.judged):
        shown.append(f"\n{judged_line(state.judged[0])}", style="bold")
    if state.worth:
        shown.append(f"\n{state.worth}", style="dim")
    return shown
