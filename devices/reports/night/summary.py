"""A night in one sentence, for whoever slept; in a line that fits a phone's notification; and why an epoch has its state."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, nanoseconds, night_zone
from kinegraph.devices.reports.night.numbers import NO_NUMBERS, WHY, asleep_range, runs
from kinegraph.stream.text.time_text import in_hours

COUNTED = ("no", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve")


def sentence(facts: Facts, epochs: LoggedEpochs) -> str:
    """How long asleep, how long awake and in how many stretches, in bed from when to when; and what is not known, if that is much.

    Awake is all wake in the time in bed, before falling asleep, too, as the log's epochs say it.
    """
    n = facts.numbers
    if not n:
        return NO_NUMBERS[facts.closed]
    zone = night_zone(facts)
    part = epochs.part(int(n["onset"]), int(n["end"]))
    states, minutes = part.texts["state"], facts.epoch_s / 60
    awake = float((states == "wake").sum()) * minutes
    stretches = len(runs(states == "wake"))
    asleep = f"Asleep {_long(n['tst'])}{_error(n)}" if n["tst"] else "Not seen asleep"
    wake = f"awake {_long(awake)} in {_count(stretches)} stretch{'' if stretches == 1 else 'es'}"
    begin, end = clock(int(n["onset"]), zone), clock(int(n["end"]), zone)
    whole = (int(n["end"]) - int(n["onset"])) / 60e9
    lost = max(0.0, whole - float(np.isin(states, ("sleep", "wake")).sum()) * minutes)
    unknown = f"; {_long(lost)} not known" if lost >= 1 else ""
    between = "lights off" if n.get("bed") in ("lights", "schedule") else "in bed"
    return f"{asleep}, {wake if awake else 'never awake'}; {between} {begin:%H:%M} to {end:%H:%M}{unknown}."


def headline(facts: Facts) -> str:
    """The same in at most 60 characters: for a notification. In brackets: within the published error of such scorers."""
    n = facts.numbers
    if not n:
        return "The night goes on" if not facts.closed else "A night without numbers"
    begin, end = (clock(int(n[name]), night_zone(facts)) for name in ("onset", "end"))
    found = asleep_range(n)
    error = f" ({found[0] / 60:.1f}–{found[1] / 60:.1f} h)" if found else ""
    efficient = f", {n['se']:.0f} %" if n["se"] is not None else ""
    return f"Asleep {_long(n['tst'])}{error}{efficient}, {begin:%H:%M} to {end:%H:%M}"


def _error(numbers: dict[str, Any]) -> str:
    """What the published error of such scorers makes of the time asleep."""
    found = asleep_range(numbers)
    return f" ({_long(found[0])} to {_long(found[1])} by the published error of such scores)" if found else ""


WEBSTER = {
    "after 4 min": "after at least 4 min awake, the first minute of sleep counts as awake",
    "after 10 min": "after at least 10 min awake, the first 3 min of sleep count as awake",
    "after 15 min": "after at least 15 min awake, the first 4 min of sleep count as awake",
    "between 10 min": "sleep of at most 6 min between two times of at least 10 min awake counts as awake",
    "between 20 min": "sleep of at most 10 min between two times of at least 20 min awake counts as awake",
}
"""Webster's rules, by the names that epochs carry."""
UNKNOWN = {
    "unseen": "it was not seen",
    "gaps": "too much around it was not seen",
    "start": "it is too near the beginning for this method",
}


def reason(facts: Facts, epochs: LoggedEpochs, place: int) -> str:
    """Why the epoch at `place` has its state, in a sentence; "" where the night's log is older than reasons."""
    cause, why = (str(epochs.texts[name][place]) for name in ("cause", "why"))
    if not cause:
        return ""
    if cause in UNKNOWN:
        return f"Not scored: {WHY.get(why, UNKNOWN[cause])}."
    limit = facts.meta.get("threshold")
    against = f" ({epochs.numbers['score'][place]:.3g}; wake from {limit:g} on)" if limit is not None else ""
    if facts.meta.get("method") == "oakley":
        against = against.replace(" on)", " up)")
    if cause == "rescored":
        return f"Awake by Webster's rule: {WEBSTER.get(str(epochs.texts['rule'][place]), '')}. {_moved(facts, epochs, place)}".strip()
    verdict = (
        "Awake: the score reaches the threshold"
        if cause == "movement"
        else "Asleep: the score stays below the threshold"
    )
    return f"{verdict}{against}. {_moved(facts, epochs, place)}"


def _moved(facts: Facts, epochs: LoggedEpochs, place: int) -> str:
    """Which movement adds most to an epoch's score, and how much."""
    mover = str(epochs.texts["mover"][place])
    if not mover:
        return "Nothing moved around it."
    onset, zone = nanoseconds(mover), night_zone(facts)
    weight, adds = (float(epochs.numbers[name][place]) for name in ("weight", "adds"))
    what = f"movement at {clock(onset, zone):%H:%M:%S}"
    found = np.flatnonzero(epochs.onset == onset)
    if len(found):
        if epochs.texts["bed"][found[0]] == "out":
            what = f"being out of bed at {clock(onset, zone):%H:%M:%S}"
        elif np.isfinite(moved := epochs.numbers["moved_s"][found[0]]):
            what += f" ({moved:.3g} s of {facts.epoch_s:g} s)"
    here = " in this epoch" if onset == epochs.onset[place] else ""
    weighed = f"its weight is {weight:.3g}, and it adds {adds:.3g}" if np.isfinite(weight) else f"it adds {adds:.3g}"
    return f"The most comes from {what}{here}: {weighed} to the score."


def wakings(facts: Facts, epochs: LoggedEpochs) -> list[tuple[str, str, str]]:
    """When somebody was awake in bed, how long, and the reason of the epoch with the highest score there."""
    if not (epochs.texts["cause"] != "").any():
        return []
    zone, result = night_zone(facts), []
    for first, stop in runs((epochs.texts["state"] == "wake") & (epochs.texts["bed"] != "out")):
        score = epochs.numbers["score"][first:stop]
        top = first + int(np.nanargmax(score)) if np.isfinite(score).any() else first
        span = f"{clock(int(epochs.onset[first]), zone):%H:%M} – {clock(int(epochs.end[stop - 1]), zone):%H:%M}"
        result.append((span, _long((stop - first) * facts.epoch_s / 60), reason(facts, epochs, top)))
    return result


def _long(minutes: float | None) -> str:
    """6 h 20 min; 35 min below an hour."""
    whole = round(minutes or 0.0)
    return f"{whole} min" if whole < 60 else in_hours(whole)


def _count(number: int) -> str:
    return COUNTED[number] if number < len(COUNTED) else str(number)
