"""Nights that the product's own simulator does not render: a nudged camera, a lamp, a partner, a heap, a wrong region, the dark.

What cannot be judged is unknown, and says why; what can be judged is scored as it was.
"""

from __future__ import annotations

import numpy as np
import pytest

from bench.bedside import START, Run
from kinegraph.operators.bed.frames.view import VIEW, View
from kinegraph.stream.chunk import NS, Array
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import blocks_spec, play
from tests.support.rendered_room import RenderedRoom, Scene
from tests.support.tiers import rest_nightly

GRAPH = """
nodes:
  camera: {use: devices.people.bedside.Bedside, CAMERA}
  simplify: {use: operators.bed.frames.simplify.Simplify, from: camera.depth}
  view: {use: operators.bed.frames.view.View, from: simplify.blocks}
  bed: {use: operators.bed.bed.BedRegion, from: {view: view, in: simplify.blocks}, regions: REGIONS}
  presence: {use: operators.bed.presence.Presence, from: {view: view, regions: bed, blocks: simplify.blocks}}
  motion: {use: operators.bed.motion.Motion, from: {regions: bed, frames: simplify}}
  activity: {use: operators.bed.activity.Activity, from: {view: view, bed: presence, far: motion.far, motion: motion}}
  scorer: {use: operators.sleep.scorer.SleepScorer, from: {in: activity, seen: activity.epochs}}
"""
SMALL = "width: 192, height: 144, fps: 1"
"""A fifth of the work, where what is seen does not hang on it."""
IN, MOVES = ((120.0, 2700.0),), (400.0, 1000.0, 1900.0, 2300.0)


class Reported:
    """What the graph says of a scene; epochs by their number."""

    def __init__(self, scene: Scene, regions: str = "[]", camera: str = "width: 256, height: 192, fps: 2") -> None:
        graph = load_text(GRAPH.replace("REGIONS", regions).replace("CAMERA", camera))
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
    made = Reported(Scene(3000, IN, moves=MOVES), camera=SMALL)
    assert [str(e["what"]) for e in made.view] == ["steady"]
    assert made.of(270, 2640) == ({"sleep"}, {""}) and [str(s) for s in made.presence["state"]][:3] == [
        "out",
        "in",
        "out",
    ]


@pytest.mark.parametrize(
    ("shift_m", "degrees", "regions"),
    rest_nightly(
        (0.08, 0.0, "[]"), (-0.06, 0.0, "[[16, 80, 160, 96]]"), (0.08, 2.0, "[[16, 80, 160, 96]]"), (0.0, 1.5, "[]")
    ),
)
def test_a_nudged_camera_is_noticed_and_the_bed_is_learned_again(shift_m: float, degrees: float, regions: str) -> None:
    made = Reported(Scene(2700, IN, moves=MOVES, nudges=((1500, shift_m, degrees),)), regions)
    assert [str(e["what"]) for e in made.view] == ["steady", "moved", "steady"]
    assert abs(made.seconds(made.view)[1] - 1500) <= 5
    assert abs(float(made.view["right"][1]) - shift_m * 256 * 0.78 / 2.4) <= 2.5, "pixels"
    assert made.of(270, 1490) == ({"sleep"}, {""})
    assert made.of(1500, 1620) == ({"unknown"}, {"camera"})
    assert made.of(1710, 2640) == ({"sleep"}, {""}), "still sleep is sleep again, by the region and the noise of now"
    assert int(made.regions["rows"][-1]) > 100
    assert ("unknown", "camera") in [(str(e["state"]), str(e["why"])) for e in made.presence]


def test_a_jump_too_far_to_follow_is_noticed_and_a_region_that_was_set_holds_no_more() -> None:
    made = Reported(Scene(2400, IN, moves=MOVES, nudges=((1500, 0.7, 5.0),)), "[[16, 80, 160, 96]]")
    assert [str(e["what"]) for e in made.view][:2] == ["steady", "moved"] and np.isnan(made.view["right"][1])
    assert int(made.regions["rows"][-1]) == 0
    assert made.of(1530, 2370) == ({"unknown"}, {"camera"})


