"""Nights that the product's own simulator does not render: a nudged camera, a lamp, a partner, a heap, a wrong region, the dark.

What cannot be judged is unknown, and says why; what can be judged is scored as it was.
"""

from __future__ import annotations

import numpy as np
import pytest
from rendered_room import RenderedRoom, Scene

from bench.bedside import START, Run
from stream.chunk import NS, Array
from stream.graph.load import load_text

GRAPH = """
nodes:
  camera: {use: devices.simulators.bedside.Bedside, width: 256, height: 192, fps: 2}
  simplify: {use: operators.depth.simplify.Simplify, from: camera.depth}
  view: {use: operators.depth.view.View, from: simplify.blocks}
  bed: {use: operators.depth.bed.BedRegion, from: {view: view, in: simplify.blocks}, regions: REGIONS}
  presence: {use: operators.depth.presence.Presence, from: {view: view, regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.depth.motion.Motion, from: {regions: bed, frames: simplify}}
  activity: {use: operators.depth.activity.Activity, from: {view: view, bed: presence, motion: motion}}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: activity}
"""
IN, MOVES = ((120.0, 2700.0),), (400.0, 1000.0, 1900.0, 2300.0)


class Told:
    """What the graph says of a scene; epochs by their number."""

    def __init__(self, scene: Scene, regions: str = "[]") -> None:
        graph = load_text(GRAPH.replace("REGIONS", regions))
        graph.nodes["camera"].part = RenderedRoom.of(graph.nodes["camera"].part, scene)  # type: ignore[arg-type]
        run = Run(graph, ("view", "bed", "presence", "activity.epochs", "scorer")).run()
        finals = run["scorer"][run["scorer"]["final"]]
        self.state: Array = finals["state"]
        self.why: Array = run["activity.epochs"]["why"]
        self.view, self.regions, self.presence = run["view"], run["bed"], run["presence"]

    def of(self, begin_s: float, end_s: float) -> tuple[set[str], set[str]]:
        """The states of the epochs within these times, and the reasons."""
        part = slice(-(-int(begin_s) // 30), int(end_s) // 30)
        return {str(s) for s in self.state[part]}, {str(w) for w in self.why[part]}

    def seconds(self, events: Array) -> list[int]:
        return [(int(t) - START) // NS for t in events["onset"]]


def test_a_plain_night_has_no_reasons() -> None:
    told = Told(Scene(3000, IN, moves=MOVES))
    assert [str(e["what"]) for e in told.view] == ["steady"]
    assert told.of(270, 2640) == ({"sleep"}, {""}) and [str(s) for s in told.presence["state"]][:3] == [
        "out",
        "in",
        "out",
    ]


@pytest.mark.parametrize(
    ("shift_m", "degrees", "regions"),
    [(0.08, 0.0, "[]"), (-0.06, 0.0, "[[16, 80, 160, 96]]"), (0.08, 2.0, "[[16, 80, 160, 96]]"), (0.0, 1.5, "[]")],
)
def test_a_nudged_camera_is_noticed_and_the_bed_is_learned_again(shift_m: float, degrees: float, regions: str) -> None:
    told = Told(Scene(2700, IN, moves=MOVES, nudges=((1500, shift_m, degrees),)), regions)
    assert [str(e["what"]) for e in told.view] == ["steady", "moved", "steady"]
    assert abs(told.seconds(told.view)[1] - 1500) <= 5
    assert abs(float(told.view["right"][1]) - shift_m * 256 * 0.78 / 2.4) <= 2.5, "pixels"
    assert told.of(270, 1490) == ({"sleep"}, {""})
    assert told.of(1500, 1620) == ({"unknown"}, {"camera"})
    assert told.of(1710, 2640) == ({"sleep"}, {""}), "still sleep is sleep again, by the region and the noise of now"
    assert int(told.regions["rows"][-1]) > 100
    assert ("unknown", "camera") in [(str(e["state"]), str(e["why"])) for e in told.presence]


def test_a_jump_too_far_to_follow_is_noticed_and_a_region_that_was_set_holds_no_more() -> None:
    told = Told(Scene(2400, IN, moves=MOVES, nudges=((1500, 0.7, 5.0),)), "[[16, 80, 160, 96]]")
    assert [str(e["what"]) for e in told.view][:2] == ["steady", "moved"] and np.isnan(told.view["right"][1])
    assert int(told.regions["rows"][-1]) == 0
    assert told.of(1530, 2370) == ({"unknown"}, {"camera"})


def test_noise_in_bed_of_more_than_three_times_the_empty_beds_is_learned() -> None:
    told = Told(Scene(3000, ((120.0, 3000.0),), moves=(400.0, 1000.0), coarse=((120.0, 3000.0),)))
    assert told.of(1500, 2940) == ({"sleep"}, {""})


def test_people_beds_and_lamps_are_no_jump_of_the_view() -> None:
    scene = Scene(
        1500, ((100, 1300),), partner=((300, 600),), standing=((50, 90), (700, 720), (800, 1000)), heap=((1300, 1500),),
        moves=(200, 300, 400), lamp=((750, 900),),
    )  # fmt: skip
    assert [str(e["what"]) for e in Told(scene).view] == ["steady"]
