"""The report of a training session as an outlet: a CSV file of every repetition as it comes, an HTML page at the end."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import structlog
from filelock import FileLock

from kinegraph.devices.outlets.append_file import AppendFile
from kinegraph.devices.outlets.output_lock import check_path, lock_output, unlock_output
from kinegraph.devices.reports.training.page import render
from kinegraph.devices.reports.training.rows import REPETITION, REST, SET, Training, nothing_done, take
from kinegraph.stream.chunk import NEVER, NS, Array, Chunk, Specs
from kinegraph.stream.data.csv_writer import Sheet
from kinegraph.stream.data.state import pack
from kinegraph.stream.errors import DeviceError, InputError, ParameterError
from kinegraph.stream.graph import Graph
from kinegraph.stream.operator import Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.system.atomic_file import write_complete

KINDS = {
    "activity": ("sets", SET.names or ()),
    "repetition": ("repetitions", (*(REPETITION.names or ()), "side")),
    "rest": ("rests", REST.names or ()),
}
"""By port: where its events are kept, and the fields that they must have."""
HEADER = (
    "activity", "repetition", "exercise", "start (s)", "duration (s)", "range", "of", "distance", "sure", "side",
    "sides alike",
)  # fmt: skip

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class TrainingState:
    """`stem`: the files' path without suffix; `offset`, `pending`: how far the CSV file has come."""

    training: Training
    stem: str = ""
    offset: int = 0
    pending: str = ""


class TrainingRuntime:
    """What belongs to a running report but not to its state. `unit`: of ranges and distances."""

    def __init__(self, unit: str) -> None:
        self.unit = unit
        self.facts: dict[str, Any] = {}
        self.table: AppendFile | None = None
        self.lock: FileLock | None = None


@dataclass(frozen=True, slots=True)
class TrainingReport(Outlet[TrainingState, TrainingRuntime]):
    """Sets and repetitions in; at the session's end an HTML page for people and, beside it, a CSV file of every repetition.

    activity, rest   of `operators.segmentation.Segment`
    repetition       of `operators.segmentation.names.naming.NameRepetitions`

    Any streams of events with the same fields will do. The page holds what each set was: exercise, repetitions, tempo and how even it
    was, range, how near to what was shown, how alike left and right were, the rest after it; and how duration and range went over the
    session. Partial repetitions are listed apart, and not counted. What was done less often than `min_repetitions` in a row is no set: who
    drinks twice does no exercise. The CSV file grows as repetitions become final: a crash leaves it.
    Memory is bounded, by 1 MB: the page shows the first 500 sets and 20 000 repetitions, and says so. Existing files are never overwritten.
    """

    inputs = {port: Input(optional=port == "rest") for port in KINDS}
    durable: ClassVar[bool] = True

    path: str = param("reports/training.html", help="the page; the CSV file is written beside it")
    title: str = param("Training", help="the page's heading")
    full_share: float = param(
        0.5, least=0.0, most=1.0, help="a repetition counts if it goes as far as this share of its set's median; 0: all"
    )
    min_repetitions: int = param(3, least=1, help="fewer repetitions in a row are no set")

    def open(self, specs: Specs) -> Specs:
        wrong = check_path(Path(self.path))
        if wrong or Path(self.path).suffix != ".html":
            raise ParameterError("path", self.path, wrong or "a file that ends with .html")
        for port, spec in specs.items():
            needed = KINDS[port][1]
            if not set(needed) <= set(spec.dtype.names or ()):
                raise InputError(port, spec.describe(), f"events with the fields {', '.join(needed)}")
        self.set_state(TrainingState(nothing_done()), TrainingRuntime(specs["repetition"].unit_of("range")))
        return {}

    @property
    def file(self) -> str:
        """The page; where it could not be written, the table, if there is one; "" before there is anything."""
        for suffix in (".html", ".csv") if self.state.stem else ():
            made = Path(self.path).with_name(f"{Path(self.state.stem).name}{suffix}")
            if made.exists():
                return str(made)
        return ""

    def meet(self, graph: Graph) -> None:
        self.runtime.facts = dict(graph.session)

    def begin(self) -> None:
        runtime, state = self.runtime, self.state
        runtime.lock = lock_output(Path(self.path).absolute())
        try:
            fresh = not state.stem
            if fresh:
                state.stem = str(_unused(Path(self.path).absolute().with_suffix("")))
            table = Path(f"{state.stem}.csv")
            runtime.table = AppendFile(table, state.offset, state.pending.encode("latin-1"), fresh=fresh)
            if not runtime.table.offset and not runtime.table.pending:
                runtime.table.write(_lines([HEADER]))
        except BaseException:
            unlock_output(runtime.lock)
            raise

    def process(self, port: str, chunk: Chunk) -> None:
        training, table = self.state.training, self.runtime.table
        if training.began == NEVER and chunk.until > NEVER:
            training.began = int(chunk.time[0]) if len(chunk) else chunk.until
        if len(chunk):
            training.ended = max(training.ended, int(chunk.time[-1]))
        kind = KINDS[port][0]
        for event in chunk.data:
            if port != "activity" or (event["repeats"] and event["repetitions"] >= self.min_repetitions):
                take(training, kind, event)
        if port == "repetition" and len(chunk) and table:
            table.write(_lines([_row(event, training.began) for event in chunk.data]))

    def close(self) -> None:
        runtime, state = self.runtime, self.state
        page = Path(f"{state.stem}.html")
        try:
            if runtime.table:
                write_complete(
                    page,
                    render(
                        self.title,
                        runtime.facts,
                        state.training,
                        runtime.unit,
                        f"{page.stem}.csv",
                        self.full_share,
                        self.min_repetitions,
                    ),
                )
                log.info("report written", page=str(page), table=f"{state.stem}.csv")
        except OSError as error:
            raise DeviceError(f"report {page}: cannot be written: {error.strerror or error}") from None
        finally:
            if runtime.table:
                table, runtime.table = runtime.table, None
                table.close()
            if runtime.lock:
                unlock_output(runtime.lock)

    def snapshot(self) -> dict[str, Array]:
        table, state = self.runtime.table, self.state
        if table:
            state.offset, state.pending = table.offset, table.pending.decode("latin-1")
        return pack(state)


def _row(event: Any, began: int) -> list[Any]:
    numbers = [event["duration_s"], event["range"], event["distance"], event["sure"], event["symmetry"]]
    duration, reach, distance, sure, alike = ("" if np.isnan(v) else f"{v:.6g}" for v in numbers)
    start = f"{(int(event['onset']) - began) / NS:.3f}"
    owner = (int(event["activity"]), int(event["repetition"]), str(event["name"]))
    return [*owner, start, duration, reach, str(event["moves"]), distance, sure, int(event["side"]), alike]


def _lines(rows: list[Any]) -> bytes:
    text = io.StringIO()
    Sheet(text).writerows(rows)
    return text.getvalue().encode()


def _unused(stem: Path) -> Path:
    """`stem`, or the first of stem-2, stem-3, ... of which neither page nor table exists."""
    number, free = 1, stem
    while any(free.with_name(free.name + suffix).exists() for suffix in (".html", ".csv")):
        number += 1
        free = stem.with_name(f"{stem.name}-{number}")
    return free
