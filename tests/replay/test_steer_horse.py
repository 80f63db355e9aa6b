"""configs/steer_horse.yaml: two people steer the four legs of an animal, with three markers each.

Recording: simulated, ten seconds of two people who walk on the spot at different paces.
Truth: the people's feet: the first one's move the fore legs, the second one's the hind legs, left with left, right with right.
"""

from __future__ import annotations

import numpy as np
import pytest

import kinegraph as kg
from kinegraph.devices.people.quadruped import TwoActors
from kinegraph.operators.steering.model.stored import KIND, from_model
from kinegraph.operators.steering.operator import MODELS
from kinegraph.stream.data.model_file import read_model
from tests.replay.replaying import signal

GRAPH = kg.load("steer_horse")
PEOPLE = GRAPH.nodes["people"]
assert isinstance(PEOPLE, TwoActors)
FEET = np.array([PEOPLE.markers(frame) for frame in range(300)])
PARTS = ["first.hip", "first.foot_l", "first.foot_r", "second.hip", "second.foot_l", "second.foot_r"]
STEERED = {"hoof_fl": "first.foot_l", "hoof_fr": "first.foot_r", "hoof_hl": "second.foot_l", "hoof_hr": "second.foot_r"}


@pytest.fixture(scope="module")
def replayed() -> kg.Results:
    return GRAPH.run({"people": signal(FEET, PEOPLE.rate_hz, PARTS, ["m"])}, keep=["legs", "dog.steer.mesh"])


@pytest.mark.parametrize("hoof", STEERED)
def test_a_hoof_goes_where_its_persons_foot_goes(replayed: kg.Results, hoof: str) -> None:
    """Forwards and back, once the ranges of motion have been learned for three seconds."""
    legs = replayed["legs"]
    forwards = legs.data[120:, legs.spec.channels.index(hoof), 2]
    likeness = {part: np.corrcoef(forwards, FEET[120:, PARTS.index(part), 2])[0, 1] for part in STEERED.values()}
    assert max(likeness, key=likeness.__getitem__) == STEERED[hoof]
    assert likeness[STEERED[hoof]] > 0.98


@pytest.mark.parametrize("hoof", STEERED)
def test_the_meshs_own_hoof_follows(replayed: kg.Results, hoof: str) -> None:
    """As the foot is lifted; forwards the mesh walks on over the paws that are down."""
    learned, _ = from_model(read_model(MODELS["dog"], KIND))
    mesh = replayed["dog.steer.mesh"].data[120:, learned.vertices[learned.markers.index(hoof)], 1]
    assert np.corrcoef(mesh, FEET[120:, PARTS.index(STEERED[hoof]), 1])[0, 1] > 0.9
