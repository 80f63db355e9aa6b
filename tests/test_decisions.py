"""When events come: what operators declare is what `check` prints, and no event of a shipped graph comes later."""

from __future__ import annotations

from pathlib import Path

import pytest

from stream.graph import Edge, Graph
from stream.graph.load import load
from stream.graph.overrides import read
from stream.graph.plan import plan
from tests.command_line import Command
from tests.decisions import measured

CONFIGS = Path(__file__).resolve().parent.parent / "configs"


def tolerance_s(graph: Graph, edge: Edge) -> float:
    """What is measured is known to the chunk of the source, and to a sample of what the operator reads."""
    node = graph.nodes[edge.node]
    chunk_s = max(getattr(source.part, "chunk_s", 0.0) for source in graph.sources)
    period_s = max((spec.period_ns / 1e9 for spec in graph.input_specs(node).values() if spec.rate_hz), default=0.0)
    upstream = max(
        (tolerance_s(graph, way) for way in node.inputs.values() if not graph.nodes[way.node].is_source), default=0.0
    )
    return max(chunk_s, upstream) + period_s + 1e-6


@pytest.mark.parametrize(
    ("config", "for_s", "settings", "seen"),
    [
        ("treadmill_emg", 0.0, ["treadmill.realtime=false", "treadmill.duration_s=30"], {"cycles", "review", "statistics"}),
        ("treadmill_both_legs", 0.0, ["treadmill.realtime=false", "treadmill.duration_s=25", "treadmill.muscles=[TA, SO]"],
         {"feet", "cycles", "review", "stages", "statistics"}),
        ("overground_emg", 0.0, [], {"left", "right", "left_cycles", "right_statistics"}),
        ("imu_steps", 15.0, [], {"steps"}),
    ],
)  # fmt: skip
def test_no_event_of_a_shipped_graph_comes_later_than_check_says(
    config: str, for_s: float, settings: list[str], seen: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    graph = load(CONFIGS / f"{config}.yaml", overrides=read(settings))
    planned = {(d.origin.node, d.origin.output): d for d in plan(graph).decisions}
    late = measured(graph, for_s=for_s)
    assert seen <= {node for node, output in late if (node, output) in planned and late[node, output]}
    for key, seconds in late.items():
        if seconds and key in planned:
            edge = planned[key].origin
            assert max(seconds) <= planned[key].after_s + tolerance_s(graph, edge), (str(edge), max(seconds))


def test_check_prints_when_events_come_beside_the_delay(kinegraph: Command) -> None:
    code, out, _ = kinegraph("check", CONFIGS / "treadmill_emg.yaml")
    told = " ".join(out.split())
    assert code == 0 and "cycles.closed 25 ms after its end or onset, 264 ms with the delay" in told, told
    assert "statistics 25 ms after its end or onset, 264 ms with the delay" in told, told
