"""What a graph costs: the delay and memory of every path, and the budget that may refuse it."""

from __future__ import annotations

import pytest

from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.shortfall import reader_of
from kinegraph.stream.errors import GraphError
from kinegraph.stream.graph import Graph, policy_of
from kinegraph.stream.graph.backpressure import queued_bytes
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.text.time_text import delay
from tests.engine.test_load import nodes
from tests.support import SUPPORT

TWO_WAYS = """
    slow: {use: graph_parts.Low, from: board, order: 10}
    fast: {use: graph_parts.Low, from: board, order: 1}
    cycles: {use: graph_parts.Cycles, from: {signal: slow, touchdown: board.touchdown}}
    both: {use: graph_parts.Join, from: [fast, cycles]}
    alone: {use: graph_parts.Low, from: fast, order: 2}"""


def graph(text: str, end: str = "") -> Graph:
    return load_text(nodes(text) + end, path="g.yaml")


def test_delays_add_up_along_the_slowest_way() -> None:
    paths = {path.sink: path for path in plan(graph(TWO_WAYS)).paths}
    assert set(paths) == {"both", "alone"}
    assert str(paths["both"]) == "board -> slow -> cycles -> both"
    assert paths["both"].delay_s == pytest.approx(0.010 + 0.050)
    assert paths["both"].explain() == "slow 10 ms + cycles 50 ms = 60 ms"
    assert paths["alone"].delay_s == pytest.approx(0.001 + 0.002)


def test_a_source_adds_the_time_that_its_chunks_cover() -> None:
    text = nodes("low: {use: graph_parts.Low, from: board}").replace("Board", "Board\n    covers_s: 0.02")
    (path,) = plan(load_text(text)).paths
    assert path.explain() == "board 20 ms + low 4 ms = 24 ms"
    assert [delay(seconds) for seconds in (0.2393, 9.9, 31.03, 7200.0)] == [
        "239.3 ms",
        "9900 ms",
        "31.03 s",
        "7200 s",
    ]


def test_what_meets_a_slower_input_waits_for_it() -> None:
    text = """
        port: {use: graph_parts.Port, port: /dev/x}
        slow: {use: graph_parts.Low, from: board, order: 10}
        join: {use: graph_parts.Join, from: [port, slow]}
        end: {use: graph_parts.Low, from: join, order: 1}"""
    paths = {path.source: path for path in plan(graph(text)).paths}
    assert set(paths) == {"board", "port"}
    assert paths["port"].explain() == "join waits 10 ms + end 1 ms = 11 ms"
    assert paths["port"].delay_s == pytest.approx(paths["board"].delay_s)


def test_many_ways_between_two_nodes_are_one_path() -> None:
    """Forty joins in a row, each of two ways: a million million ways, and still one line."""
    rows = ["n0: {use: graph_parts.Low, from: board}"]
    for i in range(1, 41):
        rows.append(f"a{i}: {{use: graph_parts.Cycles, from: {{signal: n{i - 1}, touchdown: board.touchdown}}}}")
        rows.append(f"n{i}: {{use: graph_parts.Cycles, from: {{signal: n{i - 1}, touchdown: a{i}.rejected}}}}")
    planned = plan(graph("\n" + "\n".join(rows)))
    assert [path.sink for path in planned.paths] == ["n40"]
    assert planned.paths[0].delay_s == pytest.approx(0.004 + 40 * 0.1)


def test_memory_counts_states_and_queues() -> None:
    def memory(text: str) -> int:
        return plan(graph(text)).memory_bytes

    nothing = memory("screen: {use: graph_parts.Screen, from: board}")
    one = memory("low: {use: graph_parts.Low, from: board}\nscreen: {use: graph_parts.Screen, from: low}")
    worker = memory(
        "low: {use: graph_parts.Low, from: board, worker: x, queue: 10}\nscreen: {use: graph_parts.Screen, from: low}"
    )
    assert one - nothing == 8000, "the state of Low; the same chunks wait before the outlet"
    assert worker - one == 10 * (300 + 20 * (16 + 8)), "ten chunks of 20 ms wait before the worker"


@pytest.mark.parametrize("live", ["true", "false"])
@pytest.mark.parametrize("policy", ["", ", policy: block", ", policy: drop_oldest"])
def test_the_plan_counts_the_queues_that_a_session_makes(live: str, policy: str) -> None:
    text = f"""
nodes:
  board: {{use: parts.Counting, realtime: {live}, queue: 20000}}
  aside: {{use: parts.RunningSum, from: board, worker: x, queue: 20000{policy}}}
  out: {{use: parts.Collect, from: board, queue: 20000{policy}}}
"""
    loaded = load_text(text, path=str(SUPPORT / "graph.yaml"))
    steps = {step.node: step.memory_bytes for path in plan(loaded).paths for step in path.steps}
    session = Session(loaded)
    queues = session._workers.queues | {"board": session._ingress.ports[0].queue}
    chunk = 300 + 20 * (2 * 8 + 8)
    for name, queue in queues.items():
        node = reader_of(name) or name
        held = loaded.nodes[node].declared.memory_bytes
        assert steps[node] - held == queued_bytes(queue.limit, chunk, queue.bound) or node == "board", node
        assert queue.policy == policy_of(loaded.nodes[node], live=live == "true")


def test_a_late_graph_is_refused_with_the_path_and_its_parts() -> None:
    assert plan(graph(TWO_WAYS, "latency_budget_ms: 60\n")).slowest is not None
    late = graph(TWO_WAYS, "latency_budget_ms: 50\n")
    with pytest.raises(GraphError) as caught:
        plan(late)
    text = str(caught.value)
    assert text.startswith("g.yaml: latency_budget_ms is 50")
    assert "board -> slow -> cycles -> both takes slow 10 ms + cycles 50 ms = 60 ms" in text
    assert "alone" not in text
    assert len(plan(late, enforce=False).paths) == 2
