"""A bed that is killed in the middle, and resumed: its recording and the centre's hold the same, as real processes write them."""

from __future__ import annotations

import signal
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.nats.local_server import LocalServer
from kinegraph.stream.recording.format.paths import parts_of
from tests.support.command_line import KINEGRAPH, Command
from tests.support.mosquitto import eventually
from tests.support.nats_site import folders, server, stream_of

__all__ = ["folders", "server"]

BED = """
checkpoint_s: 2
nodes:
  person: {{use: devices.people.treadmill.Treadmill, muscles: [TA], duration_s: {seconds}}}
  envelope: {{use: operators.emg.Envelope, from: person.emg}}
  centre: {{use: devices.nats.StreamOutlet, bed: cut, server: {{url: "{url}"}}, from: {{envelope: envelope}}}}
record: [envelope]
"""
CENTRE = """
nodes:
  envelope: {{use: devices.nats.StreamInlet, bed: cut, stream: envelope, server: {{url: "{url}"}}, start: all, ends: true}}
  smooth: {{use: operators.filters.iir.Lowpass, from: envelope, cutoff_hz: 2}}
record: [smooth]
"""


def size(folder: Path) -> int:
    return sum(part.stat().st_size for part in parts_of(folder)) if folder.is_dir() else 0


@pytest.mark.nightly
@pytest.mark.timeout(280)
def test_a_bed_killed_twice_and_a_server_killed_leave_no_difference(
    kinegraph: Command, server: LocalServer, tmp_path: Path
) -> None:
    (tmp_path / "bed.yaml").write_text(BED.format(url=server.url, seconds=12))
    (tmp_path / "centre.yaml").write_text(CENTRE.format(url=server.url))
    command = [str(KINEGRAPH), "run", "bed.yaml", "-o", "bed", "--view", "none"]
    for resume in ([], ["--resume"]):
        with (tmp_path / "log.txt").open("ab") as log:
            process = subprocess.Popen([*command, *resume], stdout=log, stderr=log)
            before = size(tmp_path / "bed")
            eventually(lambda before=before: size(tmp_path / "bed") > before + 200_000)  # some seconds of 1 kHz
            if resume:
                server.kill()
                server.start()
                time.sleep(1.0)
            process.send_signal(signal.SIGKILL)
            process.wait()
    assert kinegraph(*command[1:], "--resume")[0] == 0
    assert kinegraph("run", "centre.yaml", "-o", "centre", "--view", "none")[0] == 0
    bed, centre = stream_of(tmp_path / "bed", "envelope"), stream_of(tmp_path / "centre", "envelope")
    np.testing.assert_array_equal(bed[0], centre[0])
    assert bed[1].tobytes() == centre[1].tobytes() and bed[2] == centre[2]
    assert len(bed[2]) >= 2  # what the bed did not measure while it was down
