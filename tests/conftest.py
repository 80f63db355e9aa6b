"""Settings of all tests: random ones draw the same examples every time; `KINEGRAPH_EXAMPLES` asks for more of them; LSL stays here."""

from __future__ import annotations

import gc
import os
import signal
from collections import Counter
from pathlib import Path

import pytest
import structlog
from hypothesis import HealthCheck, settings

from tests.support.command_line import kinegraph, made

__all__ = ["kinegraph", "made"]
"""Fixtures that tests may ask for by name."""

EXAMPLES = int(os.environ.get("KINEGRAPH_EXAMPLES", "0"))

settings.register_profile(
    "kinegraph",
    derandomize=not EXAMPLES,
    max_examples=EXAMPLES or 50,
    deadline=None,
    print_blob=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
settings.load_profile("kinegraph")

signal.signal(signal.SIGINT, signal.default_int_handler)
if hasattr(signal, "SIGQUIT"):
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)
"""A shell that starts the tests in the background has these two ignored, also by the commands that tests start and send them to."""

os.environ["KINEGRAPH_LSL"] = f"machine:tests-{os.getpid()}"
"""No test looks for LSL streams, or shows any, beyond this computer and its own process (and those that it starts)."""


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line("markers", "nightly: long or needs more than the repository holds")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Software written elsewhere is tried nightly, and where somebody asks for it."""
    if collection_path.name == "peers" and config.getoption("markexpr") == "not nightly":
        return True
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests of a file that share a fixture of their module run in one process, which makes it once."""
    for item in items:
        info = getattr(item, "_fixtureinfo", None)
        if info is None or item.get_closest_marker("xdist_group"):
            continue
        if any(known[-1].scope == "module" for known in info.name2fixturedefs.values()):
            item.add_marker(pytest.mark.xdist_group(item.path.stem))


def pytest_collection_finish() -> None:
    """What collection has made stays until the end. Every session that a test runs would look at a million objects for garbage first."""
    gc.collect()
    gc.freeze()


def pytest_runtest_teardown() -> None:
    """A command that ran within a test has bound the log to what was standard error then, which is closed for the tests that follow."""
    structlog.reset_defaults()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """The ten slowest files, and what all took."""
    took: Counter[str] = Counter()
    for reports in terminalreporter.stats.values():
        for report in reports:
            if isinstance(report, pytest.TestReport):
                took[report.nodeid.partition("::")[0]] += report.duration
    if len(took) > 1:
        terminalreporter.section("slowest files")
        for file, seconds in took.most_common(10):
            terminalreporter.write_line(f"{seconds:7.1f} s  {file}")
        terminalreporter.write_line(f"{took.total():7.1f} s  all {len(took)} files, of all processes together")


def pytest_report_header() -> str:
    if EXAMPLES:
        return f"random tests: {EXAMPLES} examples each, drawn anew; a failure prints how to repeat it"
    return "random tests: the same examples every time (KINEGRAPH_EXAMPLES=500 draws that many new ones)"
