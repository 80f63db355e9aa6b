"""An edge over a real NATS server: the same samples, stamps and gaps on the other side, each once, whatever happens in between."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.nats.local_server import LocalServer
from kinegraph.stream.engine.replay import Replay
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording import Recording
from tests.support.nats_site import Running, folders, server, session, stream_of

__all__ = ["folders", "server"]

BED = """
nodes:
  person: {{use: devices.people.treadmill.Treadmill, realtime: false, duration_s: {seconds}, muscles: [TA]}}
  envelope: {{use: operators.emg.Envelope, from: person.emg}}
  out:
    use: devices.nats.StreamOutlet
    bed: {bed}
    server: {{url: "{url}"}}
    from: {{envelope: envelope, touchdown: person.touchdown}}
record: [envelope]
"""
CENTRE = """
nodes:
  envelope: {{use: devices.nats.StreamInlet, bed: {bed}, stream: envelope, server: {{url: "{url}"}}, ends: true, start: all}}
  touchdown: {{use: devices.nats.StreamInlet, bed: {bed}, stream: touchdown, server: {{url: "{url}"}}, ends: true, start: all}}
  smooth: {{use: operators.filters.iir.Lowpass, from: envelope, cutoff_hz: 3}}
record: [smooth]
"""


@pytest.mark.quick
def test_the_centre_records_what_the_bed_recorded_bit_for_bit(server: LocalServer, tmp_path: Path) -> None:
    facts = {"bed": "same", "url": server.url, "seconds": 5}
    bed = session(BED.format(**facts), tmp_path / "bed")
    assert bed.run().error is None
    centre = Running(session(CENTRE.format(**facts), tmp_path / "centre"))
    centre.ended()
    for ours, theirs in (("envelope", "envelope"), ("person.touchdown", "touchdown")):
        time, data, gaps = stream_of(tmp_path / "bed", ours)
        time_there, data_there, gaps_there = stream_of(tmp_path / "centre", theirs)
        np.testing.assert_array_equal(time, time_there)
        assert data.tobytes() == data_there.tobytes() and gaps == gaps_there
    with Recording.open(tmp_path / "centre") as recording:
        replayed = Replay(load_text(CENTRE.format(**facts)), recording).run()
    assert not replayed.differing and replayed.digests
