"""A page on a terminal stays when its session has ended, says so and links the report; without a terminal it ends by itself."""

from __future__ import annotations

import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from kinegraph.devices.page.hub import Hub, Looking
from kinegraph.devices.page.transfer.wire import decode
from tests.support.page_session import a_terminal, needs_page, page_process, see, until

pytestmark = needs_page

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, duration_s: 0.3}
  report: {use: leaves.Report, from: board.emg}
"""
LEAVES = '''
from dataclasses import dataclass
from pathlib import Path
from kinegraph.stream.outlet import Outlet

@dataclass(frozen=True, slots=True)
class Report(Outlet):
    """Leaves a page."""
    path: str = "the report.html"

    def open(self, specs):
        self.set_state(None)
        return {}

    def process(self, port, chunk):
        pass

    def close(self):
        Path(self.path).write_text("<b>42 cycles</b>")
'''


@pytest.fixture
def graph(tmp_path: Path) -> Path:
    (tmp_path / "graph.yaml").write_text(GRAPH)
    (tmp_path / "leaves.py").write_text(LEAVES)
    return tmp_path


@pytest.fixture
def terminal() -> Iterator[int]:
    with a_terminal() as there:
        yield there


def test_on_a_terminal_the_page_stays_with_the_report_until_ctrl_c(graph: Path, terminal: int) -> None:
    options = ("--no-record", "--view", "none", "--no-token")
    with page_process(graph, "run", "graph.yaml", *options, terminal=terminal) as process:
        with process.client() as client:
            see(client)
            reported = until(client, "state", over="the session has ended", reports=["the report.html"])
            assert reported["table"]["board.emg"]["samples"], "what was measured is still there"
        with urllib.request.urlopen(process.at("reports/0")) as report:
            assert report.read() == b"<b>42 cycles</b>"
            policy = report.headers["Content-Security-Policy"]
            assert "default-src 'none'" in policy and "sandbox" in policy and "script-src" not in policy
        with process.client() as later:
            see(later)
            assert until(later, "state")["reports"], "somebody who comes later finds it, too"
        for path in ("reports/1", "reports/-1", "reports/../leaves.py", "reports/"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                urllib.request.urlopen(process.at(path))
        assert "stays until Ctrl-C" in process.output
        assert process.stop() == 0


@pytest.mark.parametrize("options", [(), ("--for", "5")])
def test_without_a_terminal_or_for_a_given_time_the_command_ends_with_the_session(
    options: tuple[str, ...], graph: Path, terminal: int
) -> None:
    there = terminal if options else None
    with page_process(graph, "run", "graph.yaml", "--no-record", "--view", "none", *options, terminal=there) as process:
        assert process.process.wait(60) == 0
        assert "stays until" not in process.output


def test_a_session_that_was_ended_by_a_service_manager_does_not_stay(graph: Path, terminal: int) -> None:
    (graph / "graph.yaml").write_text(GRAPH.replace("duration_s: 0.3", "duration_s: 0"))
    with page_process(graph, "run", "graph.yaml", "--no-record", "--view", "none", terminal=terminal) as process:
        with process.client() as client:
            see(client)
            until(client, "signal")
        process.process.terminate()
        assert process.process.wait(60) == 0
        assert "stays until" not in process.output


def test_the_end_without_reports_keeps_those_that_were_named() -> None:
    hub = Hub(lambda _: None)
    hub.receive({"t": "over", "why": "the session has ended", "reports": ["/a/report.html"]}, memoryview(b""))
    hub.receive({"t": "over", "why": "the session has ended"}, memoryview(b""))
    (reported,) = hub.news_for(Looking())
    assert decode(reported)[0]["reports"] == ["report.html"], "clients get no paths"
