"""What is compared with what: each leg of a session with the same leg of the next, each stage with the same stage."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from kinegraph.operators.emg.commands.session_cycles import SessionCycles, other_speeds

UNEVEN = 1.2
"""Cycles of which the slow ones (90th percentile) last this many times as long as the fast ones (10th) are of more than one speed."""


@dataclass(frozen=True, slots=True)
class Group:
    """What is the same in these sessions ("left, 1.2 m/s"; "" where nothing is named), and their places among all; the first two differ or
    do not."""

    name: str
    members: tuple[int, ...]


def by_stage(session: SessionCycles) -> list[SessionCycles]:
    """A session's cycles, stage by stage, without those in no stage; the session itself where there are no stages."""
    stages = list(dict.fromkeys(str(stage) for stage in session.stages if stage))
    made = []
    for stage in stages:
        here = session.stages == stage
        label = f"{session.label} {stage}"
        part = {
            "numbers": session.numbers[here],
            "curves": session.curves[here],
            "durations_s": session.durations_s[here],
            "stages": session.stages[here],
        }
        made.append(replace(session, label=label, stage=stage, **part))
    return made or [session]


def groups_of(recordings: list[list[SessionCycles]]) -> tuple[list[Group], list[str]]:
    """The groups of sessions to compare, by their recordings, and remarks about them.

    Of several recordings, the same leg in the same stage. Of one recording, its legs in the same stage; of one leg alone, its stages.
    """
    every = [session for recording in recordings for session in recording]
    ways = [("limb", "stage")] if len(recordings) > 1 else [("stage",), ("limb",)]  # by what is the same in a group
    for way in ways:
        found: dict[tuple[str, ...], list[int]] = {}
        for place, session in enumerate(every):
            found.setdefault(tuple(getattr(session, part) for part in way), []).append(place)
        groups = [Group(", ".join(filter(None, key)), tuple(where)) for key, where in found.items() if len(where) > 1]
        if groups:
            paired = {place for group in groups for place in group.members}
            alone = [session.label for place, session in enumerate(every) if place not in paired]
            notes = (
                [f"compared with no other, because no other has this leg and stage: {', '.join(alone)}"]
                if alone
                else []
            )
            return groups, notes
    labels = ", ".join(session.label for session in every)
    return [Group("", tuple(range(len(every))))], [
        f"no two have the same leg and stage, so they are compared as they are: {labels}"
    ]


def speed_notes(sessions: list[SessionCycles], groups: list[Group]) -> list[str]:
    """What to say of speeds: those that differ within a group, and those that are pooled in a session."""
    notes = [note for group in groups for note in other_speeds([sessions[place] for place in group.members])]
    for session in sessions:
        if len(session.durations_s) < 2:
            continue
        fast, slow = np.percentile(session.durations_s, [10, 90]).tolist()
        if slow > UNEVEN * fast:
            notes.append(f"{session.label}: cycles of {fast:.2f} to {slow:.2f} s; different speeds are in one mean")
    return notes
