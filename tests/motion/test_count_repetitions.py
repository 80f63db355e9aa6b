"""count_repetitions.yaml over recordings as phones make them, through the commands that a user gives: import, replay."""

import csv
import os
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.segmentation.evaluation.found import read_found
from tests.support.command_line import call_command, succeeding
from tests.support.real import needs_data
from tests.support.tiers import rest_nightly

COUNTER = Path(__file__).resolve().parents[2] / "configs" / "count_repetitions.yaml"
DATA = Path(os.environ.get("KINEGRAPH_DATA", "/nowhere"))


def kinegraph(*arguments):
    with succeeding():
        call_command(*arguments)


def counted(folder, time, acceleration):
    """The repetitions (n, 2) in a recording that is imported as a table of seconds and three axes in m/s2."""
    with (folder / "phone.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(["t", "x", "y", "z"])
        table.writerows([f"{v:.4f}" for v in row] for row in np.column_stack([time, acceleration]))
    source = ("--stream", "sensor.imu=x,y,z", "--time", "t", "--unit", "m/s2")
    kinegraph("files", "import", folder / "phone.csv", "-o", folder / "phone.mcap", *source)
    kinegraph("replay", COUNTER, folder / "phone.mcap", "-q", "-o", folder / "counted.mcap")
    found = read_found(folder / "counted.mcap")
    return found.primitives[found.repetition > 0]


def phone(counts, cycle_s, rest_s, seed, *, noise=0.1, swing=2.5):
    """Stamps and acceleration of a phone that lies still for `rest_s`, is lifted and tilted `counts[0]` times, lies still, ...

    50 Hz with stamps that come 15 % early or late, one sample in 200 lost, repetitions 6 % longer or shorter than one another, and noise.
    Returns when each bout begins and ends, too.
    """
    rng = np.random.default_rng(seed)
    edges, bouts = [0.0], []
    for count in counts:
        begins = edges[-1] + rest_s + np.append(0.0, np.cumsum(cycle_s * (1 + 0.06 * rng.normal(size=count))))
        edges += begins.tolist()
        bouts.append((begins[0], begins[-1]))
    turns = np.concatenate([[0.0], *(np.arange(c + 1.0) for c in counts), [0.0]])
    time = np.cumsum(rng.normal(0.02, 0.003, int((edges[-1] + rest_s) * 50)).clip(0.002))
    time = time[rng.random(len(time)) > 0.005]
    phase = 2 * np.pi * np.interp(time, [*edges, edges[-1] + rest_s], turns)
    moves = np.any([(time >= a) & (time < b) for a, b in bouts], axis=0)
    lift = moves * (swing * np.sin(phase) + 0.8 * np.sin(2 * phase))
    tilt = 0.3 + moves * 0.175 * (1 - np.cos(phase))
    clean = np.stack([(9.81 + lift) * np.sin(tilt), 0.2 + 0.5 * lift * np.cos(phase), (9.81 + lift) * np.cos(tilt)], 1)
    return time, clean + noise * rng.normal(size=clean.shape), bouts


@pytest.mark.parametrize(
    ("counts", "cycle_s", "rest_s"),
    rest_nightly(((8, 10), 1.5, 15.0), ((12,), 2.0, 4.0), ((20,), 0.8, 20.0), ((6,), 4.0, 60.0)),
)
def test_a_phone_that_lay_still_for_any_time_is_counted_right(tmp_path, counts, cycle_s, rest_s):
    time, acceleration, bouts = phone(counts, cycle_s, rest_s, seed=len(counts))
    spans = counted(tmp_path, time, acceleration) + time[0]
    middle = spans.mean(axis=1)
    assert [int(((middle > a) & (middle < b)).sum()) for a, b in bouts] == list(counts)
    assert len(spans) == sum(counts)
    inner = np.concatenate([np.diff(spans[(middle > a) & (middle < b)][1:-1], axis=1)[:, 0] for a, b in bouts])
    assert np.abs(inner / cycle_s - 1).max() < 0.25


def test_a_phone_that_only_lies_there_counts_nothing(tmp_path):
    time, acceleration, _ = phone((1,), 0.1, 40.0, seed=9, swing=0.0)
    assert len(counted(tmp_path, time, acceleration)) == 0


@needs_data
@pytest.mark.parametrize("person", ["s07", "s08", "s12"])
def test_strides_of_a_real_foot_are_counted_within_two(tmp_path, person):
    """A walk there and back, with its first and last steps and the turn; annotated are the foot's contacts."""
    with np.load(DATA / "steps" / f"imu_voisard_{person}.npz") as archive:
        time, acceleration = archive["t1_rf_counter"] / 100.0, archive["t1_rf"][:, :3]
        contacts = archive["t1_right_events"][:, 1] / 100.0
    spans = counted(tmp_path, time, acceleration)
    assert abs(len(spans) - (len(contacts) - 1)) <= 2, "a stride lies between two contacts"
    walking = [(a, b) for a, b in pairwise(contacts) if b - a < 1.6]
    held = [int(((spans.mean(axis=1) >= a) & (spans.mean(axis=1) < b)).sum()) for a, b in walking]
    assert np.mean(np.array(held) == 1) >= 0.8
