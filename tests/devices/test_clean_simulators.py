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
from kinegraph.stream.engine.flow.admission import soundness
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.source import Source
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
    "bitalino": (
        "devices.bitalino.Bitalino, port: '', rate_hz: 100, channels: [{input: A1}, {input: A2}]",
        lambda _: SimulatedBitalino().brain(),
    ),
    "shimmer": ("devices.shimmer.Shimmer, port: '', rate_hz: 204.8", lambda _: SimulatedShimmer().brain()),
}  # fmt: skip


def findings(name: str, seconds: float, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the gate finds in a device's streams over so many seconds of its time, and what the source finds itself."""
    yaml, made = DEVICES[name]
    node = load_text(f"nodes:\n  device: {{use: {yaml}}}").nodes["device"]
    source = node.part
    assert isinstance(source, Source)
    gates = {output: ClaimGate(output, spec, wrong=source.rate_tolerance) for output, spec in node.specs.items()}
    sound = {output: soundness(spec, gates[output]) for output, spec in node.specs.items()}
    came = dict.fromkeys(gates, 0)

    def emit(_: Arriving, chunk: Chunk, output: str = "out") -> None:
        came[output] += len(chunk)
        assert sound[output](chunk)

    monkeypatch.setattr(Arriving, "emit", emit)
    feed = played(source, made(source), seconds, monkeypatch)
    assert max(came.values()) > 40 * seconds
    own = [str(facts) for kind, facts in feed.reports if kind == "finding"]
    return own + [finding.text for gate in gates.values() for finding in gate.look(over=True)]


@pytest.mark.parametrize("name", DEVICES)
def test_a_device_that_sends_as_declared_gives_no_finding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert findings(name, 12.0, monkeypatch) == []


@pytest.mark.nightly
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", DEVICES)
def test_two_hours_of_a_device_give_no_finding(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the device's time, read in pieces of 20 ms; it takes minutes."""
    monkeypatch.setattr("tests.devices.scripted.STEP_S", 0.02)
    assert findings(name, 7200.0, monkeypatch) == []
