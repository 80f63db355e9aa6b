"""`kinegraph nights`: what the night's log holds; draw a report again; delete a night."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from stream.errors import KinegraphError
from stream.plain import say


class Action(StrEnum):
    """What may be done with nights."""

    list = "list"
    report = "report"
    delete = "delete"


def nights(
    action: Annotated[
        Action, typer.Argument(help="list all; draw a night's report again; delete a night")
    ] = Action.list,
    names: Annotated[list[str] | None, typer.Argument(metavar="NIGHT...", help="such as 2026-11-20, or last")] = None,
    path: Annotated[Path, typer.Option(help="the folder of all nights")] = Path("nights"),
    yes: Annotated[bool, typer.Option("--yes", "-y", help="delete without asking")] = False,
) -> None:
    """The nights on this computer: a table of them; `report NIGHT` draws one again; `delete NIGHT` removes it with all its files.

    kinegraph nights delete 2026-11-20
    """
    from devices.outlets.night import archive

    if not path.is_dir():
        raise KinegraphError(f"there is no folder {path}; name the one of the night's log with --path")
    if action is Action.list:
        _list(path)
        return
    if not names:
        raise KinegraphError(f"name the night to {action.value}: a date such as 2026-11-20, or last")
    folders = [archive.find(path, name) for name in names]
    if action is Action.report:
        from devices.outlets.night.page import draw

        failed = []
        for folder in folders:
            try:
                say(draw(folder))
            except KinegraphError as error:
                failed.append(str(error))
        if failed:
            raise KinegraphError("\n".join(failed))
        return
    broken = archive.damaged(path)
    for folder in folders:
        if folder not in broken and not archive.Facts.load(folder).closed and not yes:
            raise KinegraphError(
                f"the night {folder.name} is not over; stop kinegraph first, or delete what there is of it with --yes"
            )
        if not yes and not sys.stdin.isatty():
            raise KinegraphError(f"nobody is there to be asked, so {folder.name} stays; --yes deletes without asking")
        if yes or typer.confirm(f"Delete the night {folder.name} with all its files?"):
            archive.remove(folder)
            say(f"deleted {folder}")


def _epochs(folder: Path) -> str:
    """How many there are of a night; a damaged table does not hide the other nights."""
    from devices.outlets.night import archive

    try:
        return str(len(archive.read_epochs(folder)))
    except archive.NightError:
        return "damaged"


def _list(root: Path) -> None:
    from rich.table import Table

    from devices.outlets.night import archive
    from stream.screen import Screen

    table = Table(
        "night", "from", "to", "asleep", "efficiency", "epochs", "report", "size", box=None, header_style="bold"
    )
    found = archive.nights(root)
    for folder, facts in found:
        zone, n = archive.night_zone(facts), facts.numbers
        begin = archive.clock(int(n.get("onset", facts.begun)), zone)
        minutes = round(n.get("tst") or 0)
        asleep = f"{minutes // 60} h {minutes % 60:02d} min" if n else ""
        table.add_row(
            folder.name, f"{begin:%H:%M}", f"{archive.clock(int(n['end']), zone):%H:%M}" if n else "goes on" if not facts.closed else "",
            asleep, f"{n['se']:.0f} %" if n and n["se"] is not None else "", _epochs(folder),
            "yes" if (folder / archive.DRAWN[0]).exists() else "no", f"{archive.bytes_of(folder) / 1000:.0f} kB",
        )  # fmt: skip
    console = Screen()
    console.print(table)
    for folder in archive.damaged(root):
        console.print(f"{folder.name}: cannot be read; kinegraph nights delete {folder.name} removes it")
    console.print(f"{len(found)} night{'' if len(found) == 1 else 's'} in {root}")
