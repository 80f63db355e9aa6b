"""configs/steer_by_two.yaml: from a depth camera to the vertices of a mesh, by two people.

Recording: simulated, performers of capsules before a rendered camera (of a real camera there is no recording that may be kept).
Truth: where the performers' feet are, and who moves.
"""

from __future__ import annotations

from importlib.util import find_spec

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.rendered_performer import POINTS, RenderedPerformer
from kinegraph.operators.steering.model.stored import KIND, from_model
from kinegraph.operators.steering.operator import MODELS
from kinegraph.stream.chunk import NS
from kinegraph.stream.data.model_file import read_model
from kinegraph.stream.recording import Recording
from tests.replay.replaying import CAMERA_HZ, no_images, signal
from tests.support.command_line import Command
from tests.support.command_line import kinegraph as kinegraph

pytestmark = pytest.mark.nightly
SECONDS, LEARNED_S = 11.0, 7.5
DOG, _ = from_model(read_model(MODELS["dog"], KIND))
ANKLES = [POINTS.index("left_ankle"), POINTS.index("right_ankle")]


def replayed(config: str, people: int) -> tuple[kg.Results, np.ndarray]:
    """What the graph makes of a rendered session; and where the feet (n, people, 2, 3) are, seen from the hips."""
    graph, performer = kg.load(config), RenderedPerformer(320, 200, people=people)
    frames = range(int(SECONDS * CAMERA_HZ))
    depth = np.stack([performer.frame(i, i / CAMERA_HZ) for i in frames])
    joints = np.array([[performer.joints(i / CAMERA_HZ, who) for who in range(people)] for i in frames])
    hips = joints[:, :, [POINTS.index("left_hip"), POINTS.index("right_hip")]]
    series = kg.Series("", graph.specs["camera.depth"], signal(depth, CAMERA_HZ).time, depth)
    sources = {"camera.depth": series, "camera.mono": no_images(graph, "camera.mono")}
    return graph.run(sources, keep=["legs", "dog.steer.mesh"]), joints[:, :, ANKLES] - hips


@pytest.fixture(scope="module")
def two() -> tuple[kg.Results, np.ndarray]:
    return replayed("steer_by_two", 2)


def paws(results: kg.Results) -> np.ndarray:
    """The paws' heights above their ground (n, 4), from the mesh itself, once ranges have been learned."""
    mesh = results["dog.steer.mesh"]
    high = mesh.data[:, DOG.vertices[:4], 1]
    return high[mesh.time >= LEARNED_S * NS]


def test_two_people_before_a_camera_move_the_legs_of_one_mesh(two: tuple[kg.Results, np.ndarray]) -> None:
    """Each paw goes up and down as the foot does that steers it: the first one's the fore legs, the second one's the hind legs."""
    results, feet = two
    high = paws(results)
    lifted = -feet[-len(high) :, :, :, 1].reshape(len(high), 4)
    assert np.isfinite(results["dog.steer.mesh"].data).all()
    likeness = np.array([[np.corrcoef(high[:, a], lifted[:, b])[0, 1] for b in range(4)] for a in range(4)])
    assert (likeness.argmax(axis=1) == range(4)).all(), likeness.round(2)
    assert np.diag(likeness).mean() > 0.4, likeness.round(2)


def test_paws_that_are_down_do_not_slide(two: tuple[kg.Results, np.ndarray]) -> None:
    mesh = two[0]["dog.steer.mesh"].data[-int((SECONDS - LEARNED_S) * CAMERA_HZ) :]
    paw = mesh[:, DOG.vertices[:4]]
    down = paw[..., 1] < paw[..., 1].min(axis=1, keepdims=True) + 0.003
    both = down[1:] & down[:-1]
    moved = np.linalg.norm(np.diff(paw[..., [0, 2]], axis=0), axis=-1)
    assert both.mean() > 0.15
    assert 100 * CAMERA_HZ * np.median(moved[both]) < 2.0, "centimetres a second"


@pytest.mark.skipif(find_spec("depthai") is None, reason="depthai is not installed (pip install 'kinegraph[oak]')")
@pytest.mark.timeout(200, method="thread")
@pytest.mark.xdist_group("depthai")
@pytest.mark.parametrize("config", ["steer_by_one", "steer_by_two"])
def test_a_simulated_camera_of_depthai_moves_the_mesh(kinegraph: Command, config: str) -> None:
    code, _, complaint = kinegraph("run", config, "--simulate", "--for", "12", "--view", "none", "-o", "run")
    assert code == 0, complaint
    with Recording.open("run") as recording:
        _, mesh = recording.read("dog.steer.mesh")
    late = mesh[len(mesh) // 2 :]
    assert mesh.shape[1:] == (3502, 3) and np.isfinite(mesh).all()
    assert np.ptp(late[:, DOG.vertices[:4]], axis=0).max() > 0.03, "paws move"
