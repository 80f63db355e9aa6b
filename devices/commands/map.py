"""`kinegraph motion map`: recordings of motion in a browser, on a map of all their poses."""

from __future__ import annotations

import asyncio
import hashlib
import os
from importlib.metadata import entry_points
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.cli.commands.page_options import NoToken, PageAt, PageCertificate, PageFor, PageKey
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.devices.page.address import Address
    from kinegraph.devices.page.map.hub import MapHub


def map_(
    recordings: Annotated[
        list[Path],
        typer.Argument(
            help="recordings of markers or poses, or one map of `kinegraph motion train map`", metavar="RECORDING"
        ),
    ],
    markers: Annotated[
        Path | None, typer.Option(metavar="FILE", help="YAML: which markers, as for `motion train map`")
    ] = None,
    origin: Annotated[str, typer.Option(help="without --markers: the marker that positions are relative to")] = "",
    ahead: Annotated[str, typer.Option(help="without --markers: the marker that is turned ahead")] = "",
    rate_hz: Annotated[float, typer.Option(min=1.0, max=1000.0, help="poses per second")] = 60.0,
    page_at: PageAt = "",
    page_certificate: PageCertificate = "",
    page_key: PageKey = "",
    no_token: NoToken = False,
    duration_s: PageFor = 0.0,
) -> None:
    """Explore recorded motion on a map, in a browser.

    It shows which poses there are, how sequences run through them, and what resembles what (thesis, chapter 5).

    kinegraph motion map horses/*.mcap --markers horse.yaml

    The map is trained once and kept; it is trained again when a recording or the table has changed. A map that `kinegraph motion train map`
    has made can be given in the recordings' place.
    """
    from kinegraph.devices.page.address import parsed
    from kinegraph.devices.page.map.hub import MapHub
    from kinegraph.devices.page.serving import refuse_unbuilt
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.domain.pose_map import MotionIndex

    logs.set_up()
    address = parsed(page_at, page_certificate, page_key, no_token=no_token)
    address.check()
    refuse_unbuilt()
    kept = recordings[0] if len(recordings) == 1 and recordings[0].suffix == ".npz" else None
    if kept is None:
        kept = trained(recordings, {"markers": markers, "origin": origin, "ahead": ahead, "rate_hz": rate_hz})
    name = recordings[0].stem if len(recordings) == 1 else f"{recordings[0].stem} and {len(recordings) - 1} more"
    asyncio.run(_serve(MapHub(MotionIndex.read(kept), kept, name), address, duration_s))


def trained(recordings: list[Path], options: dict[str, Any]) -> Path:
    """The map of these recordings; made now unless a valid one exists."""
    import platformdirs

    from kinegraph.stream.recording.format.paths import parts_of

    lines = [repr(sorted((k, str(v)) for k, v in options.items()))]
    files = [part for path in recordings for part in (parts_of(path) or [path])]
    for path in [*files, *([options["markers"]] if options["markers"] else [])]:
        try:
            found = Path(path).stat()
            lines.append(f"{Path(path).absolute()} {found.st_size} {found.st_mtime_ns}")
        except OSError as error:
            raise KinegraphError(f"{path}: cannot be read: {error.strerror}") from None
    folder = Path(os.environ.get("KINEGRAPH_CACHE", platformdirs.user_cache_dir("kinegraph"))) / "maps"
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    kept = folder / f"{hashlib.sha256(chr(10).join(lines).encode()).hexdigest()[:24]}.npz"
    if kept.exists():
        return kept
    for training in entry_points(group="kinegraph.commands", name="motion.train.map"):
        training.load()(
            recordings=recordings, output=kept, rows=12, columns=12, seed=0, overwrite=False, **options,
        )  # fmt: skip
    return kept


async def _serve(hub: MapHub, address: Address, duration_s: float) -> None:
    from kinegraph.devices.page.map.requests import wanted
    from kinegraph.devices.page.serving import PageServer, tls_context

    server = PageServer(hub, lambda: "# EOF\n", files=FILES, understand=wanted)
    port = await server.open(address.host, address.port, address.token, tls_context(address.certificate, address.key))
    say(f"page: {address.url(port)} (Ctrl-C ends it)", err=True)
    searching = asyncio.create_task(hub.search())
    try:
        await asyncio.sleep(duration_s or 1e9)
    finally:
        searching.cancel()
        await asyncio.gather(searching, return_exceptions=True)
        await server.close()


FILES = {
    "/": ("map.html", "text/html; charset=utf-8"),
    "/map.js": ("map.js", "text/javascript; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
}
