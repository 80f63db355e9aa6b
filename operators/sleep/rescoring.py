"""Webster's rescoring: short sleep after long wake is wake (Webster 1982).

The rules look at the scores as they were, not at what other rules made of them:
after at least 4 (10, 15) min of wake the first 1 (3, 4) min of sleep are wake; sleep of at most 6 (10) min between two stretches of at
least 10 (20) min of wake is wake. Unknown epochs end a stretch: nothing is concluded across them.
"""

from __future__ import annotations

import numpy as np

from kinegraph.stream.chunk import FOREVER
from kinegraph.stream.domain.night import SLEEP, UNKNOWN, WAKE, States, runs

AFTER = ((4.0, 1.0), (10.0, 3.0), (15.0, 4.0))
BETWEEN = ((10.0, 6.0), (20.0, 10.0))
REACH_MIN = 30.0
"""How far back and ahead of an epoch anything can matter to it."""


RULES = ("", *(f"after {wake:g} min" for wake, _ in AFTER), *(f"between {wake:g} min" for wake, _ in BETWEEN))
"""Names of the rules, as an epoch's reason gives them; the first: no rule."""


def rescored(states: States, epoch_min: float, *, ahead: int = UNKNOWN) -> States:
    """The states (n,) after Webster's rules. `ahead`: what is taken to go on for ever after the last one."""
    return np.where(rules_applied(states, epoch_min, ahead=ahead) > 0, np.int8(WAKE), states)


def rules_applied(states: States, epoch_min: float, *, ahead: int = UNKNOWN) -> States:
    """Which of RULES makes wake of each epoch (n,); 0: no rule does. Where several do, the first."""
    made = np.zeros(len(states), np.int8)
    found = [(state, first, stop, (stop - first) * epoch_min) for state, first, stop in runs(states)]
    if found and ahead:
        state, first, stop, _ = found[-1]
        if state == ahead:
            found[-1] = (state, first, stop, float(FOREVER))
        else:
            found.append((ahead, stop, stop, float(FOREVER)))
    for k, (state, first, stop, length) in enumerate(found):
        if state != SLEEP or k == 0 or found[k - 1][0] != WAKE:
            continue
        before = found[k - 1][3]
        around = min(before, found[k + 1][3]) if k + 1 < len(found) and found[k + 1][0] == WAKE else 0.0
        reached = [min(stop, first + round(sleep / epoch_min)) if before >= wake else first for wake, sleep in AFTER]
        reached += [stop if around >= wake and length <= sleep else first for wake, sleep in BETWEEN]
        for number, end in enumerate(reached, 1):
            made[first:end][made[first:end] == 0] = number
    return made


def settled(states: States, place: int, epoch_min: float) -> bool:
    """Whether nothing that may follow can change what the rules make of the epoch at `place`.

    Endless wake to come turns the most sleep into wake, endless sleep the least; where both agree, so does all between.
    """
    if states[place] != SLEEP:
        return True
    most, least = (rescored(states, epoch_min, ahead=ahead)[place] for ahead in (WAKE, SLEEP))
    return bool(most == least)
