"""A session to which nothing good came ends with another exit code than 0, and says what came."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.command_line import Command


@pytest.fixture
def garbage() -> Iterator[str]:
    """A device that sends only bad lines."""
    stop = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(0.1)

        def work() -> None:
            while not stop.is_set():
                try:
                    client, _ = server.accept()
                except TimeoutError:
                    continue
                with client:
                    while not stop.wait(0.02):
                        try:
                            client.sendall(b"no, numbers at all\r\n")
                        except OSError:
                            break

        thread = threading.Thread(target=work, daemon=True)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        stop.set()
        thread.join()


@pytest.mark.parametrize("seconds", ["2", "30"])
def test_a_recording_of_which_every_line_was_bad(
    kinegraph: Command, tmp_path: Path, garbage: str, seconds: str
) -> None:
    (tmp_path / "lines.yaml").write_text(
        f"nodes:\n  lines: {{use: devices.lines.AsciiLines, port: '{garbage}', columns: [a, b], rate_hz: 50, deadline_s: 3}}\n"
        "record: [lines]\n"
    )
    code, out, complaint = kinegraph("run", "lines.yaml", "--for", seconds, "-o", "session", "--view", "none")
    assert code not in (0, None), out + complaint
    assert "lines" in complaint
