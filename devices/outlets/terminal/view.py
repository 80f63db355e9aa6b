"""A running session on the terminal: one panel that is redrawn on a screen, plain lines elsewhere (a pipe, a log file)."""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Mapping
from contextlib import ExitStack, suppress
from typing import Any, ClassVar, Self, TextIO

import structlog
from rich.columns import Columns
from rich.console import Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from kinegraph.stream.graph import Graph
from kinegraph.stream.text.progress import FirstAndLast
from kinegraph.stream.text.safe_text import plain
from kinegraph.stream.text.screen import Screen
from kinegraph.stream.text.time_text import elapsed, rate
from kinegraph.stream.text.units import shown

REFRESH_HZ = 2.0
LINE_S = 10.0
HINT = "a word and Enter annotates · a digit or the space bar marks · Ctrl-C ends"
WAITING = "getting ready"

log = structlog.get_logger(__name__)

Metrics = Mapping[str, Mapping[str, Any]]
"""Per source stream, node, and "recording": what `stream.engine.status.table_of` measures."""


class TerminalView:
    """Keeps a session's metrics, and whatever running outlets would show, until it is left. By itself (`--view none`) it shows nothing.

    `update` only keeps what it is given; a thread of its own draws, so that the graph never waits for a terminal.
    """

    current: ClassVar[TerminalView | None] = None
    """The view that is open; outlets that show something on the terminal look here."""

    def __init__(self, graph: Graph, file: TextIO | None = None) -> None:
        self.name = graph.name or graph.path
        self.metrics: Metrics = {}
        self.waits_for = WAITING
        self.notices: dict[str, RenderableType] = {}
        self._file = file or sys.stdout
        self._began = time.monotonic()

    def update(self, metrics: Metrics) -> None:
        """The session's state now; called about once a second, from when it has begun."""
        if not self.metrics:
            self._began = time.monotonic()
        self.metrics = metrics

    def starting(self, text: str, over: bool) -> None:
        """How far the compilation of kernels is, and whether it is over; from any thread."""
        self.waits_for = WAITING if over else text

    def hang_out(self, title: str, notice: RenderableType, line: str) -> None:
        """Show `notice` before the metrics until the next one of this title; `line` says the same where lines are shown, "" nothing."""
        self.notices[title] = notice

    @property
    def elapsed_s(self) -> float:
        return time.monotonic() - self._began

    def __enter__(self) -> Self:
        self._began = time.monotonic()
        TerminalView.current = self
        return self

    def __exit__(self, *_: object) -> None:
        TerminalView.current = None


class LiveView(TerminalView):
    """A panel at the foot of the terminal, drawn twice a second; log lines run above it."""

    def __init__(self, graph: Graph, file: TextIO | None = None) -> None:
        super().__init__(graph, file)
        self._console = Screen(file=file)
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        super().__enter__()
        logs = sys.stderr.isatty()
        live = Live(
            get_renderable=self.panel,
            console=self._console,
            refresh_per_second=REFRESH_HZ,
            redirect_stdout=True,
            redirect_stderr=logs,
            vertical_overflow="crop",
        )
        self._stack.enter_context(live)
        if logs:
            self._stack.enter_context(_logs_to(sys.stderr))
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()
        super().__exit__()

    def panel(self) -> RenderableType:
        if not self.metrics:
            return Text.assemble((self.name, "bold"), f"  {self.waits_for}")
        head = Text.assemble((self.name, "bold"), f"  {elapsed(self.elapsed_s)}  ", (HINT, "dim"))
        return Group(head, Columns([*self.notices.values(), metrics_table(self.metrics)], padding=(0, 4)))


