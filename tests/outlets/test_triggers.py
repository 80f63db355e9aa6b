"""Start and stop by trigger: pulses in (a TTL channel, markers) open and end a session; pulses out start and stop other devices."""

from __future__ import annotations

import os
import pty
import select
import socket
import threading
import tty
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import serial

from kinegraph.devices.lsl.network import library
from kinegraph.devices.outlets.session_end import SessionEnd
from kinegraph.devices.outlets.trigger.outlet import TriggerOutlet
from kinegraph.operators.cycles.cycles import Cycles
from kinegraph.operators.emg.envelope import Envelope
from kinegraph.operators.filters.threshold import Threshold
from kinegraph.operators.timing.gate import Gate
from kinegraph.stream.chunk import NS, Chunk, StreamSpec
from kinegraph.stream.engine.session import Session
from kinegraph.stream.errors import DeviceError, InputError, KinegraphError, ParameterError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.emg_run import contacts, drive, stamps

ONSET = np.dtype([("onset", "<i8")])
MARK = np.dtype([("onset", "<i8"), ("text", "<U16")])
EVENTS = StreamSpec((), ONSET, units=("ns",))


def marks(*reported: tuple[float, str]) -> tuple[StreamSpec, Any, Any]:
    times = np.array([round(s * NS) for s, _ in reported])
    rows = np.array([(t, text) for t, (_, text) in zip(times.tolist(), reported, strict=True)], MARK)
    return StreamSpec((), MARK, units=("ns", "")), times, rows


def test_a_ttl_pulse_starts_and_ends_what_is_measured() -> None:
    n = 20_000
    time, rng = stamps(n), np.random.default_rng(1)
    ttl = np.zeros((n, 1))
    ttl[4000:4010] = ttl[15_300:15_310] = 5.0
    pulses = drive(Threshold(level=2.5), {"in": (StreamSpec((1,), rate_hz=1000.0, units=("V",)), time, ttl)})["onset"]
    assert pulses[2]["onset"].tolist() == [time[4000], time[15_300]]
    emg = (StreamSpec((1,), rate_hz=1000.0, channels=("TA",), units=("uV",)), time, rng.normal(0, 50, (n, 1)))
    touch = contacts(np.arange(0.5, 20, 1.1))
    gated = {
        port: drive(Gate(), {"pulses": pulses, "in": given})["out"] for port, given in (("emg", emg), ("touch", touch))
    }
    assert gated["emg"][1].tolist() == time[4000:15_300].tolist() and (gated["emg"][2] == emg[2][4000:15_300]).all()
    signal = drive(Envelope(), {"in": gated["emg"]})["out"]
    closed = drive(Cycles(), {"signal": signal, "touchdown": gated["touch"]})["closed"][2]
    inside = touch[1][(touch[1] >= time[4000]) & (touch[1] < time[15_300])]
    assert closed["onset"].tolist() == inside[:-1].tolist() and len(inside) > 8


@pytest.mark.parametrize(("tail_s", "expected"), [(0.0, 8), (0.4, 9)])
def test_a_cycle_that_ends_just_before_the_closing_pulse_is_told_where_the_gate_has_a_tail(
    tail_s: float, expected: int
) -> None:
    """The pulse comes 20 ms after a touch-down, which is reported another 10 ms later; what began after it is not reported."""
    n, touch = 20_000, contacts(np.arange(0.5, 20, 1.1))
    time = stamps(n)
    close = int(touch[1][13]) + NS // 50
    pulses = (EVENTS, np.array([time[4000], close]), np.array([(time[4000],), (close,)], ONSET))
    spec, when, rows = touch
    late = (spec, when + 30_000_000, rows)
    emg = (StreamSpec((1,), rate_hz=1000.0, units=("uV",)), time, np.random.default_rng(1).normal(0, 50, (n, 1)))
    gated = {
        port: drive(Gate(tail_s=tail_s), {"pulses": pulses, "in": given})["out"]
        for port, given in (("emg", emg), ("touch", late))
    }
    assert close + (tail_s - 0.001) * NS <= gated["emg"][1][-1] < close + tail_s * NS
    closed = drive(Cycles(), {"signal": drive(Envelope(), {"in": gated["emg"]})["out"], "touchdown": gated["touch"]})[
        "closed"
    ][2]
    inside = when[(when >= time[4000]) & (when < close)]
    assert len(inside) == 10 and closed["onset"].tolist() == inside[:expected].tolist()
    assert closed["rejected"].tolist() == [""] * expected


