"""From a night's log to the contents of the report: the table, what was not seen, and the words that belong to them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs, clock, night_zone
from kinegraph.stream.chunk import NS
from kinegraph.stream.text.time_text import about, in_hours

CAVEATS = (
    "It estimates sleep and wake from movement.",
    "It has not been validated against polysomnography with this camera.",
    "Quiet wakefulness is commonly scored as sleep: time asleep is rather too long, time awake too short.",
    "It is not a medical device, and raises no alarm for apnoea or infants.",
    "Simplification removes detail finer than a block; outline and habits remain.",
)
PUBLISHED = ((0.967, 0.450), (0.899, 0.657), (0.881, 0.683), (0.955, 0.532), (0.95, 0.83), (0.89, 0.53))
"""Sensitivity and specificity against polysomnography of scorers that see movement alone: of MESA's nights in bed Cole-Kripke, the same
rescored, Oakley 40 rescored, and a sensor under the mattress; by radar healthy sleepers, at least, and patients (PMC8361351)."""
KNOWN_ERROR = (
    "Published error: what the time asleep would have been if this scorer erred as scorers of movement have against polysomnography "
    "(sensitivity .88 to .97, specificity .45 to .83). While somebody lies awake and still, their specificity is .21 or less."
)
NO_NUMBERS = {
    False: "The night is not over: its numbers come with its end.",
    True: "The night was broken off, or a part of it deleted: it has no numbers.",
}
"""By whether it is closed."""
SHOWN_NS = 15 * 60 * NS
"""This much before and after the night is drawn."""
MIN_SEEN = 0.5
AT_ONCE_NS = 60 * NS


@dataclass(frozen=True, slots=True)
class ReportRow:
    """A line of the table: a name, its value, what the unknown epochs leave open, and what it is."""

    name: str
    value: str
    bounds: str
    meaning: str


@dataclass(frozen=True, slots=True)
class Stretch:
    """A time of the night with something to say about it (ns)."""

    begin: int
    end: int
    what: str


def span(facts: Facts, epochs: LoggedEpochs) -> tuple[int, int]:
    """From when to when the report shows the night."""
    if facts.numbers:
        begin = facts.begun if begun_after(facts, epochs) else int(facts.numbers["onset"]) - SHOWN_NS
        return begin, int(facts.numbers["end"]) + SHOWN_NS
    return (int(epochs.onset[0]), int(epochs.end[-1])) if len(epochs) else (facts.begun, facts.begun + NS)


def begun_after(facts: Facts, epochs: LoggedEpochs) -> Stretch | None:
    """The break after which the numbers begin, though the night had begun before it: another session saw that part. None: no break."""
    n = facts.numbers
    dark = [int(t) for t, what in facts.switched if what == "lights off"]
    for begin, end in ((int(a), int(b)) for a, b in facts.breaks):
        known = epochs.texts["bed"][(epochs.end <= begin) & np.isin(epochs.texts["bed"], ("in", "out"))]
        in_bed = not len(known) or known[-1] == "in"
        told_again = (
            int(n.get("onset", 0)) - end < AT_ONCE_NS
        )  # what a switch had been before comes with the new session
        dark_before = n.get("bed") != "lights" or told_again or any(t < begin for t in dark)
        if n and in_bed and dark_before and facts.begun < begin and end <= int(n["onset"]):
            return Stretch(begin, end, "")
    return None


def table(facts: Facts, epochs: LoggedEpochs) -> list[ReportRow]:
    """The night's numbers with their definitions, by the convention that made them."""
    n = facts.numbers
    if not n:
        return []
    time_in_bed = "from going to bed to leaving it, as it was seen" if n["estimated"] else "lights off to lights on"
    made = [
        ReportRow("Time in bed (TIB)", in_hours(n["tib"]), "", f"{time_in_bed}"),
        ReportRow("Total sleep time (TST)", in_hours(n["tst"]), _bounds(n, "tst", in_hours), "all epochs of sleep in the time in bed"),
        *_published(n),
        ReportRow("Sleep efficiency (SE)", f"{_plain(n['se'])} %", _bounds(n, "se", _plain), "TST / TIB"),
        ReportRow(
            f"Sleep onset latency (SOL){', estimated' if n['estimated'] else ''}", _minutes(n["sol"]), _bounds(n, "sol", _minutes),
            "wake before the first epoch of sleep" + ("; without lights off it is an estimate" if n["estimated"] else ""),
        ),
        ReportRow("Wake after sleep onset (WASO)", _minutes(n["waso"]), _bounds(n, "waso", _minutes), WASO[n["convention"]]),
        ReportRow("Awakenings", str(n["awakenings"]), "", f"stretches of wake; on average {_minutes(n['mean_awakening'])}"),
        ReportRow("Longest sleep in one piece", in_hours(n["longest_bout"]), "", "without an epoch of wake or unknown"),
        ReportRow("Bed exits", str(len(exits(facts))), "", "times out of bed between two times in it"),
        ReportRow("Movement index", f"{_plain(n['movement'])} %", "", "epochs with movement, from the first to the last sleep"),
        ReportRow("Fragmentation index", f"{_plain(n['fragmentation'])} %", "", "movement index + share of still stretches up to 1 min"),
    ]  # fmt: skip
    epochs = epochs.part(int(n["onset"]), int(n["end"]))
    breaths = epochs.numbers["breaths_per_min"]
    known = breaths[np.isfinite(breaths)]
    if len(known):
        low, middle, high = np.percentile(known, [5, 50, 95])
        there = epochs.texts["bed"] == "in" if (epochs.texts["bed"] != "").any() else np.ones(len(epochs), np.bool_)
        covered = f"of {_share(np.isfinite(breaths[there]).mean())} of the epochs in bed; half of them are above this"
        made.append(ReportRow("Breathing rate", f"{middle:.1f} /min", f"90 %: {low:.1f} – {high:.1f}", covered))
        made += _breath(epochs)
    return made


