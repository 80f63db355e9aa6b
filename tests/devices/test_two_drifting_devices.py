"""Two devices that drift apart; one starts its clock again and loses its cable three times. Every stamp is true, or in a marked gap."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.lines.indexed_simulator import Indexed, IndexedModel
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.cli.commands.info import clocks
from kinegraph.stream.engine.session import Session
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command

WITHIN_S = 0.010
BOARD, LEG = Indexed(rate_hz=250, drift_ppm=80), Indexed(rate_hz=200, drift_ppm=-60)
LOST = FaultInjection(unplug_every_s=3.5, unplug_s=0.8, jump_every_s=5.0, jump_s=-5.0)
"""The cable is out at 3.5, 7 and 10.5 s; at 5 and 10 s the clock starts again at 0."""
SECONDS = 12.5


class Timed(IndexedModel):
    """The same, and when (Unix time, ns) it was switched on."""

    began = 0

    def say(self, seconds: float) -> list[bytes]:
        self.began = self.began or time.time_ns() - round(seconds * NS)
        return super().say(seconds)


def node(name: str, address: str, of: Indexed) -> str:
    """A line is sent when the next sample is made: that is the constant delay."""
    return (
        f"  {name}: {{use: devices.lines.AsciiLines, port: {address}, columns: [index, t, n], time: t, "
        f"rate_hz: {of.rate_hz:g}, latency_s: {1 / of.rate_hz}, silence_s: 3}}\n"
    )


def lateness_s(recording: Recording, name: str, made: Samples, of: Indexed) -> float:
    """How late the computer was in the worst quarter of a second, by what came soonest in it: no clock can know of that."""
    arrival = recording.read(f"{name}.timing")[1]["arrival"] / NS
    late, quarter = arrival - made - 1 / of.rate_hz, (made * 4).astype(int)
    return float(max(late[quarter == q].min() for q in np.unique(quarter)))


@pytest.mark.nightly
def test_every_stamp_is_true_or_in_a_marked_gap_and_info_says_so(tmp_path: Path, kinegraph: Command) -> None:
    brains = {"board": Timed(BOARD), "leg": Timed(LEG)}
    with (
        Server(brains["board"], line_at(name="ttyBOARD"), GOOD) as board,
        Server(brains["leg"], line_at(name="ttyLEG"), LOST) as leg,
    ):
        graph = load_text("nodes:\n" + node("board", board.address, BOARD) + node("leg", leg.address, LEG))
        outcome = Session(graph, tmp_path / "s", duration_s=SECONDS).run()
    assert outcome.error is None
    with Recording.open(tmp_path / "s") as recording:
        for name, of in (("board", BOARD), ("leg", LEG)):
            stamp, data = recording.read(name)
            index = data[:, 0]
            made = brains[name].began / NS + index / of.rate_hz
            error = np.abs(stamp / NS - made)
            assert error.max() < WITHIN_S + lateness_s(recording, name, made, of), name
            missing = np.flatnonzero(np.diff(index) > 1)
            gaps = {int(chunk.time[0]) for chunk in recording.chunks(name) if chunk.lost and len(chunk)}
            assert {int(stamp[at + 1]) for at in missing} <= gaps, "whatever is missing is marked"
            assert len(missing) >= 3 if name == "leg" else not gaps
        log, known = list(recording.log), clocks(recording)
    assert sum(entry["kind"] == "source reopened" for entry in log) == 3
    assert [round(entry["jump_s"]) for entry in log if entry["kind"] == "device clock jumped"] == [-5, -5]
    assert known["leg"]["uncertainty_s"] < WITHIN_S and known["board"]["uncertainty_s"] < WITHIN_S
    _, shown, _ = kinegraph("info", str(tmp_path / "s"))
    assert "board and leg agree within" in shown and "device clock jumped" in shown and "source reopened" in shown