def test_markers_open_and_close_by_their_text_and_what_was_kept_back_is_lost() -> None:
    pulses = marks((0.5, "hello"), (1, "go"), (1.5, "go"), (2, "end"), (3, "go"))
    time = stamps(400, 100.0)
    spec = StreamSpec((1,), rate_hz=100.0)
    gate = Gate("go", "end")
    found = drive(gate, {"pulses": pulses, "in": (spec, time, np.arange(400.0)[:, None])})["out"]
    assert found[2][:, 0].tolist() == [*range(100, 200), *range(300, 400)]
    one = Gate("go", "end")
    one.open({"pulses": pulses[0], "in": spec})
    lost = []
    for port, chunk in (
        ("in", Chunk(time[:5], np.zeros((5, 1)), int(time[4]))),
        ("pulses", Chunk(pulses[1][1:2], pulses[2][1:2], int(pulses[1][1]))),
        ("in", Chunk(time[101:110], np.zeros((9, 1)), int(time[109]))),
        ("pulses", Chunk(pulses[1][3:4], pulses[2][3:4], int(pulses[1][3]))),
        ("in", Chunk(time[201:210], np.zeros((9, 1)), int(time[209]))),
        ("pulses", Chunk(pulses[1][4:5], pulses[2][4:5], int(pulses[1][4]))),
        ("in", Chunk(time[301:310], np.zeros((9, 1)), int(time[309]))),
    ):
        out = one.process(port, chunk)
        lost += [out.lost] * bool(len(out))
    assert lost == [0, 9]
    with pytest.raises(ParameterError, match="start"):
        Gate("go").open({"pulses": EVENTS, "in": spec})
    with pytest.raises(InputError, match="Threshold"):
        Gate().open({"pulses": spec, "in": spec})


class Lines(type(serial.serial_for_url("loop://", do_not_open=True))):  # type: ignore[misc]
    """A serial port that writes down what its control lines do."""

    def __init__(self) -> None:
        self.seen: list[tuple[str, bool]] = []
        super().__init__()
        self.port = "loop://"

    def _update_rts_state(self) -> None:
        self.seen.append(("rts", self._rts_state))
        super()._update_rts_state()

    def _update_dtr_state(self) -> None:
        self.seen.append(("dtr", self._dtr_state))
        super()._update_dtr_state()


@pytest.mark.parametrize("line", ["rts", "dtr"])
def test_a_serial_ports_line_goes_up_and_down_once_per_event(line: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    lines = Lines()
    monkeypatch.setattr(serial, "serial_for_url", lambda url, do_not_open: lines)
    outlet = TriggerOutlet(when="events", serial_port="loop://", line=line, pulse_ms=1)
    outlet.open({"in": EVENTS})
    outlet.begin()
    outlet.process("in", Chunk(stamps(3), np.zeros(3, ONSET), NS))
    outlet.close()
    ups = [up for name, up in lines.seen if name == line]
    assert ups[-6:] == [True, False] * 3 and not any(ups[:-6]), "at rest when it opens, then three pulses"
    assert not any(up for name, up in lines.seen if name != line)
    assert not lines.is_open


def test_start_and_stop_go_out_by_osc_and_lsl() -> None:
    lsl = library()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60)
        outlet = TriggerOutlet(lsl="trigger test", osc=f"127.0.0.1:{receiver.getsockname()[1]}")
        outlet.open({"in": StreamSpec((1,), rate_hz=100.0)})
        outlet.begin()
        inlet = lsl.StreamInlet(lsl.resolve_byprop("name", "trigger test", 1, 60.0)[0])
        inlet.open_stream(60.0)
        with ThreadPoolExecutor(1) as listener:
            heard = listener.submit(lambda: inlet.pull_chunk(30.0, 2)[0])
            for first in (0, 10):
                outlet.process("in", Chunk(stamps(20, 100.0)[first : first + 10], np.zeros((10, 1)), NS))
            outlet.close()
            texts = [str(row[0]) for row in heard.result()]
        rows = [receiver.recv(1024) for _ in range(2)]
        inlet.close_stream()
    assert texts == ["start", "stop"]
    assert [b"/kinegraph/trigger" in data for data in rows] == [True, True]
    assert [data[-4:] for data in rows] == [np.array(v, ">f4").tobytes() for v in (1.0, 0.0)]


def test_what_cannot_give_a_pulse_is_refused_when_the_graph_is_opened() -> None:
    signal = StreamSpec((1,), rate_hz=100.0)
    for outlet, spec, reported in (
        (TriggerOutlet(), signal, "way out"),
        (TriggerOutlet(osc="nowhere"), signal, "HOST:PORT"),
        (TriggerOutlet(osc="a:1", osc_address="x"), signal, "OSC address"),
        (TriggerOutlet(osc="a:1", when="events"), signal, "events"),
        (SessionEnd(), signal, "events"),
        (SessionEnd(text="stop"), EVENTS, "text"),
    ):
        with pytest.raises(KinegraphError, match=reported):
            outlet.open({"in": spec})
    missing = TriggerOutlet(serial_port="/dev/there-is-none")
    missing.open({"in": signal})
    with pytest.raises(DeviceError, match="there-is-none"):
        missing.begin()