@pytest.mark.nightly
def test_noise_in_bed_of_more_than_three_times_the_empty_beds_is_learned() -> None:
    made = Reported(Scene(3000, ((120.0, 3000.0),), moves=(400.0, 1000.0), coarse=((120.0, 3000.0),)))
    assert made.of(1500, 2940) == ({"sleep"}, {""})


@pytest.mark.nightly
def test_people_beds_and_lamps_are_no_jump_of_the_view() -> None:
    scene = Scene(
        1500, ((100, 1300),), partner=((300, 600),), standing=((50, 90), (700, 720), (800, 1000)), heap=((1300, 1500),),
        moves=(200, 300, 400), lamp=((750, 900),),
    )  # fmt: skip
    assert [str(e["what"]) for e in Reported(scene).view] == ["steady"]


@pytest.mark.parametrize("noise", rest_nightly(0.5, 0.2, 5.0, 30.0))
def test_a_lamp_on_the_bed_is_a_light_and_no_wake_however_strong(noise: float) -> None:
    camera = SMALL if noise != 5.0 else "width: 256, height: 192, fps: 2"
    made = Reported(Scene(2100, IN, moves=MOVES, lamp=((1500, 1860),), lamp_noise=noise), camera=camera)
    states, why = made.of(1530, 1860)
    assert states <= {"unknown", "sleep"} and why in ({"light"}, {"light", "still"}), "its noise may hide the breath"
    assert "wake" not in made.of(270, 1850)[0]


def test_a_second_body_is_noticed_and_movement_with_it_is_nobodys() -> None:
    scene = Scene(3000, IN, moves=MOVES, partner=((1200, 2100),), partner_moves=tuple(range(1210, 2100, 45)))
    made = Reported(scene, camera=SMALL)
    states, why = made.of(1260, 2070)
    assert "wake" not in states and "body" in why and why <= {"", "body"}
    assert made.of(2190, 2640) == ({"sleep"}, {""})


def test_a_second_body_that_comes_two_minutes_after_the_sleeper_is_noticed() -> None:
    scene = Scene(2100, IN, moves=MOVES, partner=((240, 1500),), partner_moves=tuple(range(255, 1500, 45)))
    made = Reported(scene, camera=SMALL)
    states, why = made.of(270, 1470)
    assert states <= {"sleep", "unknown"} and "body" in why and why <= {"", "body", "learning"}
    assert made.of(1590, 2040) == ({"sleep"}, {""})


def test_in_the_epoch_in_which_a_second_body_arrives_movement_is_nobodys() -> None:
    moves = tuple(range(1456, 1480, 4))
    scene = Scene(1700, IN, moves=MOVES[:2], partner=((1452, 1650),), partner_moves=moves)
    made = Reported(scene, camera=SMALL)
    assert made.of(1440, 1470) == ({"unknown"}, {"body"}), "the epoch in which it comes"
    assert "wake" not in made.of(270, 1650)[0]


CAME, LEFT = (1410.0, 2100.0), (900.0, 1410.0)


@pytest.mark.parametrize(
    ("name", "partner", "nudges", "off"),
    rest_nightly(
        ("came in a cut, and is there after another", CAME, (), ((1380, 1500), (1800, 1860))),
        ("came in a cut after a nudge", CAME, ((900, 0.08, 0.0),), ((1380, 1500),)),
        ("came in the cut in which the camera was nudged", CAME, ((1400, 0.08, 0.0),), ((1380, 1500),)),
        ("left in the cut in which the camera was nudged", LEFT, ((1400, -0.08, 0.0),), ((1380, 1500),)),
        ("was there when the camera was nudged", (900.0, 2100.0), ((1400, 0.08, 0.0),), ()),
    ),
)
def test_a_second_body_is_noticed_across_power_cuts_and_nudges(
    name: str, partner: tuple[float, float], nudges: tuple[tuple[float, float, float], ...], off: tuple[tuple[float, float], ...]
) -> None:  # fmt: skip
    bout = tuple(float(t) for t in range(2400, 2580, 12))
    stirs = tuple(float(t) for t in np.arange(partner[0] + 10, partner[1], 40))
    scene = Scene(
        2850, ((120.0, 2850.0),), partner=(partner,), partner_moves=stirs, moves=(400.0, *bout), nudges=nudges, off=off
    )
    made = Reported(scene, camera=SMALL)
    states = made.of(270, 2370)[0]
    assert states == {"sleep", "unknown"}, f"{name}: the other's movement has no owner"
    why = made.of(max(partner[0], off[0][1] if off else 0) + 90, partner[1])[1]
    assert "body" in why if partner[1] > 1500 else True
    assert made.of(2430, 2550)[0] == {"wake"}, f"{name}: alone again"
    assert made.of(2700, 2760)[0] == {"sleep"}


