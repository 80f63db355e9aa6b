"""In bed or not; activity with a threshold of the frames' own; breath: on made-up depths of which everything is known."""

from __future__ import annotations

import numpy as np
import pytest

from kinegraph.operators.bed.activity import Activity
from kinegraph.operators.bed.bed_events import BED
from kinegraph.operators.bed.breathing import Breathing
from kinegraph.operators.bed.frames.view import VIEW
from kinegraph.operators.bed.presence import Presence
from kinegraph.operators.sleep.scorer import SleepScorer
from kinegraph.stream.chunk import NS, Array, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.operator import grid
from tests.sleep.depth_frames import blocks_spec, frames_spec, play, regions
from tests.support.tiers import rest_nightly

RATE = 4.0
ROWS, COLUMNS = 15, 20
BODY = np.s_[3:12, 8:12]
REGION = (8, 48, 104, 64)
"""Rows 1 to 13, columns 6 to 13: 104 blocks, 36 of them under the body."""


def bedroom(seconds: int, *stays: tuple[float, float], breath_mm: float = 4.0, seed: int = 0) -> tuple[Array, Array]:
    """Stamps and blocks of a room in which somebody lies in bed in these times, quite still but for the breath."""
    random = np.random.default_rng(seed)
    time = grid(RATE, round(seconds * RATE), 900 * NS)
    at = (time - time[0]) / NS
    depth = np.full((len(time), ROWS, COLUMNS), 2600.0)
    depth[:, 1:14, 6:14] = 2050.0
    there = np.any([(at >= a) & (at < b) for a, b in stays], axis=0) if stays else np.zeros(len(at), bool)
    body = np.zeros((ROWS, COLUMNS))
    body[BODY] = 200.0
    depth -= there[:, None, None] * body
    breath = breath_mm * np.sin(2 * np.pi * 0.23 * at)
    depth[:, 4:8, 9:11] -= (there * breath)[:, None, None]
    depth += random.normal(0, 0.3, depth.shape)
    depth[random.random(depth.shape) < 0.03] = np.nan
    return time, depth


def presence(time: Array, depth: Array, **parameters: float) -> dict[str, Array]:
    rectangle = regions(int(time[0]), a=REGION)
    return play(Presence(**parameters), regions=rectangle, blocks=(blocks_spec(ROWS, COLUMNS, RATE), time, depth))


def states(events: Array, time: Array) -> list[tuple[str, int]]:
    """State and onset in whole seconds since the beginning."""
    return [(str(e["state"]), round((int(e["onset"]) - int(time[0])) / NS)) for e in events]


def test_who_lies_still_is_in_bed_and_leaves_it_when_leaving_it() -> None:
    time, depth = bedroom(900, (200, 500), (560, 800))
    made = presence(time, depth)
    assert states(made["out"], time) == [
        ("out", 0),
        ("in", 200),
        ("out", 500),
        ("in", 560),
        ("out", 800),
        ("unknown", 900),
    ]
    assert abs(made["out"]["height"][1] - 200 * 36 / 104) < 3 and abs(made["out"]["raised"][1] - 36 / 104) < 0.02
    assert np.nanmax(made["height"][600:]) > 60 > 5 > abs(made["height"][150, 0])


@pytest.mark.parametrize("columns", [2, 1])
def test_a_child_who_breathes_in_a_bed_that_was_found_is_not_out_of_bed(columns: int) -> None:
    """Children of 130 cm cover .07 to .09 of a wide bed; who covers less is unknown, as a cat would be."""
    time, depth = bedroom(900)
    at = (time - time[0]) / NS
    there = (at >= 200) & (at < 800)
    small = np.s_[:, 4:8, 9 : 9 + columns]
    depth[small] -= (there * (150.0 + 3.0 * np.sin(2 * np.pi * 0.4 * at)))[:, None, None]
    spec, onset, rectangle = regions(int(time[0]), a=REGION)
    rectangle["found"] = True
    made = play(Presence(), regions=(spec, onset, rectangle), blocks=(blocks_spec(ROWS, COLUMNS, RATE), time, depth))
    known = [(state, s) for state, s in states(made["out"], time) if s < 890]
    assert known[0] == ("out", 0) and len(known) == 3 and known[2][0] == "out" and 800 <= known[2][1] <= 890
    assert known[1][0] == ("in" if columns == 2 else "unknown") and 180 <= known[1][1] <= 240


