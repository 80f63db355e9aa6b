"""A night in one sentence, for whoever slept; and in a line that fits a phone's notification."""

from __future__ import annotations

import numpy as np

from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, night_zone
from kinegraph.devices.reports.night.numbers import NO_NUMBERS, runs
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
    asleep = f"Asleep {_long(n['tst'])}" if n["tst"] else "Not seen asleep"
    wake = f"awake {_long(awake)} in {_count(stretches)} stretch{'' if stretches == 1 else 'es'}"
    begin, end = clock(int(n["onset"]), zone), clock(int(n["end"]), zone)
    whole = (int(n["end"]) - int(n["onset"])) / 60e9
    lost = max(0.0, whole - float(np.isin(states, ("sleep", "wake")).sum()) * minutes)
    unknown = f"; {_long(lost)} not known" if lost >= 1 else ""
    between = "lights off" if n.get("bed") in ("lights", "schedule") else "in bed"
    return f"{asleep}, {wake if awake else 'never awake'}; {between} {begin:%H:%M} to {end:%H:%M}{unknown}."


def headline(facts: Facts) -> str:
    """The same in at most 60 characters: for a notification."""
    n = facts.numbers
    if not n:
        return "The night goes on" if not facts.closed else "A night without numbers"
    begin, end = (clock(int(n[name]), night_zone(facts)) for name in ("onset", "end"))
    efficient = f", {n['se']:.0f} % of the time" if n["se"] is not None else ""
    return f"Asleep {_long(n['tst'])}{efficient}, {begin:%H:%M} to {end:%H:%M}"


def _long(minutes: float | None) -> str:
    """6 h 20 min; 35 min below an hour."""
    whole = round(minutes or 0.0)
    return f"{whole} min" if whole < 60 else in_hours(whole)


def _count(number: int) -> str:
    return COUNTED[number] if number < len(COUNTED) else str(number)
