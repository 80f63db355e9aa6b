"""Contacts from real force plates, against the events that a laboratory's own software set in the same file."""

from __future__ import annotations

import os
from pathlib import Path

import ezc3d
import numpy as np
import pytest

from kinegraph.operators.contacts.limb_contacts import LimbContacts
from kinegraph.stream.chunk import NS, StreamSpec
from tests.support.emg_run import drive, stamps
from tests.support.real import DATA_MARKS

DATA = os.environ.get("KINEGRAPH_DATA", "")
pytestmark = DATA_MARKS


def found(name: str, plates: dict[str, list[str]]) -> dict[str, dict[str, np.ndarray]]:
    """Touch-downs and lift-offs in s of the file's clock, by foot, from each foot's plates."""
    file = ezc3d.c3d(str(Path(DATA) / "files" / "c3d" / name))
    analog, points = file["parameters"]["ANALOG"], file["parameters"]["POINT"]
    labels, rate = analog["LABELS"]["value"], float(analog["RATE"]["value"][0])
    channels = [channel for mine in plates.values() for channel in mine]
    loads = file["data"]["analogs"][0][[labels.index(channel) for channel in channels]].T
    spec = StreamSpec((len(channels),), rate_hz=rate, channels=tuple(channels), units=("N",))
    limbs = {foot: {"channels": mine} for foot, mine in plates.items()}
    made = drive(LimbContacts("force", limbs, {"inverted": True}), {"in": (spec, stamps(len(loads), rate), loads)}, 100)
    first = file["header"]["points"]["first_frame"] / points["RATE"]["value"][0]
    return {
        port: {foot: first + rows["onset"][rows["limb"] == foot] / NS for foot in plates}
        for port, (_, _, rows) in made.items()
    }


def test_a_run_over_eight_plates_agrees_with_the_events_of_the_file() -> None:
    """Four plates were stepped on, one foot each; the others are silent, and their faint noise makes no contact."""
    made = found(
        "events_8plates.c3d", {"right": ["Fz2", "Fz7"], "left": ["Fz4", "Fz8"], "none": ["Fz1", "Fz3", "Fz5", "Fz6"]}
    )
    expected = {
        "touchdown": {"right": [3.68, 4.14], "left": [3.908, 4.364], "none": []},
        "liftoff": {"right": [3.804, 4.264], "left": [4.032, 4.488], "none": []},
    }
    for port, feet in expected.items():
        for foot, times in feet.items():
            assert len(made[port][foot]) == len(times), (port, foot)
            assert np.allclose(made[port][foot], times, atol=0.005), (port, foot)


@pytest.mark.parametrize(("name", "plates"), [("walking5.c3d", ("Fz1", "Fz2")), ("gait_bmc.c3d", ("F1Z", "F2Z"))])
def test_plates_with_an_offset_and_another_scale_give_one_stance_each(name: str, plates: tuple[str, str]) -> None:
    """walking5's plates read some 17 N while empty; gait_bmc's highest load is 74 N."""
    made = found(name, {"first": [plates[0]], "second": [plates[1]]})
    for foot in ("first", "second"):
        down, up = made["touchdown"][foot], made["liftoff"][foot]
        assert len(down) == len(up) == 1 and 0.45 < up[0] - down[0] < 0.75
