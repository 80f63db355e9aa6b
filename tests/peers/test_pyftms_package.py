"""pyftms, written elsewhere, reads what our treadmill sends, and what it makes of a capture's layout is what we make of it."""

from __future__ import annotations

import importlib
import sys
import typing
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typing_extensions

from kinegraph.devices.fitness_treadmill import protocol as ftms


def their_treadmill() -> Any:
    """Its module on treadmills. The package as a whole is written for Python 3.12, and is passed by."""
    name = "pyftms.models.realtime_data.treadmill"
    if name in sys.modules:
        return sys.modules[name]
    found = find_spec("pyftms")
    if found is None or not found.submodule_search_locations:
        pytest.skip("pyftms is not installed")
    if not hasattr(typing, "override"):
        typing.override = typing_extensions.override  # type: ignore[attr-defined]
    place = Path(found.submodule_search_locations[0])
    for part in ("pyftms", "pyftms.models", "pyftms.models.realtime_data"):
        package = ModuleType(part)
        package.__path__ = [str(place.joinpath(*part.split(".")[1:]))]
        sys.modules.setdefault(part, package)
    return importlib.import_module(name)


def read(data: bytes) -> Any:
    """What it makes of a notification."""
    module = their_treadmill()
    serializer = importlib.import_module("pyftms.serializer")
    return serializer.get_serializer(module.TreadmillData).deserialize(BytesIO(data))


NAMES = {"speed": "speed_instant", "distance": "distance_total", "heart_rate": "heart_rate", "elapsed": "time_elapsed"}


@pytest.mark.parametrize(
    "data",
    [bytes.fromhex("9C05") + bytes(range(1, 22)), ftms.build(5.4, -1.5, 70_000, 3601), ftms.build(0.8, 15, 3, 4)],
)
def test_pyftms_reads_what_we_read(data: bytes) -> None:
    theirs, ours = read(data), ftms.parse(data)
    assert ours is not None
    for name, their_name in NAMES.items():
        if name in ours.values:
            assert getattr(theirs, their_name) == pytest.approx(ours.values[name]), name
    assert theirs.inclination.inclination == pytest.approx(ours.values["incline"])
    if "climbed" in ours.values:
        assert theirs.elevation_gain.elevation_gain_positive == pytest.approx(ours.values["climbed"], rel=10)
