"""All simulated devices misbehave at once, in one session: metrics and recording show it, and the rest of the graph goes on."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from kinegraph.devices.bitalino import simulator as bitalino
from kinegraph.devices.commands.simulate import simulate
from kinegraph.devices.cyton import simulator as cyton
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.lines import simulator as ascii_lines
from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.lsl.simulator import Lsl
from kinegraph.devices.mti import simulator as mti
from kinegraph.devices.oak import simulator as oak
from kinegraph.devices.shimmer import simulator as shimmer
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.devices.simulation.serve import Server
from kinegraph.devices.trigno import simulator as trigno
from kinegraph.devices.usb import simulated_reports as usb_reports
from kinegraph.stream.engine.session import Session
from kinegraph.stream.engine.status import Outcome, SessionView, Table
from kinegraph.stream.graph import Graph
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from kinegraph.stream.source import Source

WRONG = FaultInjection(
    lose=0.04, duplicate=0.04, corrupt=0.06, from_s=1.0, seed=1,
    stall_every_s=1.3, stall_s=0.4, reset_every_s=1.9, unplug_every_s=6.0, unplug_s=0.5,
)  # fmt: skip
AT_MOST_S = 240.0


@dataclass(frozen=True, slots=True)
class Device:
    """yaml: its node; shows: per faults, what its source counts (any of them), where it can be seen at all."""

    yaml: str
    shows: dict[str, tuple[str, ...]]


LOST = ("lost packet", "lost frame", "lost line", "lost sample")
BROKEN = (
    "resync",
    "bad line",
    "bad checksum",
    "bytes that are no frame",
    "bytes that are no packet",
    "impossible value",
)
TWICE = ("repeated packet", "repeated frame", "repeated frame or wrong time", "repeated line or wrong time")
ANEW = ("counter reset", "device restarted")
ALL = {"lose": LOST, "duplicate": TWICE, "corrupt": BROKEN, "reset": ANEW}
DEVICES = {
    "cyton": Device("use: devices.cyton.Cyton, port: ''", ALL),
    "ascii": Device(
        "use: devices.lines.AsciiLines, port: '', columns: [n, us, a], counter: n, time: us, rate_hz: 200", ALL
    ),
    "binary": Device(
        "use: devices.frames.Binary, port: '', frames: [{name: x, sync: A5 5A, rate_hz: 200, checksum: sum8, fields: "
        "[{type: u8, role: counter}, {type: u32, role: time, unit: us}, {name: a, type: i16}]}]",
        ALL,
    ),
    "mti": Device("use: devices.mti.Mti, port: ''", ALL),
    "mti_usb": Device("use: devices.mti.Mti, port: 'usb://2639'", ALL),
    # a duplicate breaks the sequence of four bits, which is all that tells frames; a counter that starts again looks like a loss.
    # Where no counter or time tells how much is lost, two fifths of a start's samples may be, which is no reason to end this session
    "bitalino": Device(
        "use: devices.bitalino.Bitalino, port: '', rate_hz: 100, rate_mismatch: warn, channels: [{input: A1}, {input: A2}]",
        {"lose": LOST, "corrupt": BROKEN},
    ),
    "shimmer": Device("use: devices.shimmer.Shimmer, port: '', rate_hz: 204.8", ALL),
    # nothing in its samples tells what is missing or there twice, but the time that they take
    "trigno": Device(
        "use: devices.trigno.Trigno, port: 'tcp://', rate_mismatch: warn, sensors: [{sensor: 1}, {sensor: 2}]",
        {"corrupt": BROKEN},
    ),
    # its reports have no checksum: of damage only what changes the id shows
    "dualsense": Device(
        "use: devices.usb.endpoint.Endpoint, port: 'usb://054c:0ce6', frames: [{name: imu, sync: '01', rate_hz: 250, fields: "
        "[{type: u24}, {type: u24}, {type: u8, role: counter}, {type: u64}, {name: gx, type: i16}, {name: gy, type: i16}, "
        "{type: u64}, {type: u32, role: time, unit: us, scale: 0.3333333333}]}]",
        {"lose": LOST, "duplicate": TWICE, "reset": ANEW},
    ),
    # what is sent twice hides for two seconds how much is lost, so each has a stream of its own
    "lsl": Device("use: devices.lsl.LslInlet, name: lsl, channels: [TA, GM], rate_hz: 200, unit: uV", {"lose": LOST}),
    "lsl_twice": Device(
        "use: devices.lsl.LslInlet, name: lsl_twice, channels: [TA, GM], rate_hz: 200, unit: uV",
        {"duplicate": ("stamp ran backwards",)},
    ),
    "oak": Device(
        "use: devices.oak.Oak, width: 64, height: 48, fps: 20, lost_after_s: 2, reconnect_s: 1",
        {"lose": LOST, "duplicate": TWICE},
    ),
}
if find_spec("depthai") is None:
    del DEVICES["oak"]
HEALTHY = """
  healthy: {use: devices.people.treadmill.Treadmill}
  envelope: {use: operators.emg.Envelope, from: healthy.emg}
