"""Further clients of a page, in a process of their own: people look from machines of their own, and these take no turn from the session.

    python -m bench.page_clients ws://127.0.0.1:7790/socket 19

They look at all streams and take every message until the standard input is closed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from websockets.exceptions import ConnectionClosed, InvalidMessage
from websockets.sync.client import connect

from bench.page_session import HOUSE, looks

NICE = 19


@contextmanager
def company(url: str, count: int) -> Iterator[None]:
    """So many clients, until it is left."""
    if not count:
        yield
        return
    command = [sys.executable, "-m", "bench.page_clients", url, str(count)]
    with subprocess.Popen(command, cwd=HOUSE, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin and process.stdout
        try:
            process.stdout.readline()  # all of them are connected
            yield
        finally:
            process.stdin.close()
            process.wait(30)


def drain(url: str, connected: threading.Semaphore) -> None:
    with suppress(ConnectionClosed, InvalidMessage, OSError):
        client = connect(url, max_size=None, compression=None, ping_interval=None)
        looks(client, 0)
        connected.release()
        for _ in client:
            pass


def main(url: str, count: str) -> None:
    os.nice(NICE)
    connected = threading.Semaphore(0)
    for _ in range(int(count)):
        threading.Thread(target=drain, args=(url, connected), daemon=True).start()
    for _ in range(int(count)):
        connected.acquire(timeout=60)
    print(flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main(*sys.argv[1:])
