"""The night's log: an outlet that writes every final epoch as it becomes final, and has the report drawn in the morning."""

from __future__ import annotations

import json
import uuid
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import structlog

from devices.outlets.claim import check_path, claim, let_go
from devices.outlets.night import archive, rows
from devices.outlets.night.archive import Facts, clock, nanoseconds
from devices.outlets.night.recount import recounted
from devices.outlets.night.runtime import LogRuntime, LogState
from devices.outlets.night.writing import OpenNight, readable, write_map
from devices.outlets.report.words import settings, versions
from stream.chunk import NEVER, NS, Array, Chunk, Specs
from stream.errors import DeviceError, ParameterError
from stream.graph import Graph
from stream.operator import Outlet
from stream.params import param
from stream.state import pack

if TYPE_CHECKING:
    from stream.clock import SessionClock

HELD = 200
"""What is known of this many epochs waits for their final scores (Webster's rules: up to 70)."""
APART_NS = 4 * 3600 * NS
"""So long after anyone was in bed, what follows is another night, whatever the statistics say."""
MOST_WAITING = 3000
"""This many epochs wait for a disk that takes no new folder: a day."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class NightLog(Outlet[LogState, LogRuntime]):
    """Every final epoch as a row on the disk, a folder for each night; in the morning a report: HTML, PNG, EDF+.

    epochs     of `operators.sleep.scorer.SleepScorer`
    nights     of `operators.sleep.statistics.SleepStatistics`: a row closes the night, and its numbers stand in the report
    bed        of `operators.depth.presence.Presence`: bed exits
    seen       of `operators.depth.activity.Activity` (epochs): how much of each epoch was seen, and whether anyone was in bed
    breathing  of `operators.depth.breathing.Breathing`
    map        of `operators.depth.night_map.NightMap`
    lights     a button or switch: when the lights went off and on
    view       of `operators.depth.view.View`: when the camera was moved

    A night begins with the first epoch in which somebody is in bed (without `seen`: with the first epoch), and a row of `nights` ends it.
    Rows are on the disk, past every cache, before the next epoch: neither `kill -9` nor a power cut loses or doubles one, and what was
    final once is never changed. A night that was broken off goes on after a restart, with the gap marked. While the disk is full rows wait
    in memory. Pages are drawn by a process of its own. About 150 kB a night, and as much for the report.
    """

    inputs: ClassVar[tuple[str, ...]] = ("bed", "seen", "breathing", "lights", "view", "map", "epochs", "nights")
    optional: ClassVar[tuple[str, ...]] = ("bed", "seen", "breathing", "lights", "view", "map")
    durable: ClassVar[bool] = True
    in_order: ClassVar[bool] = False

    path: str = param("nights", help="the folder of all nights")
    timezone: str = param("", help="of the times in the report, e.g. Europe/Berlin; left out: the computer's")
    sleeper: str = param("", help="whose night it is, where `seen`, `bed`, `breathing` are of several")
    keep_days: float = param(0.0, least=0.0, help="older nights are deleted; 0: none is")
    report: bool = param(True, help="draw the report in the morning")

    def open(self, specs: Specs) -> Specs:
        wrong = check_path(Path(self.path) / "night")
        if wrong:
            raise ParameterError("path", self.path, wrong)
        try:
            archive.zone_of(self.timezone)
        except (KeyError, ValueError):
            raise ParameterError("timezone", self.timezone, "a time zone's name, like Europe/Berlin") from None
        rows.check(specs)
        self.hold(LogState(), LogRuntime(specs))
        return {}

    def meet(self, graph: Graph) -> None:
        self.runtime.graph = graph

    def keep_time(self, clock: SessionClock) -> None:
        self.runtime.now = clock.utc_ns

    def begin(self) -> None:
        """Go on with the night that was broken off, if there is one."""
        runtime, root = self.runtime, Path(self.path).absolute()
        runtime.held = {int(onset): facts for onset, facts in json.loads(self.state.held).items()}
        runtime.claim = claim(root / (f"night-{self.sleeper}" if self.sleeper else "night"))
        runtime.zone = archive.zone_of(self.timezone)
        self.state.run = self.state.run or uuid.uuid4().hex
        broken_off = None
        for folder, facts in archive.nights(root):
            epochs = readable(folder)
            if facts.sleeper != self.sleeper or not len(epochs) or self._of_another_clock(folder, facts, epochs):
                continue
            runtime.last = max(runtime.last, int(epochs.onset[-1]))
            if facts.closed:
                runtime.former, runtime.former_end = folder, int(facts.numbers.get("end", runtime.last))
                self.state.rests = self.state.rests or str(epochs.texts["bed"][-1]) == "in"
            else:
                broken_off = folder, facts, epochs
        if broken_off:
            runtime.night = OpenNight.go_on(*broken_off)
            runtime.night.facts.run = self.state.run
            self._mark_break(runtime.night, int(broken_off[2].end[-1]))

    def _of_another_clock(self, folder: Path, facts: Facts, epochs: archive.LoggedEpochs) -> bool:
        """Whether an earlier session's night lies ahead of this one's beginning: a simulated one, or the clock has been wrong.

        Such a night is over, and what is seen now is not taken for what it holds already.
        """
        ahead = self.runtime.now != NEVER and int(epochs.onset[-1]) > self.runtime.now + round(facts.epoch_s * NS)
        if facts.run == self.state.run or not ahead:
            return False
        log.warning("a night in the log is ahead of the clock; another one begins beside it", night=folder.name)
        if not facts.closed:
            facts.closed = True
            with suppress(OSError):
                facts.save(folder)
        return True

    def _mark_break(self, night: OpenNight, written: int) -> None:
        """From the last epoch that is known, final or not, to now, nobody looked."""
        length, now = round(night.facts.epoch_s * NS), self.runtime.now
        begin = min(now, max([written, *(onset + length for onset in self.runtime.held)]))
        if now != NEVER:
            night.note(night.facts.breaks, [begin, now])
            log.info("the night goes on", night=night.folder.name, away_s=(now - begin) // NS)

    def process(self, port: str, chunk: Chunk) -> None:
        if len(chunk):
            if port == "map":
                self._map(np.asarray(chunk.data[-1]["map"], np.float32))
            else:
                for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                    self._take(port, row, stamp)
        self.runtime.renderer.look()

    def close(self) -> None:
        runtime = self.runtime
        self._settle()
        for late in runtime.over:
            late.let_go()
        try:
            runtime.renderer.finish()
        finally:
            night, runtime.night = runtime.night, None
            if runtime.claim:
                let_go(runtime.claim)
            if night:
                night.save()
                night.file.close()

    def snapshot(self) -> dict[str, Array]:
        self.state.held = json.dumps(self.runtime.held)
        return pack(self.state)

    # what comes in -------------------------------------------------------------------------------------------------------

    def _take(self, port: str, row: Any, stamp: int) -> None:
        if port == "epochs":
            self._epoch(row)
        elif port == "nights":
            self._night(row)
        elif port == "lights":
            self._switched(row, stamp)
        elif port == "view":
            self._looks(row)
        elif self.sleeper in ("", str(row["sleeper"])):
            if port == "bed":
                self._bed(row)
            else:
                self._hold(int(row["onset"]), rows.seen(row) if port == "seen" else rows.breathing(row))

    def _hold(self, onset: int, facts: dict[str, Any]) -> None:
        held = self.runtime.held
        held.setdefault(onset, {}).update(facts)
        while len(held) > HELD:
            del held[min(held)]

    def _epoch(self, row: Any) -> None:
        """A provisional score is held; a final one is written, once."""
        onset = int(row["onset"])
        if not row["final"]:
            self._hold(onset, {"provisional": str(row["state"])})
            return
        known = self.runtime.held.pop(onset, {})
        if onset <= self.runtime.last:
            return
        facts = {**known, **rows.final(row)}
        if rows.withdrawn(facts):
            facts["why"] = "body"
        self._settle()
        self._forget_deleted(onset)
        if self._begins_or_goes_on(onset, str(known.get("bed", "")), str(row["state"])):
            self.runtime.last = onset
            self.runtime.waiting = [*self.runtime.waiting[-MOST_WAITING:], facts]
            self._write()

    def _begins_or_goes_on(self, onset: int, bed: str, state: str) -> bool:
        """Whether an epoch belongs to a night: one that is open (or waits for the disk), or one that begins with it."""
        runtime, night = self.runtime, self.runtime.night
        told = "seen" in runtime.specs
        here = bed == "in" if told else state != "unknown"
        if night is not None and onset - night.in_bed > APART_NS:
            if not here:
                return False
            self._shut(night)
            night = runtime.night = None
        if bed == "out" or onset > runtime.former_end + APART_NS:
            self.state.rests = False
        if night is not None and here:
            night.in_bed = onset
        if night is not None or runtime.waiting:
            return True
        return here and not self.state.rests and (told or onset >= runtime.former_end + APART_NS)

    def _write(self) -> None:
        """Write what waits, in a new folder if need be; a disk that is full is tried again with the next epoch."""
        runtime = self.runtime
        if runtime.night is None:
            try:
                runtime.night = self._opened(nanoseconds(runtime.waiting[0]["onset"]))
            except (OSError, DeviceError) as error:
                log.error("the night has no folder yet; its epochs wait in memory", path=self.path, error=str(error))
                return
        for row in runtime.waiting:
            runtime.night.write(row)
        runtime.waiting = []

    def _night(self, row: Any) -> None:
        """The numbers of a night that is over."""
        runtime, night = self.runtime, self.runtime.night
        numbers = {name: row[name].item() for name in row.dtype.names}
        if night is None or not numbers["onset"] - APART_NS < night.facts.begun < numbers["end"]:
            return
        if numbers["onset"] >= runtime.deleted:
            night.facts.numbers = {k: (None if v != v else v) for k, v in numbers.items()}
            if not night.file.pending:
                night.facts.numbers = recounted(night.facts, readable(night.folder))
        runtime.former, runtime.former_end, runtime.night, runtime.deleted = night.folder, numbers["end"], None, NEVER
        self.state.rests = True
        log.info("the night is over", night=night.folder.name, folder=str(night.folder))
        self._shut(night)
        self._forget(numbers["end"])

    def _shut(self, night: OpenNight) -> None:
        self.runtime.over.append(night)
        self._settle()

    def _settle(self) -> None:
        """See that nights that are over are on the disk, and have them drawn."""
        runtime = self.runtime
        for night in [*runtime.over]:
            if night.deleted or night.shut():
                runtime.over.remove(night)
                night.let_go()
                if self.report and not night.deleted:
                    runtime.renderer.soon(night.folder)

    def _forget_deleted(self, onset: int) -> None:
        """The open night was deleted while it went on: what follows gets a folder of its own."""
        runtime = self.runtime
        if runtime.night is not None and runtime.night.deleted:
            log.warning(
                "the night was deleted while it went on; what follows is kept in another folder",
                night=runtime.night.folder.name,
            )
            runtime.night.let_go()
            runtime.night, runtime.deleted = None, onset

    def _bed(self, row: Any) -> None:
        before, self.state.bed = self.state.bed, str(row["state"])
        night = self.runtime.night
        if night is not None and self.state.bed != before:  # "in" comes again with a second body, and without it
            night.note(night.facts.exits, [int(row["onset"]), self.state.bed])

    def _switched(self, row: Any, stamp: int) -> None:
        night = self.runtime.night
        self.runtime.switched = [stamp, "lights on" if row["on"] else "lights off"]
        # a switch that says after a restart what it was before was not switched
        if night is not None and self.runtime.switched[1] not in [what for _, what in night.facts.switched[-1:]]:
            night.note(night.facts.switched, self.runtime.switched)

    def _looks(self, row: Any) -> None:
        """The camera was moved: that belongs into the night's facts, and into the log."""
        if str(row["what"]) != "moved":
            return
        onset = int(row["onset"])
        by = [float(row[name]) if np.isfinite(row[name]) else None for name in ("down", "right")]
        log.warning("the camera was moved", at=str(clock(onset, self.runtime.zone)), down_px=by[0], right_px=by[1])
        night = self.runtime.night
        if night is not None:
            night.note(night.facts.moved, [onset, *by])

    def _map(self, frame: Array) -> None:
        """The map comes with the night's numbers, before or after them."""
        runtime = self.runtime
        folder = runtime.night.folder if runtime.night else runtime.former
        if (
            folder is not None
            and folder.is_dir()
            and write_map(folder, frame)
            and runtime.night is None
            and self.report
        ):
            runtime.renderer.soon(folder)

    # nights on the disk --------------------------------------------------------------------------------------------------

    def _opened(self, onset: int) -> OpenNight:
        runtime = self.runtime
        folder = archive.new_folder(Path(self.path).absolute(), onset, runtime.zone)
        spec, graph = runtime.specs["epochs"], runtime.graph
        facts = Facts(
            folder.name, onset, float(spec.meta["epoch_s"]), self.timezone, self.sleeper,
            meta={k: v for k, v in spec.meta.items() if isinstance(v, str | int | float | bool)},
            session=dict(graph.session) if graph else {},
            settings=[[s.node, s.use, s.parameters] for s in settings(graph)] if graph else [],
            versions=[list(pair) for pair in versions()],
            run=self.state.run,
        )  # fmt: skip
        if self.state.bed:
            facts.exits.append([onset, self.state.bed])
        if runtime.switched and runtime.switched[1] == "lights off" and onset - runtime.switched[0] < APART_NS:
            facts.switched.append(runtime.switched)
        night = OpenNight.begin(folder, facts)
        log.info("a night begins", night=folder.name, at=str(clock(onset, runtime.zone)))
        return night

    def _forget(self, now: int) -> None:
        """Delete nights that are older than they may become."""
        if not self.keep_days:
            return
        root, oldest = Path(self.path).absolute(), now - self.keep_days * 86_400 * NS
        old = [folder for folder, facts in archive.nights(root) if facts.closed and facts.begun < oldest]
        old += [folder for folder in archive.damaged(root) if folder.stat().st_mtime_ns < oldest]
        for folder in old:
            try:
                archive.remove(folder)
                log.info("an old night was deleted", night=folder.name, keep_days=self.keep_days)
            except DeviceError as error:
                log.error(str(error))