def box_reads(master: int, until: threading.Event) -> bytes:
    """What a trigger box at the other end of a pseudo-terminal was sent, with the moments left out."""
    heard = b""
    while not until.is_set() or select.select([master], [], [], 0.2)[0]:
        if select.select([master], [], [], 0.05)[0]:
            heard += os.read(master, 100)
    return heard


def test_a_session_is_started_and_ended_by_a_trigger_box_and_starts_and_ends_another_by_pseudo_terminals(
    tmp_path: Path,
) -> None:
    """Both boxes are at the far ends of terminals that the system makes: one prints its TTL line, one takes bytes."""
    ours, theirs = zip(pty.openpty(), pty.openpty(), strict=True)
    for end in theirs:
        tty.setraw(end)
    over = threading.Event()

    def box_prints() -> None:
        """The line is up for 40 ms at 2 s and at 5 s after the session has opened the port, and printed 50 times a second."""
        select.select([ours[0]], [], [], 60.0)  # "b": the session is there
        for k in range(100_000):
            if over.wait(0.02):
                return
            os.write(ours[0], b"1\n" if k % 1000 in (100, 101, 250, 251) else b"0\n")

    graph = BOXES.format(*(os.ttyname(end) for end in theirs))
    with ThreadPoolExecutor(2) as boxes:
        boxes.submit(box_prints)
        taken = boxes.submit(box_reads, ours[1], over)
        try:
            outcome = Session(load_text(graph), tmp_path / "w", duration_s=60.0).run()
        finally:
            over.set()
        sent = taken.result()
    for end in (*ours, *theirs):
        os.close(end)
    assert outcome.error is None and outcome.exit_code == 0
    assert sent == bytes([5, 0, 6, 0]), "the start's byte, rest, the end's byte, rest"
    with Recording.open(tmp_path / "w") as recording:
        at, pulses = recording.read("pulses.onset")
        time, _ = recording.read("measured")
        ended = int(recording.read("treadmill.emg")[0][-1])
    assert len(pulses) == 2 and 2.5 * NS < at[1] - at[0] < 4 * NS
    assert at[0] <= time[0] <= at[0] + NS // 100 and at[1] + 0.49 * NS <= time[-1] < at[1] + 0.5 * NS
    assert ended < at[1] + 3 * NS, "the second pulse ended the session, not its 60 s"


BOXES = """
nodes:
  treadmill: {{use: devices.people.treadmill.Treadmill, muscles: [TA]}}
  box: {{use: devices.lines.AsciiLines, port: {0}, columns: [ttl], start: b}}
  pulses: {{use: operators.filters.threshold.Threshold, from: box.out, level: 0.5}}
  measured: {{use: operators.timing.gate.Gate, from: {{pulses: pulses.onset, in: treadmill.emg}}, tail_s: 0.5}}
  recorder: {{use: devices.outlets.trigger.TriggerOutlet, from: measured, serial_port: {1}, line: byte, codes: [5, 6]}}
  end: {{use: devices.outlets.session_end.SessionEnd, from: pulses.onset, after_s: 0.6}}
record: [pulses.onset, measured]
"""
GRAPH = """
nodes:
  treadmill: {use: devices.people.treadmill.Treadmill, muscles: [TA]}
  pulses: {use: operators.filters.threshold.Threshold, from: treadmill.force, level: 100, release: 50}
  measured: {use: operators.timing.gate.Gate, from: {pulses: pulses.onset, in: treadmill.emg}, tail_s: TAIL}
  out: {use: devices.outlets.trigger.TriggerOutlet, from: measured, osc: "127.0.0.1:PORT"}
  end: {use: devices.outlets.session_end.SessionEnd, from: pulses.onset, after_s: AFTER}
record: [pulses.onset, measured]
"""


@pytest.mark.parametrize("tail_s", [0.0, 0.3])
def test_a_live_session_begins_and_ends_with_pulses(tail_s: float, tmp_path: Path) -> None:
    """Nothing else ends it: without the second pulse it would run until the test is given up."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(60)
        graph = (
            GRAPH.replace("PORT", str(receiver.getsockname()[1]))
            .replace("TAIL", str(tail_s))
            .replace("AFTER", str(1.5 * tail_s))
        )
        session = Session(load_text(graph), tmp_path / "w")
        outcome = session.run()
        rows = [receiver.recv(1024)[-4:] for _ in range(2)]
    assert outcome.error is None and outcome.exit_code == 0
    assert rows == [np.array(v, ">f4").tobytes() for v in (1.0, 0.0)]
    with Recording.open(tmp_path / "w") as recording:
        at, pulses = recording.read("pulses.onset")
        time, _ = recording.read("measured")
    assert len(pulses) >= 2 and at[0] <= time[0] <= at[0] + NS // 100
    assert at[1] + tail_s * NS - (NS // 500 if tail_s else NS) <= time[-1] < at[1] + tail_s * NS
