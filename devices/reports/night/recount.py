"""A night's numbers counted once more, from its log: after a break the log has epochs that the going-on session did not see."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs
from kinegraph.stream.chunk import NS
from kinegraph.stream.domain.night import NAMES, SLEEP, UNKNOWN, WAKE, night


def recounted(facts: Facts, epochs: LoggedEpochs) -> dict[str, Any]:
    """The numbers of `facts`, by their own definitions, of the epochs as they are logged; as they were, where nothing broke in on them.

    What was final before a power cut is in the log. The session that goes on has lost the newest frames, scores those epochs as not
    seen, and its statistics count them so. Before the log's first epoch the bed was empty: that is wake.
    """
    numbers = facts.numbers
    begin, end = int(numbers["onset"]), int(numbers["end"])
    if not any(begin < until and since < end for since, until in facts.breaks):
        return numbers
    step = round(facts.epoch_s * NS)
    n = round((end - begin) / step)
    place = (epochs.onset + step // 2 - begin) // step
    here = (place >= 0) & (place < n)
    states, activity = np.full(n, UNKNOWN, np.int8), np.full(n, np.nan)
    first = int(place[here].min()) if here.any() else 0
    states[:first], activity[:first] = WAKE, 1.0
    for name, code in zip(NAMES.tolist(), range(len(NAMES)), strict=True):
        states[place[here & (epochs.texts["state"] == name)]] = code
    activity[place[here]] = epochs.numbers["activity"][here]
    found = asdict(night(states, activity, facts.epoch_s / 60, numbers["convention"]))
    asleep = np.flatnonzero(states == SLEEP)
    slept = len(asleep) > 0 and found["first"] < n
    stop = found["stop"] if numbers["convention"] == "Actiware" else int(asleep[-1]) + 1 if slept else 0
    found["sleep_onset"], found["sleep_end"] = (begin + found["first"] * step, begin + stop * step) if slept else (0, 0)
    return {**numbers, **{name: None if value != value else value for name, value in found.items() if name in numbers}}
