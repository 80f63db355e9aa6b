"""Options of every command that serves a page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

PageAt: TypeAlias = Annotated[
    str,
    typer.Option(metavar="HOST:PORT", help="serve the page there"),
]
PageCertificate: TypeAlias = Annotated[str, typer.Option(metavar="FILE", help="encrypt the page with this certificate")]
PageKey: TypeAlias = Annotated[str, typer.Option(metavar="FILE", help="the certificate's key")]
NoToken: TypeAlias = Annotated[
    bool,
    typer.Option("--no-token", help="serve the page to every account of this machine: its address holds no token"),
]
PageAvatar: TypeAlias = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="the avatar on the page: your own VRM file; default: one that comes with it"),
]
PageFor: TypeAlias = Annotated[
    float, typer.Option("--for", metavar="SECONDS", min=0.0, help="end after this many seconds; 0: at Ctrl-C")
]
