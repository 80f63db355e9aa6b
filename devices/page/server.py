"""The process that serves a session's page: it hears the session on its standard input, and asks on its standard output."""

from __future__ import annotations

import asyncio
import os
import signal
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import msgspec

from kinegraph.devices.page.hub import Hub
from kinegraph.devices.page.metrics import openmetrics
from kinegraph.devices.page.serving import PageServer, tls_context
from kinegraph.devices.page.transfer.wire import LENGTH, MAX_BYTES, OPTIONS, decode
from kinegraph.stream.cli.commands import logs


def say(asked: dict[str, Any]) -> None:
    """Ask the session for something, one line of JSON each; where it is gone, so is what `read_session` reads, and this process ends."""
    with suppress(OSError):
        os.write(1, msgspec.json.encode(asked) + b"\n")


async def read_session(hub: Hub, first: asyncio.Event) -> None:
    """Hear the session until it closes the pipe."""
    reader = asyncio.StreamReader(limit=1 << 20)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin.buffer)
    try:
        while True:
            (length,) = LENGTH.unpack(await reader.readexactly(LENGTH.size))
            if length > MAX_BYTES:
                return
            hub.receive(*decode(await reader.readexactly(length)))
            first.set()
    except asyncio.IncompleteReadError:
        return


async def main(options: dict[str, Any]) -> None:
    """Serve until the session ends, and a little longer, so that clients hear of it."""
    hub, first = Hub(say), asyncio.Event()
    reading = asyncio.create_task(read_session(hub, first))
    await asyncio.wait([reading, asyncio.create_task(first.wait())], return_when=asyncio.FIRST_COMPLETED)
    server = PageServer(
        hub,
        lambda: openmetrics(hub.hello.get("name", ""), hub.table, len(hub.clients), hub.dropped),
        avatar=Path(options["avatar"]).read_bytes(),
        reports=lambda: hub.reports,
    )
    tls = tls_context(options["certificate"], options["key"])
    port = await server.open(options["host"], options["port"], options["token"], tls)
    say({"do": "listen", "port": port})
    await reading
    hub.receive({"t": "tick"}, memoryview(b""))
    await asyncio.sleep(0.3)
    with suppress(TimeoutError):  # a client that reads nothing has not heard that this is the end
        await asyncio.wait_for(server.close(), 2)


if __name__ == "__main__":
    logs.set_up()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the session, which then ends us
    asyncio.run(main(msgspec.json.decode(os.environ.pop(OPTIONS))))