def test_a_fan_that_lifts_the_blanket_of_an_empty_bed_all_evening_is_no_fault_of_the_region() -> None:
    time, depth = bedroom(1200)
    at = (time - time[0]) / NS
    depth[:, 3:11, 7:12] -= np.where(at > 70, 6.0 * (1 + np.sin(2 * np.pi * 0.05 * at)), 0.0)[:, None, None]
    assert states(presence(time, depth)["out"], time) == [("out", 0), ("unknown", 1200)]


def test_still_sleep_without_visible_breath_is_not_an_empty_bed() -> None:
    time, depth = bedroom(3000, (200, 2900), breath_mm=0.0)
    made = presence(time, depth, unsure_min=0.0)["out"]
    assert states(made, time) == [("out", 0), ("in", 200), ("out", 2900), ("unknown", 3000)]
    unsure = presence(time, depth)["out"]
    assert [state for state, _ in states(unsure, time)] == ["out", "in", "unknown", "out", "unknown"]
    assert unsure["why"].tolist() == ["", "", "still", "", "unseen"] and states(unsure, time)[3][1] == 2900
    vacant = states(presence(time, depth, vacant_min=30.0)["out"], time)
    assert vacant[:2] == [("out", 0), ("in", 200)] and vacant[3][0] == "out" and vacant[3][1] < 2200


def test_a_breathing_sleeper_is_never_taken_for_the_empty_bed() -> None:
    """Somebody is in bed when the camera starts."""
    time, depth = bedroom(1500, (0, 800))
    made = states(presence(time, depth)["out"], time)
    assert made[0] == ("in", 0) and made[1][0] == "out" and 800 <= made[1][1] <= 870
    time, depth = bedroom(1800, (0, 400), (1300, 1600))
    assert states(presence(time, depth)["out"], time)[2:4] == [("in", 1300), ("out", 1600)]


def test_a_body_that_does_not_stir_from_the_start_on_is_not_learned_as_the_empty_bed() -> None:
    time, depth = bedroom(2400, (0, 1500), breath_mm=0.0)
    depth[np.ix_((time - time[0] > 900 * NS) & (time - time[0] < 905 * NS), [4, 5, 6], [8, 9, 10])] -= 90.0
    made = presence(time, depth)["out"]
    assert [(s, t) for s, t in states(made, time)][:2] == [("unknown", 0), ("in", 900)]
    assert made["why"][0] == "still" and states(made, time)[2][0] == "out" and 1500 <= states(made, time)[2][1] < 1800
    never = presence(time, bedroom(3600, (0, 3600), breath_mm=0.0)[1][: len(time)], vacant_min=30.0)["out"]
    assert states(never, time)[:2] == [("unknown", 0), ("out", 0)], "after `vacant_min` it is a heap"


@pytest.mark.parametrize("tilt", [0.0, 12.0])
def test_pillows_and_a_tilted_camera_leave_an_empty_bed_empty_at_once(tilt: float) -> None:
    time, depth = bedroom(300)
    depth[:, 1:5, 7:13] -= 140.0
    depth[:, 12:14, 6:14] -= 120.0  # a folded blanket
    room = 1 / (1 / depth[0, 6, 7] + 1e-6 * tilt * (np.arange(ROWS)[:, None] - 7 + 0 * np.arange(COLUMNS)))
    made = states(presence(time, depth + room - room[7, 7])["out"], time)
    assert made[0] == ("out", 0)


def test_a_heap_of_blankets_does_not_stay_in_bed_for_ever() -> None:
    time, depth = bedroom(3600, (200, 400))
    depth[time - time[0] > 400 * NS, 9:13, 7:13] -= 250.0
    made = states(presence(time, depth, vacant_min=20.0)["out"], time)
    assert [state for state, _ in made] == ["out", "in", "unknown", "out", "unknown"] and made[3][1] < 500


def test_a_heap_whose_edges_tremble_is_not_a_sleeper_and_who_breathes_in_its_place_is_one() -> None:
    time, depth = bedroom(1500, (200, 800), (1300, 1500))
    heap = (time - time[0] >= 800 * NS) & (time - time[0] < 1300 * NS)
    depth[heap, 3:12, 8:12] -= 200.0
    depth[np.ix_(heap, range(5, 8), [9])] += np.random.default_rng(3).normal(0, 4.0, (heap.sum(), 3, 1))
    made = states(presence(time, depth)["out"], time)
    assert [state for state, _ in made] == ["out", "in", "unknown", "in", "unknown"]
    assert made[2] == ("unknown", 810) and 1260 <= made[3][1] <= 1350, "seen in the minute that began at 1260 s"


