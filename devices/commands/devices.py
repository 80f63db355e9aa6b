"""`kinegraph devices`: what is connected, with the YAML to use it."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.devices.discovery.finders import FoundDevice


def devices(
    kinds: Annotated[
        list[str] | None,
        typer.Argument(
            help="look only for these: serial, usb, ble, lsl, natnet, oak, orbbec, realsense; left out: all",
            metavar="KIND",
        ),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="print JSON")] = False,
) -> None:
    """List what is connected, with the YAML to use it."""
    from kinegraph.devices.discovery.finders import finders, look

    known = finders()
    for kind in kinds or ():
        if kind not in known:
            raise KinegraphError(f"there is no kind of device {kind!r}; {nearest(kind, known)}")
    chosen = {kind: known[kind] for kind in (kinds or known)}
    found: list[FoundDevice] = []
    for kind, finder in chosen.items():
        here, failed = look(finder)
        found += here
        if failed:
            say(f"{kind}: could not be asked: {failed}", err=True)
    if as_json:
        say(json.dumps([asdict(one) for one in found], indent=2))
        return
    for one in found:
        say(_shown(one))
    if not found:
        say(f"nothing is connected (looked for: {', '.join(chosen) or 'nothing'})")
    say(
        "without a device: kinegraph dev simulate lists the simulated ones; kinegraph run CONFIG --simulate",
        err=True,
    )


def _shown(found: FoundDevice) -> str:
    lines = [f"{found.kind}: {found.address}", f"  {found.what}"]
    lines += [f"  {found.note}"] if found.note else []
    lines += [f"      {line}" for line in found.yaml.splitlines()]
    return "\n".join(lines) + "\n"
