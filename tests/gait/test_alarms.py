"""What a session notices while somebody can still do something about it: electrodes and contacts with faults put in."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.outlets.terminal.alarms import Alarms
from kinegraph.devices.people.treadmill import Treadmill
from kinegraph.devices.people.treadmill.faults import Fault, Faults
from kinegraph.devices.reports.session.contents.tally import add_chunk, nothing_yet
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.emg.quality import SignalQuality
from kinegraph.operators.monitors.cycle_watch import CycleWatch
from kinegraph.operators.monitors.electrode_watch import ADVICE, ElectrodeWatch
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.domain.alarm import ALARM, ALARM_UNITS, ON, OVER
from tests.support.emg_run import contacts, drive, stamps

CONFIG = Path(__file__).resolve().parents[2] / "configs" / "treadmill_emg.yaml"
SECONDS, FROM_S, FOR_S = 30, 10.35, 10.0


def walked(fault: Fault) -> tuple[StreamSpec, Any, Any]:
    muscles = ("TA", "SO", "RF")
    signal = Treadmill(muscles=muscles).signal()
    signal.spoil = Faults((fault,), signal).spoil
    emg, _ = signal.read(0, SECONDS * 1000)
    return StreamSpec((3,), rate_hz=1000.0, channels=muscles, units=("uV",)), stamps(len(emg)), emg


@pytest.mark.parametrize(
    ("kind", "size_uv", "reasons"),
    [
        ("flat", 200.0, {"flat line"}),
        ("hum", 100.0, {"mains hum"}),
        ("hum", 50.0, {"mains hum", "baseline noise"}),
        ("noise", 60.0, {"baseline noise"}),
    ],
)
@pytest.mark.parametrize("muscle", ["TA", "SO"])
def test_an_electrode_that_fails_is_an_alarm_within_two_seconds(
    kind: Any, size_uv: float, reasons: set[str], muscle: str
) -> None:
    fault = Fault(kind, muscle, from_s=FROM_S, for_s=FOR_S, size_uv=size_uv)
    quality = drive(SignalQuality(), {"in": walked(fault)}, 100)["out"]
    _, time, rows = drive(ElectrodeWatch(), {"in": quality}, 7)["out"]
    assert set(rows["subject"]) == {muscle}
    on, over = rows[0], rows[-1]
    assert 0 < time[0] / NS - FROM_S <= 2.0
    assert on["state"] == "on" and on["what"] in reasons and on["advice"] == ADVICE[str(on["what"])]
    assert over["state"] == "over" and 0 < time[-1] / NS - FROM_S - FOR_S <= 3.0


def test_a_sound_walk_gives_no_alarm() -> None:
    quality = drive(SignalQuality(), {"in": walked(Fault("flat", "TA", from_s=1e6))}, 100)["out"]
    assert not len(drive(ElectrodeWatch(), {"in": quality})["out"][1])


def watched(touch: Any, seconds: float = 80.0) -> list[tuple[float, str, str]]:
    spec = StreamSpec((1,), rate_hz=60.0, channels=("TA",), units=("uV",))
    time = stamps(int(seconds * 60), 60.0)
    signal = (spec, time, np.ones((len(time), 1)))
    closed = drive(Cycles(), {"signal": signal, "touchdown": contacts(touch)}, 40)["closed"]
    _, at, rows = drive(CycleWatch(), {"signal": signal, "closed": closed}, 40)["out"]
    return [(t / NS, str(row["state"]), str(row["what"])) for t, row in zip(at.tolist(), rows, strict=True)]


def test_contacts_that_fall_silent_are_an_alarm_after_two_cycles_and_come_back() -> None:
    touch = np.arange(1.0, 79.0, 1.05)
    alarms = watched(touch[(touch < 40.0) | (touch > 47.0)])
    last = touch[touch < 40.0][-1]
    assert [state for _, state, _ in alarms] == ["on", "over"]
    assert alarms[0][0] == pytest.approx(last + 2 * 1.05, abs=0.05) and alarms[0][2] == "no contact for 2.1 s"
    assert 47.0 < alarms[1][0] < 50.0


def test_contacts_that_never_come_are_an_alarm() -> None:
    assert watched(np.array([70.0]))[0] == (10.0, "on", "no contact for 10.0 s")


def test_every_second_step_missed_is_told_at_the_second_long_cycle() -> None:
    touch = np.arange(1.0, 79.0, 1.05)
    alarms = watched(np.concatenate([touch[:30], touch[30::2]]))
    cadence = [(at, what) for at, state, what in alarms if "cadence" in what and state == "on"]
    assert cadence[0][1] == "cadence went from 57 to 29 strides/min"
    assert cadence[0][0] - touch[30] < 5 * 1.05
    assert ("on", "cadence") not in [(state, what) for _, state, what in alarms]


def test_contacts_found_early_and_late_are_told_and_another_speed_is_not() -> None:
    late = np.cumsum(np.full(60, 1.0)) + np.where(np.arange(60) > 30, np.random.default_rng(3).normal(0, 0.1, 60), 0)
    alarms = [(at, state) for at, state, what in watched(late, 62.0) if what.startswith("cycles differ by")]
    assert [state for _, state in alarms] == ["on"] and 31 < alarms[0][0] < 45
    speeds = np.cumsum(np.where(np.arange(60) < 20, 1.3, np.where(np.arange(60) < 40, 1.05, 0.9)))
    tremble = np.random.default_rng(4).normal(0, 0.02, 60)
    assert watched(speeds + tremble, float(speeds[-1]) + 1) == []


def test_cycles_that_cover_little_of_the_session_are_told() -> None:
    rng = np.random.default_rng(0)
    touch = np.arange(1.0, 79.0, 1.05)
    alarms = watched(touch[rng.random(len(touch)) < 0.5])
    assert any(state == "on" and what.startswith("cycles cover") for _, state, what in alarms)
    assert not watched(touch)


def test_the_session_says_it_on_the_screen_in_the_log_and_in_the_report(tmp_path: Path) -> None:
    faults = "[{kind: flat, muscle: SO, from_s: 6, for_s: 8}]"
    sets = ["treadmill.realtime=false", "treadmill.duration_s=18", f"report.path={tmp_path / 'live.html'}"]
    sets += [f"treadmill.faults={faults}"]
    command = [Path(sys.executable).parent / "kinegraph", "run", CONFIG, "-o", tmp_path / "walk", "--view", "lines"]
    for setting in sets:
        command += ["--set", setting]
    done = subprocess.run(command, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    assert f"ALARM SO: flat line. {ADVICE['flat line']}" in done.stdout
    assert "over: SO: flat line" in done.stdout
    assert "alarm" in done.stderr + done.stdout and "flat line" in done.stderr + done.stdout
    page = (tmp_path / "live.html").read_text()
    assert "Noticed during the session" in page and "<td>SO</td><td>flat line</td>" in page


def test_two_inputs_may_have_an_alarm_about_the_same_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    """The end of the one is not the end of the other, on the screen and in the report."""
    rows = [
        ("contacts", ON, "no contact for 2.1 s"),
        ("timing", ON, "contacts 2.0 % of the cycle later than at first"),
        ("contacts", OVER, "no contact"),
    ]
    events = [
        (port, Chunk(np.array([k * NS]), np.array([(k * NS, "contacts", state, what, "look")], ALARM), k * NS))
        for k, (port, state, what) in enumerate(rows, 1)
    ]
    spec = StreamSpec((), ALARM, units=ALARM_UNITS)
    screen = Alarms()
    screen.open({"contacts": spec, "timing": spec})
    specs = {"cycles": StreamSpec((100, 1)), "contacts": spec, "timing": spec}
    tally = nothing_yet(specs)
    for port, chunk in events:
        screen.process(port, chunk)
        add_chunk(tally, specs, port, chunk)
    assert "over: contacts: no contact" in capsys.readouterr().out
    assert screen.state.what == ["contacts 2.0 % of the cycle later than at first"]
    assert [(str(row["what"])[:10], int(row["over"])) for row in tally.alarms[:2]] == [
        ("no contact", 3 * NS),
        ("contacts 2", 0),
    ]