def test_blocks_that_tremble_at_an_edge_neither_move_nor_breathe() -> None:
    """A block of floor and bed: its mean depends on which of its pixels are measured in a frame."""
    time, depth = bedroom(900, (200, 800))
    depth[:, 1:14, 6] = np.random.default_rng(9).normal(2320.0, 9.0, (len(time), 13))
    assert states(presence(time, depth)["out"], time) == [("out", 0), ("in", 200), ("out", 800), ("unknown", 900)]
    rates = breaths(depth, time)["rate"][8:26]
    assert (np.abs(rates - 13.8) < 0.6).all()


def test_unseen_is_unknown_and_decided_again_when_seen() -> None:
    time, depth = bedroom(900, (200, 700))
    depth[1200:1600] = np.nan
    made = states(presence(time, depth)["out"], time)
    assert made == [("out", 0), ("in", 200), ("unknown", 300), ("in", 400), ("out", 700), ("unknown", 900)]
    there = (np.arange(len(time)) < 1200) | (np.arange(len(time)) >= 1600)
    assert states(presence(time[there], depth[there])["out"], time) == made
    nothing = presence(time, np.full_like(depth, np.nan))
    assert not len(nothing["out"]) and np.isnan(nothing["height"]).all()


# activity ------------------------------------------------------------------------------------------------------------

FPS = 10.0
START = 3000 * NS


def motion(epochs: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).normal(0.6, 0.01, (round(30 * FPS) * epochs, 1))


def active(
    x: Array,
    bed: list[tuple[float, str]] | None = None,
    far: Array | None = None,
    late_s: float = 0.0,
    **parameters: float,
) -> dict[str, Array]:
    """`bed`: (s since the beginning, state), decided `late_s` later. `far`: the change over twice the time."""
    names = ("a", "b")[: x.shape[1]]
    spec = StreamSpec((x.shape[1],), rate_hz=FPS, channels=names, units=("mm",))
    inputs = {"motion": (spec, grid(FPS, len(x), START), x)}
    if far is not None:
        inputs["far"] = (spec, grid(FPS, len(x), START), far)
    if bed is not None:
        events = np.array([(START + round(s * NS), "a", state, 0, 0, "") for s, state in bed], BED)
        inputs["bed"] = (StreamSpec((), BED), events["onset"] + round(late_s * NS), events)
    return play(Activity(**parameters), **inputs)


def test_movement_is_what_exceeds_the_noise_of_the_stillest_epochs() -> None:
    x = motion(40)
    x[3000:3030] += 0.1  # 3 s of the 11th epoch
    x[6000:6004] += 0.1  # too short
    x[9000:9900] += 0.8  # three whole epochs
    made = active(x)
    activity = made["out"][:40, 0]
    assert np.isnan(activity[:3]).all() and np.isnan(made["epochs"]["threshold"][:3]).all()
    assert np.flatnonzero(activity > 0).tolist() == [10, 30, 31, 32]
    assert activity[10] == pytest.approx(0.1) and (activity[30:33] == 1.0).all()
    assert made["epochs"]["moved_s"][[10, 20]].tolist() == [3.0, 0.5]
    assert (abs(made["epochs"]["threshold"][3:40] - 0.64) < 0.02).all()


@pytest.mark.parametrize(("grows", "why"), rest_nightly((0.0, "light"), (0.41, ""), (1.0, "")))
def test_a_steady_rise_is_a_light_where_it_does_not_grow_with_the_time(grows: float, why: str) -> None:
    """Noise is as far after two looks as after one; a random walk is farther by 0.41 of it, steady movement by all of it."""
    low, high = motion(60), 5 * motion(200, seed=1)
    x = np.concatenate([low, high])
    far = x + np.where(np.arange(len(x))[:, None] < len(low), 0.0, grows * (5 - 1) * 0.6)
    made = active(x, far=far)["epochs"]
    assert abs(made["threshold"][59] - 0.64) < 0.02 and abs(made["threshold"][-1] - 3.2) < 0.1
    assert (made["why"][60:104] == why).all() and bool(made["moved_s"][60:104].all()) == (why == "")
    assert not made["moved_s"][4:60].any()
    assert not made["moved_s"][106:].any() and not made["why"][106:].astype(bool).any(), "three quarters are like it"