"""


def graph() -> Graph:
    nodes = "".join(
        f"  {name}: {{{device.yaml}, stale_s: 0.25, patience_s: 0.5}}\n" for name, device in DEVICES.items()
    )
    return load_text(f"nodes:\n{nodes}{HEALTHY}record: [envelope]")


def plugged(name: str, source: Any) -> AbstractContextManager[Source]:
    """The source, reading a simulated device that misbehaves."""
    kinds: dict[str, Any] = {
        "cyton": cyton.SimulatedCyton(),
        "ascii": ascii_lines.SimulatedAsciiLines(("n", "us", "a"), rate_hz=200, time="us", counter="n"),
        "mti": mti.SimulatedMti(),
        "bitalino": bitalino.SimulatedBitalino(),
        "shimmer": shimmer.SimulatedShimmer(),
        "trigno": trigno.SimulatedTrigno(),
    }
    return _plugged(name, source, kinds.get(name))


@contextmanager
def _plugged(name: str, source: Any, device: Any) -> Iterator[Source]:
    wrong = replace(WRONG, seed=list(DEVICES).index(name))
    if name == "binary":
        with Server(BinaryModel(source), line_at(name="ttyBIN"), wrong) as server:
            yield replace(source, port=server.address)
    elif name == "mti_usb":
        with mti.SimulatedMti().on_usb(wrong) as address:
            yield replace(source, port=address)
    elif name == "dualsense":
        with usb_reports.serving(source, wrong) as address:
            yield replace(source, port=address)
    elif name.startswith("lsl"):
        wrong = replace(
            wrong, corrupt=0.0, **({"duplicate": 0.0} if name == "lsl" else {"lose": 0.0}), unplug_every_s=6.0
        )
        with Lsl(name, source_id=name, channels=("TA", "GM"), rate_hz=200).serving(wrong):
            yield source
    elif name == "oak":
        with oak.OakSimulator(width=64, height=48, fps=20).plugged_in(wrong) as camera:
            yield oak.SimulatedOak.of(source, camera)
    else:
        with device.serving(wrong) as address:
            yield replace(source, port=address)


class Watching(SessionView):
    """A view that ends the session when all has shown that can, and every source that was opened again has samples from then on."""

    def __init__(self) -> None:
        self.session: Session | None = None
        self.table: Table = {}
        self._before: dict[str, int] = {}
        """By source opened again: its samples when that was first seen."""

    def update(self, table: Table) -> None:
        self.table = table
        if not missing(table) and not self._away(table):
            assert self.session
            self.session.stop()

    def _away(self, table: Table) -> bool:
        again = {name: row(table, name) for name in DEVICES if row(table, name).get("openings", 0) > 1}
        return any(facts["samples"] <= self._before.setdefault(name, facts["samples"]) for name, facts in again.items())


def row(table: Table, name: str) -> dict[str, Any]:
    """A source's first output, which has its counts."""
    return next((facts for stream, facts in table.items() if stream.startswith(f"{name}.") or stream == name), {})


def missing(table: Table) -> list[str]:
    """What has not shown in the metrics yet."""
    found = []
    for name, device in DEVICES.items():
        facts = row(table, name)
        problems = facts.get("problems", {})
        found += [f"{name}: {kind}" for kind, shown in device.shows.items() if not any(problems.get(k) for k in shown)]
        if facts.get("openings", 0) < 2 and not problems.get("reconnected") and not problems.get("connection lost"):
            found.append(f"{name}: unplug")
    return found


@pytest.mark.timeout(400)
@pytest.mark.nightly
def test_all_devices_misbehave_at_once_and_the_rest_goes_on(tmp_path: Path) -> None:
    made, view = graph(), Watching()
    with ExitStack() as cables:
        for name in DEVICES:
            made.nodes[name].part = cables.enter_context(plugged(name, made.nodes[name].part))
        view.session = Session(made, tmp_path / "s", duration_s=AT_MOST_S, view=view)
        outcome: Outcome = view.session.run()
    assert outcome.error is None
    assert missing(view.table) == [], "in the metrics"

    with Recording.open(tmp_path / "s") as recording:
        log = Counter(
            (entry["kind"], entry.get("node") or str(entry.get("stream", "")).partition(".")[0])
            for entry in recording.log
        )
        *_, last = recording.metrics()
        gaps = {
            name: sum(s.gaps for stream, s in recording.streams.items() if stream.partition(".")[0] == name)
            for name in DEVICES
        }
        healthy, envelope = recording.streams["healthy.emg"], recording.streams["envelope"]
    assert missing(last["table"]) == [], "in the recorded metrics"
    for name in DEVICES:
        assert gaps[name] > 0, f"{name}: gaps in the recording"
        assert log["stream is stale", name] > 0, f"{name}: a stall in the recording"
        if row(last["table"], name)["openings"] > 1:
            assert log["source failed", name] > 0 and log["source reopened", name] > 0
            assert log["device", name] > 1 or name in ("ascii", "binary")
    assert healthy.gaps == envelope.gaps == 0 and healthy.samples > 3000 and envelope.samples > 300


def test_the_command_names_every_fault() -> None:
    reported = simulate.__doc__ or ""
    assert [name for name in FaultInjection.__dataclass_fields__ if f"{name}=" not in reported] == []


def test_a_cable_that_is_out_can_be_pulled_once_more() -> None:
    """A busy soak pulled it again before it was put in, and waited for ever."""
    with Server(Indexed(rate_hz=200).brain(), line_at("", Indexed.port_name)) as server:
        server.unplug()
        again = threading.Thread(target=server.unplug, daemon=True)
        again.start()
        again.join(20.0)
        assert not again.is_alive()
