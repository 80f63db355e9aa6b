"""A session's report: an HTML page that a clinician can read and print, and a CSV file of every cycle."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

from filelock import FileLock

from kinegraph.devices.outlets.append_file import AppendFile
from kinegraph.devices.outlets.output_lock import check_path, lock_output, unlock_output
from kinegraph.devices.reports.session.compose import compose
from kinegraph.devices.reports.session.contents.data import Curves, Report
from kinegraph.devices.reports.session.contents.labels import relative_to
from kinegraph.devices.reports.session.contents.paths import free_stem, page_of, recording_of
from kinegraph.devices.reports.session.contents.tally import Tally, add_chunk, nothing_yet, numbers
from kinegraph.devices.reports.session.curve_table import write_curves
from kinegraph.devices.reports.session.cycle_rows import (
    About,
    Held,
    header,
    nothing_held,
    release,
    settle,
    take_closed,
    take_statistics,
)
from kinegraph.devices.reports.session.drawing import PageDrawing
from kinegraph.devices.reports.session.ports import NEEDED, PORTS, check_ports
from kinegraph.devices.reports.session.workbook import missing, write_tables
from kinegraph.stream.chunk import Array, Chunk, Specs
from kinegraph.stream.data.state import pack
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.graph import Graph
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

FIRST_INTERIM_S = 30.0


@dataclass(slots=True)
class ReportState:
    """`stem`: the files' path without suffix; `offset`, `pending`: how far the CSV file has come."""

    tally: Tally
    held: Held
    stem: str = ""
    offset: int = 0
    pending: str = ""


class ReportRuntime:
    """What belongs to a running outlet but not to its state: specs, the graph, open files, a page being drawn."""

    def __init__(self, specs: Specs) -> None:
        self.specs = specs
        self.about = About(relative_to(specs["cycles"].meta))
        self.graph: Graph | None = None
        self.table: AppendFile | None = None
        self.lock: FileLock | None = None
        self.drawing = PageDrawing()
        self.next_interim = 0.0