def test_without_the_change_over_twice_the_time_a_rise_is_movement() -> None:
    made = active(np.concatenate([motion(60), 5 * motion(20, seed=1)]))["epochs"]
    assert (made["moved_s"][60:] == 30).all() and not made["why"][60:].astype(bool).any()


def test_out_of_bed_is_awake_unknown_is_unknown_and_unseen_is_unseen() -> None:
    x = motion(30)
    x[4500:4700] = np.nan  # two thirds of the 16th epoch
    x[4800:4900] = np.nan  # one third of the 17th
    bed = [(0.0, "out"), (65.0, "in"), (600.0, "unknown"), (660.0, "in"), (760.0, "out"), (840.0, "in")]
    made = active(x, bed)
    activity = made["out"][:30, 0]
    assert activity[:2].tolist() == [1.0, 1.0], "out of bed from the first sample on"
    assert np.isnan(activity[2:5]).all(), "the noise in bed is not known yet"
    assert not activity[6:15].any() and np.isnan(activity[15]) and activity[16] == 0
    assert np.isnan(activity[[19, 20, 21]]).tolist() == [False, True, True]
    assert activity[[25, 26, 27, 28]].tolist() == [0.0, 1.0, 1.0, 0.0]
    assert made["epochs"]["bed"][[1, 10, 20, 26]].tolist() == ["out", "in", "unknown", "out"]
    assert made["epochs"]["seen"][[15, 16, 18]] == pytest.approx([1 / 3, 2 / 3, 1.0])
    unknown = active(x, [])
    assert np.isnan(unknown["out"]).all(), "the bed's state is unknown"


def test_who_left_before_the_epoch_was_out_throughout_though_that_is_decided_in_it() -> None:
    bed = [(0.0, "in"), (595.0, "out"), (900.0, "in"), (1185.0, "out")]
    activity = active(motion(42), bed, late_s=6.0)["out"][:42, 0]
    assert activity[[18, 19, 20, 21]].tolist() == [0.0, 0.0, 1.0, 1.0]
    assert activity[[38, 39, 40]].tolist() == [0.0, 0.0, 1.0], "decided in the same epoch"


