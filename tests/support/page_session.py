"""A session with its page, as a person starts it, and what a client that is no browser sees of it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit, urlunsplit

import pytest
from websockets.sync.client import ClientConnection, connect

from kinegraph.devices.page.transfer.wire import decode
from tests.support.command_line import KINEGRAPH

BUILT = Path(__file__).resolve().parents[2] / "devices" / "page" / "built" / "page.js"
PATIENCE_S = 120.0
ADDRESS = re.compile(r"page: (http\S+)")

needs_page = pytest.mark.skipif(
    not BUILT.exists(),
    reason="the page has not been built: `pip install -e .` builds it where the npm registry can be reached",
)


class PageProcess:
    """`kinegraph` with a page. `url` is the address that it printed."""

    def __init__(self, process: subprocess.Popen[str], log: Path) -> None:
        self.process, self._log = process, log
        self.url = self.wait_for(ADDRESS)[1]

    @property
    def output(self) -> str:
        return self._log.read_text(encoding="utf-8", errors="replace")

    def wait_for(self, pattern: re.Pattern[str]) -> re.Match[str]:
        """What it printed that matches."""
        end = time.monotonic() + PATIENCE_S
        while not (found := pattern.search(self.output)):
            assert time.monotonic() < end and (self.process.poll() is None or pattern.search(self.output)), self.output
            time.sleep(0.05)
        return found

    def at(self, path: str) -> str:
        """The address of another of its paths, with the token."""
        place = urlsplit(self.url)
        return urlunsplit(place._replace(path=f"/{path}"))

    def server(self) -> int:
        """The process that serves the page."""
        output = subprocess.run(
            ["ps", "-o", "pid=,args=", "--ppid", str(self.process.pid)], capture_output=True, text=True
        )
        return next(int(line.split()[0]) for line in output.stdout.splitlines() if "page.server" in line)

    def client(self, **options: Any) -> ClientConnection:
        """A client, connected."""
        return connect(
            self.at("socket").replace("http", "ws", 1),
            max_size=None,
            compression=None,
            ping_interval=None,
            close_timeout=0.5,
            **options,
        )

    def stop(self) -> int:
        """End it as Ctrl-C does; its exit code."""
        self.process.send_signal(signal.SIGINT)
        return self.process.wait(60)


@contextmanager
def page_process(
    folder: Path,
    *arguments: object,
    at: str = ":0",
    program: Path = KINEGRAPH,
    terminal: int | None = None,
    **environment: str,
) -> Iterator[PageProcess]:
    """`kinegraph` with these arguments and a page, at a free port; it is gone afterwards. `terminal`: its standard input and output."""
    log = folder / "output.txt"
    command = [str(program), *map(str, arguments), "--page-at", at]
    with (
        log.open("w") as out,
        subprocess.Popen(
            command,
            cwd=folder,
            stdin=subprocess.DEVNULL if terminal is None else terminal,
            stdout=out if terminal is None else terminal,
            stderr=out,
            text=True,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
        ) as process,
    ):
        try:
            yield PageProcess(process, log)
        finally:
            if process.poll() is None:
                process.kill()


@contextmanager
def a_terminal() -> Iterator[int]:
    """A terminal that discards what is written to it."""
    ours, theirs = os.openpty()

    def show() -> None:
        with suppress(OSError):  # the last program has left it
            while os.read(ours, 65536):
                pass

    thread = threading.Thread(target=show, daemon=True)
    thread.start()
    try:
        yield theirs
    finally:
        os.close(theirs)
        thread.join(5)
        os.close(ours)


def see(client: ClientConnection, *, width_ns: int = 0) -> dict[str, Any]:
    """Look at every stream; returns the session's greeting."""
    hello, _ = decode(client.recv(timeout=PATIENCE_S))
    client.send(json.dumps({"do": "see", "streams": {str(i): width_ns for i in range(len(hello["streams"]))}}))
    return hello


def until(client: ClientConnection, what: str, **like: Any) -> dict[str, Any]:
    """The next message of this kind, the others passed over."""
    end = time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        header, _ = decode(client.recv(timeout=PATIENCE_S))
        if header["t"] == what and all(header.get(k) == v for k, v in like.items()):
            return header
    raise AssertionError(f"no {what} came")
