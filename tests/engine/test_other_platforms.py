"""Where Python has no pty, termios, tty, fcntl and resource, and select takes sockets only: as on Windows, which was not tried itself."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.devices.transport.transport import SerialTransport
from kinegraph.stream.errors import DeviceError

HOUSE = Path(__file__).resolve().parents[2]


@pytest.mark.timeout(300)
def test_all_is_imported_and_a_graph_runs(tmp_path: Path) -> None:
    arguments = [
        "run",
        str(HOUSE / "configs" / "shimmer_emg.yaml"),
        "--simulate",
        "--for",
        "3",
        "-o",
        str(tmp_path / "s"),
        "--view",
        "none",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "tests.engine.hidden_platform", *arguments],
        cwd=HOUSE, env={**os.environ, "PYTHONWARNINGS": "default"}, capture_output=True, text=True, timeout=280,
    )  # fmt: skip
    assert done.stdout.startswith("imported"), done.stdout[-2000:] + done.stderr[-2000:]
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-3000:]
    assert any((tmp_path / "s").iterdir())


class PortWithoutNumber:
    """A pyserial port as on Windows: it has no file descriptor, and waits by itself."""

    def __init__(self, name: str, baud: int, **_: object) -> None:
        self.timeout, self._data, self.pulled = 0.0, bytearray(b"hello"), False

    def fileno(self) -> int:
        raise io.UnsupportedOperation("fileno")

    @property
    def in_waiting(self) -> int:
        return len(self._data)

    def read(self, size: int) -> bytes:
        if self.pulled:
            raise OSError("ClearCommError failed")
        made = bytes(self._data[:size])
        del self._data[:size]
        return made

    def close(self) -> None: ...


def test_a_port_without_a_number_is_read_by_pyserials_own_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    import serial

    monkeypatch.setattr(serial, "Serial", PortWithoutNumber)
    with SerialTransport("COM3", 115200) as link:
        port = link._port
        assert link.read(0.2) == b"hello" and port.timeout == 0.2
        assert link.read(0.1) == b"" and port.timeout == 0.1
        port.pulled = True
        with pytest.raises(DeviceError, match="COM3 is gone: the cable was pulled"):
            link.read(0.1)
