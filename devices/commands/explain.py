"""`kinegraph sleep explain`: why an epoch of a night is awake, asleep or unknown."""

from __future__ import annotations

import json
from datetime import datetime, time, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.devices.reports.night.archive import Facts, LoggedEpochs

STATES = {"wake": "awake", "sleep": "asleep", "unknown": "unknown"}
OLDER = "This night was written before reasons were kept: only its score is known."


def explain(
    night: Annotated[str, typer.Argument(metavar="NIGHT", help="such as 2026-11-20, or last")],
    when: Annotated[str, typer.Argument(metavar="TIME", help="on the night's clock, such as 03:12 or 03:12:30")],
    path: Annotated[Path, typer.Option(help="the folder of all nights")] = Path("nights"),
    as_json: Annotated[bool, typer.Option("--json", help="as JSON, for programs")] = False,
) -> None:
    """Explain an epoch's state: its score, the movement that adds most to it, and the rule that rescored it.

    kinegraph sleep explain last 03:12
    """
    from kinegraph.devices.reports.night import archive
    from kinegraph.devices.reports.night.summary import reason

    folder = archive.find(path, night)
    facts, epochs = archive.Facts.load(folder), archive.read_epochs(folder)
    place = _place(facts, epochs, when)
    sentence = reason(facts, epochs, place) or OLDER
    if as_json:
        say(json.dumps(_facts(facts, epochs, place, sentence)))
        return
    zone = archive.night_zone(facts)
    begin, end = (archive.clock(int(stamp[place]), zone) for stamp in (epochs.onset, epochs.end))
    texts, numbers = epochs.texts, epochs.numbers
    say(
        f"{facts.name}, {begin:%H:%M:%S} to {end:%H:%M:%S}: {STATES.get(str(texts['state'][place]), texts['state'][place])}"
    )
    say(sentence)
    if texts["provisional"][place] not in ("", texts["state"][place]):
        say(
            f"At first it was {STATES.get(str(texts['provisional'][place]), '')}, before the epochs after it were known."
        )
    seen = (
        f"{100 * numbers['seen'][place]:.0f} % of its frames were seen" if np.isfinite(numbers["seen"][place]) else ""
    )
    bed = f"the bed was {texts['bed'][place]}" if texts["bed"][place] == "unknown" else f"{texts['bed'][place]} of bed"
    bed = {"in": "in bed", "": ""}.get(str(texts["bed"][place]), bed)
    if text := ", ".join(part for part in (seen, bed) if part):
        say(f"{text[0].upper()}{text[1:]}.")


def _place(facts: Facts, epochs: LoggedEpochs, when: str) -> int:
    """The epoch that holds a time. Raises KinegraphError."""
    from kinegraph.devices.reports.night import archive

    zone = archive.night_zone(facts)
    if not len(epochs):
        raise KinegraphError(f"the night {facts.name} holds no epochs")
    first, last = archive.clock(int(epochs.onset[0]), zone), archive.clock(int(epochs.end[-1]), zone)
    try:
        if "T" in when.strip().upper():
            moment = datetime.fromisoformat(when.strip())
            moment = moment if moment.tzinfo else moment.replace(tzinfo=zone)
        else:
            moment = datetime.combine(first.date(), time.fromisoformat(when.strip()), zone)
            moment += timedelta(days=1) * (moment < first - timedelta(seconds=facts.epoch_s))
    except ValueError:
        raise KinegraphError(
            f"{when!r} is not a time; give one such as 23:15, 23:15:30 or 2026-11-20T23:15:30"
        ) from None
    stamp = round(moment.timestamp()) * NS
    holds = np.flatnonzero((epochs.onset <= stamp) & (stamp < epochs.end))
    if not len(holds):
        raise KinegraphError(
            f"the night {facts.name} has no epoch at {moment:%H:%M:%S}; it holds {first:%H:%M} to {last:%H:%M}, "
            "and gaps where kinegraph did not run"
        )
    return int(holds[0])


def _facts(facts: Facts, epochs: LoggedEpochs, place: int, sentence: str) -> dict[str, Any]:
    """Everything that is known of an epoch's state; null where it is not known."""
    from kinegraph.devices.reports.night.archive import iso, nanoseconds

    texts = {name: str(column[place]) for name, column in epochs.texts.items()}
    numbers = {name: _number(column[place]) for name, column in epochs.numbers.items()}
    movement: dict[str, Any] | None = None
    if texts["mover"]:
        movement = {"onset": texts["mover"], "activity": None, "moved_s": None, "bed": ""}
        for k in np.flatnonzero(epochs.onset == nanoseconds(texts["mover"]))[:1]:
            movement |= {name: _number(epochs.numbers[name][k]) for name in ("activity", "moved_s")}
            movement["bed"] = str(epochs.texts["bed"][k])
        movement |= {name: numbers[name] for name in ("weight", "adds")}
    return {
        "night": facts.name, "onset": iso(int(epochs.onset[place])), "end": iso(int(epochs.end[place])), "state": texts["state"],
        "provisional": texts["provisional"], "method": facts.meta.get("method", ""), "threshold": facts.meta.get("threshold"),
        "score": numbers["score"], "activity": numbers["activity"], "cause": texts["cause"], "movement": movement,
        "rescored": bool(numbers["rescored"]), "rule": texts["rule"], "why": texts["why"], "bed": texts["bed"], "seen": numbers["seen"],
        "sentence": sentence,
    }  # fmt: skip


def _number(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
