"""The electrode check: every fault of a channel is named with what to do, and the exit code says whether all are good."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from kinegraph.operators.emg.commands.electrode_check import check_electrodes
from kinegraph.stream.chunk import FOREVER, Chunk, StreamSpec
from kinegraph.stream.errors import InputError
from kinegraph.stream.graph import RecordingOptions
from kinegraph.stream.recording import Recorder
from tests.support.command_line import Command
from tests.support.emg_run import stamps

NAMES = ("TA", "SO", "GM")
SPEC = StreamSpec((3,), rate_hz=1000.0, channels=NAMES, units=("uV",))


def measured(fault="", seed=4):
    """Five seconds of rest at 2 uV, then each muscle contracted for three; the soleus has a fault."""
    rng = np.random.default_rng(seed)
    level = np.full((14000, 3), 2.0)
    for k in range(3):
        level[5000 + 3000 * k : 8000 + 3000 * k, k] = 100.0
    x = rng.standard_normal((14000, 3)) * level
    t = np.arange(14000) / 1000
    match fault:
        case "flat line":
            x[:, 1] = 0.0
        case "mains hum":
            x[:, 1] += 80 * np.sin(2 * np.pi * 50 * t)
        case "baseline noise":
            x[:, 1] += 20 * rng.standard_normal(14000)
        case "no contraction":
            x[:, 1] = 2 * rng.standard_normal(14000)
        case "crosstalk":
            x[:, 1] += 0.8 * x[:, 0]
        case "same signal":
            x[:, 1] = x[:, 0]
    return x


def judged(fault):
    return {e.name: e for e in check_electrodes(SPEC, stamps(14000), measured(fault), (0, 5), (5, 14))}


def test_good_electrodes_are_good():
    assert [(e.flag, e.reason) for e in judged("").values()] == [("good", "")] * 3


@pytest.mark.parametrize(
    ("fault", "flag", "others"),
    [
        ("flat line", "bad", 0),
        ("mains hum", "bad", 0),
        ("baseline noise", "doubtful", 0),
        ("no contraction", "bad", 0),
        ("crosstalk", "doubtful", 1),
        ("same signal", "bad", 1),
    ],
)
def test_a_fault_is_named_with_what_to_do(fault, flag, others):
    found = judged(fault)
    assert (found["SO"].flag, found["SO"].reason) == (flag, fault) and found["SO"].advice
    assert sum(e.flag != "good" for e in found.values()) == 1 + others, found


def in_turn(muscles, held_s):
    """Three seconds of rest, then each of so many muscles contracted for `held_s`, with a second between them."""
    names = tuple(f"M{k}" for k in range(muscles))
    spec = StreamSpec((muscles,), rate_hz=1000.0, channels=names, units=("uV",))
    level = np.full((3000 + round(1000 * (held_s + 1)) * muscles, muscles), 4.0)
    for k in range(muscles):
        begin = 3000 + round(1000 * (held_s + 1)) * k
        level[begin : begin + round(1000 * held_s), k] = 340.0
    return spec, np.random.default_rng(2).standard_normal(level.shape) * level


@pytest.mark.parametrize("held_s", [0.6, 3.0])
def test_muscles_contracted_one_after_another_are_good_however_many_they_are(held_s):
    spec, x = in_turn(16, held_s)
    found = check_electrodes(spec, stamps(len(x)), x, (0, 3), (3, len(x) / 1000))
    assert [(e.flag, e.reason) for e in found] == [("good", "")] * 16
    assert [e.contraction for e in found] == pytest.approx([340.0] * 16, rel=0.2)


def test_a_knock_on_a_cable_is_no_contraction():
    x = measured("no contraction")
    x[9000:9150, 1] += 300 * np.sin(np.arange(150) / 4)  # 40 Hz for 150 ms
    found = {e.name: e for e in check_electrodes(SPEC, stamps(14000), x, (0, 5), (5, 14))}
    assert found["SO"].reason == "no contraction"


def test_a_stage_that_is_not_there_is_refused():
    with pytest.raises(InputError, match="of contraction"):
        check_electrodes(SPEC, stamps(5000), measured()[:5000], (0, 5), (5, 14))


@pytest.mark.parametrize(("fault", "code"), [("", 0), ("mains hum", 1)])
def test_a_recording(kinegraph: Command, tmp_path: Path, fault: str, code: int) -> None:
    with Recorder(tmp_path / "r.mcap", {}, RecordingOptions(), wait=True) as recorder:
        number = recorder.add_stream("board.emg", SPEC, "input")
        recorder.write(number, Chunk(stamps(14000), measured(fault), FOREVER), int(stamps(14000)[-1]), 0)
    result = kinegraph("emg", "check-electrodes", "r.mcap", "--contraction", "5-14")
    assert result[0] == code and "what to do" in result[1]
    electrodes = json.loads(kinegraph("emg", "check-electrodes", "r.mcap", "--contraction", "5-14", "--json")[1])
    assert [e["name"] for e in electrodes["electrodes"] if e["flag"] != "good"] == ["SO"] * code
    assert not fault or "SO mains hum" in result[2]


@pytest.mark.parametrize(("faults", "code"), [("[]", 0), ("[{kind: hum, muscle: SO}]", 1)])
def test_a_simulated_session(kinegraph: Command, tmp_path: Path, faults: str, code: int) -> None:
    (tmp_path / "g.yaml").write_text(
        "nodes:\n  board: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 16, faults: "
        + faults
        + "}\n"
    )
    result = kinegraph("emg", "check-electrodes", "g.yaml")
    assert result[0] == code, result
    assert code == 0 or "1 of 13 electrodes need a look: SO mains hum" in result[2]


def test_words_that_are_no_times(kinegraph: Command) -> None:
    assert "such as 0-5" in kinegraph("emg", "check-electrodes", "x.mcap", "--rest", "now")[2]
