"""Real walks through a laboratory, imported and replayed through the overground graph: cycles of both legs from the markers alone."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import structlog

from kinegraph.stream.chunk import NS
from kinegraph.stream.cli import main as cli
from kinegraph.stream.recording import Recording
from tests.support.real import DATA_MARKS

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "overground_emg.yaml"
DATA = os.environ.get("KINEGRAPH_DATA", "")
pytestmark = [*DATA_MARKS, pytest.mark.nightly]

WALKS = [f"{subject}/{trial}" for subject in ("S1_FLOAT", "S2_NO_FLOAT", "S3_FLOAT", "S3_NO_FLOAT", "S4_FLOAT", "S4_NO_FLOAT")
         for trial in ("T_01", "T_02", "T_03")]  # fmt: skip
FAULTY = {"S1_FLOAT": "LTA", "S2_NO_FLOAT": "LMG"}
"""Channels that whoever recorded them knows to be faulty."""
MISTAKEN = {("S4_NO_FLOAT/T_02", "left", 0)}
"""False touch-downs: the foot is drawn back before the first step, and the walk's direction is not known yet."""


class Walk(NamedTuple):
    """A trial's events and flags as the replay gave them."""

    name: str
    recording: Recording
    markers: np.ndarray

    def onsets_s(self, side: str) -> np.ndarray:
        rows = self.recording.read("feet.touchdown")[1]
        return np.asarray(rows["onset"][rows["limb"] == side] / NS)

    @property
    def flags(self) -> dict[str, str]:
        """The verdict on each channel over the whole session, at its end."""
        rows = self.recording.read("quality")[1]
        return {str(row["name"]): str(row["session_flag"]) for row in rows}


@pytest.fixture(scope="module")
def walks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[list[Walk]]:
    """Every trial of every recording, through import and replay as a user would call them."""
    folder = tmp_path_factory.mktemp("overground")
    opened = []
    for name in WALKS:
        subject, trial = name.split("/")
        file = Path(DATA) / "emg" / f"emg_epfl_{subject}.npz"
        walk = folder / f"{subject}_{trial}.mcap"
        emg = ["--stream", f"lab.emg={trial}_emg", "--names", "lab.emg=emg_names", "--rate", "lab.emg=fs_emg"]
        markers = [
            "--stream",
            f"lab.markers={trial}_kin",
            "--names",
            "lab.markers=kin_names",
            "--rate",
            "lab.markers=fs_kin",
        ]
        units = ["--unit", "lab.emg=mV", "--unit", "lab.markers=mm"]
        call("files import", file, "-o", walk, *emg, *markers, *units)
        call("replay", CONFIG, walk, "-o", walk.with_suffix(""), "-q")
        with np.load(file) as arrays:
            opened.append(Walk(name, Recording.open(walk.with_suffix("")), arrays[f"{trial}_kin"]))
    structlog.reset_defaults()
    yield opened
    for walk in opened:
        walk.recording.close()


def call(command: str, *arguments: object) -> None:
    try:
        cli.call(command, list(map(str, arguments)))
    except SystemExit as end:
        assert not end.code, (command, arguments)


def test_every_walk_gives_cycles_of_both_legs(walks: list[Walk]) -> None:
    for walk in walks:
        for side in ("left", "right"):
            onsets = walk.onsets_s(side)
            assert len(onsets) >= 3, (walk.name, side)
            closed = walk.recording.read("cycles.closed")[1]
            closed = closed[closed["limb"] == side]
            accepted = closed[closed["rejected"] == ""]
            assert len(accepted) >= 2, (walk.name, side)
            statistics = walk.recording.read("statistics")[1]  # a cycle comes again where a bad second ended after it
            mine = statistics[np.char.startswith(statistics["name"], side[0].upper())]
            judged = walk.recording.read("review.judged")[1]
            used = {
                int(row["number"]) for row in judged if row["used"]
            }  # without any muscle of the leg a cycle has no numbers
            assert {int(row["number"]) for row in mine} >= {int(row["number"]) for row in accepted} & used, (
                walk.name,
                side,
            )
            assert len(np.unique(mine[["number", "muscle"]])) == 2 * len(np.unique(mine["number"])) >= 2
            # a cycle is from one touch-down to the next; the last may end after the envelope does
            pairs = list(pairwise(onsets))
            found = [(row["onset"] / NS, row["end"] / NS) for row in closed]
            assert found == pairs[: len(found)] and len(pairs) - len(found) <= 1, (walk.name, side)
        curves, rows = walk.recording.read("cycles.cycles")[1], walk.recording.read("cycles.closed")[1]
        limbs = rows["limb"][rows["rejected"] == ""]
        assert curves.shape == (len(limbs), 100, 4)
        own = np.array(
            [[name[0] == limb[0].upper() for name in ("LTA", "LMG", "RTA", "RMG")] for limb in limbs.tolist()]
        )
        assert (np.isfinite(curves).all(axis=1) == own).all()


def test_strides_are_those_of_a_person_who_walks(walks: list[Walk]) -> None:
    """Left and right take turns, half a stride apart, and a stride takes as long on both sides."""
    for walk in walks:
        left, right = walk.onsets_s("left"), walk.onsets_s("right")
        sides = np.array(["l"] * len(left) + ["r"] * len(right))[np.argsort(np.concatenate([left, right]))]
        assert (sides[1:] != sides[:-1]).all(), walk.name
        strides = [np.median(np.diff(onsets)) for onsets in (left, right)]
        assert 0.8 < strides[0] < 3.0 and abs(strides[0] - strides[1]) < 0.15 * strides[0], walk.name
        after = np.array([(r - left[left < r][-1]) / strides[0] for r in right if (left < r).any()])
        assert (np.abs(after[1:] - 0.5) < 0.15).all(), walk.name  # the first step is that of one who stood


def test_a_foot_that_has_touched_down_stands(walks: list[Walk]) -> None:
    """The toe's forward speed just after its touch-down is a small part of what it is in the middle of the swing."""
    moving = set()
    for walk in walks:
        names = list(walk.recording.streams["lab.markers"].spec.channels)
        for side in ("left", "right"):
            toe = walk.markers[:, names.index(f"{side[0].upper()}TOE")]
            along = np.argmax(np.ptp(toe[:, :2], axis=0))
            speed = np.abs(np.gradient(toe[:, along]))
            for i, onset in enumerate(walk.onsets_s(side)[:-1]):
                after = speed[round(onset * 100) + 12 : round(onset * 100) + 22]
                if after.mean() > 0.25 * np.nanpercentile(speed, 95):
                    moving.add((walk.name, side, i))
    assert moving <= MISTAKEN


def test_the_known_faulty_channels_are_flagged_and_the_others_mostly_not(walks: list[Walk]) -> None:
    doubtful = []
    for walk in walks:
        faulty = FAULTY.get(walk.name.partition("/")[0])
        for channel, flag in walk.flags.items():
            if channel == faulty:
                assert flag == "bad", (walk.name, channel, flag)
            else:
                assert flag != "bad", (walk.name, channel)
                doubtful += [(walk.name, channel)] if flag != "good" else []
    assert len(doubtful) <= 4, doubtful  # of 66; two of RMG beside the faulty LMG of S2, two of LMG of S3
