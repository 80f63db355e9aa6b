"""Serves the application of a lab or a ward at an address, with its token, until Ctrl-C; opens the browser."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Callable
from contextlib import suppress

import uvicorn
from starlette.types import ASGIApp

from kinegraph.devices.page.access import Access, is_loopback
from kinegraph.devices.page.address import Address
from kinegraph.stream.cli.commands.demo import show
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say


async def serve_app(
    make: Callable[[Access], ASGIApp], name: str, after: str, address: Address, *, duration_s: float, browser: bool
) -> None:
    """Serve what `make` returns until Ctrl-C, or for `duration_s`; `after`: what continues after Ctrl-C."""
    listens = listening(address, name)
    port = listens.getsockname()[1]
    app = make(Access(address.token, port, here=is_loopback(address.host)))
    config = uvicorn.Config(
        app, log_config=None, access_log=False, server_header=False, lifespan="off", ws="websockets-sansio", timeout_graceful_shutdown=1
    )  # fmt: skip
    server = uvicorn.Server(config)
    say(f"{name}: {address.url(port)} (Ctrl-C ends it; {after})", err=True)
    if browser:
        show(address.url(port))
    serving = asyncio.create_task(server.serve(sockets=[listens]))
    with suppress(asyncio.TimeoutError):
        await asyncio.wait_for(asyncio.shield(serving), duration_s or None)
    server.should_exit = True
    await serving


def listening(address: Address, name: str) -> socket.socket:
    """A socket at the address; at any free port where that one is taken."""
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    for port in (address.port, 0):
        made = socket.socket(family, socket.SOCK_STREAM)
        made.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            made.bind((address.host, port))
            made.listen()
        except OSError as error:
            made.close()
            if not port:
                raise KinegraphError(
                    f"the {name} cannot be served at {address.host}: {error.strerror or error}"
                ) from None
            continue
        return made
    raise KinegraphError("no port is free")