def asleep_range(numbers: Mapping[str, Any]) -> tuple[float, float] | None:
    """Between which times asleep (min) the truth is, if the scorer errs as those that were published; None: nothing was scored.

    Of T minutes that were scored, S asleep: truth is (S - (1 - specificity) T) / (sensitivity + specificity - 1), within 0 and T.
    """
    scored = float(numbers["tib"]) - float(numbers.get("unknown") or 0.0)
    if not scored > 0:
        return None
    asleep = float(numbers["tst"])
    truths = [
        min(max(0.0, (asleep - (1 - specificity) * scored) / (sensitivity + specificity - 1)), scored)
        for sensitivity, specificity in PUBLISHED
    ]
    return min(truths), max(truths)


def _published(numbers: Mapping[str, Any]) -> list[ReportRow]:
    found = asleep_range(numbers)
    if found is None:
        return []
    low, high = found
    se = f"{100 * low / numbers['tib']:.0f} – {100 * high / numbers['tib']:.0f} % of the time in bed"
    what = "where TST would be if this scorer erred as six published ones did"
    return [ReportRow("TST, published error", f"{low / 60:.1f} – {high / 60:.1f} h", se, what)]


def _breath(epochs: LoggedEpochs) -> list[ReportRow]:
    """How far the chest rises, and pauses; nothing in the logs of older versions."""
    empty = np.empty(0)
    lift, pauses = (epochs.numbers.get(name, empty) for name in ("lift_mm", "pauses"))
    lift, pauses = lift[np.isfinite(lift)], pauses[np.isfinite(pauses)]
    made = []
    if len(lift):
        low, middle, high = np.percentile(lift, [5, 50, 95])
        made.append(
            ReportRow(
                "Chest lift", f"{middle:.1f} mm", f"90 %: {low:.1f} – {high:.1f}", "5th to 95th percentile of the wave"
            )
        )
    if len(pauses):
        hours = len(pauses) * float(np.median(epochs.end - epochs.onset)) / 3.6e12
        made.append(ReportRow("No effort seen for 10 s", f"{pauses.sum() / hours:.1f} /h", "", PAUSES))
    return made


PAUSES = "no diagnosis: effort under a thick blanket may not be seen"
WASO = {
    "AASM": "all wake from the first epoch of sleep to the end of the time in bed",
    "ActiLife": "all wake from the first epoch of sleep to the end of the time in bed",
    "Actiware": "wake within the sleep interval",
}


def exits(facts: Facts) -> list[Stretch]:
    """Times out of bed that a time in bed follows."""
    found, left = [], None
    begin, end = (int(facts.numbers.get(name, limit)) for name, limit in (("onset", 0), ("end", 1 << 62)))
    for time, state in sorted((int(t), str(s)) for t, s in facts.exits):
        if state == "out" and begin < time < end:
            left = time
        elif state == "in" and left is not None:
            found.append(Stretch(left, time, "out of bed"))
            left = None
    return found


def unseen(epochs: LoggedEpochs) -> list[Stretch]:
    """Stretches that were not scored: unknown epochs, and times between epochs of which no row is there."""
    found = [
        Stretch(int(epochs.onset[a]), int(epochs.end[b - 1]), "") for a, b in runs(epochs.texts["state"] == "unknown")
    ]
    found += [
        Stretch(int(epochs.end[k]), int(epochs.onset[k + 1]), "")
        for k in np.flatnonzero(epochs.onset[1:] > epochs.end[:-1]).tolist()
    ]
    joined: list[Stretch] = []
    for stretch in sorted(found, key=lambda s: s.begin):
        if joined and stretch.begin <= joined[-1].end:
            joined[-1] = Stretch(joined[-1].begin, stretch.end, "")
        else:
            joined.append(stretch)
    return joined


