"""aio-rtsp-toolkit (PyPI), an RTSP server written elsewhere, serves a film to devices.cameras.video; RTP over TCP."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.cameras.video import Video
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import DeviceError
from tests.support.device_feed import check, reading, wait_for

pytestmark = pytest.mark.nightly
av = pytest.importorskip("av")
pytest.importorskip("aio_rtsp_toolkit")
WIDTH, HEIGHT, RATE = 64, 48, 25
SERVER = """
import asyncio, sys
from aio_rtsp_toolkit import server
asyncio.run(server.serve(sys.argv[1], host="127.0.0.1", port=int(sys.argv[2])))
"""


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with 20 s of film; the left half changes its level from frame to frame."""
    folder = tmp_path_factory.mktemp("films")
    with av.open(str(folder / "walk.mp4"), "w") as made:
        stream = made.add_stream("libx264", rate=RATE, options={"preset": "ultrafast", "tune": "zerolatency", "g": "5"})
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        for k in range(20 * RATE):
            picture = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
            picture[:, : WIDTH // 2] = 10 * k % 200 + 20
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts, frame.time_base = k, Fraction(1, RATE)
            made.mux(stream.encode(frame))
        made.mux(stream.encode())
    return folder


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as found:
        return int(found.getsockname()[1])


@contextmanager
def served(folder: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    server = subprocess.Popen([sys.executable, "-c", SERVER, str(folder), str(port)], stdout=subprocess.DEVNULL)
    try:
        wait_for(lambda: not Video(f"rtsp://127.0.0.1:{port}/walk.mp4").missing())
        yield server
    finally:
        server.kill()
        server.wait()


def test_a_stream_is_read_by_its_own_times_and_again_after_the_server_was_gone(films: Path) -> None:
    port = free_port()
    source = Video(f"rtsp://127.0.0.1:{port}/walk.mp4", width=WIDTH, height=HEIGHT, fps=RATE)
    with served(films, port) as server, reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("image") > 40)
        assert feed.error is None, feed.error
        server.kill()
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError) and "127.0.0.1" in str(feed.error)
    check(source, feed)
    assert np.median(np.diff(feed.time("image"))) == pytest.approx(NS / RATE, rel=0.05)
    levels = feed.data("image")[:, 10:-10, 8:24].mean(axis=(1, 2, 3))
    steps = np.round(np.diff(levels) / 10) % 20
    assert (steps == 1).mean() > 0.9, "each frame follows the one before"
    with reading(source) as feed:
        wait_for(lambda: feed.error is not None)
    assert "cannot be opened as a video" in str(feed.error)
    with served(films, port), reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("image") > 5)
        assert feed.error is None, feed.error


def test_a_server_that_falls_silent_is_given_up(films: Path) -> None:
    port = free_port()
    source = Video(f"rtsp://127.0.0.1:{port}/walk.mp4", width=WIDTH, height=HEIGHT, fps=RATE, lost_after_s=2.0)
    with served(films, port) as server, reading(source) as feed:
        wait_for(lambda: feed.error is not None or feed.count("image") > 5)
        assert feed.error is None, feed.error
        server.send_signal(signal.SIGSTOP)
        wait_for(lambda: feed.error is not None)
    assert isinstance(feed.error, DeviceError)


def test_a_film_that_the_server_lacks_is_refused(films: Path) -> None:
    port = free_port()
    with served(films, port), reading(Video(f"rtsp://127.0.0.1:{port}/other.mp4")) as feed:
        wait_for(lambda: feed.error is not None)
    assert "cannot be opened as a video" in str(feed.error)