@dataclass(frozen=True, slots=True)
class SessionReport(Outlet[ReportState, ReportRuntime]):
    """Gait cycles and what is known of them in; at the session's end a self-contained HTML page and a CSV file beside it.

    closed, cycles   of `operators.cycles.cycles.Cycles`; with these alone there are curves, cadence and rejected cycles
    statistics       of `operators.cycles.statistics.CycleStatistics`: the table's numbers per cycle
    muscles, pairs   of `operators.cycles.statistics.ensemble.CycleEnsemble`: repeatability, co-contraction
    quality          of `operators.emg.quality.SignalQuality`: the verdict on each electrode
    electrodes       of `operators.monitors.electrode_watch.ElectrodeWatch`, and
    contacts         of `operators.monitors.cycle_watch.CycleWatch`, and
    changes          of `operators.emg.mixtures.drift.MixtureDrift` (`change`), and
    channels         of `operators.monitors.channel_watch.ChannelWatch`, and
    patterns, timing of `operators.monitors.pattern_watch.PatternWatch` and `operators.monitors.timing_watch.TimingWatch`, and
    markers          of `operators.monitors.marker_watch.MarkerWatch`: the session's alarms, and how long each lasted
    symmetry         of `operators.cycles.statistics.symmetry.LimbSymmetry`
    footfalls, gait  of `operators.strides.footfalls.Footfalls` (`limbs`, `gait`)
    bursts, active   of `operators.cycles.statistics.bursts.CycleBursts` (`session`, `active`): when muscles are active, a table and bars
    modes            of `operators.emg.mixtures.PeakMixtures`: the modes of each muscle's activation peaks, as ellipses and a table
    distance         of `operators.emg.mixtures.drift.MixtureDrift`: how far a muscle has moved, and how far it is from the other leg's
    low, high        of `operators.cycles.statistics.norms.NormativeBands`: the laboratory's own bands, drawn behind the curves, and a table
    each_burst       of `operators.cycles.statistics.bursts.CycleBursts` (`bursts`): a table of every burst
    frequency        of `operators.cycles.statistics.median_frequency.MedianFrequency`
    annotations      what a person types: a table of remarks, with time and cycle
    emg              the raw signal: when the session began, its gaps and losses

    Where cycles name their limb, the limbs' curves of a muscle stand in one panel, and cadence, cycle and stance are given per limb. Where
    they name their stage (`operators.cycles.stages.Stages`), curves and numbers are given per stage, too, and NAME-curves.csv holds the
    mean
    curves of each stage (of the session, without stages) with their standard deviations; NAME-remarks.csv what was typed. `tables:
    [xlsx, mat]` writes all tables once more, as NAME.xlsx and NAME.mat.

    The CSV file has one row per cycle, rejected ones with the reason, written as the cycle closes. A cycle that is
    reported again (it was taken back, or counts after all) has two rows while the session runs (the last counts) and one at its end.
    Memory is bounded: running statistics
    and at most 200 single curves. Every `interim_s` a page marked "interim" is drawn, so that a crash leaves one; pages are drawn by a
    process of their own and appear whole or not at all. Existing files are never overwritten: a second session gets name-2.html.
    Without `path` the files lie with the session's recording, called after the node; where nothing is recorded, in reports.
    """

    inputs = {port: Input(optional=port not in NEEDED) for port in PORTS}
    durable: ClassVar[bool] = True

    path: str = param("", help="the page; the tables lie beside it; empty: with the recording")
    title: str = param("EMG session", help="the page's heading")
    tables: tuple[Literal["xlsx", "mat"], ...] = param((), help="the tables as an Excel workbook or MATLAB file, too")
    interim_s: float = param(180.0, least=10.0, help="how often an interim page is drawn")

    def open(self, specs: Specs) -> Specs:
        wrong = check_path(Path(self.path)) if self.path else ""
        if wrong or Path(self.path or "report.html").suffix != ".html":
            raise ParameterError("path", self.path, wrong or "a file that ends with .html")
        for kind in self.tables:
            if what := missing(kind):
                raise ParameterError("tables", kind, f"left out, or written after `{what}`")
        check_ports(specs)
        self.set_state(ReportState(nothing_yet(specs), nothing_held(specs)), ReportRuntime(specs))
        return {}

    @property
    def file(self) -> str:
        if not self.state.stem:
            return self.path
        page = Path(f"{self.state.stem}.html")
        if self.path:
            return str(Path(self.path).with_name(page.name))
        return str(page.relative_to(Path.cwd()) if page.is_relative_to(Path.cwd()) else page)

    def meet(self, graph: Graph) -> None:
        self.runtime.graph = graph
        self.runtime.about = replace(self.runtime.about, recording=recording_of(graph))

    def begin(self) -> None:
        runtime, state = self.runtime, self.state
        page = page_of(self.path, runtime.graph, self._node)
        runtime.lock = lock_output(page)
        try:
            fresh = not state.stem
            if fresh:
                state.stem = str(free_stem(page.with_suffix("")))
            runtime.table = AppendFile(_table(state), state.offset, state.pending.encode("latin-1"), fresh=fresh)
            if not runtime.table.offset and not runtime.table.pending:
                runtime.table.write(header(runtime.specs))
        except BaseException:
            unlock_output(runtime.lock)
            raise
        runtime.next_interim = time.monotonic() + min(FIRST_INTERIM_S, self.interim_s)

    def process(self, port: str, chunk: Chunk) -> None:
        runtime, state = self.runtime, self.state
        add_chunk(state.tally, runtime.specs, port, chunk)
        if len(chunk) and port in ("closed", "statistics"):
            self._write_rows(port, chunk.data)
        if time.monotonic() >= runtime.next_interim:
            runtime.next_interim = time.monotonic() + self.interim_s
            if not runtime.drawing.busy:
                runtime.drawing.begin(Path(state.stem), *self.report(interim=True))

    def close(self) -> None:
        runtime, state = self.runtime, self.state
        try:
            if runtime.table:
                runtime.table.write(release(state.held, state.tally.started, runtime.about))
            runtime.drawing.stop()
            runtime.drawing.draw(Path(state.stem), *self.report())
        finally:
            if runtime.table:
                table, runtime.table = runtime.table, None
                table.close()
                if state.tally.revised:
                    settle(_table(state))
                write_curves(Path(f"{state.stem}-curves.csv"), state.tally, runtime.specs, runtime.about.recording)
                written = {"cycles": _table(state), "curves": Path(f"{state.stem}-curves.csv")}
                if state.tally.typed.count:
                    written["remarks"] = Path(f"{state.stem}-remarks.csv")
                    state.tally.typed.write(written["remarks"], state.tally.started, runtime.about.recording)
                for kind in dict.fromkeys(self.tables):
                    write_tables(Path(f"{state.stem}.{kind}"), written)
            if runtime.lock:
                unlock_output(runtime.lock)

    def snapshot(self) -> dict[str, Array]:
        if self.runtime.table:
            self.state.offset, self.state.pending = (
                self.runtime.table.offset,
                self.runtime.table.pending.decode("latin-1"),
            )
        return pack(self.state)

    def report(self, *, interim: bool = False) -> tuple[Report, Curves]:
        """What the page is drawn from, as far as the session has come."""
        runtime, state = self.runtime, self.state
        node = runtime.graph.nodes.get(self._node) if runtime.graph else None
        inputs = node.inputs if node else {}
        names = {port: str(edge) for port, edge in inputs.items()}
        report, curves = compose(state.tally, runtime.specs, runtime.graph, names)
        report.title, report.interim = self.title, interim
        report.table_file = _table(state).name if state.stem else ""
        return report, curves

    def _write_rows(self, port: str, rows: Array) -> None:
        runtime, state = self.runtime, self.state
        start = state.tally.started
        if port == "closed":
            lines = take_closed(state.held, rows, start, runtime.about)
        else:
            lines = take_statistics(state.held, rows, numbers(runtime.specs[port]), start, runtime.about)
        if lines and runtime.table:
            runtime.table.write(lines)

    @property
    def _node(self) -> str:
        """What the graph calls it; of two with the same parameters, the first."""
        nodes = self.runtime.graph.nodes.values() if self.runtime.graph else ()
        return next((node.name for node in nodes if node.part == self), "report")


def _table(state: ReportState) -> Path:
    return Path(f"{state.stem}.csv")
