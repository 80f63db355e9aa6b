"""The shipped graph of steps on simulated walkers: steps where they are, the manner recognised, and the model that is shipped with it."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from kinegraph.devices.mti.simulator import MtiModel, SimulatedMti
from kinegraph.devices.outlets.terminal.step_panel import StepPanel, panel
from kinegraph.devices.people.walking_back import MANNERS, Back
from kinegraph.operators.steps.classifier import SHIPPED, StepClassifier
from kinegraph.operators.steps.forest import StepModel
from kinegraph.operators.steps.steps import Steps
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.operator import grid
from kinegraph.stream.recording import Recording
from kinegraph.stream.recording.series import Series, write_recording
from tests.support.command_line import call_command, succeeding

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "step_biometrics.yaml"
CHANNELS, UNITS = ("ax", "ay", "az", "gx", "gy", "gz"), ("m/s2",) * 3 + ("rad/s",) * 3


def kinegraph(*arguments: object) -> None:
    with succeeding():
        call_command(*arguments)


def walk(manner: str, person: int, seconds: int = 30) -> tuple[StreamSpec, np.ndarray, np.ndarray]:
    measured = Back(manner, person).measure(np.arange(seconds * 100))  # type: ignore[arg-type]
    data = np.concatenate([measured["acceleration"], measured["angular_velocity"]], 1)
    return StreamSpec((6,), rate_hz=100.0, channels=CHANNELS, units=UNITS), grid(100.0, len(data)), data


@pytest.mark.parametrize("manner", MANNERS)
def test_steps_of_a_simulated_person_are_found_where_they_are(manner: str) -> None:
    spec, time, data = walk(manner, 101, 60)
    finder = Steps()
    finder.open({"in": spec})
    rows = finder.process("in", Chunk(time, data, int(time[-1]))).data
    true = Back(manner, 101).steps(0, 6000) / 100  # type: ignore[arg-type]
    found = rows["end"] / NS
    near = np.array([np.abs(found - t).min() for t in true])
    assert (near < 0.25).mean() > 0.95 and len(found) < 1.1 * len(true) + 4
    assert (rows["kind"] == "turn").sum() >= 2, "they turn round"
    standing = (found % 30 > 26.0) & (found % 30 < 29.5)
    assert not standing.any()


def test_a_sample_is_the_same_whenever_it_is_made() -> None:
    whole, part = Back(person=7).measure(np.arange(900)), Back(person=7).measure(np.arange(500, 700))
    for name, values in part.items():
        np.testing.assert_allclose(values, whole[name][500:700], atol=1e-9)
    model = SimulatedMti(site="lower_back", manner="shuffling", seed=5).brain()
    assert isinstance(model, MtiModel) and model.packets(0, 3)


def test_the_shipped_model_is_what_its_script_makes() -> None:
    """Of the same steps; the forest itself may differ with scikit-learn's version."""
    model = StepModel.read(SHIPPED)
    assert model.classes == sorted(MANNERS) and model.header["subjects"] == 24
    assert model.header["verdict"] == "better than guessing" and model.header["accuracy"]["subject_wise"] > 0.9
    assert SHIPPED.stat().st_size < 50_000


@pytest.mark.parametrize("manner", MANNERS)
def test_people_it_has_never_seen_are_told_by_their_manner(manner: str) -> None:
    finder, who = Steps(), StepClassifier()
    spec, time, data = walk(manner, 150)
    made = finder.open({"in": spec})
    steps = finder.process("in", Chunk(time, data, int(time[-1])))
    who.open({"in": made["steps"]})
    rows = who.process("in", steps).data
    assert str(rows["decided"][-1]) == manner and rows["share"][-1] > 0.9
    assert rows["settles"][-1] <= rows["steps"][-1]


@pytest.mark.nightly
def test_the_graph_runs_as_it_stands_and_says_what_it_sees(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kinegraph("run", CONFIG, "--for", "14", "--view", "lines", "-o", tmp_path / "w", "--set", "walk.screen.every=5")
    shown = capsys.readouterr().out
    assert "brisk: " in shown and "steps, " in shown
    with Recording.open(tmp_path / "w") as recording:
        _, steps = recording.read("walk.steps.steps")
        _, who = recording.read("walk.who.judgement")
    assert (steps["kind"] == "walk").sum() >= 8 and str(who["decided"][-1]) == "brisk"


def test_it_runs_on_a_phones_recording_with_bursts_and_a_gap(tmp_path: Path) -> None:
    """Stamps of 102 Hz, eight percent of them equal, one gap of 188 ms: a phone's."""
    _, time, data = walk("shuffling", 160)
    rng = np.random.default_rng(3)
    late = np.sort(time + rng.integers(0, 30_000_000, len(time)))
    late[1:][rng.random(len(late) - 1) < 0.08] = 0
    late = np.maximum.accumulate(late)
    keep = np.ones(len(late), bool)
    keep[900:918] = False
    phone = StreamSpec((6,), channels=CHANNELS, units=UNITS)
    write_recording(tmp_path / "phone.mcap", [Series("walker.imu", phone, late[keep], data[keep])], {})
    kinegraph("replay", CONFIG, tmp_path / "phone.mcap", "-o", tmp_path / "again", "--quiet")
    with Recording.open(tmp_path / "again") as recording:
        _, steps = recording.read("walk.steps.steps")
        _, who = recording.read("walk.who.judgement")
    true = Back("shuffling", 160).steps(0, 3000)
    assert abs(len(steps) - len(true)) <= 4 and str(who["decided"][-1]) == "shuffling"


def test_the_panel_says_uncertain_until_the_vote_is_decided() -> None:
    finder, who, screen = Steps(), StepClassifier(), StepPanel()
    spec, time, data = walk("brisk", 150, 20)
    made = finder.open({"in": spec})["steps"]
    judged = who.open({"in": made})["judgement"]
    screen.open({"steps": made, "judgement": judged})
    steps = finder.process("in", Chunk(time, data, int(time[-1])))
    rows = who.process("in", steps)
    screen.process("steps", steps)
    texts = []
    for k in (0, len(rows) - 1):
        screen.process("judgement", Chunk(rows.time[k : k + 1], rows.data[k : k + 1], int(rows.time[k])))
        console = Console(width=120, file=io.StringIO(), record=True)
        console.print(panel(screen.state))
        texts.append(console.export_text())
    assert "uncertain" in texts[0] and "would settle after" in texts[0]
    assert "brisk: " in texts[1] and "uncertain" not in texts[1] and "never seen" in texts[1]
