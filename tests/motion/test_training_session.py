"""Three exercises of ten repetitions before a simulated camera, with pauses, a joint out of sight in the middle: what is seen and kept."""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.people.exerciser import Exerciser, Routine
from kinegraph.stream.chunk import NS
from kinegraph.stream.recording import Recording
from tests.support.command_line import call_command, succeeding

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "segment_kinect.yaml"
DONE = ("arms", "squat", "knees")
TEN = 10


def kinegraph(*arguments: object) -> None:
    with succeeding():
        call_command(*arguments)


def session(folder: Path, routine: Routine, **more: object) -> Path:
    """What these exercises give, as fast as they can be made."""
    values = {
        "kinect.realtime": "false", "kinect.exercises": f"[{', '.join(DONE)}]",
        "kinect.duration_s": round(float(routine.starts(2)[-1]) + 4.0, 1), "report.path": folder.with_suffix(".html"), **more,
    }  # fmt: skip
    sets = [part for name, value in values.items() for part in ("--set", f"{name}={value}")]
    kinegraph("run", CONFIG, *sets, "--view", "none", "-o", folder)
    return folder


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Routine]:
    """The session's folder; one person showed the exercises, another does them."""
    folder = tmp_path_factory.mktemp("training")
    first = Routine(Exerciser(seed=2, exercises=DONE, repetitions=5))
    shown = session(folder / "shown", first, **{"kinect.seed": 2, "kinect.repetitions": 5})
    spans = [f"{name}={first.starts(k)[0]:.1f}-{first.starts(k)[-1]:.1f}" for k, name in enumerate(DONE)]
    kinegraph("motion", "label", shown, *spans, "-o", folder / "exercises.npz")
    routine = Routine(Exerciser(seed=5, exercises=DONE, repetitions=TEN, pause_s=8.0))
    middle = routine.starts(1)
    more = {
        "kinect.seed": 5, "kinect.repetitions": TEN, "kinect.pause_s": 8.0, "named.model": folder / "exercises.npz",
        "kinect.lost_joint": "wrist_l", "kinect.lost_s": f"[{middle[3]:.2f}, {middle[6]:.2f}]",
    }  # fmt: skip
    return session(folder / "done", routine, **more), routine


def found(folder: Path, name: str) -> tuple[Any, Any]:
    """Stamps, in seconds of the session, and events of an output."""
    with Recording.open(folder) as recording:
        zero = min(s.first for s in recording.streams.values() if s.role == "input" and s.first is not None)
        chunks = [entry[0] for entry in recording.entries(name)]
    return (np.concatenate([c.time for c in chunks]) - zero) / NS, np.concatenate([c.data for c in chunks])


def test_counts_are_right_as_the_exercises_go(trained: tuple[Path, Routine]) -> None:
    """From the third repetition on: half a cycle after its end it counts, and at most the next one, which is half done, beside it."""
    folder, routine = trained
    at, table = found(folder, "segment.count")
    for number in range(len(DONE)):
        starts = routine.starts(number)
        for k in range(3, TEN + 1):
            shown = table["count"][at <= starts[k] + (starts[k] - starts[k - 1]) / 2][-1]
            assert shown in (k, min(k + 1, TEN)), (DONE[number], k)


def test_names_are_right_as_the_exercises_go(trained: tuple[Path, Routine]) -> None:
    folder, routine = trained
    at, table = found(folder, "named.believed")
    for number, name in enumerate(DONE):
        starts = routine.starts(number)
        mine = (at > starts[2]) & (at < starts[-1] + 1.0)
        assert mine.sum() >= TEN - 2 and set(table["name"][mine]) == {name}


@pytest.mark.nightly
def test_the_report_has_ten_of_each_with_its_name(trained: tuple[Path, Routine]) -> None:
    folder, routine = trained
    _, table = found(folder, "named.repetition")
    assert [(name, int((table["name"] == name).sum())) for name in DONE] == [(name, TEN) for name in DONE]
    assert len(table) == TEN * len(DONE)
    page = re.sub(r"<svg.*?</svg>", "", folder.with_suffix(".html").read_text(), flags=re.S)
    cells = [
        [re.sub("<.*?>", "", c) for c in re.findall("<td.*?>(.*?)</td>", row)]
        for row in re.findall("<tr>(.*?)</tr>", page)
    ]
    assert all([name, "1", str(TEN)] in cells for name in DONE)
    with folder.with_suffix(".csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["exercise"] for row in rows] == [name for name in DONE for _ in range(TEN)]
    for number in range(len(DONE)):
        taken = [float(row["duration (s)"]) for row in rows[TEN * number : TEN * (number + 1)]]
        assert np.median(taken) == pytest.approx(np.median(np.diff(routine.starts(number))), rel=0.1)


def test_a_rest_lasts_as_long_as_somebody_stands_also_before_a_camera_with_little_noise(tmp_path: Path) -> None:
    """Stillness that never reaches the segmentation is a gap: of 12 s of rest 2 were reported."""
    routine = Routine(Exerciser(seed=3, noise_mm=1.0, exercises=DONE, repetitions=4, pause_s=12.0))
    little = {"kinect.seed": 3, "kinect.noise_mm": 1, "kinect.repetitions": 4, "kinect.pause_s": 12}
    _, rests = found(session(tmp_path / "still", routine, **little), "segment.rest")
    assert (rests["end"] - rests["onset"])[:3] / NS == pytest.approx([12.0, 12.0, 12.0], abs=1.0)
