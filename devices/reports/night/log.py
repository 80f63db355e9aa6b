"""The night's log: an outlet that writes every final epoch as it becomes final, and has the report drawn in the morning."""

from __future__ import annotations

import json
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import structlog

from kinegraph.devices.outlets.output_lock import check_path, lock_output, unlock_output
from kinegraph.devices.reports.night import archive, rows
from kinegraph.devices.reports.night.archive import Facts, clock
from kinegraph.devices.reports.night.log_state import LogState
from kinegraph.devices.reports.night.night_writer import APART_NS, NightWriter
from kinegraph.devices.reports.night.runtime import LogRuntime
from kinegraph.devices.reports.session.contents.labels import settings, versions
from kinegraph.stream.chunk import NS, Array, Chunk, Specs
from kinegraph.stream.data.state import pack
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.graph import Graph
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.stream.system.clock import SessionClock

HELD = 200
"""What is known of this many epochs waits for their final scores (Webster's rules: up to 70)."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class NightLog(Outlet[LogState, LogRuntime]):
    """Every final epoch as a row on the disk, a folder for each night; in the morning a report: HTML, PNG, EDF+.

    epochs     of `operators.sleep.scorer.SleepScorer`
    nights     of `operators.sleep.statistics.SleepStatistics`: a row closes the night, and its numbers stand in the report
    bed        of `operators.bed.presence.Presence`: bed exits
    seen       of `operators.bed.activity.Activity` (epochs): how much of each epoch was seen, and whether anyone was in bed
    breathing  of `operators.bed.breathing.Breathing`; wave: its output wave, the movement of the chest
    map        of `operators.bed.night_map.NightMap`
    lights     a button or switch: when the lights went off and on
    view       of `operators.bed.frames.view.View`: when the camera was moved

    A night begins with the first epoch in which somebody is in bed (without `seen`: with the first epoch), and a row of `nights` ends it.
    Rows are on the disk, past every cache, before the next epoch: neither `kill -9` nor a power cut loses or doubles one, and what was
    final once is never changed. A night that was broken off goes on after a restart, with the gap marked. While the disk is full rows wait
    in memory. Pages are drawn by a process of its own. About 600 kB a night, most of it the wave, and 150 kB
    for the report.
    """

    inputs = {
        "bed": Input(optional=True),
        "seen": Input(optional=True),
        "breathing": Input(optional=True),
        "wave": Input(optional=True),
        "lights": Input(optional=True),
        "view": Input(optional=True),
        "map": Input(optional=True),
        "epochs": Input(),
        "nights": Input(),
    }
    durable: ClassVar[bool] = True
    in_order: ClassVar[bool] = False

    path: str = param("nights", help="the folder of all nights")
    timezone: str = param("", help="of the times in the report, e.g. Europe/Berlin; left out: the computer's")
    sleeper: str = param("", help="the sleeper's name, if `seen`, `bed`, `breathing` are of several")
    keep_days: float = param(0.0, least=0.0, help="older nights are deleted; 0: never")
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
        self.set_state(LogState(), LogRuntime(specs))
        return {}

    @property
    def undelivered(self) -> str:
        return self.runtime.writer.undelivered if self.runtime.writer else ""

    def meet(self, graph: Graph) -> None:
        self.runtime.graph = graph

    def keep_time(self, clock: SessionClock) -> None:
        self.runtime.now = clock.utc_ns

    def begin(self) -> None:
        """Go on with the night that was broken off, if there is one."""
        runtime, root = self.runtime, Path(self.path).absolute()
        runtime.held = {int(onset): facts for onset, facts in json.loads(self.state.held).items()}
        runtime.lock = lock_output(root / (f"night-{self.sleeper}" if self.sleeper else "night"))
        runtime.zone = archive.zone_of(self.timezone)
        self.state.run = self.state.run or uuid.uuid4().hex
        runtime.writer = NightWriter(
            root, self.state, self._facts, sleeper=self.sleeper, has_seen="seen" in runtime.specs,
            keep_days=self.keep_days, report=self.report,
        )  # fmt: skip
        runtime.writer.resume(runtime.now, runtime.held)

    def process(self, port: str, chunk: Chunk) -> None:
        writer = self._writer
        if len(chunk):
            if port == "map":
                writer.map(np.asarray(chunk.data[-1]["map"], np.float32))
            elif port == "wave":
                self._breathes(chunk)
            else:
                for stamp, row in zip(chunk.time.tolist(), chunk.data, strict=True):
                    self._take(port, row, stamp)
        writer.look()

    def close(self) -> None:
        runtime = self.runtime
        try:
            if runtime.writer:
                runtime.writer.close()
        finally:
            if runtime.lock:
                unlock_output(runtime.lock)

    def snapshot(self) -> dict[str, Array]:
        self.state.held = json.dumps(self.runtime.held)
        return pack(self.state)

    @property
    def _writer(self) -> NightWriter:
        assert self.runtime.writer, "`begin` makes it"
        return self.runtime.writer

    def _take(self, port: str, row: Any, stamp: int) -> None:
        if port == "epochs":
            self._epoch(row)
        elif port == "nights":
            self._writer.end({name: row[name].item() for name in row.dtype.names})
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

    def _breathes(self, chunk: Chunk) -> None:
        """The wave of each epoch is held with it, `x` where it is not known."""
        spec = self.runtime.specs["wave"]
        k = spec.channels.index(self.sleeper) if self.sleeper in spec.channels else 0
        length = round(float(self.runtime.specs["epochs"].meta["epoch_s"]) * NS)
        for stamp, values in zip(chunk.time.tolist(), chunk.data, strict=True):
            onset = stamp // length * length
            known = str(self.runtime.held.get(onset, {}).get("wave", "")).split()
            place = int((stamp - onset) * spec.rate_hz / NS)
            known += ["x"] * (place - len(known))
            self._hold(onset, {"wave": " ".join([*known, rows.risen(values[k])])})

    def _epoch(self, row: Any) -> None:
        """A provisional score is held; a final one is written, once."""
        onset = int(row["onset"])
        if not row["final"]:
            self._hold(onset, {"provisional": str(row["state"])})
            return
        known = self.runtime.held.pop(onset, {})
        if onset <= self._writer.last:
            return
        facts = {**known, **rows.final(row)}
        if rows.withdrawn(facts):
            facts["why"] = "body"
        self._writer.write(onset, facts, str(known.get("bed", "")), str(row["state"]))

    def _bed(self, row: Any) -> None:
        before, self.state.bed = self.state.bed, str(row["state"])
        night = self._writer.night
        if night is not None and self.state.bed != before:  # "in" comes again with a second body, and without it
            night.note(night.facts.exits, [int(row["onset"]), self.state.bed])

    def _switched(self, row: Any, stamp: int) -> None:
        night = self._writer.night
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
        night = self._writer.night
        if night is not None:
            night.note(night.facts.moved, [onset, *by])

    def _facts(self, onset: int) -> Facts:
        """What is known of a night that begins."""
        runtime = self.runtime
        spec, graph = runtime.specs["epochs"], runtime.graph
        facts = Facts(
            "", onset, float(spec.meta["epoch_s"]), self.timezone, self.sleeper,
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
        return facts