def quality(facts: Facts, epochs: LoggedEpochs) -> list[tuple[str, str]]:
    """What was seen of the night, and what was not."""
    zone = night_zone(facts)
    n = len(epochs)
    if not n:
        return [("Epochs", "none")]
    lost = unseen(epochs)
    lines = [("Epochs", f"{n} of {facts.epoch_s:g} s; {int((epochs.texts['state'] == 'unknown').sum())} unknown")]
    if lost:
        lines.append(("Not scored", "; ".join(_when(s, zone) for s in lost[:12]) + ("; …" if len(lost) > 12 else "")))
    lines += _disturbed(facts, epochs)
    if facts.breaks:
        whole = [Stretch(int(a), int(b), "") for a, b in facts.breaks]
        lines.append(("kinegraph did not run", "; ".join(_when(s, zone) for s in whole[:12])))
    if begun_after(facts, epochs):
        since = clock(int(facts.numbers["onset"]), zone)
        lines.append(
            (
                "Numbers",
                f"of the time from {since:%H:%M} on alone: kinegraph was stopped before, and a new session began",
            )
        )
    seen = epochs.numbers["seen"]
    if np.isfinite(seen).any():
        poor = int((seen < MIN_SEEN).sum())
        below = f"below one half in {poor} epoch{'' if poor == 1 else 's'}"
        lines.append(
            (
                "Frames seen and valid",
                f"{_share(float(np.nanmean(seen)))} on average; {below}",
            )
        )
    first = epochs.texts["provisional"]
    both = (first != "") & (first != "unknown") & (epochs.texts["state"] != "unknown")
    if both.any():
        changed = int((first != epochs.texts["state"])[both].sum())
        lines.append(("Provisional state corrected", f"in {changed} epochs ({100 * changed / both.sum():.1f} %)"))
    crosstalk = epochs.numbers["crosstalk"]
    if (crosstalk > MIN_SEEN).any():
        lines.append(("Movement that may be the partner's", f"in {int((crosstalk > MIN_SEEN).sum())} epochs"))
    breaths = epochs.numbers["breaths_per_min"]
    if np.isfinite(breaths).any():
        confidence = float(np.nanmean(epochs.numbers["confidence"][np.isfinite(breaths)]))
        lines.append(
            (
                "Breathing",
                f"known in {_share(np.isfinite(breaths).mean())} of all epochs; mean confidence {confidence:.2f}",
            )
        )
    return lines


WHY = {
    "camera": "the camera was moved, and the bed is learned again",
    "dark": "it was too dark for the camera",
    "unseen": "too little was seen",
    "light": "a light, or what else makes the frames noisier",
    "body": "a second body in the region, or the other sleeper moves",
    "still": "no breath and no movement, though the bed is not flat",
    "region": "something moves outside the bed: is the region right?",
    "learning": "too little was known yet of stillness",
}
"""Why an epoch was not judged."""


def _disturbed(facts: Facts, epochs: LoggedEpochs) -> list[tuple[str, str]]:
    """When the camera was moved, and why epochs were not judged."""
    zone = night_zone(facts)
    rows = []
    if facts.moved:
        rows.append(
            ("The camera was moved", "at " + ", ".join(f"{clock(int(m[0]), zone):%H:%M}" for m in facts.moved[:12]))
        )
    why = epochs.texts.get("why", np.empty(0, "U12"))
    counts = [(int((why == name).sum()), words) for name, words in WHY.items()]
    reasons = [f"{words}: {n} epoch{'' if n == 1 else 's'}" for n, words in counts if n]
    return [*rows, ("Not judged because", "; ".join(reasons))] if reasons else rows


def runs(which: np.ndarray) -> list[tuple[int, int]]:
    """(start, stop) of every stretch that is true."""
    edges = np.flatnonzero(np.diff(np.r_[False, which, False].astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _when(gap: Stretch, zone: object) -> str:
    begin, end = clock(gap.begin, zone), clock(gap.end, zone)  # type: ignore[arg-type]
    span = f"{begin:%H:%M}–{end:%H:%M}" if f"{begin:%H:%M}" != f"{end:%H:%M}" else f"{begin:%H:%M}"
    return f"{span} ({about((gap.end - gap.begin) / NS)})"


def _bounds(numbers: dict[str, object], name: str, write: object) -> str:
    """What the unknown epochs leave open; "" where they leave nothing."""
    low, high = numbers.get(f"{name}_low"), numbers.get(f"{name}_high")
    if low is None or high is None or low == high:
        return ""
    return f"{write(low)} – {write(high)}"  # type: ignore[operator]


def _minutes(minutes: float | None) -> str:
    return "–" if minutes is None else f"{minutes:.1f} min"


def _plain(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


def _share(value: float) -> str:
    return f"{100 * value:.0f} %"
