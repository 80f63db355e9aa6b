"""A simulated camera on the network: it serves JPEG pictures of someone who moves, over HTTP, as many telephones' apps do."""

from __future__ import annotations

import io
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np

from kinegraph.devices.cameras.video.source import Video
from kinegraph.devices.people.rendered_performer import RenderedPerformer, camera_of
from kinegraph.stream.chunk import Array

BOUNDARY = "picture"
QUALITY = 90


class NetworkCamera:
    """A camera that serves `fps` pictures a second to everyone who asks; `unplug` ends all answers and refuses new ones."""

    def __init__(self, width: int, height: int, fps: float) -> None:
        self.size, self.fps = (width, height), fps
        self._performer, self._lock = RenderedPerformer(width, height), threading.Lock()
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

    def picture(self, frame: int) -> Array:
        """The picture (height, width, 3) of that number: what it shows begins when the first one is asked for."""
        with self._lock:
            return np.repeat(self._performer.image(frame, frame / self.fps)[..., None], 3, 2)

    def pictures(self) -> Iterator[bytes]:
        """JPEG files at the camera's pace; a frame whose time has passed is not made."""
        from PIL import Image

        self._began = time.monotonic() if self._began is None else self._began
        number = round((time.monotonic() - self._began) * self.fps)
        while not self._out.is_set():
            number = max(number, int((time.monotonic() - self._began) * self.fps))
            time.sleep(max(0.0, self._began + number / self.fps - time.monotonic()))
            file = io.BytesIO()
            Image.fromarray(self.picture(number)).save(file, "JPEG", quality=QUALITY)
            yield file.getvalue()
            number += 1

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


@contextmanager
def network_camera(width: int, height: int, fps: float) -> Iterator[NetworkCamera]:
    """A camera that can be reached for as long as the context lasts."""
    camera = NetworkCamera(width, height, fps)
    try:
        yield camera
    finally:
        camera.close()


@contextmanager
def simulated(source: Video) -> Iterator[Video]:
    """The source as it reads a simulated camera over HTTP."""
    if source.is_file:
        source = replace(source, url="")
    width, height = source.size()
    with network_camera(width, height, source.fps) as camera:
        intrinsics = source.intrinsics or camera_of(width, height)
        yield replace(source, url=camera.url, width=width, height=height, intrinsics=intrinsics)
