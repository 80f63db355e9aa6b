"""`kinegraph view`: a recording in a browser, with a time line of all its streams."""

from __future__ import annotations

import asyncio
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.page_options import NoToken, PageAt, PageAvatar, PageCertificate, PageFor, PageKey
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.devices.page.address import Address
    from kinegraph.devices.page.recorded.viewing import RecordingHub


FOR_CLIENTS = 192 << 20
"""Bytes for threads and for what waits for clients, beside those that reading a file may take."""


def view(
    recording: Annotated[
        Path, typer.Argument(help="a recording: an .mcap file, or a session's folder", metavar="FILE")
    ],
    page_at: PageAt = "",
    page_certificate: PageCertificate = "",
    page_key: PageKey = "",
    no_token: NoToken = False,
    avatar: PageAvatar = None,
    duration_s: PageFor = 0.0,
) -> None:
    """Open a recording in a browser: scrub through all its streams, see gaps and annotations."""
    from kinegraph.devices.page.address import parsed
    from kinegraph.devices.page.avatar_file import checked_avatar
    from kinegraph.devices.page.recorded.viewing import RecordingHub
    from kinegraph.devices.page.serving import refuse_unbuilt
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.data.bounded import reading, room
    from kinegraph.stream.errors import RecordingError
    from kinegraph.stream.recording import Recording
    from kinegraph.stream.system.memory_limit import limited

    logs.set_up()
    address = parsed(page_at, page_certificate, page_key, no_token=no_token)
    address.check()
    refuse_unbuilt()
    shown = checked_avatar(avatar).read_bytes()
    if not recording.exists():
        raise RecordingError(f"{recording}: there is no such recording")
    with limited(room(recording) + FOR_CLIENTS), ExitStack() as stack:
        with reading(recording, "a recording that can be shown"):
            opened = stack.enter_context(Recording.open(recording))
            hub = RecordingHub(opened, asks_avatar=avatar is not None)
        asyncio.run(_serve(hub, address, duration_s, shown))


async def _serve(hub: RecordingHub, address: Address, duration_s: float, avatar: bytes) -> None:
    from kinegraph.devices.page.metrics import openmetrics
    from kinegraph.devices.page.serving import PageServer, tls_context

    def metrics() -> str:
        return openmetrics(hub.recording.path.name, hub.metrics(), len(hub.clients), 0)

    server = PageServer(hub, metrics, avatar=avatar)
    port = await server.open(address.host, address.port, address.token, tls_context(address.certificate, address.key))
    say(f"page: {address.url(port)} (Ctrl-C ends it)", err=True)
    loop = asyncio.get_running_loop()
    building = asyncio.create_task(asyncio.to_thread(hub.build, lambda message: _in(loop, hub, message)))
    try:
        await asyncio.sleep(duration_s or 1e9)
    finally:
        building.cancel()
        await server.close()
        await hub.close()


def _in(loop: asyncio.AbstractEventLoop, hub: RecordingHub, message: bytes) -> None:
    loop.call_soon_threadsafe(hub.tell, message)
