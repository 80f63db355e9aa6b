"""The night's log: an outlet that writes every final epoch as it becomes final, and has the report drawn in the morning."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass, field
from datetime import tzinfo
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import structlog
from filelock import FileLock

from devices.append_file import AppendFile
from devices.claim import check_path, claim, let_go
from devices.night import shelf
from devices.night.shelf import COLUMNS, EPOCHS, MAP, Facts, clock, iso
from devices.report.words import settings, versions
from stream.chunk import NEVER, NS, Array, Chunk, Specs
from stream.errors import DeviceError, InputError, ParameterError
from stream.graph import Graph
from stream.operator import Outlet
from stream.params import param
from stream.state import pack

if TYPE_CHECKING:
    from stream.engine.clock import SessionClock

HELD = 200
"""What is known of so many epochs waits for their final scores (Webster's rules: up to 70)."""
APART_NS = 4 * 3600 * NS
"""So long after anyone was in bed, what follows is another night, whatever the statistics say."""
SETTLE_S, AGAIN_S, DRAWING_S = 1.0, 60.0, 300.0
MOST_LISTED = 500

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class LogState:
    """
    held   what is known of epochs that are not final yet, as JSON by onset
    bed    what the bed is now
    rests  the night is over, but somebody is still in bed: the next begins when the bed was left
    """

    held: str = "{}"
    bed: str = ""
    rests: bool = False


class _Desk:
    """What belongs to a running outlet but not to its state: files, and the night that is being written."""

    def __init__(self, specs: Specs) -> None:
        self.specs = specs
        self.graph: Graph | None = None
        self.claim: FileLock | None = None
        self.zone: tzinfo | None = None
        self.night: Night | None = None
        self.former: Path | None = None
        """The night that was closed last."""
        self.former_end = NEVER
        self.now = NEVER
        """When this session began; NEVER in replay."""
        self.held: dict[int, dict[str, Any]] = {}
        """What is known of epochs that are not final yet, by onset."""
        self.last = NEVER
        """Onset of the newest epoch that stands in a log."""
        self.drawing: tuple[subprocess.Popen[bytes], Path] | None = None
        self.due: dict[Path, float] = {}
        """Reports that are to be drawn, and when."""


@dataclass(slots=True)
class Night:
    """The open night. `in_bed`: the onset of the last epoch in which somebody was; `stale`: its facts are not on the disk yet."""

    folder: Path
    facts: Facts
    file: AppendFile
    in_bed: int
    stale: bool = field(default=False)

    def save(self) -> None:
        """Write the facts; a disk that is full is tried again with the next epoch."""
        try:
            self.facts.save(self.folder)
            self.stale = False
        except OSError as error:
            if not self.stale:
                log.error("cannot write the night's facts", folder=str(self.folder), error=error.strerror)
            self.stale = True


class _Logger(Outlet[LogState]):
    __slots__ = ("desk",)
    desk: _Desk


@dataclass(frozen=True, slots=True)
class NightLog(_Logger):
    """Every final epoch as a row on the disk, a folder for each night; in the morning a report: HTML, PNG, EDF+.

    epochs     of `operators.sleep_scorer.SleepScorer`
    nights     of `operators.sleep_statistics.SleepStatistics`: a row closes the night, and its numbers stand in the report
    bed        of `operators.depth_presence.Presence`: bed exits
    seen       of `operators.depth_activity.Activity` (epochs): how much of each epoch was seen, and whether anyone was in bed
    breathing  of `operators.depth_breathing.Breathing`
    map        of `operators.depth_night_map.NightMap`
    lights     a button or switch: when the lights went off and on

    A night begins with the first epoch in which somebody is in bed (without `seen`: with the first epoch), and a row of `nights` ends it.
    Rows are on the disk, past every cache, before the next epoch: neither `kill -9` nor a power cut loses or doubles one, and what was
    final once is never changed. A night that was broken off goes on after a restart, with the gap marked. While the disk is full rows wait
    in memory. Pages are drawn by a process of its own. About 150 kB a night, and as much for the report.
    """

    inputs: ClassVar[tuple[str, ...]] = ("bed", "seen", "breathing", "lights", "map", "epochs", "nights")
    optional: ClassVar[tuple[str, ...]] = ("bed", "seen", "breathing", "lights", "map")
    durable: ClassVar[bool] = True
    in_order: ClassVar[bool] = False

    path: str = param("nights", help="the folder of all nights")
    timezone: str = param("", help="of the times in the report, e.g. Europe/Berlin; left out: the computer's")
    sleeper: str = param("", help="whose night it is, where `seen`, `bed`, `breathing` tell of several")
    keep_days: float = param(0.0, least=0.0, help="older nights are deleted; 0: none is")
    report: bool = param(True, help="draw the report in the morning")

    def open(self, specs: Specs) -> Specs:
        wrong = check_path(Path(self.path) / "night")
        if wrong:
            raise ParameterError("path", self.path, wrong)
        try:
            shelf.zone_of(self.timezone)
        except (KeyError, ValueError):
            raise ParameterError("timezone", self.timezone, "a time zone's name, like Europe/Berlin") from None
        for port, needed in FIELDS.items():
            if port in specs and not set(needed) <= set(specs[port].dtype.names or ()):
                raise InputError(port, specs[port].describe(), f"events with the fields {', '.join(needed)}")
        if not float(specs["epochs"].meta.get("epoch_s", 0.0)) > 0:
            raise InputError("epochs", "without epoch_s in its meta", "scored epochs of a known length")
        if "map" in specs and len(specs["map"].dtype["map"].shape) != 2:
            raise InputError("map", specs["map"].describe(), "events whose field `map` is a table (rows, columns)")
        object.__setattr__(self, "desk", _Desk(specs))
        self.hold(LogState())
        return {}

    def meet(self, graph: Graph) -> None:
        self.desk.graph = graph

    def keep_time(self, clock: SessionClock) -> None:
        self.desk.now = clock.utc_ns

    def begin(self) -> None:
        """Go on with the night that was broken off, if there is one."""
        desk, root = self.desk, Path(self.path).absolute()
        desk.held = {int(onset): facts for onset, facts in json.loads(self.state.held).items()}
        desk.claim = claim(root / (f"night-{self.sleeper}" if self.sleeper else "night"))
        desk.zone = shelf.zone_of(self.timezone)
        for folder, facts in shelf.nights(root):
            if facts.sleeper != self.sleeper:
                continue
            epochs = _readable(folder)
            if len(epochs):
                desk.last = max(desk.last, int(epochs.onset[-1]))
            if facts.closed:
                desk.former, desk.former_end = folder, int(facts.numbers.get("end", desk.last))
                self.state.rests = self.state.rests or (len(epochs) > 0 and str(epochs.texts["bed"][-1]) == "in")
            elif len(epochs):
                desk.night = _continued(folder, facts, epochs)
                self._mark_break(desk.night, int(epochs.end[-1]))

    def _mark_break(self, night: Night, written: int) -> None:
        """From the last epoch that is known, final or not, to now, nobody looked."""
        length = round(night.facts.epoch_s * NS)
        begin = max([written, *(onset + length for onset in self.desk.held)])
        begin, now = min(begin, self.desk.now), self.desk.now
        if now != NEVER and len(night.facts.breaks) < MOST_LISTED:
            night.facts.breaks.append([begin, now])
            night.save()
            log.info("the night goes on", night=night.folder.name, away_s=(now - begin) // NS)

    def process(self, port: str, chunk: Chunk) -> None:
        if len(chunk):
            if port == "map":
                self._map(np.asarray(chunk.data[-1]["map"], np.float32))
            else:
                for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                    self._take(port, row, stamp)
        self._look_after_drawing()

    def close(self) -> None:
        desk = self.desk
        try:
            for folder in list(desk.due):
                desk.due[folder] = 0.0
            self._finish_drawing()
        finally:
            night, desk.night = desk.night, None
            if desk.claim:
                let_go(desk.claim)
            if night:
                night.save()
                night.file.close()

    def snapshot(self) -> dict[str, Array]:
        self.state.held = json.dumps(self.desk.held)
        return pack(self.state)

    # what comes in -------------------------------------------------------------------------------------------------------

    def _take(self, port: str, row: Any, stamp: int) -> None:
        if port == "epochs":
            self._epoch(row)
        elif port == "nights":
            self._night(row)
        elif port == "lights":
            self._switched(row, stamp)
        elif self.sleeper in ("", str(row["sleeper"])):
            if port == "bed":
                self._bed(row)
            else:
                self._hold(int(row["onset"]), _seen(row) if port == "seen" else _breathing(row))

    def _hold(self, onset: int, facts: dict[str, Any]) -> None:
        held = self.desk.held
        held.setdefault(onset, {}).update(facts)
        while len(held) > HELD:
            del held[min(held)]

    def _epoch(self, row: Any) -> None:
        """A provisional score is held; a final one is written, once."""
        onset = int(row["onset"])
        if not row["final"]:
            self._hold(onset, {"provisional": str(row["state"])})
            return
        known = self.desk.held.pop(onset, {})
        if onset <= self.desk.last:
            return
        night = self._night_for(onset, str(known.get("bed", "")), str(row["state"]))
        if night is None:
            return
        self.desk.last = onset
        facts = {
            "onset": iso(onset), "end": iso(int(row["end"])), "state": str(row["state"]), "rescored": int(row["rescored"]),
            "score": _number(row["score"]), "activity": _number(row["activity"]),
        }  # fmt: skip
        night.file.write(_line({**known, **facts}))
        night.file.sync()
        if night.stale:
            night.save()

    def _night_for(self, onset: int, bed: str, state: str) -> Night | None:
        """The night that an epoch belongs to; None if nobody is in bed and no night is open."""
        desk, night = self.desk, self.desk.night
        told = "seen" in desk.specs
        here = bed == "in" if told else state != "unknown"
        if night is not None and onset - night.in_bed > APART_NS:
            if not here:
                return None
            self._shut(night)
            night = None
        if bed == "out" or onset > desk.former_end + APART_NS:
            self.state.rests = False
        if night is None:
            if not here or self.state.rests or (not told and onset < desk.former_end + APART_NS):
                return None
            night = self._opened(onset)
        if here:
            night.in_bed = onset
        return night

    def _night(self, row: Any) -> None:
        """The numbers of a night that is over."""
        desk, night = self.desk, self.desk.night
        numbers = {name: row[name].item() for name in row.dtype.names}
        if night is None or not numbers["onset"] - APART_NS < night.facts.begun < numbers["end"]:
            return
        night.facts.numbers = {k: (None if v != v else v) for k, v in numbers.items()}
        night.facts.closed = True
        desk.former, desk.former_end, desk.night = night.folder, numbers["end"], None
        self.state.rests = True
        self._shut(night)
        log.info("the night is over", night=night.folder.name, folder=str(night.folder))
        self._draw_soon(night.folder)
        self._forget(numbers["end"])

    def _bed(self, row: Any) -> None:
        self.state.bed = str(row["state"])
        night = self.desk.night
        entry = [int(row["onset"]), self.state.bed]
        if night is not None and entry not in night.facts.exits and len(night.facts.exits) < MOST_LISTED:
            night.facts.exits.append(entry)
            night.save()

    def _switched(self, row: Any, stamp: int) -> None:
        night = self.desk.night
        if night is not None and len(night.facts.switched) < MOST_LISTED:
            entry = [stamp, "lights on" if row["on"] else "lights off"]
            if entry not in night.facts.switched:
                night.facts.switched.append(entry)
                night.save()

    def _map(self, frame: Array) -> None:
        """The map comes with the night's numbers, before or after them."""
        folder = self.desk.night.folder if self.desk.night else self.desk.former
        if folder is None or not folder.is_dir():
            return
        draft = folder / f".{MAP}.draft"
        try:
            with draft.open("wb") as file:
                np.save(file, frame)
            draft.replace(folder / MAP)
        except OSError as error:
            log.error("cannot write the motion map", folder=str(folder), error=error.strerror)
            return
        if self.desk.night is None:
            self._draw_soon(folder)

    # nights on the disk --------------------------------------------------------------------------------------------------

    def _opened(self, onset: int) -> Night:
        desk = self.desk
        folder = shelf.new_folder(Path(self.path).absolute(), onset, desk.zone)
        spec, graph = desk.specs["epochs"], desk.graph
        facts = Facts(
            folder.name, onset, float(spec.meta["epoch_s"]), self.timezone, self.sleeper,
            meta={k: v for k, v in spec.meta.items() if isinstance(v, str | int | float | bool)},
            session=dict(graph.session) if graph else {},
            settings=[[s.node, s.use, s.parameters] for s in settings(graph)] if graph else [],
            versions=[list(pair) for pair in versions()],
        )  # fmt: skip
        if self.state.bed:
            facts.exits.append([onset, self.state.bed])
        try:
            folder.mkdir(parents=True)
        except OSError as error:
            raise DeviceError(f"cannot make {folder}: {error.strerror}; choose another path") from None
        file = AppendFile(folder / EPOCHS)
        file.write((",".join(COLUMNS) + "\n").encode())
        night = desk.night = Night(folder, facts, file, onset)
        night.save()
        log.info("a night begins", night=folder.name, at=str(clock(onset, desk.zone)))
        return night

    def _shut(self, night: Night) -> None:
        """Close a night's files; what could not be written is told, and does not end the outlet."""
        night.facts.closed = True
        night.save()
        if self.desk.night is night:
            self.desk.night = None
        try:
            night.file.close()
        except DeviceError as error:
            log.error(str(error))

    def _forget(self, now: int) -> None:
        """Delete nights that are older than they may become."""
        if not self.keep_days:
            return
        for folder, facts in shelf.nights(Path(self.path).absolute()):
            if facts.closed and facts.begun < now - self.keep_days * 86_400 * NS:
                shelf.remove(folder)
                log.info("an old night was deleted", night=folder.name, keep_days=self.keep_days)

    # the report ----------------------------------------------------------------------------------------------------------

    def _draw_soon(self, folder: Path) -> None:
        if self.report:
            self.desk.due[folder] = time.monotonic() + SETTLE_S

    def _look_after_drawing(self) -> None:
        """Begin what is due, and see how the last one ended; never waits."""
        desk = self.desk
        if desk.drawing:
            process, folder = desk.drawing
            if process.poll() is None:
                return
            desk.drawing = None
            self._drawn(process, folder)
        for folder, when in list(desk.due.items()):
            if time.monotonic() >= when:
                del desk.due[folder]
                desk.drawing = (_draw(folder), folder)
                return

    def _finish_drawing(self) -> None:
        """At the session's end: everything that is due, once."""
        desk = self.desk
        while desk.drawing or desk.due:
            self._look_after_drawing()
            if not desk.drawing:
                continue
            process, folder = desk.drawing
            desk.drawing = None
            try:
                process.wait(DRAWING_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            self._drawn(process, folder)
            failed = desk.due.pop(folder, None)
            if failed and failed > time.monotonic() + SETTLE_S:
                raise DeviceError(
                    f"no report of {folder}: try `kinegraph nights report {folder.name} --path {folder.parent}`"
                )

    def _drawn(self, process: subprocess.Popen[bytes], folder: Path) -> None:
        complaint = process.stderr.read().decode(errors="replace").strip().splitlines()[-1:] if process.stderr else []
        if process.stderr:
            process.stderr.close()
        if process.returncode:
            log.error(
                "report not drawn; tried again in a minute", night=folder.name, why=complaint[0] if complaint else ""
            )
            self.desk.due[folder] = time.monotonic() + AGAIN_S
        else:
            log.info("report written", page=str(folder / "report.html"))


FIELDS = {
    "epochs": ("onset", "end", "state", "score", "activity", "final", "rescored"),
    "nights": ("onset", "end", "tib", "tst", "convention", "estimated"),
    "bed": ("onset", "sleeper", "state"),
    "seen": ("onset", "sleeper", "moved_s", "seen", "bed"),
    "breathing": ("onset", "sleeper", "rate", "confidence"),
    "lights": ("on",),
    "map": ("map",),
}


def _continued(folder: Path, facts: Facts, epochs: shelf.Epochs) -> Night:
    """A night that was broken off: a row that was being written is cut off."""
    text = (folder / EPOCHS).read_bytes()
    file = AppendFile(folder / EPOCHS, text.rfind(b"\n") + 1, fresh=False)
    there = epochs.texts["bed"] == "in"
    return Night(folder, facts, file, int(epochs.onset[there][-1] if there.any() else epochs.onset[-1]))


def _readable(folder: Path) -> shelf.Epochs:
    try:
        return shelf.read_epochs(folder)
    except shelf.NightError as error:
        log.error("a night cannot be read", folder=str(folder), error=str(error))
        none = np.empty(0, np.int64)
        return shelf.Epochs(none, none, {}, {})


def _seen(row: Any) -> dict[str, Any]:
    crosstalk = row["crosstalk"] if "crosstalk" in row.dtype.names else np.nan
    told = {"moved_s": row["moved_s"], "seen": row["seen"], "crosstalk": crosstalk}
    return {"bed": str(row["bed"]), **{name: _number(value) for name, value in told.items()}}


def _breathing(row: Any) -> dict[str, Any]:
    return {"breaths_per_min": _number(row["rate"]), "confidence": _number(row["confidence"])}


def _number(value: Any) -> str:
    return f"{float(value):.4g}" if np.isfinite(value) else ""


def _line(facts: dict[str, Any]) -> bytes:
    return (",".join(str(facts.get(name, "")) for name in COLUMNS) + "\n").encode()


def _draw(folder: Path) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "devices.night.page", str(folder)]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)
    try:
        os.setpriority(os.PRIO_PROCESS, process.pid, 10)
    except (OSError, AttributeError):
        log.debug("report drawn at normal priority")
    return process
