"""A client that reads slowly, on a real socket: it gets fewer and newer views, the page says so, and other clients are not held up."""

from __future__ import annotations

import asyncio
import json
import socket
import threading
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from websockets.sync.client import connect

from kinegraph.devices.page.hub import Hub
from kinegraph.devices.page.serving import PageServer
from kinegraph.devices.page.transfer.catalogue import described
from kinegraph.devices.page.transfer.wire import decode, encode
from kinegraph.stream.chunk import NS, StreamSpec
from tests.support.browser import needs_browser
from tests.support.live_browser import live_browser
from tests.support.page_session import PATIENCE_S, needs_page

pytestmark = [needs_page, pytest.mark.timeout(280)]

RATE_HZ, FRAMES = 30.0, 400
CAMERA = StreamSpec((240, 320), np.dtype("<u2"), RATE_HZ, units=("mm",))
"""150 kB a picture: 400 of them are far more than sockets hold."""
PIXELS = np.full(CAMERA.shape, 1000, "<u2")


class Served:
    """A page's server and its hub, in this process: `frame` gives a picture, `state` the engine's."""

    def __init__(self, hub: Hub, port: int, call: Callable[..., Any]) -> None:
        self.hub, self.port, self._call = hub, port, call
        self.frames = 0

    def frame(self) -> None:
        self._call(self._give)

    def state(self) -> None:
        self._call(
            self.hub.receive,
            {"t": "state", "table": {"camera": {"kind": "source", "samples": self.frames}}, "dropped": 0},
            memoryview(b""),
        )
        self._call(self.hub.receive, {"t": "tick"}, memoryview(b""))

    def _give(self) -> None:
        self.frames += 1
        time = np.array([round(self.frames * NS / RATE_HZ)])
        header = {"t": "chunk", "s": 0, "n": 1, "lost": 0, "until": int(time[0])}
        self.hub.receive(*decode(encode(header, time.tobytes(), (PIXELS + self.frames).tobytes())))
        self.hub.receive({"t": "tick"}, memoryview(b""))


@asynccontextmanager
async def serving() -> AsyncIterator[tuple[Hub, int]]:
    hub = Hub(lambda asked: None)
    panels = [{"kind": "frame", "of": ["camera"]}, {"kind": "state", "of": []}]
    streams = [described("camera", CAMERA)]
    hello = {"t": "hello", "v": 1, "name": "slow", "mode": "live", "t0_ms": 0.0, "t0_ns": 0, "session": {}, "streams": streams, "nodes": [],
             "edges": [], "values": [], "words": [], "panels": panels, "specs": [CAMERA.to_json()]}  # fmt: skip
    hub.receive(*decode(encode(hello)))
    server = PageServer(hub, lambda: "")
    yield hub, await server.open("127.0.0.1", 0, "")
    await server.close()


@contextmanager
def served() -> Iterator[Served]:
    """A server in a thread of its own."""
    loop = asyncio.new_event_loop()
    found: list[Served] = []
    ready, over = threading.Event(), asyncio.Event()

    async def run() -> None:
        async with serving() as (hub, port):
            found.append(Served(hub, port, loop.call_soon_threadsafe))
            ready.set()
            await over.wait()

    thread = threading.Thread(target=loop.run_until_complete, args=(run(),))
    thread.start()
    try:
        assert ready.wait(PATIENCE_S)
        yield found[0]
    finally:
        loop.call_soon_threadsafe(over.set)
        thread.join(PATIENCE_S)
        loop.close()


def test_a_client_that_reads_slowly_gets_the_newest_and_hears_that_it_is_slow() -> None:
    with served() as page, socket.socket() as narrow:
        narrow.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 15)
        narrow.connect(("127.0.0.1", page.port))
        url = f"ws://127.0.0.1:{page.port}/socket"
        options: dict[str, Any] = {"max_size": None, "compression": None, "ping_interval": None, "close_timeout": 0.5}
        with connect(url, **options) as quick, connect(url, sock=narrow, max_queue=1, **options) as slow:
            for client in (quick, slow):
                assert decode(client.recv())[0]["t"] == "hello"
                client.send(json.dumps({"do": "see", "streams": {"0": 0}}))
            for number in range(1, FRAMES + 1):
                page.frame()
                while True:  # the quick one has each before the next is given
                    header = decode(quick.recv(timeout=PATIENCE_S))[0]
                    if header["t"] == "frame":
                        assert header["count"] == number
                        break
            page.state()
            seen = []
            while (header := decode(slow.recv(timeout=PATIENCE_S))[0])["t"] != "state":
                seen.append(header["count"])
            assert seen == sorted(seen) and seen[-1] == FRAMES, "it ends with what is newest"
            assert len(seen) < FRAMES // 10, "what it could not take in time waits nowhere"
            assert header["skipped"] > FRAMES // 2
            assert decode(quick.recv(timeout=PATIENCE_S))[0]["skipped"] <= FRAMES // 10


@needs_browser
def test_the_page_of_a_slow_browser_says_so(tmp_path: Path) -> None:
    with served() as page, live_browser(tmp_path) as browser:
        browser.open(f"http://127.0.0.1:{page.port}/")
        browser.wait("/^(live|starting)/.test(document.body.dataset.state)")
        page.state()
        browser.wait("document.querySelector('.state output').textContent.includes('1 looking')")
        assert "slow" not in browser.value("document.querySelector('.state output').textContent")
        browser.value(
            "void setTimeout(() => { const end = Date.now() + 3000; document.body.dataset.busy = 1; while (Date.now() < end); }, 0)"
        )
        for _ in range(FRAMES):
            page.frame()
            threading.Event().wait(0.005)
        page.state()
        browser.wait(
            "/this page is slow: \\d+ updates came together/.test(document.querySelector('.state output').textContent)"
        )
        browser.wait(f"Math.abs(document.querySelector('.frame').dataset.least - {1000 + FRAMES}) < 1")
        assert browser.complaints == []
