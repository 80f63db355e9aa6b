"""`kinegraph dev new device`: what comes from a simulated device becomes a declaration that reads it, through the command line."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.devices.frames import guess as frame_guess
from kinegraph.devices.frames.simulator import BinaryModel
from kinegraph.devices.frames.simulator import serving as serving_frames
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.lines.simulator import SimulatedAsciiLines
from kinegraph.stream.params import build
from kinegraph.stream.recording import Recording
from tests.support.command_line import Command

COUNTED = [
    {"type": "u8", "role": "counter"},
    {"type": "i16", "name": "a", "unit": "g", "scale": 0.001},
    {"type": "i16", "name": "b", "unit": "deg/s", "scale": 0.1},
]
TIMED = [{"type": "u32", "role": "time", "unit": "us"}, {"type": "f32", "name": "z", "count": 3}]


def device(framing: str = "none", **frame: Any) -> Binary:
    declared = {"name": "m", "rate_hz": 100, **frame}
    return build(Binary, {"port": "/dev/x", "framing": framing, "frames": [declared]})


DEVICES = {
    "sum": device(sync="A5 5A", fields=COUNTED, checksum="sum8"),
    "crc": device(sync="7E", fields=[*COUNTED, *TIMED], checksum="crc16_modbus", endian="big"),
    "footer": device(sync="AA", fields=TIMED, footer="0D 0A"),
    "cobs": device("cobs", sync="", fields=COUNTED, checksum="crc16_ccitt"),
    "slip": device("slip", sync="01", fields=COUNTED, checksum="crc32"),
}


@pytest.mark.parametrize("name", list(DEVICES))
def test_what_is_proposed_is_what_the_device_was_declared_as(name: str) -> None:
    source = DEVICES[name]
    (frame,) = source.frames
    found = frame_guess.guess(b"".join(BinaryModel(source).say(4.0))[7:])
    assert found is not None and found.covered > 0.95
    assert (found.framing, found.checksum, found.size) == (source.framing, frame.checksum, source.layouts()[0].size)
    by_role = {one["role"]: one["type"] for one in found.fields if "role" in one}
    assert by_role == {f.role: f.type for f in frame.fields if f.role != "data"}
    assert source.framing != "none" or found.sync.endswith(source.layouts()[0].sync)


@pytest.mark.parametrize("noise", [b"", bytes(5000), np.random.default_rng(2).bytes(5000), b"\xa5" * 5000])
def test_nothing_is_proposed_for_what_has_no_frames(noise: bytes) -> None:
    assert frame_guess.guess(noise) is None


@pytest.mark.parametrize("name", ["sum", "cobs"])
def test_a_declaration_is_written_and_reads_the_device(kinegraph: Command, tmp_path: Path, name: str) -> None:
    with serving_frames(BinaryModel(DEVICES[name])) as port:
        code, _, complaint = kinegraph("dev", "new", "device", port, "--for", "4", "-o", "board.yaml")
        assert code == 0, complaint
        text = (tmp_path / "board.yaml").read_text()
        assert "rate_hz: 100" in text and f"checksum: {DEVICES[name].frames[0].checksum}" in text, text
        code, _, complaint = kinegraph("run", "board.yaml", "--for", "2", "-o", "session", "--view", "none")
        assert code == 0, complaint
    with Recording.open(tmp_path / "session") as recording:
        assert recording.streams["board"].samples > 50


def test_lines_are_proposed_with_their_time_and_counter(kinegraph: Command, tmp_path: Path) -> None:
    lines = SimulatedAsciiLines(columns=("t", "n", "a"), time="t", counter="n", rate_hz=100.0)
    with lines.serving() as port:
        code, printed, complaint = kinegraph("dev", "new", "device", port, "--for", "3")
    assert code == 0, complaint
    for line in ("use: devices.lines.AsciiLines", "counter: x2", "time: x1", "time_unit: us", "rate_hz: 100"):
        assert line in printed


@contextmanager
def talking(seed: int) -> Iterator[str]:
    """A server that sends bytes at random."""
    server, stop = socket.create_server(("127.0.0.1", 0)), threading.Event()

    def serve() -> None:
        connection, _ = server.accept()
        random = np.random.default_rng(seed)
        with connection, suppress(OSError):
            while not stop.is_set():
                connection.sendall(random.bytes(500))
                time.sleep(0.05)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
    finally:
        stop.set()
        thread.join()
        server.close()


def test_what_cannot_be_told_is_shown(kinegraph: Command) -> None:
    with talking(3) as port:
        code, _, complaint = kinegraph("dev", "new", "device", port, "--for", "1")
    assert code == 3 and "no frames of one length and no lines of numbers in" in " ".join(complaint.split())


def test_a_graph_is_never_overwritten(kinegraph: Command, tmp_path: Path) -> None:
    (tmp_path / "board.yaml").write_text("mine")
    code, _, complaint = kinegraph("dev", "new", "device", "/dev/nowhere", "-o", "board.yaml")
    assert code == 2 and "board.yaml: already exists" in complaint
