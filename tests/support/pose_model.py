"""The pose network for tests: they are skipped where it is not there."""

from __future__ import annotations

import pytest

from kinegraph.operators.body.network.blazepose import model_path
from kinegraph.operators.body.network.published import FACE, HAND, PERSON
from kinegraph.stream.errors import ParameterError


def pose_network_or_skip() -> None:
    """Skip the test, with the reason, where the network or its runtime is missing."""
    try:
        model_path("")
    except ParameterError as error:
        pytest.skip(f"the pose network cannot be used here: {error}")


def camera_networks_or_skip() -> None:
    """The same for what an ordinary camera needs beside it."""
    pose_network_or_skip()
    try:
        for network in (PERSON, HAND, FACE):
            network.path("model")
    except ParameterError as error:
        pytest.skip(f"the networks for ordinary cameras cannot be used here: {error}")
