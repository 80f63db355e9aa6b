"""Graphs over a real NATS server: live is replay, over machines; what several processes measure comes together in another."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.nats.local_server import LocalServer
from kinegraph.devices.nats.messages import digest_of, spec_text
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.command_line import KINEGRAPH, Command
from tests.support.mosquitto import eventually
from tests.support.nats_site import Running, folders, sending, server, session, stream_of

__all__ = ["folders", "server"]

BED = """
nodes:
  person: {{use: devices.people.treadmill.Treadmill, realtime: false, duration_s: {seconds}, muscles: [TA]}}
  envelope: {{use: operators.emg.Envelope, from: person.emg}}
  slow: {{use: operators.filters.iir.Lowpass, from: envelope, cutoff_hz: 2}}
  out:
    use: devices.nats.StreamOutlet
    bed: {bed}
    server: {{url: "{url}"}}
    from: {{envelope: envelope, slow: slow, touchdown: person.touchdown}}
record: [envelope, slow]
"""
CENTRE = """
nodes:
  envelope: {{use: devices.nats.StreamInlet, bed: {bed}, stream: envelope, server: {{url: "{url}"}}, ends: true, start: all}}
  slow: {{use: devices.nats.StreamInlet, bed: {bed}, stream: slow, server: {{url: "{url}"}}, ends: true, start: all}}
  smooth: {{use: operators.filters.iir.Lowpass, from: envelope, cutoff_hz: 3}}
  rectified: {{use: operators.filters.rectify.Rectify, from: slow}}
record: [smooth, rectified]
"""


@pytest.mark.quick
def test_the_centre_records_what_the_bed_recorded_and_computes_live_what_a_replay_computes(
    server: LocalServer, tmp_path: Path
) -> None:
    facts = {"bed": "same", "url": server.url, "seconds": 20}
    assert session(BED.format(**facts), tmp_path / "bed").run().error is None
    centre = session(CENTRE.format(**facts), tmp_path / "centre")
    reading = Running(centre)
    eventually(lambda: bool(centre.table) or not reading.is_alive())
    server.kill()
    server.start()
    reading.ended()
    for name in ("envelope", "slow"):
        alone, there = stream_of(tmp_path / "bed", name), stream_of(tmp_path / "centre", name)
        np.testing.assert_array_equal(alone[0], there[0])
        assert alone[1].tobytes() == there[1].tobytes() and alone[2] == there[2] == []
    for folder, count in (("centre", 2), ("bed", 0)):
        with Recording.open(tmp_path / folder) as recording:
            replayed = Replay(load_text(CENTRE.format(**facts)), recording, output=tmp_path / f"{folder}-again").run()
        assert not replayed.differing and len(replayed.digests) == count
    for name in ("smooth", "rectified"):
        again, live = stream_of(tmp_path / "bed-again", name), stream_of(tmp_path / "centre", name)
        np.testing.assert_array_equal(again[0], live[0])
        assert again[1].tobytes() == live[1].tobytes()


CYCLES = """
  envelope: {use: operators.emg.Envelope, from: %semg}
  cycles: {use: operators.cycles.cycles.Cycles, from: {signal: envelope, touchdown: %stouchdown, liftoff: %sliftoff}}
record: [cycles.closed]
"""
PERSON = (
    "nodes:\n  person: {use: devices.people.treadmill.Treadmill, realtime: false, duration_s: 20, muscles: [TA]}"
    + CYCLES % (("person.",) * 3)
)
INLET = '  %s: {use: devices.nats.StreamInlet, bed: %s, stream: %s, server: {url: "%s"}, ends: true, start: all}\n'


def test_gait_with_amplifier_and_markers_on_two_machines_has_the_cycles_of_one(
    server: LocalServer, tmp_path: Path
) -> None:
    """The amplifier and the markers send from processes of their own; cycles of a third have the stamps of a single-process run."""
    assert session(PERSON, tmp_path / "one").run().error is None
    places = {"emg": "amplifier", "touchdown": "markers", "liftoff": "markers"}
    with Recording.open(tmp_path / "one") as recording:
        for bed in ("amplifier", "markers"):
            names = [name for name, where in places.items() if where == bed]
            specs = {name: recording.streams[f"person.{name}"].spec for name in names}
            with sending(bed, server, specs=specs) as outlet:
                for name in names:
                    for chunk in recording.chunks(f"person.{name}"):
                        outlet.process(name, chunk)
    inlets = "".join(INLET % (name, bed, name, server.url) for name, bed in places.items())
    Running(session(f"nodes:\n{inlets}{CYCLES % ('', '', '')}", tmp_path / "third")).ended()
    one, third = (stream_of(tmp_path / folder, "cycles.closed") for folder in ("one", "third"))
    assert len(one[0]) > 10
    np.testing.assert_array_equal(one[0], third[0])  # the same to the nanosecond, where 1 ms is asked
    assert one[1].tobytes() == third[1].tobytes()


SENDING = """
nodes:
  person: {{use: devices.people.treadmill.Treadmill, muscles: [TA]}}
  out: {{use: devices.nats.StreamOutlet, bed: {bed}, server: {{url: "{url}"}}, from: {{{streams}}}}}
"""


@pytest.mark.nightly
@pytest.mark.timeout(280)
def test_gait_of_three_processes_has_the_cycles_of_one(kinegraph: Command, server: LocalServer, tmp_path: Path) -> None:
    """As laboratories have it: the amplifier's computer, that of the markers, and a third that cuts cycles; each a process."""
    Path("one.yaml").write_text(PERSON)
    assert kinegraph("run", "one.yaml", "-o", "one", "--view", "none")[0] == 0
    places = {"emg": "amplifier3", "touchdown": "markers3", "liftoff": "markers3"}
    inlets = "".join(INLET % (name, bed, name, server.url) for name, bed in places.items())
    Path("third.yaml").write_text(f"nodes:\n{inlets}{CYCLES % ('', '', '')}")
    with Recording.open(tmp_path / "one") as recording:
        kept = tmp_path / "state" / "kinegraph" / "specs"
        kept.mkdir(parents=True)
        for name, bed in places.items():  # the third is started first, before a server knows the streams
            spec = spec_text(recording.streams[f"person.{name}"].spec)
            (kept / f"{digest_of(server.url)}.{bed}.{name}.json").write_text(spec)
    processes = []
    with Path("log.txt").open("wb") as log:
        for command in (
            ["run", "third.yaml", "-o", "third", "--view", "none"],
            *(["replay", f"{bed}.yaml", "one", "--speak", "out", "--speed", "2"] for bed in ("amplifier3", "markers3")),
        ):
            if command[0] == "replay":
                bed = command[1].removesuffix(".yaml")
                streams = ", ".join(f"{name}: person.{name}" for name, where in places.items() if where == bed)
                Path(command[1]).write_text(SENDING.format(bed=bed, url=server.url, streams=streams))
            processes.append(subprocess.Popen([KINEGRAPH, *command], stdout=log, stderr=log))
        assert [process.wait(200) for process in processes] == [0, 0, 0], Path("log.txt").read_text()
    one, third = (stream_of(tmp_path / folder, "cycles.closed") for folder in ("one", "third"))
    assert len(one[0]) > 10
    np.testing.assert_array_equal(one[0], third[0])
    assert one[1].tobytes() == third[1].tobytes()
