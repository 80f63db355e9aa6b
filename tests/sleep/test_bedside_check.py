"""`kinegraph sleep check` on the simulated bedroom: a region that holds, one that does not, and a camera that is blind at night."""

from __future__ import annotations

import struct
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from kinegraph.operators.bed.setup.command import Preview
from kinegraph.operators.bed.setup.graph import small
from kinegraph.operators.bed.setup.judgement import Minute, judge
from tests.support.command_line import Command, kinegraph, refused

__all__ = ["kinegraph"]
CONFIGS = Path(__file__).resolve().parents[2] / "configs"
ROOM = (
    CONFIGS / "bedside_simulated.yaml",
    "--between",
    80,
    "--set",
    "camera.evening_min=2",
    "--set",
    "camera.bed_h=0.2",
)


def test_a_bed_that_was_found_holds_who_lies_in_it(kinegraph: Command) -> None:
    code, out, _ = kinegraph("sleep", "check", *ROOM)
    assert code == 0 and "NOT WELL" not in out and "the region holds 100%" in out and "the light is the same" in out
    assert "well: breath is seen: 1" in out and "next: kinegraph run" in out


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--set", "bed.regions=[[0, 0, 24, 24]]"), "too small, or elsewhere; try regions: [[8, 56, 96, 40]]"),
        (("--set", "bed.regions=[[0, 0, 120, 160]]"), "it is too large; try regions"),
        (("--between", 0, "--in", 50), "no person was seen in bed"),
    ],
)
def test_what_is_not_well_is_named_and_ends_with_2(kinegraph: Command, more: tuple[object, ...], message: str) -> None:
    code, out, _ = kinegraph("sleep", "check", *ROOM, *more)
    assert code == 2 and message in out


def test_a_look_writes_thinned_frames_until_its_reader_leaves(monkeypatch: pytest.MonkeyPatch) -> None:
    written: list[bytes] = []

    def write(data: bytes) -> None:
        written.append(data)
        if len(written) == 2:
            raise BrokenPipeError

    monkeypatch.setattr("sys.stdout", SimpleNamespace(buffer=SimpleNamespace(write=write, flush=lambda: None)))
    monkeypatch.setattr("kinegraph.operators.bed.setup.command.LOOK_S", 0.0)
    wide = ["camera.width=400", "camera.height=240"]
    Preview(small(CONFIGS / "bedside_simulated.yaml", wide).graph).run()
    rows, columns, step = struct.unpack("<3I", written[0][:12])
    assert (rows, columns, step) == (80, 134, 3) and len(written) == 2
    depth = np.frombuffer(written[0][12:], "<u2").reshape(rows, columns)
    assert 500 < np.median(depth[depth > 0]) < 5000


def test_a_stereo_camera_without_a_light_is_refused_before_it_is_opened(kinegraph: Command) -> None:
    checked = kinegraph("sleep", "check", CONFIGS / "bedside_sleep.yaml", "--set", "camera.projector=0")
    refused(checked, "sees nothing in the dark", "lit_room: true")


@pytest.mark.parametrize(("raised", "empty"), [((8, 12), False), ((0, 4), True)])
def test_a_bed_that_was_not_empty_in_the_minute_out_of_it_is_named(raised: tuple[int, int], empty: bool) -> None:
    """Depths of 20 x 10 blocks: a heap across the middle, or a pillow at the head."""
    random = np.random.default_rng(4)
    out, inn = Minute.of((20, 10)), Minute.of((20, 10))
    for minute in (out, inn):
        for _ in range(20):
            depth = 2000.0 + random.normal(0, 1, (20, 10))
            depth[slice(*raised), 2:8] -= 150.0
            depth[4:18, 3:7] -= 200.0 * (minute is inn)
            minute.add(depth)
    found = judge(out, {"sleeper": inn}, {"sleeper": (0, 0, 20, 10)}, 8, 80.0, 0.15)
    assert any("while it should be empty" in f.text for f in found) != empty
    assert all(f.well for f in found) == empty, [f.text for f in found]
