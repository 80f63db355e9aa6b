"""What a session looks like on a terminal, and without one."""

from __future__ import annotations

import io
import os
import pty
import re
import subprocess
import sys
from typing import Any

from rich.console import Console

from kinegraph.devices.outlets.terminal.view import WAITING, LineView, LiveView, metrics_line
from kinegraph.stream.graph import Graph

METRICS: dict[str, dict[str, Any]] = {
    "treadmill.emg": {"kind": "source", "state": "running", "samples": 5000, "rate_hz": 999.8, "queue": 1, "dropped": 0,
                      "late": 2, "gaps": 1, "lost": 30, "error": ""},
    "envelope": {"kind": "operator", "samples": 600, "rate_hz": 120.0, "p50_us": 41.3, "p99_us": 95.0, "queue": 0,
                 "dropped": 0, "gaps": 1, "error": ""},
    "csv": {"kind": "outlet", "samples": 1, "rate_hz": 0.9, "p50_us": 300.0, "p99_us": 1250.0, "queue": 0, "dropped": 7,
            "gaps": 0, "error": "disk on fire"},
    "recording": {"kind": "recording", "bytes": 2_500_000, "behind_s": 0.1, "dropped_chunks": 0, "error": ""},
}  # fmt: skip


def graph() -> Graph:
    return Graph("walk", {}, "")


def test_the_panel_shows_rate_latency_losses_and_errors() -> None:
    view = LiveView(graph(), io.StringIO())
    view.update(METRICS)
    view.hang_out("cycle", "cycle 7".ljust(100, "."), "cycle 7")
    console = Console(width=110, file=io.StringIO(), record=True)
    console.print(view.panel())
    rows = {line.split()[0]: line.split() for line in console.export_text().splitlines() if line.strip()}
    assert rows["treadmill.emg"][1:] == ["999.8", "1", "2", "1"]
    assert rows["envelope"][1:] == ["120.0", "41", "95", "0", "0", "1"]
    assert rows["csv"][-3:] == ["disk", "on", "fire"] and "7" in rows["csv"]
    assert rows["recording"][1:3] == ["2.5", "MB"] and rows["cycle"][1].startswith("7...")


def test_without_a_terminal_there_are_plain_lines() -> None:
    out = io.StringIO()
    with LineView(graph(), out) as view:
        view.update(METRICS)
        assert out.getvalue() == f"walk: {WAITING}\n"  # the metrics only every ten seconds
        view._next = 0.0
        view.update(METRICS)
        view.hang_out("cycle", "a table", "cycle 7  1.05 s")
    _, first, second = out.getvalue().splitlines()
    assert first == f"0:00  {metrics_line(METRICS)}" and second == "cycle 7  1.05 s"
    assert "treadmill.emg 1000/s" in first and "csv p99 1250 µs" in first and "dropped 9, gaps 2" in first
    assert "\x1b" not in out.getvalue()


def test_a_session_of_less_than_ten_seconds_prints_a_line_too() -> None:
    out = io.StringIO()
    with LineView(graph(), out) as view:
        view.update(METRICS)
    assert out.getvalue().splitlines()[1:] == [f"0:00  {metrics_line(METRICS)}"]


def test_a_session_without_any_sample_yet() -> None:
    assert metrics_line({}) == "nothing comes in; dropped 0, gaps 0"


SCRIPT = """
import sys, time, structlog
from kinegraph.devices.outlets.terminal.view import LiveView
from kinegraph.stream.cli.commands import logs
from kinegraph.stream.graph import Graph
logs.set_up()
log = structlog.get_logger("test")
with LiveView(Graph("walk", {}, "")) as view:
    for i in range(12):
        view.update({"emg": {"kind": "source", "rate_hz": 1000.0 + i, "queue": 0, "dropped": 0, "gaps": 0}})
        log.warning("log line", number=i)
        print(f"printed line {i}", flush=True)
        time.sleep(0.1)
log.warning("after the end")
print("last")
"""


def test_logs_and_the_panel_do_not_garble_each_other() -> None:
    master, terminal = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100", "LINES": "30", "NO_COLOR": "1"}
    with subprocess.Popen([sys.executable, "-c", SCRIPT], stdout=terminal, stderr=terminal, env=environment) as process:
        os.close(terminal)
        text = b""
        while True:
            try:
                got = os.read(master, 65536)
            except OSError:
                break
            text += got
            if not got:
                break
        assert process.wait() == 0
    os.close(master)
    shown = screen(text.decode())
    assert [line for line in shown if "printed line" in line] == [f"printed line {i}" for i in range(12)]
    logged = [line for line in shown if "log line" in line]
    assert len(logged) == 12 and all(re.search(rf"number={i}\b", line) for i, line in enumerate(logged))
    assert sum("rate /s" in line for line in shown) == 1 and "1011.0" in "\n".join(shown)
    assert any("after the end" in line for line in shown) and shown[-1] == "last"


def screen(text: str) -> list[str]:
    """The lines a terminal shows after `text`: just the controls that rich uses (up, erase line, return, newline)."""
    lines, row, column = [""], 0, 0
    for part in re.finditer(r"\x1b\[(\??[\d;]*)([A-Za-z])|([\r\n])|([^\x1b\r\n]+)", text):
        argument, control, newline, plain = part.groups()
        if control == "A":
            row = max(0, row - int(argument or 1))
        elif control == "K":
            lines[row] = lines[row][:column] if argument in ("", "0") else ""
        elif newline == "\r":
            column = 0
        elif newline == "\n":
            row, column = row + 1, 0
            if row == len(lines):
                lines.append("")
        elif plain:
            lines[row] = (lines[row].ljust(column)[:column] + plain + lines[row][column + len(plain) :]).rstrip()
            column += len(plain)
    while lines and not lines[-1]:
        lines.pop()
    return lines
