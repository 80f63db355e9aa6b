"""A pose network on an OAK camera: its archive, depthai's own calculator on this computer, its markers, and the simulated camera.

What needs a camera (the camera node, stereo, the network) is held against depthai's signatures.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.oak import Oak
from kinegraph.devices.oak.archive import pose_archive
from kinegraph.devices.oak.keypoint_sets import BLAZEPOSE, COCO, INSIDE_M, MARKERS
from kinegraph.devices.oak.keypoints import Keypoints, Sight, markers_of
from kinegraph.operators.body import names, placing
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.warmup import warm_up
from kinegraph.stream.errors import GraphError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from tests.devices.oak_runs import HEAD, archive, config, standing

NOW = 1_700_000_000 * NS
FRAME = NS // 30


@pytest.mark.parametrize("points", [17, 33])
def test_an_archive_of_a_pose_network_is_taken(points: int, tmp_path: Path) -> None:
    head = {**HEAD, "metadata": {**HEAD["metadata"], "n_keypoints": points}}
    path = archive(tmp_path, config({"parser": "YOLO", "metadata": {}}, head))
    assert pose_archive(path) == ("pose", points)


@pytest.mark.parametrize(
    ("expected", "name", "why"),
    [
        (config(HEAD), "settings.json", "config.json in it; this archive lacks it"),
        (b"{broken", "config.json", "this one is not JSON"),
        ([1, 2], "config.json", "holds no settings"),
        ({"model": {}}, "config.json", "names the network's heads"),
        (config({"parser": "YOLO", "metadata": {"classes": ["cup"]}}), "config.json", "YOLO with no key points"),
        (
            config({**HEAD, "metadata": {"n_keypoints": 21}}),
            "config.json",
            r"17 \(COCO\), 33 \(BlazePose\); this one is YOLO with 21",
        ),
        (config({**HEAD, "parser": "HRNetParser"}), "config.json", "with the parser YOLO.*HRNetParser with 17"),
        (config("YOLO"), "config.json", "YOLO with no key points"),
    ],
)
def test_another_archive_is_refused_with_what_to_do(expected: Any, name: str, why: str, tmp_path: Path) -> None:
    path = archive(tmp_path, expected, name)
    with pytest.raises(ParameterError, match=why) as refused:
        pose_archive(path)
    assert path in str(refused.value)


def test_no_archive_at_all_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=r"nothing_there\.tar\.xz.*no such file"):
        pose_archive(str(tmp_path / "nothing_there.tar.xz"))
    text = tmp_path / "text.tar.xz"
    text.write_text("a page that says: not found")
    with pytest.raises(ParameterError, match=r"cannot be read as one.*fetch it again"):
        pose_archive(str(text))
    whole = Path(archive(tmp_path, config(HEAD))).read_bytes()
    text.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ParameterError, match="fetch it again"):
        pose_archive(str(text))


def test_the_source_says_what_is_wrong_before_it_opens_anything(tmp_path: Path) -> None:
    pytest.importorskip("depthai")
    source = Oak(network=str(tmp_path / "none.tar.xz"))
    assert source.outputs == ("depth", "markers", "confidence", "timing") and set(source.specs()) == set(source.outputs)
    with pytest.raises(ParameterError, match="no such file"):
        source.prepare()
    facts = {"nodes": {"eye": {"use": "devices.oak.Oak", "network": source.network}}, "record": ["eye.markers"]}
    with pytest.raises(GraphError, match=r"node 'eye': network is .*no such file"):
        warm_up(Pipeline(load_text(json.dumps(facts))))
    for other in (Oak(network="x", image="mono"), Oak(network="x", depth="tof", height=480)):
        with pytest.raises(ParameterError, match="network is 'x'"):
            other.specs()


# from key points to markers, without depthai -------------------------------------------------------------------------


def test_names_and_depths_are_those_of_the_body() -> None:
    assert MARKERS == names.MARKERS
    assert np.array_equal(INSIDE_M, placing.INSIDE[names.TAKEN])
    assert BLAZEPOSE.names == names.LANDMARKS[:33]
    assert set(COCO.names) - set(MARKERS) == {"left_eye", "right_eye"}


@pytest.mark.parametrize("known", [COCO, BLAZEPOSE])
def test_key_points_become_markers_inside_the_body(known: Any) -> None:
    places, confidence = markers_of(standing(known=known))
    absent = {MARKERS[k] for k in np.flatnonzero(np.isnan(places).any(axis=1))}
    assert absent == ({"left_heel", "right_heel", "left_toe", "right_toe"} if known is COCO else set())
    hip, on = MARKERS.index("left_hip"), np.array([0.18, 0.1, 2.5])
    assert places[hip] == pytest.approx(on * 2.6 / 2.5) and confidence[hip] == 0.9
    ears = places[[MARKERS.index("left_ear"), MARKERS.index("right_ear")]]
    assert places[MARKERS.index("head")] == pytest.approx(ears.mean(axis=0))


def test_what_was_measured_on_something_else_is_missing() -> None:
    points = standing()
    points[COCO.names.index("left_wrist"), 2] = 4.2  # the wall beside the hand
    points[COCO.names.index("right_knee"), 2] = 1.7  # a chair before it
    points[COCO.names.index("left_ear"), 2] = 0.0  # not measured
    points[COCO.names.index("nose"), 0] = np.nan
    places, confidence = markers_of(points)
    missing = {MARKERS[k] for k in np.flatnonzero(~np.isfinite(places).all(axis=1))}
    assert {"left_wrist", "right_knee", "left_ear", "nose"} <= missing and not confidence[
        [MARKERS.index(n) for n in missing]
    ].any()
    assert "head" not in missing and "left_elbow" not in missing


def sights(
    *people: list[Samples], number: int = 0, step: int = 1, least: float = 0.5
) -> list[tuple[Samples, int, int]]:
    """Markers, stamp and loss of each of these frames."""
    kept, out = Keypoints(NOW, 0, least, FRAME // 3), []
    for i, seen in enumerate(people):
        device = (number + i * step) * FRAME
        kept.depth(device, NOW + device + 5)
        kept.see(Sight(number + i * step, device, device, seen))
        out += [(markers.data[0], int(markers.time[0]), markers.lost) for markers, _ in kept.take()]
    return out


def test_of_several_people_the_nearest_is_followed_and_kept() -> None:
    near, far = standing(-0.5, 2.0), standing(0.8, 3.0)
    frames = [[far, near]] * 3 + [[standing(-0.5 + 0.02 * i, 2.0), standing(0.8, 3.0 - 0.05 * i)] for i in range(30)]
    middles = [float(np.nanmedian(markers[:, 0])) for markers, _, _ in sights(*frames)]
    assert np.all(np.abs(np.diff(middles)) < 0.05) and middles[-1] < 0.2, "the other one came nearer, and was taken"
    gone = sights(*[[near, far]] * 3, *[[far]] * 45)
    seen = [bool(np.isfinite(markers).any()) for markers, _, _ in gone]
    assert seen[:3] == [True] * 3 and not any(seen[3:30]) and seen[-1], "another one is followed after a second"


def test_nobody_in_view_is_nan_and_time_goes_on() -> None:
    found = sights([], [], [standing()], [])
    assert [bool(np.isfinite(m).any()) for m, _, _ in found] == [False, False, True, False]
    assert [stamp for _, stamp, _ in found] == [NOW + i * FRAME + 5 for i in range(4)]
    one = standing()
    one[3:] = 0.0
    assert np.isnan(sights([one])[0][0]).all(), "three points are no person"


def test_low_confidence_is_missing() -> None:
    unsure = standing()
    unsure[COCO.names.index("left_elbow"), 3] = 0.3
    elbow = MARKERS.index("left_elbow")
    assert np.isnan(sights([unsure])[0][0][elbow]).all()
    assert np.isfinite(sights([unsure], least=0.2)[0][0][elbow]).all()
    assert np.isnan(sights([standing(sure=0.3)])[0][0]).all()


def test_what_is_missing_is_known_and_late_words_bear_the_stamp_of_their_depth() -> None:
    assert [lost for _, _, lost in sights([], [], [], step=3)] == [0, 2, 2]
    kept, got = Keypoints(NOW, 0, 0.5, FRAME // 3), []
    for i in range(10):
        kept.depth(i * FRAME, NOW + i * FRAME)
        if i >= 4:  # the network is four frames late
            kept.see(Sight(i - 4, (i - 4) * FRAME + 1_000_000, (i - 4) * FRAME, [standing()]))
        got += kept.take()
    assert [int(m.time[0]) for m, _ in got] == [NOW + i * FRAME for i in range(6)]
    early = Keypoints(NOW, 0, 0.5, FRAME // 3)
    early.see(Sight(1, FRAME, FRAME, []))
    early.depth(0, NOW)
    assert not early.take(), "its depth is still to come"
    early.depth(FRAME, NOW + FRAME)
    assert [int(m.time[0]) for m, _ in early.take()] == [NOW + FRAME]
    early.interrupted()
    early.depth(0, NOW + 9 * FRAME)
    early.see(Sight(0, 0, 9 * FRAME, []))
    assert [m.lost for m, _ in early.take()] == [-1]
