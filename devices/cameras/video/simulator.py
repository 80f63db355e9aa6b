"""A simulated camera on the network: it serves JPEG pictures of a shipped clip over HTTP, as many telephones' apps do; or a film."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from kinegraph.devices.cameras.video import container
from kinegraph.devices.cameras.video.source import Video

CLIPS = {name: Path(__file__).with_name(f"{name}.mp4") for name in ("someone", "walker")}
"""A rendered person before a webcam, with hands and a face, and one who walks on a treadmill (`python -m bench.demo_clip`)."""
TIMES = 5
"""How often a film shows it."""
BOUNDARY = "picture"
QUALITY = 90


class NetworkCamera:
    """A camera that serves `fps` pictures a second of a clip, again and again, to everyone who asks; `unplug` ends all answers."""

    def __init__(self, width: int, height: int, fps: float, shows: str = "someone") -> None:
        self.size, self.fps, self._clip = (width, height), fps, CLIPS[shows]
        self._began: float | None = None
        self._out = threading.Event()
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self._server.daemon_threads = True
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.05}, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self._server.server_address[1]}/video"

    def unplug(self) -> None:
        self._out.set()

    def plug(self) -> None:
        self._out.clear()

    def close(self) -> None:
        self._out.set()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def pictures(self) -> Iterator[bytes]:
        """JPEG files at the camera's pace; one that comes too late is not made. The clip begins when somebody first asks."""
        self._began = time.monotonic() if self._began is None else self._began
        number = self._now()
        for begins, ends, frame in clip_from(self._clip, number / self.fps):
            if self._out.is_set():
                return
            number = max(number, self._now())
            while begins <= number / self.fps < ends:
                time.sleep(max(0.0, self._began + number / self.fps - time.monotonic()))
                if self._out.is_set():
                    return
                yield self._jpeg(frame)
                number += 1

    def _now(self) -> int:
        """The number of the picture that is due."""
        return int((time.monotonic() - (self._began or 0.0)) * self.fps)

    def _jpeg(self, frame: Any) -> bytes:
        file, (width, height) = io.BytesIO(), self.size
        frame.reformat(width=width, height=height, format="rgb24").to_image().save(file, "JPEG", quality=QUALITY)
        return file.getvalue()

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        camera = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                if camera._out.is_set():
                    self.send_error(503)
                    return
                self.send_response(200)
                self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
                self.end_headers()
                try:
                    for picture in camera.pictures():
                        head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(picture)}\r\n\r\n"
                        self.wfile.write(head.encode() + picture + b"\r\n")
                except OSError:
                    return  # whoever looked is gone

            def log_message(self, format: str, *arguments: object) -> None:
                """Nothing."""

        return Handler


def clip_from(clip: Path, seconds: float) -> Iterator[tuple[float, float, Any]]:
    """A clip's frames, again and again: from when to when (s) each is shown, the first one not long before `seconds`."""
    facts = container.file_facts(str(clip))
    rate = facts.rate_hz or 30.0
    turn = int(seconds * rate / facts.frames)
    while True:
        with container.opened(str(clip), 0, 0, 0.0) as (opened, _):
            for k, frame in enumerate(opened.decode(video=0), turn * facts.frames):
                yield k / rate, (k + 1) / rate, frame
        turn += 1


@contextmanager
def network_camera(width: int, height: int, fps: float, shows: str = "someone") -> Iterator[NetworkCamera]:
    """A camera that can be reached for as long as the context lasts."""
    camera = NetworkCamera(width, height, fps, shows)
    try:
        yield camera
    finally:
        camera.close()


def film_of(clip: Path, folder: Path) -> Path:
    """A film that shows a clip some times, one after the other, as a list that ffmpeg's libraries open as one file."""
    (folder / clip.name).write_bytes(clip.read_bytes())
    film = folder / "film.ffconcat"
    film.write_text("ffconcat version 1.0\n" + f"file {clip.name}\n" * TIMES, encoding="ascii")
    return film


@contextmanager
def simulated(source: Video) -> Iterator[Video]:
    """The source as it reads a simulated camera over HTTP; one that is not in real time, as it reads a file."""
    if not source.realtime:
        with TemporaryDirectory() as folder:
            yield replace(source, url=str(film_of(CLIPS[source.shows], Path(folder))))
        return
    if source.is_file:
        source = replace(source, url="")
    width, height = source.size()
    with network_camera(width, height, source.fps, source.shows) as camera:
        yield replace(source, url=camera.url, width=width, height=height)
