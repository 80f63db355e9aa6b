"""`kinegraph lab`: set up, run and finish sessions in a browser."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.page_options import NoToken, PageFor


def lab(
    home: Annotated[
        Path, typer.Argument(help="the folder of sessions, presets and graphs of your own", metavar="[FOLDER]")
    ] = Path("lab"),
    at: Annotated[str, typer.Option(metavar="HOST:PORT", help="serve it there")] = "",
    no_token: NoToken = False,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open it in a browser")] = True,
    duration_s: PageFor = 0.0,
) -> None:
    """Set up, run and finish sessions in a browser; no YAML is needed.

    A session runs in a process of its own, as with `kinegraph run`: it goes on when the lab or the browser ends, and the next lab in the
    same folder finds it.
    """
    import asyncio

    from kinegraph.devices.lab.app import serve
    from kinegraph.devices.page.address import parsed
    from kinegraph.devices.page.serving import refuse_unbuilt
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.errors import KinegraphError
    from kinegraph.stream.system.atomic_file import private_folder

    logs.set_up()
    if os.name == "nt":
        raise KinegraphError("the lab needs Linux or macOS: Windows has no lock that a session's process can inherit")
    refuse_unbuilt()
    address = parsed(at or f":{DEFAULT_PORT}", no_token=no_token)
    if home.exists() and not home.is_dir():
        raise KinegraphError(f"{home} is a file; name the folder of your sessions, or one to be made")
    private_folder(home)
    asyncio.run(serve(home.resolve(), address, duration_s=duration_s, browser=browser))


DEFAULT_PORT = 7780
