"""While an outlet writes what is left, the log says that; a warning of a node that hangs is for a call on data only."""

from __future__ import annotations

from time import perf_counter_ns
from types import SimpleNamespace
from typing import Any

import pytest
from structlog.testing import capture_logs

from kinegraph.stream.cli.commands.ending import LOOK_S, Ending
from kinegraph.stream.engine.workers import Call
from kinegraph.stream.graph.model import NodeOptions


class Asked:
    """A session in which one call lasts."""

    def __init__(self, call: Call, *, is_outlet: bool, file: str = "") -> None:
        node = SimpleNamespace(name=call.node, is_outlet=is_outlet, options=NodeOptions())
        self.pipeline = SimpleNamespace(
            stages={call.node: SimpleNamespace(node=node, operator=SimpleNamespace(file=file))}
        )
        self.table: object = {}
        self.call, self.reports = call, list[str]()
        self.clock = SimpleNamespace(now=lambda: 0)
        self.log = SimpleNamespace(report=lambda kind, **facts: self.reports.append(kind))

    def in_hand(self) -> Call:
        return self.call


def looked_at(session: Any) -> list[dict[str, Any]]:
    """What is logged once the metrics have not moved between two looks, and at a third one."""
    ending = Ending(session, lambda outcome: None)
    with capture_logs() as logs:
        for _ in range(3):
            ending._look()
    return list(logs)


def call(where: str) -> Call:
    return Call("report", perf_counter_ns() - round(LOOK_S * 1e9), where)


@pytest.mark.parametrize(
    ("file", "expected"), [("s/report.html", "writing the report"), ("s/rows.csv", "an outlet writes what is left")]
)
def test_a_report_that_is_being_written_is_called_so_once(file: str, expected: str) -> None:
    session = Asked(call(""), is_outlet=True, file=file)
    logs = looked_at(session)
    assert [(line["event"], line["node"], line["file"]) for line in logs] == [(expected, "report", file)]
    assert session.reports == []


@pytest.mark.parametrize("is_outlet", [True, False])
def test_a_call_on_data_that_lasts_is_reported_once(is_outlet: bool) -> None:
    session = Asked(call(" at sample time 2026"), is_outlet=is_outlet)
    assert looked_at(session) == [] and session.reports == ["node does not return"]


def test_an_operator_that_closes_does_not_hang() -> None:
    session = Asked(call(""), is_outlet=False)
    assert looked_at(session) == [] and session.reports == []