class LineView(TerminalView):
    """One line every ten seconds and one at the end, and one for whatever an outlet shows; for pipes, log files and screen readers."""

    def __init__(self, graph: Graph, file: TextIO | None = None) -> None:
        super().__init__(graph, file)
        self._next = LINE_S
        self._printed: Metrics = {}
        self._starting = FirstAndLast(lambda text: self._say(f"{self.name}: {text}"))

    def update(self, metrics: Metrics) -> None:
        super().update(metrics)
        if self.elapsed_s >= self._next:
            self._next = self.elapsed_s + LINE_S
            self._print_metrics()

    def starting(self, text: str, over: bool) -> None:
        self._starting(text, over)

    def __exit__(self, *of: object) -> None:
        super().__exit__(*of)
        if self.metrics is not self._printed:
            self._print_metrics()

    def _print_metrics(self) -> None:
        self._printed = self.metrics
        self._say(f"{elapsed(self.elapsed_s)}  {metrics_line(self.metrics)}")

    def hang_out(self, title: str, notice: RenderableType, line: str) -> None:
        if line:
            self._say(line)

    def __enter__(self) -> Self:
        self._say(f"{self.name}: {WAITING}")
        return super().__enter__()

    def _say(self, line: str) -> None:
        """Print a line; if the output is closed (`| head`, a full disk), the session continues without a view."""
        try:
            print(shown(plain(line)), file=self._file, flush=True)
        except OSError as error:
            self._file = _nowhere(error)


def _nowhere(error: OSError) -> TextIO:
    """What takes the place of a standard output that takes nothing any more; nor does the end of the program complain of it."""
    log.warning("the session is no longer shown, but continues", error=error.strerror or str(error))
    nowhere = open(os.devnull, "w")  # noqa: SIM115, PTH123 - for as long as the program runs
    with suppress(OSError, ValueError):
        os.dup2(nowhere.fileno(), sys.stdout.fileno())
    return nowhere


def metrics_table(metrics: Metrics) -> Table:
    """Rate, time per chunk, queue, drops and gaps of every source stream and node."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    table.add_column("stream or node", no_wrap=True)
    for name in ("rate /s", "p50 µs", "p99 µs", "queue", "dropped", "gaps"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("", no_wrap=True)
    for name, row in metrics.items():
        if row.get("kind") == "recording":
            continue
        trouble = row.get("error") or (
            "" if row.get("state") in (None, "running", "ended", "stopped") else row["state"]
        )
        table.add_row(
            name,
            rate(row.get("rate_hz", 0.0), 1),
            _number(row.get("p50_us")),
            _number(row.get("p99_us")),
            str(row.get("queue", 0)),
            _count(row.get("dropped", 0) + row.get("late", 0)),
            _count(row.get("gaps", 0)),
            Text(str(trouble), style="red"),
        )
    if recording := metrics.get("recording"):
        error = recording.get("error")
        table.add_row(
            "recording", f"{recording['bytes'] / 1e6:.1f} MB", "", "", "", _count(recording["dropped_chunks"]), "",
            Text(str(error or ""), style="red"),
        )  # fmt: skip
    return table


def metrics_line(metrics: Metrics) -> str:
    """The same in one line: the sources' rates, the slowest node, and all that was lost."""
    rates = [
        f"{n} {rate(r['rate_hz'], 0)}/s" for n, r in metrics.items() if r.get("kind") == "source" and r.get("rate_hz")
    ]
    timed = {n: float(r["p99_us"]) for n, r in metrics.items() if r.get("p99_us")}
    slowest = max(timed, key=timed.__getitem__, default="")
    parts = [", ".join(rates) or "nothing comes in"]
    if slowest:
        parts.append(f"slowest node {slowest} p99 {timed[slowest]:.0f} µs")
    dropped = sum(r.get("dropped", 0) + r.get("late", 0) + r.get("dropped_chunks", 0) for r in metrics.values())
    parts.append(f"dropped {dropped}, gaps {sum(r.get('gaps', 0) for r in metrics.values())}")
    parts += [f"{name}: {row['error']}" for name, row in metrics.items() if row.get("error")]
    return "; ".join(parts)


class _logs_to:
    """Within: log lines go to `file`, which draws them above the panel instead of across it."""

    def __init__(self, file: TextIO) -> None:
        self._factory = structlog.PrintLoggerFactory(file=file)

    def __enter__(self) -> None:
        self._before = structlog.get_config()["logger_factory"]
        structlog.configure(logger_factory=self._factory)

    def __exit__(self, *_: object) -> None:
        structlog.configure(logger_factory=self._before)


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def _count(value: int) -> Text:
    return Text(str(value), style="bold red" if value else "dim")
