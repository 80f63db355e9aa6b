"""Simulated devices that send as declared give no finding: there are no false alarms."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from kinegraph.devices.bitalino.simulator import SimulatedBitalino
from kinegraph.devices.cyton.simulator import SimulatedCyton
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.lines.simulator import SimulatedAsciiLines
from kinegraph.devices.mti.simulator import SimulatedMti
from kinegraph.devices.shimmer.simulator import SimulatedShimmer
from kinegraph.stream.chunk import Chunk
from kinegraph.stream.domain.claims import ClaimGate
from kinegraph.stream.engine.flow.admission import conform, soundness
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.source import Source
from tests.devices import travelling
from tests.devices.scripted import Arriving, played

FRAME = (
    "{name: x, sync: A5 5A, rate_hz: 200, checksum: sum8, fields: [{type: u8, role: counter}, {type: u32, role: time, unit: us}, "
    "{name: a, type: i16}]}"
)
DEVICES: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "cyton": ("devices.cyton.Cyton, port: ''", lambda _: SimulatedCyton().brain()),
    "lines": (
        "devices.lines.AsciiLines, port: '', columns: [n, us, a], counter: n, time: us, rate_hz: 200",
        lambda _: SimulatedAsciiLines(("n", "us", "a"), rate_hz=200, time="us", counter="n").brain(),
    ),
    "lines without a clock": (
        "devices.lines.AsciiLines, port: '', columns: [a, b], rate_hz: 100",
        lambda _: SimulatedAsciiLines(("a", "b"), rate_hz=100).brain(),
    ),
    "binary": (f"devices.frames.Binary, port: '', frames: [{FRAME}]", BinaryModel),
    "mti": ("devices.mti.Mti, port: ''", lambda _: SimulatedMti().brain()),
    "mti on a back": (
        "devices.mti.Mti, port: ''",
        lambda _: SimulatedMti(site="lower_back", manner="shuffling", seed=101).brain(),
    ),
    "bitalino": (
        "devices.bitalino.Bitalino, port: '', rate_hz: 100, channels: [{input: A1}, {input: A2}]",
        lambda _: SimulatedBitalino().brain(),
    ),
    "shimmer": ("devices.shimmer.Shimmer, port: '', rate_hz: 204.8", lambda _: SimulatedShimmer().brain()),
}  # fmt: skip


IMU = (
    "{name: imu, sync: '01', rate_hz: 250, fields: [{type: u24}, {type: u24}, {type: u8, role: counter}, {type: u64}, "
    + "".join(f"{{name: g{axis}, type: i16, scale: 0.0625, unit: deg/s}}, " for axis in "xyz")
    + "".join(f"{{name: a{axis}, type: i16, scale: 0.0001220703125, unit: g}}, " for axis in "xyz")
    + "{type: u32, role: time, unit: us, scale: 0.3333333333333333}]}"
)
OSC = (
    "{name: phone, address: /acc, rate_hz: 100, arguments: [{name: n, role: counter}, {name: t, role: time, unit: ms}, {name: a}]}, "
    "{name: bare, address: /bare, rate_hz: 50, arguments: [{name: a}]}"
)
QUALISYS = (
    "markers: [knee, ankle], bodies: [shank], segments: ['Fred:Hips'], analog: [EMG 1], rate_hz: 100, analog_hz: 1000"
)
SENDERS: dict[str, tuple[str, Callable[..., None]]] = {
    "polar": ("devices.polar.Polar, acceleration_hz: 100", travelling.by_bluetooth),
    "heart rate": ("devices.heart_rate.HeartRate", travelling.by_bluetooth),
    "dot": ("devices.dot.MovellaDot, rate_hz: 60", travelling.by_bluetooth),
    "dot's orientation": ("devices.dot.MovellaDot, rate_hz: 60, mode: orientation", travelling.by_bluetooth),
    "ganglion": ("devices.ganglion.Ganglion", travelling.by_bluetooth),
    "fitness treadmill": ("devices.fitness_treadmill.FtmsTreadmill", travelling.by_bluetooth),
    "osc": (f"devices.osc.OscInlet, streams: [{OSC}]", travelling.by_datagrams),
    "usb": (f"devices.usb.endpoint.Endpoint, port: 'usb://054c:0ce6', frames: [{IMU}]", travelling.by_usb),
    "trigno": ("devices.trigno.Trigno, port: 'tcp://127.0.0.1:50040', sensors: [{sensor: 1}], aux: true", travelling.of_trigno),
    "natnet": ("devices.natnet.NatNet, bodies: [Shank], markers: ['Shank:1'], analog: ['plate 1:Fx'], rate_hz: 120", travelling.of_natnet),
    "qualisys": (f"devices.qualisys.Qualisys, {QUALISYS}", travelling.of_qualisys),
    "lsl": ("devices.lsl.LslInlet, name: simulated, channels: [TA, SO], rate_hz: 1000, unit: uV", travelling.by_lsl),
    "oak": ("devices.oak.Oak, width: 64, height: 48, fps: 10, imu_hz: 100", travelling.of_oak),
    "oak with images": ("devices.oak.Oak, width: 64, height: 48, fps: 5, image: mono", travelling.of_oak),
    "orbbec": ("devices.cameras.orbbec.Orbbec, width: 64, height: 48, fps: 10", travelling.in_place),
    "treadmill": ("devices.people.treadmill.Treadmill, legs: both", travelling.paced),
    "walkway": ("devices.people.walkway.Walkway, duration_s: 0", travelling.paced),
    "exerciser": ("devices.people.exerciser.Exerciser, duration_s: 0", travelling.paced),
    "performer": ("devices.people.performer.Performer", travelling.paced),
    "quadruped": ("devices.people.quadruped.Quadruped", travelling.paced),
    "two actors": ("devices.people.quadruped.TwoActors", travelling.paced),
    "before a camera": ("devices.people.before_camera.BeforeCamera, width: 64, height: 48, fps: 5", travelling.paced),
    "bedside": ("devices.people.bedside.Bedside, width: 64, height: 48, fps: 2, speed: 1", travelling.paced),
    "actigraph": ("devices.people.actigraph.Actigraph, realtime: true", travelling.paced),
}  # fmt: skip


class Judge:
    """A gate behind each output, as in a session; `findings` at the end are of the gates and of the source itself."""

    def __init__(self, yaml: str, monkeypatch: pytest.MonkeyPatch) -> None:
        node = load_text(f"nodes:\n  device: {{use: {yaml}}}").nodes["device"]
        assert isinstance(node.part, Source)
        self.source, self.specs = node.part, node.specs
        gates = {name: ClaimGate(name, spec, wrong=self.source.rate_tolerance) for name, spec in node.specs.items()}
        sound = {name: soundness(spec, gates[name]) for name, spec in node.specs.items()}
        self.gates, self.came = gates, (came := dict.fromkeys(gates, 0))

        def emit(_: Arriving, chunk: Chunk, output: str = "out") -> None:
            came[output] += len(chunk)
            assert sound[output](chunk) or sound[output](conform(node.specs[output], chunk))

        monkeypatch.setattr(Arriving, "emit", emit)

    def findings(self, feed: Arriving, seconds: float) -> list[str]:
        for name, spec in self.specs.items():
            assert self.came[name] >= (seconds - 5) * (spec.rate_hz or 0) * 0.95 - 1, (name, self.came)
        own = [str(facts) for kind, facts in feed.reports if kind == "finding"]
        return own + [finding.text for gate in self.gates.values() for finding in gate.look(over=True)]


def findings(name: str, seconds: float, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What is found over so many seconds of a sender's own time."""
    if name in DEVICES:
        yaml, made = DEVICES[name]
        judge = Judge(yaml, monkeypatch)
        return judge.findings(played(judge.source, made(judge.source), seconds, monkeypatch), seconds)
    yaml, run = SENDERS[name]
    judge = Judge(yaml, monkeypatch)
    feed = travelling.Travelling(seconds, monkeypatch)
    run(judge.source, feed, monkeypatch)
    return judge.findings(feed, seconds)


@pytest.mark.parametrize("name", [*DEVICES, *SENDERS])
def test_a_device_that_sends_as_declared_gives_no_finding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert findings(name, 12.0, monkeypatch) == []


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", [*DEVICES, *SENDERS])
def test_two_hours_of_a_device_give_no_finding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the device's time, in longer steps; it takes minutes."""
    monkeypatch.setattr("tests.devices.scripted.STEP_S", 0.02)
    monkeypatch.setattr("tests.devices.travelling.STEP_S", 0.02)
    monkeypatch.setattr("kinegraph.devices.ble.simulated_backends.TICK_S", 0.05)
    assert findings(name, 7200.0, monkeypatch) == []