@pytest.mark.parametrize("comes", [True, False])
def test_a_second_body_is_noticed_also_before_the_empty_bed_is_known_again_after_a_move(comes: bool) -> None:
    time, depth = bedroom(1900, (200, 1900))
    at = (time - time[0]) / NS
    other = np.zeros((ROWS, COLUMNS))
    other[3:12, 6:8] = 200.0
    depth[(at > 1400) & (at < 1600)] -= comes * other
    turned = (at > 1700)[:, None, None] * (np.roll(other, 3, 1) - other)
    depth[:, :, :14] += turned[:, :, :14]  # the sleeper lies a little further to the side
    moved = np.array([(time[0] + 800 * NS, "moved", 0.0, 0.0)], VIEW)
    inputs = {"regions": regions(int(time[0]), a=REGION), "blocks": (blocks_spec(ROWS, COLUMNS, RATE), time, depth)}
    made = play(Presence(), view=(StreamSpec((), VIEW), moved["onset"].copy(), moved), **inputs)["out"]
    seconds = [(str(e["state"]), str(e["why"]), (int(e["onset"]) - int(time[0])) // NS) for e in made]
    came = [("in", "body", 1400), ("in", "", 1600)]
    assert seconds == [
        ("out", "", 0), ("in", "", 200), ("unknown", "camera", 800), ("in", "", 800), *came[: 2 * comes],
        ("unknown", "unseen", 1900),
    ]  # fmt: skip


def cat(depth: Array, second: Array, begin: float, end: float, speed: float) -> None:
    """Two by two blocks and 200 mm high, along the foot of the bed and back; `speed` in blocks a second, 0: it stands."""
    for i in np.flatnonzero((second >= begin) & (second < end)):
        column = 6 + round(3 + 3 * np.sin(speed / 3 * (second[i] - begin)))
        depth[i, 13:14, column : column + 2] = 2050.0 - 200.0
        depth[i, 12:13, column : column + 2] = 2050.0 - 200.0


@pytest.mark.parametrize(("speed", "walks"), [(1.0, True), (0.3, True), (0.0, False)])
def test_what_walks_about_apart_from_the_sleeper_is_a_body(speed: float, walks: bool) -> None:
    time, depth = bedroom(1000, (200, 950))
    second = (time - time[0]) / NS
    depth[:, 3:12, 8:12][:, 7:] += np.where((second >= 200) & (second < 950), 200.0, 0.0)[:, None, None]  # short legs
    cat(depth, second, 600, 700, speed)
    made = presence(time, depth)["out"]
    why = [(str(e["why"]), (int(e["onset"]) - int(time[0])) / NS) for e in made if e["state"] == "in"]
    assert [w for w, _ in why] == ["", "body", ""][: 1 + 2 * walks]
    if walks:
        assert 600 <= why[1][1] < 640 and 700 <= why[2][1] <= 720


def test_a_cat_is_noticed_also_before_the_empty_bed_is_known() -> None:
    time, depth = bedroom(1000, (0, 950))
    second = (time - time[0]) / NS
    depth[:, 3:12, 8:12][:, 7:] += np.where(second < 950, 200.0, 0.0)[:, None, None]  # short legs
    cat(depth, second, 600, 700, 1.0)
    why = [(str(e["why"]), (int(e["onset"]) - int(time[0])) // NS) for e in presence(time, depth)["out"]]
    assert [w for w, _ in why][:3] == ["", "body", ""] and 600 <= why[1][1] < 640 and 700 <= why[2][1] <= 720


def test_a_foot_that_lifts_the_blanket_and_a_turn_are_no_visitors() -> None:
    time, depth = bedroom(1000, (200, 950))
    second = (time - time[0]) / NS
    lifted = (second >= 600) & (second < 700) & (np.sin(second) > 0)
    depth[np.ix_(lifted, [12, 13], [7, 8])] -= 150.0  # apart from the body, and always in one place
    depth[np.ix_((second >= 750) & (second < 900), range(3, 12), [8])] += 200.0
    depth[np.ix_((second >= 750) & (second < 900), range(3, 12), [12])] -= 200.0
    assert {str(e["why"]) for e in presence(time, depth)["out"] if e["state"] == "in"} == {""}


def test_a_second_body_is_suspected_at_once_and_that_is_taken_back_where_it_goes() -> None:
    time, depth = bedroom(1000, (200, 950))
    second = (time - time[0]) / NS
    for begin, end in ((600, 610), (700, 800)):
        depth[np.ix_((second >= begin) & (second < end), range(3, 12), [6, 7])] -= 200.0
    made = presence(time, depth)["out"]
    why = [(str(e["why"]), (int(e["onset"]) - int(time[0])) // NS) for e in made if e["state"] == "in"]
    assert why == [("", 200), ("body", 600), ("", 610), ("body", 700), ("", 800)]


def test_a_second_body_in_the_first_minutes_is_noticed_and_so_is_that_it_leaves() -> None:
    time, depth = bedroom(1400, (200, 1300))
    second = (time - time[0]) / NS
    depth[np.ix_((second >= 280) & (second < 700), range(3, 12), [6, 7])] -= 200.0
    depth[np.ix_((second >= 900) & (second < 1100), range(3, 12), [6, 7])] -= 200.0
    made = presence(time, depth)["out"]
    why = [(str(e["why"]), (int(e["onset"]) - int(time[0])) // NS) for e in made if e["state"] == "in"]
    assert why == [("", 200), ("body", 280), ("", 700), ("body", 900), ("", 1100)]


@pytest.mark.parametrize(
    ("what", "rows", "columns", "mm"),
    [
        ("sits for a minute and a half", range(6, 9), range(8, 11), 550.0),
        ("lies without a blanket at first", range(3, 12), range(8, 12), 130.0),
        ("lies on one side at first", range(3, 12), range(8, 11), 270.0),
    ],
)
def test_who_settles_down_in_the_first_minutes_stays_one(what: str, rows: range, columns: range, mm: float) -> None:
    time, depth = bedroom(900, (200, 850))
    second = (time - time[0]) / NS
    before = (second >= 200) & (second < 290)
    depth[np.ix_(before, range(3, 12), range(8, 12))] += 200.0
    depth[np.ix_(before, rows, columns)] -= mm
    if "blanket" in what:
        depth[np.ix_((second >= 290) & (second < 850), range(1, 14), range(6, 14))] -= 70.0
    made = presence(time, depth)["out"]
    assert {str(e["why"]) for e in made if e["state"] == "in"} == {""}, what


def test_a_partners_movement_is_flagged() -> None:
    x = np.concatenate([motion(30), motion(30, seed=1)], axis=1)
    x[3000:3100, 0] += 2.0
    x[3000:3100, 1] += 0.2
    x[4500:4600, 1] += 0.2
    x[6000:6100, 0] += 2.0
    x[6000:6200, 1] += np.where(np.arange(200) < 100, 0.2, 1.0)
    made = active(x)
    epochs = made["epochs"]
    mine, theirs = (epochs[epochs["sleeper"] == name] for name in "ab")
    assert mine["crosstalk"][10] == 0 and theirs["crosstalk"][10] == 1.0 and theirs["crosstalk"][15] == 0
    assert theirs["moved_s"][[10, 15, 20]].tolist() == [10.0, 10.0, 20.0]
    assert theirs["why"][[10, 15, 20]].tolist() == ["body", "", ""] and not mine["why"][4:].astype(bool).any()
    mine_out, theirs_out = made["out"].T
    assert np.isnan(theirs_out[10]) and mine_out[10] == pytest.approx(1 / 3)
    assert theirs_out[20] == pytest.approx(1 / 2), (
        "the half that may be the other's is not seen; of 20 s left 10 are its own"
    )


def test_activity_goes_straight_into_the_scorer() -> None:
    x = motion(60)
    x[6000:9000] += 0.8
    made = active(x)
    spec = Activity().open({"motion": StreamSpec((1,), rate_hz=FPS, channels=("a",), units=("mm",))})["out"]
    time = grid(1 / 30, len(made["out"]), START)
    events = play(SleepScorer(), **{"in": (spec, time, made["out"])})["out"]
    states = events["state"][events["final"]][:60]
    assert states[0] == "unknown" and set(states[21:29]) == {"wake"} and set(states[40:58]) == {"sleep"}


# breath --------------------------------------------------------------------------------------------------------------


def breaths(depth: Array, time: Array, rate_hz: float = RATE, bed: Array | None = None) -> Array:
    inputs = {"blocks": (blocks_spec(ROWS, COLUMNS, rate_hz), time, depth), "regions": regions(int(time[0]), a=REGION)}
    if bed is not None:
        inputs["bed"] = (StreamSpec((), BED), bed["onset"].copy(), bed)
    return play(Breathing(), **inputs)["out"]


@pytest.mark.parametrize("per_min", [8.0, 13.8, 25.0])
def test_the_rate_of_breath_is_found(per_min: float) -> None:
    time, depth = bedroom(300, (0, 300), breath_mm=0.0)
    at = (time - time[0]) / NS
    depth[:, 4:8, 9:11] -= 2.0 * np.sin(2 * np.pi * per_min / 60 * at)[:, None, None]
    made = breaths(depth, time)
    assert len(made) == 10 and (abs(made["rate"] - per_min) < 0.6).all() and (made["confidence"] > 0.6).all()
    assert made["coverage"][-1] == 1.0


def test_no_rate_is_made_up() -> None:
    time, depth = bedroom(600, (0, 600), breath_mm=0.0)
    assert np.isfinite(breaths(depth, time)["rate"]).mean() < 0.15, "noise breathes seldom"
    time, depth = bedroom(600, (0, 600))
    depth[250:262, 5:9, 7:10] -= 60.0  # movement in the third epoch
    depth[600:840] = np.nan  # blind for two epochs
    bed = np.array([(time[0], "a", "in", 0, 0, ""), (time[1800], "a", "out", 0, 0, "")], BED)
    made = breaths(depth, time, bed=bed)
    known = np.isfinite(made["rate"])
    assert np.flatnonzero(~known).tolist() == [2, 5, 6, *range(15, 20)]
    assert made["coverage"][-1] == pytest.approx(12 / 15) and (made["confidence"][~known] < 0.5).all()
    assert np.isnan(breaths(np.full_like(depth, np.nan), time)["rate"]).all()


def test_streams_that_do_not_fit_are_refused() -> None:
    frames, blocks = frames_spec(120, 160), blocks_spec(ROWS, COLUMNS)
    place = regions(0, a=REGION)[0]
    with pytest.raises(InputError, match="mean depths of blocks"):
        Presence().open({"regions": place, "blocks": frames})
    with pytest.raises(InputError, match="regions, as operators"):
        Presence().open({"regions": StreamSpec((), BED), "blocks": blocks})
    with pytest.raises(InputError, match="at least 1 Hz"):
        Breathing().open({"regions": place, "blocks": blocks_spec(ROWS, COLUMNS, 0.3)})
    with pytest.raises(InputError, match=r"operators\.bed\.presence\.Presence"):
        Activity().open({"bed": place, "motion": StreamSpec((1,), rate_hz=30.0, channels=("a",))})
