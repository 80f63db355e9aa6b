"""`python -m tests.quadruped_model`: make the model of the simple quadruped that comes with mesh steering; a test compares."""

from __future__ import annotations

from typing import Any

import numpy as np

from kinegraph.devices.people.quadruped import marked, topology, walking
from kinegraph.operators.steering.model.fit import fit_steering
from kinegraph.operators.steering.model.stored import KIND, to_arrays
from kinegraph.operators.steering.operator import QUADRUPED
from kinegraph.stream.chunk import Array
from kinegraph.stream.data.model_file import write_model
from kinegraph.stream.domain.axes import BODY

LIMBS = ("hoof_fl", "hoof_fr", "hoof_hl", "hoof_hr")


def made() -> tuple[dict[str, Any], dict[str, Array]]:
    """The header and arrays of the model: 24 frames of a stride, every leg by its own hoof."""
    frames = np.array([walking(k / 24) for k in range(24)])
    mesh = topology()
    model = fit_steering(frames, mesh.faces, marked(), ("withers", "croup"), LIMBS, count=14, modes=2)
    header, arrays = to_arrays(model, mesh, LIMBS)
    return {**header, "axes": BODY.facts()}, arrays


if __name__ == "__main__":
    header, arrays = made()
    write_model(QUADRUPED, KIND, header, arrays)