@pytest.mark.nightly
def test_a_heap_left_behind_is_unknown_after_ten_minutes_and_empty_after_45() -> None:
    made = Reported(Scene(4200, ((120.0, 900.0),), heap=((900.0, 4200.0),), moves=(400.0, 880.0)))
    begun, end = 900 + 10 * 60 + 90, 900 + 45 * 60 - 60
    assert made.of(begun, end) == ({"unknown"}, {"still"})
    assert made.of(900 + 45 * 60 + 180, 4100) == ({"wake"}, {""})
    assert [(str(e["state"]), str(e["why"])) for e in made.presence][:4] == [
        ("out", ""), ("in", ""), ("unknown", "still"), ("out", ""),
    ]  # fmt: skip


def test_a_region_that_is_too_large_says_so_instead_of_an_empty_bed_all_night() -> None:
    made = Reported(Scene(2400, ((120.0, 2400.0),), moves=MOVES), "[[0, 0, 144, 192]]", camera=SMALL)
    assert made.of(900, 2370) == ({"unknown"}, {"region"})


def test_a_night_that_darkens_is_unknown_because_it_is_dark() -> None:
    made = Reported(Scene(2700, IN, moves=MOVES, dark=((1500, 2400),)), camera=SMALL)
    assert made.of(1530, 2370) == ({"unknown"}, {"dark"})
    assert made.of(270, 1490) == ({"sleep"}, {""})
    assert [str(e["what"]) for e in made.view] == ["steady", "dark", "steady"]


@pytest.mark.parametrize("right", [0.25, 0.5, 1.0, 2.25, -3.0])
def test_the_shift_is_measured_to_a_quarter_of_a_block(right: float) -> None:
    """A room of boxes, 8 pixels a block, seen exactly."""

    def room(shift: int) -> Array:
        fine = np.full((15 * 8, 20 * 8), 2600.0)
        fine[13:90, 40 + shift : 103 + shift] = 2100.0
        fine[20:50, max(0, 5 + shift) : max(0, 21 + shift)] = 2300.0
        return fine.reshape(15, 8, 20, 8).mean(axis=(1, 3))

    depth = np.stack([room(0)] * 240 + [room(round(8 * right))] * 120)
    depth += np.random.default_rng(1).normal(0, 0.5, depth.shape)
    made = play(View(), **{"in": (blocks_spec(15, 20, 4.0), grid(4.0, 360, 900 * NS), depth)})["out"]
    assert made.dtype == VIEW and [str(e["what"]) for e in made] == ["steady", "moved"]
    assert abs(float(made["right"][1]) - 8 * right) <= 2 and abs(float(made["down"][1])) <= 2


def test_who_is_in_bed_from_the_start_and_is_not_seen_to_breathe_is_unknown_and_not_out_of_bed() -> None:
    scene = Scene(2400, ((0.0, 1900.0),), moves=(900.0, 960.0, 1400.0, 1890.0), breath_mm=0.0)
    made = Reported(scene)
    assert made.of(60, 870) == ({"unknown"}, {"still"})
    assert made.of(1110, 1860)[0] == {"sleep"}
    assert [str(e["state"]) for e in made.presence][:3] == ["unknown", "in", "out"]
