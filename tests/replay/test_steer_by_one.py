"""configs/steer_by_one.yaml: from a depth camera to the vertices of a mesh, by the hands and feet of one person.

Recording: simulated, a performer of capsules before a rendered camera (of a real camera there is no recording that may be kept).
Truth: where the performer's feet are.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.replay.test_steer_by_two import paws, replayed

pytestmark = pytest.mark.nightly


def test_one_person_steers_with_hands_and_feet() -> None:
    results, feet = replayed("steer_by_one", 1)
    mesh, high = results["dog.steer.mesh"], paws(results)
    assert mesh.data.shape[1:] == (3502, 3) and np.isfinite(mesh.data).all()
    assert (np.ptp(high, axis=0) > 0.02).all(), "all four paws are lifted"
    lifted = -feet[-len(high) :, 0, :, 1]
    assert min(np.corrcoef(high[:, 2 + k], lifted[:, k])[0, 1] for k in range(2)) > 0.5
