"""The numbers of every night, as soon as its last epoch is final."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from typing import Any, ClassVar

import numpy as np
import structlog

from kinegraph.operators.sleep.bed_schedule import BedSchedule
from kinegraph.operators.sleep.periods import PERIOD, scored, some_epochs
from kinegraph.operators.sleep.scored_epochs import ScoredEpochs
from kinegraph.stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Specs, StreamSpec, Times
from kinegraph.stream.domain.night import SLEEP, Convention, night
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator
from kinegraph.stream.params import param

MINUTES = (
    "unknown",
    "tib",
    "tst",
    "tst_low",
    "tst_high",
    "sol",
    "sol_low",
    "sol_high",
    "waso",
    "waso_low",
    "waso_high",
)
PERCENT = ("se", "se_low", "se_high", "movement", "fragmentation", "total_fragmentation")
NIGHT = np.dtype(
    [
        ("onset", "<i8"),
        ("end", "<i8"),
        ("sleep_onset", "<i8"),
        ("sleep_end", "<i8"),
        ("convention", "U8"),
        ("bed", "U9"),
        ("estimated", "?"),
        ("epochs", "<i8"),
        ("awakenings", "<i8"),
        *((name, "<f8") for name in (*MINUTES, "mean_awakening", "longest_bout", *PERCENT, "counts")),
    ]
)
UNITS = ("ns", "ns", "ns", "ns", "", "", "", "", "", *("min",) * (len(MINUTES) + 2), *("%",) * len(PERCENT), "")
BEDS = ("lights", "schedule", "detected", "recording")
MAX_ASKED = 16

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class SleepStatisticsState:
    """
    epochs  the newest final ones
    asked   (MAX_ASKED, 3)  times in bed that wait for their last final epoch: begin, end, place in BEDS; the first `asks` hold
    dark    when the lights went off; NEVER: they are on. window (2,): the schedule's present night; NEVER: not known yet
    last    the newest stamp of any input; promised: up to when nothing more comes. bed: what the time in bed is by
    known   end of the newest epoch that was scored; NEVER if not since the last row. parted: nothing counts until one is
    """

    epochs: ScoredEpochs
    asked: Times
    asks: int
    dark: int
    window: Times
    last: int
    promised: int
    bed: str
    known: int
    parted: bool


@dataclass(frozen=True, slots=True)
class SleepStatistics(Operator[SleepStatisticsState]):
    """Scored epochs in (only final ones count), one row of numbers per night out, as soon as the night's last epoch is final.

    What the time in bed is, by what is connected or given:
    lights     the port: 0 (or field `on` false) lights off, anything else lights on; a button, MQTT, `stream.manual.Value`
    schedule   the parameter, e.g. 22:30-07:00 in `timezone`
    periods    the port: of SleepPeriods, or of Nights (which knows of the lights where somebody switched them)
    (nothing)  all that was recorded, at most `longest_h` a row; where nothing is known for `apart_h`, the next night begins

    `estimated` is true for the last two (and for lights that never came on again): then `tib` is only a "time in bed", `sol` an
    estimate.
    Every row names its `convention`; stream.domain.night.night and docs/method/sleep.md define each number by each convention. Minutes;
    `se`, `movement`, `fragmentation`, `total_fragmentation` in %. Unknown epochs enter no numerator; `_low` and `_high` bound what they
    leave open. sleep_onset, sleep_end: 0 where there was no sleep. Missing epochs are unknown.

    Lights that stay off longer than `longest_h` are no night, nor is a scheduled one of which nothing was scored: they have no row, and
    the log says so. Memory: `longest_h` of epochs.

    >>> given, made = tried(SleepStatistics)
    >>> len(given["epochs"]), made[["tib", "tst", "waso"]][0].item()
    (800, (120.0, 116.0, 4.0))
    """

    inputs = {"epochs": Input(), "lights": Input(optional=True), "periods": Input(optional=True)}
    exemptions: ClassVar[dict[str, str]] = {
        "time": "a recording's end is its last night's end; until it comes nothing is promised beyond the last epoch"
    }

    convention: Convention = param("AASM", help="the definitions to use")
    schedule: str = param("", help="lights off and on every day, HH:MM-HH:MM")
    timezone: str = param("UTC", help="in which the schedule is meant, e.g. Europe/Berlin")
    longest_h: float = param(24.0, least=0.1, most=48.0, help="the longest time in bed")
    apart_h: float = param(
        3.0, above=0.0, help="of a recording as a whole: this long without a score separates two nights"
    )

    def open(self, specs: Specs) -> Specs:
        spec = scored(specs["epochs"], "epochs")
        bed = _time_in_bed_by(specs, self.schedule)
        BedSchedule.read(self.schedule, self.timezone)
        epoch_s = float(spec.meta.get("epoch_s", 0.0))
        if not epoch_s > 0:
            raise InputError("epochs", "without epoch_s in its meta", "scored epochs of a known length")
        n = int(np.ceil(self.longest_h * 3600 / epoch_s))
        self.set_state(
            SleepStatisticsState(
                ScoredEpochs.empty(round(epoch_s * NS), n), np.zeros((MAX_ASKED, 3), np.int64), 0, NEVER, np.array([NEVER, NEVER]),
                NEVER, NEVER, bed, NEVER, False,
            )
        )  # fmt: skip
        meta = {**spec.meta, "convention": self.convention, "bed": bed}
        return {"out": StreamSpec((), NIGHT, units=UNITS, settling_s=spec.settling_s, meta=meta)}

    def process(self, port: str, chunk: Chunk) -> Chunk:
        s = self.state
        made: list[tuple[Any, ...]] = []
        stamps: list[int] = []
        for k, stamp in enumerate(chunk.time.tolist()):
            s.last = max(s.last, stamp)
            if port == "epochs":
                if chunk.data[k]["final"]:
                    self._epoch(chunk.data[k], made)
            elif port == "lights":
                self._lights(stamp, bool(chunk.data[k]["on"]) if chunk.data.dtype.names else chunk.data[k].item(0) != 0)
            else:
                bed = str(chunk.data[k]["bed"]) if "bed" in (chunk.data.dtype.names or ()) else "detected"
                self._ask(int(chunk.data[k]["onset"]), int(chunk.data[k]["end"]), bed)
            self._answer(made, ended=False)
            stamps += [stamp] * (len(made) - len(stamps))
        until = chunk.until if s.last == NEVER and chunk.until != FOREVER else max(s.last - 1, NEVER)
        s.promised = max(s.promised, until)
        return Chunk(np.array(stamps, np.int64), np.array(made, NIGHT), s.promised, -1 if chunk.lost else 0)

    def close(self) -> Chunk:
        s = self.state
        made: list[tuple[Any, ...]] = []
        if s.epochs.count:
            end = s.epochs.end
            if s.bed == "recording":
                self._ask(s.epochs.begin, end, "recording")
            elif s.dark != NEVER and s.dark < end:
                self._ask(s.dark, end, "lights", estimated=True)
            elif s.bed == "schedule" and s.window[0] < end < s.window[1]:
                self._ask(int(s.window[0]), end, "schedule", estimated=True)
            self._answer(made, ended=True)
        return Chunk(np.full(len(made), s.last), np.array(made, NIGHT), FOREVER)

    @classmethod
    def cases(cls) -> Sequence[Case]:
        epochs = some_epochs(400, 24)
        begin = int(epochs[1][0])
        times = begin + np.array([20, 100, 130, 180, 200]) * 60 * NS
        on = np.array([0.0, 1.0, 0.0, 0.0, 1.0])[:, None]
        lights = (StreamSpec((1,), channels=("value",)), times, on)
        found = np.zeros(2, PERIOD)
        found["onset"], found["end"] = begin + np.array([10, 200]) * 60 * NS, begin + np.array([90, 300]) * 60 * NS
        periods = (StreamSpec((), PERIOD, units=("ns", "ns", "min", "")), found["end"] + 600 * NS, found)
        return [
            Case(cls(longest_h=2.0), {"epochs": epochs}, least=3),
            Case(cls("AASM", longest_h=3.0), {"epochs": epochs, "lights": lights}, least=2),
            Case(cls("Actiware", schedule="00:30-02:10", timezone="Europe/London"), {"epochs": epochs}, least=1),
            Case(cls("ActiLife"), {"epochs": epochs, "periods": periods}, least=2),
        ]

    def _apart(self, onset: int, state: str, made: list[tuple[Any, ...]]) -> bool:
        """End the row where nothing was known for `apart_h`; whether the epoch is one of those that lie between two nights."""
        s = self.state
        end = onset + s.epochs.length_ns
        if (
            s.epochs.count
            and s.known != NEVER
            and (onset if state != "unknown" else end) - s.known >= self.apart_h * 3600 * NS
        ):
            self._ask(s.epochs.begin, s.known, "recording")
            self._answer(made, ended=True)
            s.epochs.count, s.known, s.parted = 0, NEVER, state == "unknown"
        if state != "unknown":
            s.known, s.parted = end, False
        return s.parted

    def _epoch(self, event: Array, made: list[tuple[Any, ...]]) -> None:
        """Keep one final epoch, and ask for what it completes."""
        s = self.state
        if s.bed == "recording" and self._apart(int(event["onset"]), str(event["state"]), made):
            return
        s.epochs.add(event)
        end = s.epochs.end
        if s.bed == "recording" and s.epochs.full:
            self._ask(s.epochs.begin, end, "recording")
        elif s.bed == "schedule":
            if s.window[1] != NEVER and end >= s.window[1]:
                self._ask(int(s.window[0]), int(s.window[1]), "schedule")
                s.window[:] = NEVER
            if s.window[1] == NEVER and (schedule := BedSchedule.read(self.schedule, self.timezone)):
                s.window[:] = schedule.night_after(end)

    def _lights(self, stamp: int, on: bool) -> None:
        s = self.state
        if not on and s.dark == NEVER:
            s.dark = stamp
        elif on and s.dark != NEVER:
            self._ask(s.dark, stamp, "lights")
            s.dark = NEVER

    def _ask(self, begin: int, end: int, bed: str, *, estimated: bool = False) -> None:
        """From `begin` to `end` someone was in bed; more than MAX_ASKED that wait for their epochs are passed over."""
        s = self.state
        if bed == "lights" and end - begin > self.longest_h * 3600 * NS:
            hours = (end - begin) / (3600 * NS)
            log.error(
                "lights off for longer than longest_h: no night, and no numbers; were they switched on unseen?",
                since=_utc(begin), until=_utc(end), hours=round(hours, 2), longest_h=self.longest_h,
            )  # fmt: skip
            return
        if end - begin >= s.epochs.length_ns and s.asks < MAX_ASKED:
            s.asked[s.asks] = begin, end, BEDS.index(bed) + len(BEDS) * (estimated or bed in ("detected", "recording"))
            s.asks += 1

    def _answer(self, made: list[tuple[Any, ...]], *, ended: bool) -> None:
        """Emit the nights with a final last epoch."""
        s = self.state
        while s.asks and s.epochs.count and (ended or s.epochs.end >= s.asked[0, 1]):
            begin, end, code = s.asked[0].tolist()
            bed = BEDS[code % len(BEDS)]
            if bed == "schedule" and not s.epochs.any_known(begin, end):
                log.warning("a scheduled night without any score: no numbers", since=_utc(begin), until=_utc(end))
            else:
                made.append(self._row(begin, end, bed, code >= len(BEDS)))
            s.asked[:-1] = s.asked[1:]
            s.asks -= 1
            if s.bed == "recording":
                s.epochs.count = 0

    def _row(self, begin: int, end: int, bed: str, estimated: bool) -> tuple[Any, ...]:
        length = self.state.epochs.length_ns
        states, activity = self.state.epochs.between(begin, end)
        found = asdict(night(states, activity, length / (60 * NS), self.convention))
        asleep = np.flatnonzero(states == SLEEP)
        slept = len(asleep) > 0 and found["first"] < len(states)
        stop = found["stop"] if self.convention == "Actiware" else int(asleep[-1]) + 1 if slept else 0
        facts = {
            **found,
            "onset": begin,
            "end": end,
            "sleep_onset": begin + found["first"] * length if slept else 0,
            "sleep_end": begin + stop * length if slept else 0,
            "convention": self.convention,
            "bed": bed,
            "estimated": estimated,
        }
        return tuple(facts[name] for name in NIGHT.names or ())


def _time_in_bed_by(specs: Specs, schedule: str) -> str:
    """Which of `BEDS` the time in bed is by. Raises InputError or ParameterError where two say when someone is in bed."""
    if "lights" in specs and not (specs["lights"].is_signal or "on" in (specs["lights"].dtype.names or ())):
        raise InputError("lights", specs["lights"].describe(), "a signal of one channel, or events with a field `on`")
    if "periods" in specs and not set(PERIOD.names or ()) <= set(specs["periods"].dtype.names or ()):
        raise InputError("periods", specs["periods"].describe(), "the periods of operators.sleep.periods.SleepPeriods")
    given = [name for name in ("lights", "periods") if name in specs]
    if schedule and given:
        raise ParameterError(
            "schedule", schedule, f"left out where {given[0]} are connected: both say when someone is in bed"
        )
    if len(given) > 1:
        raise InputError("periods", "connected beside lights", "left out: both say when someone is in bed")
    if schedule:
        return "schedule"
    return {"lights": "lights", "periods": "detected"}[given[0]] if given else "recording"


def _utc(time: int) -> str:
    return f"{datetime.fromtimestamp(time // NS, UTC):%Y-%m-%d %H:%M} UTC"
