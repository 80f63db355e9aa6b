"""When events come: what operators declare is what `check` prints, and no event of a shipped graph comes later."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import FOREVER, NS, Chunk
from kinegraph.stream.graph import Edge, Graph
from kinegraph.stream.graph.components import catalogue
from kinegraph.stream.graph.plan import plan
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.reading.overrides import read
from kinegraph.stream.operator import Case, Operator
from kinegraph.stream.outlet import Outlet
from tests.laws.decisions import lateness, measured
from tests.support.command_line import Command

CONFIGS = Path(__file__).resolve().parents[2] / "configs"


def tolerance_s(graph: Graph, edge: Edge) -> float:
    """What is measured is known to the chunk of the source, and to a sample of what the operator reads."""
    node = graph.nodes[edge.node]
    chunk_s = max(getattr(source.part, "chunk_s", 0.0) for source in graph.sources)
    period_s = max((spec.period_ns / 1e9 for spec in graph.input_specs(node).values() if spec.rate_hz), default=0.0)
    upstream = max(
        (tolerance_s(graph, way) for way in node.inputs.values() if not graph.nodes[way.node].is_source), default=0.0
    )
    return max(chunk_s, upstream) + period_s + 1e-6


TRIED: list[tuple[str, list[str], set[str]]] = [
    ("treadmill_emg", ["treadmill.realtime=false", "treadmill.duration_s=15"], {"cycles", "review", "statistics"}),
    ("treadmill_both_legs", ["treadmill.realtime=false", "treadmill.duration_s=25", "treadmill.muscles=[TA, SO]"],
     {"feet", "cycles", "review", "stages", "statistics"}),
    ("overground_emg", ["lab.realtime=false"], {"feet", "cycles", "review", "statistics"}),
    ("bedside_simulated", ["camera.bed_h=1.2", "camera.morning_min=100"],
     {"view", "bed", "presence", "activity", "breathing", "scorer", "nights"}),
    ("actigraphy_sleep", [], {"scorer"}),
    ("segment_kinect", ["kinect.realtime=false", "kinect.duration_s=60"], {"segment", "named"}),
    ("segment_mocap", ["mocap.realtime=false", "mocap.duration_s=60"], {"segment", "named"}),
    ("segment_emg", ["board.realtime=false", "board.duration_s=60"], {"segment"}),
]  # fmt: skip
"""A shipped graph that is run to the end of its source, settings, nodes that give events."""
LONG = {"bedside_simulated", "treadmill_both_legs", "overground_emg", "segment_emg", "segment_kinect"}
"""Graphs of these that run nightly."""
ALIKE = {
    "bedside_sleep": "bedside_simulated",
    "bedside_two": "bedside_simulated",
    "segment_emg_acc": "segment_emg",
    "segment_imu": "segment_mocap",
    "count_repetitions": "segment_mocap",
    "count_depth": "segment_mocap",
    "count_video": "segment_mocap",
    "count_landmarks": "segment_mocap",
    "dualsense": "segment_mocap",
}
"""Graphs that need a device at its own pace: every operator of theirs that gives events is in another one."""
ON_ITS_CASES = {
    "gait_angles",
    "video_gait",
    "grow_graph",
    "imu_steps",
    "shimmer_emg",
    "myoware",
    "cyton_emg",
    "bitalino_emg",
    "lsl_emg",
    "trigno_emg",
}
"""The same, but their operators are only tried one by one, below."""
SPOKEN = dict.fromkeys(("avatar", "avatar_oak", "webcam_avatar"), "its prompts are of the sample that leads to them")


@cache
def eventful(config: str) -> set[type]:
    """The kinds of operators of a shipped graph that say when their events come."""
    graph = load(CONFIGS / f"{config}.yaml")
    return {type(graph.nodes[decision.origin.node].part) for decision in plan(graph).decisions}


def test_every_shipped_graph_that_says_when_events_come_is_tried() -> None:
    promising = {path.stem for path in CONFIGS.glob("*.yaml") if eventful(path.stem)}
    assert promising == {config for config, *_ in TRIED} | {*ALIKE, *ON_ITS_CASES, *SPOKEN}
    assert all(eventful(config) <= eventful(other) for config, other in ALIKE.items())


@pytest.mark.parametrize(
    ("config", "settings", "seen"),
    [pytest.param(*graph, marks=[pytest.mark.nightly] if graph[0] in LONG else []) for graph in TRIED],
)
def test_no_event_of_a_shipped_graph_comes_later_than_check_says(
    config: str, settings: list[str], seen: set[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    graph = load(CONFIGS / f"{config}.yaml", overrides=read(settings))
    planned = {(d.origin.node, d.origin.output): d for d in plan(graph).decisions}
    late = measured(graph)
    reported = {node for node, output in late if (node, output) in planned and late[node, output]}
    assert seen <= {node.rpartition(".")[2] for node in reported}
    for key, seconds in late.items():
        if seconds and key in planned:
            edge = planned[key].origin
            assert max(seconds) <= planned[key].after_s + tolerance_s(graph, edge), (str(edge), max(seconds))


def test_check_prints_when_events_come_beside_the_delay(kinegraph: Command) -> None:
    code, out, _ = kinegraph("check", CONFIGS / "treadmill_emg.yaml")
    text = " ".join(out.split())
    assert code == 0 and "cycles.closed 25 ms after its end or onset, 264 ms with the delay" in text, text
    assert "statistics 25 ms after its end or onset, 264 ms with the delay" in text, text


# operator by operator ------------------------------------------------------------------------------------------------

STEPS = 120
"""Each case is fed in so many steps of time; how late an event is, is known to one of them."""
PROMISE_NOTHING = {
    ("CycleReview", "closed"): "an annotation changes a cycle long after it was over",
    ("CycleReview", "judged"): "an annotation changes a cycle long after it was over",
    ("MixtureDrift", "change"): "between its windows cycles may be rejected or missing",
    ("NightMap", "out"): "it waits until the night is known to be over",
    ("SleepStatistics", "out"): "it waits until it is known when somebody was in bed",
    ("StepActivity", "activity"): "a turn is reported once the body has turned by enough",
    ("Steps", "steps"): "a peak stands until the signal has fallen",
}
"""Events that may come as late as they like."""


def fed(case: Case) -> tuple[Operator[Any], dict[str, float], float]:
    """An operator that was given a case; how late its events came (s) and how far apart the moments lay at which it was given something."""
    operator = case.operator.unopened()
    operator.open({port: spec for port, (spec, _, _) in case.inputs.items()})
    stamps = np.unique(np.concatenate([time for _, time, _ in case.inputs.values()]))
    moments = stamps[np.unique(np.linspace(0, len(stamps) - 1, STEPS).astype(int))]
    before, late = dict.fromkeys(case.inputs, 0), dict[str, float]()
    for moment in moments.tolist():
        for port in (port for port in operator.inputs if port in case.inputs):
            _, time, data = case.inputs[port]
            a, before[port] = before[port], int(np.searchsorted(time, moment, "right"))
            emitted = operator.process(port, Chunk(time[a : before[port]], data[a : before[port]], moment))
            for output, chunk in [(operator.outputs[0], emitted)] if isinstance(emitted, Chunk) else emitted or []:
                seconds = lateness(chunk, moment)
                late[output] = max([late.get(output, 0.0), *seconds.tolist()])
    return operator, late, float(np.diff(moments).max() / NS)


def came_late(case: Case) -> float:
    """How long after what they describe the events of a case come to the operator (s)."""
    given = (lateness(Chunk(time, data, FOREVER), time) for spec, time, data in case.inputs.values() if spec.is_event)
    return max((float(seconds.max()) for seconds in given if len(seconds)), default=0.0)


EVENTFUL = {
    use: cls for use, cls in catalogue(("operators",))[0].items() if issubclass(cls, Operator) and not issubclass(cls, Outlet)
}  # fmt: skip


@pytest.mark.parametrize("use", EVENTFUL)
def test_no_operator_gives_an_event_later_than_it_declares(use: str) -> None:
    for case in EVENTFUL[use].cases():
        specs = case.operator.unopened().open({port: spec for port, (spec, _, _) in case.inputs.items()})
        if not any(spec.is_event for spec in specs.values()):
            return
        operator, late, step_s = fed(case)
        for output, seconds in late.items():
            if (type(operator).__name__, output) not in PROMISE_NOTHING:
                max_s = operator.decision_s.get(output, 0.0) + came_late(case) + 2 * step_s
                assert seconds <= max_s, f"{output}: {seconds:.3f} s"
