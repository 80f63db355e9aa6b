"""configs/body_markers.yaml: the markers of a person before a depth camera, where they stand and where the floor is.

Recording: simulated, a performer of capsules before a rendered camera (of a real camera there is no recording that may be kept).
Truth: where the performer and the floor are. The markers themselves come from a pose network that not every computer has:
`kinegraph files fetch pose-model` brings it, and tests/avatar/test_body.py tries it.
"""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import AWAY_M, EMPTY_S, HEIGHT_M, POINTS
from kinegraph.stream.chunk import NS
from tests.replay.replaying import CAMERA_HZ, performance, signal

DEPTH, JOINTS = performance(6.0)
CONFIG = Path(__file__).resolve().parents[2] / "configs" / "body_markers.yaml"


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    written, text = YAML(), StringIO()
    graph = written.load(CONFIG.read_text(encoding="utf-8"))
    for node in ("network", "markers", "screen"):
        del graph["nodes"][node]
    del graph["page"]  # it shows what is left out here
    graph["record"] = ["background.floor", "persons.persons"]
    written.dump(graph, text)
    without = kg.Graph.from_yaml(text.getvalue())
    depth = kg.Series("", without.specs["camera.depth"], signal(DEPTH, CAMERA_HZ).time, DEPTH)
    return without.run({"camera.depth": depth})


def test_the_floor_is_level_and_as_far_below_as_it_is(replayed: kg.Results) -> None:
    (floor,) = replayed["background.floor"].data
    assert floor["height_m"] == pytest.approx(HEIGHT_M, abs=0.02)
    np.testing.assert_allclose(np.abs(floor["normal"]), [0.0, 1.0, 0.0], atol=0.02)


def test_one_person_is_seen_from_the_moment_that_somebody_is_there(replayed: kg.Results) -> None:
    rows = replayed["persons.persons"].data
    assert rows["onset"][0] / NS == pytest.approx(EMPTY_S, abs=0.2)
    assert set(rows["person"]) == {1}
    assert len(rows) > 0.95 * (6.0 - EMPTY_S) * CAMERA_HZ


def test_the_person_is_where_the_performers_hips_are(replayed: kg.Results) -> None:
    rows = replayed["persons.persons"].data
    frames = np.round(rows["onset"] / NS * CAMERA_HZ).astype(int)
    hips = JOINTS[frames][:, [POINTS.index("left_hip"), POINTS.index("right_hip")]].mean(axis=1)
    assert np.abs(rows["place"][:, 0] - hips[:, 0]).max() < 0.15
    assert np.abs(rows["place"][:, 2] - AWAY_M).max() < 0.35


def test_the_box_holds_the_head_and_the_feet(replayed: kg.Results) -> None:
    """Rows of pixels from the head to the ankles, by the camera's focal length of 224 pixels."""
    rows = replayed["persons.persons"].data
    frames = np.round(rows["onset"] / NS * CAMERA_HZ).astype(int)
    for point in ("head", "left_ankle", "right_ankle"):
        joint = JOINTS[frames, POINTS.index(point)]
        row = 224.0 * joint[:, 1] / joint[:, 2] + 99.5
        top, height = rows["box"][:, 0], rows["box"][:, 2]
        assert ((row > top - 3) & (row < top + height + 3)).mean() > 0.95
