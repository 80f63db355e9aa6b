"""`kinegraph sleep nights`: what the night's log holds, over weeks, too; draw a report again; export; delete a night."""

from __future__ import annotations

import sys
from datetime import date
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import structlog
import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.time_text import in_hours

if TYPE_CHECKING:
    from kinegraph.devices.reports.night.weeks import NightRow


class Action(StrEnum):
    """What may be done with nights."""

    list = "list"
    report = "report"
    weeks = "weeks"
    export = "export"
    study = "study"
    delete = "delete"


log = structlog.get_logger(__name__)
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")


def nights(
    action: Annotated[
        Action,
        typer.Argument(
            metavar="ACTION",
            help="list all, with trends; draw a night's report again; report on weeks; export one table; "
            "copy nights for a study; delete a night",
        ),
    ] = Action.list,
    names: Annotated[list[str] | None, typer.Argument(metavar="NIGHT", help="such as 2026-11-20, or last")] = None,
    path: Annotated[Path, typer.Option(help="the folder of all nights")] = Path("nights"),
    yes: Annotated[bool, typer.Option("--yes", "-y", help="delete without asking")] = False,
    sleeper: Annotated[str, typer.Option(help="the sleeper's name, if there are several")] = "",
    since: Annotated[str, typer.Option(metavar="DATE", help="weeks, export: the first evening")] = "",
    until: Annotated[str, typer.Option(metavar="DATE", help="weeks, export: the last evening")] = "",
    compare: Annotated[
        list[str] | None,
        typer.Option(metavar="DATE..DATE", help="weeks: a period to be compared; give it twice, the earlier one first"),
    ] = None,
    months: Annotated[bool, typer.Option("--months", help="weeks: by months")] = False,
    free: Annotated[str, typer.Option(help="mornings without work")] = "sat,sun",
    output: Annotated[
        Path | None, typer.Option("-o", "--out", help="weeks: the folder; export: the file; report: one page as PDF")
    ] = None,
    code: Annotated[str, typer.Option(help="study: what the sleeper is called there, such as P01")] = "",
    as_json: AsJson = False,
) -> None:
    """List the nights on this computer, with their trends.

    `report NIGHT` draws one again; `weeks` reports on many and compares periods; `export` writes one table; `study` copies nights under a
    code and on other dates, without names, places and settings; `delete NIGHT` removes a night with all its files.

    kinegraph sleep nights weeks --compare 2026-10-19..2026-11-01 --compare 2026-11-02..2026-11-15
    """
    if not path.is_dir():
        raise KinegraphError(f"there is no folder {path}; name the one of the night's log with --path")
    weekdays = _weekdays(free)
    if action is Action.list:
        _list(path, sleeper, weekdays, as_json)
    elif action is Action.study:
        _study(path, sleeper, names or [], code, output)
    elif action in (Action.weeks, Action.export):
        _over_weeks(
            action,
            path,
            sleeper,
            (_date(since), _date(until)),
            [_period(p) for p in compare or []],
            weekdays,
            months,
            output,
        )
    else:
        _of_single(action, path, names or [], yes, output)


def _of_single(action: Action, path: Path, names: list[str], yes: bool, output: Path | None) -> None:
    """Report or delete."""
    from kinegraph.devices.reports.night import archive

    if not names:
        raise KinegraphError(f"name the night to {action.value}: a date such as 2026-11-20, or last")
    folders = [archive.find(path, name) for name in names]
    if action is Action.report:
        from kinegraph.devices.reports.night.page import draw

        if output is not None:
            _one_page(folders, output)
            return
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
                f"the night {folder.name} is not over; stop kinegraph first, or delete it as it is with --yes"
            )
        if not yes and not sys.stdin.isatty():
            raise KinegraphError(
                f"no terminal to ask for confirmation, so {folder.name} stays; --yes deletes without asking"
            )
        if yes or typer.confirm(f"Delete the night {folder.name} with all its files?"):
            archive.remove(folder)
            say(f"deleted {folder}")


def _study(path: Path, sleeper: str, names: list[str], code: str, output: Path | None) -> None:
    """Copy nights without what identifies the sleeper."""
    from kinegraph.devices.reports.night import archive, study

    chosen = {archive.find(path, name) for name in names}
    of = [(f, facts) for f, facts in archive.nights(path) if facts.sleeper == sleeper and (not names or f in chosen)]
    if not of:
        raise KinegraphError(f"{path} holds no such nights{f' of {sleeper}' if sleeper else ''}")
    for written in study.export(of, code, output or Path("study")):
        say(written)
    say("names, time zone, settings and dates are left out; times of day, weekdays and habits remain")


def _one_page(folders: list[Path], output: Path) -> None:
    """A night as a page to hand over."""
    from kinegraph.devices.reports.night.page import one_page
    from kinegraph.stream.system.atomic_file import private_folder, write_complete

    if len(folders) != 1 or output.suffix != ".pdf":
        raise KinegraphError("-o takes one night and a name that ends in .pdf")
    private_folder(output.absolute().parent)
    write_complete(output, one_page(folders[0]))
    say(output)


def _over_weeks(
    action: Action,
    path: Path,
    sleeper: str,
    span: tuple[date | None, date | None],
    periods: list[tuple[date, date]],
    free: tuple[int, ...],
    months: bool,
    output: Path | None,
) -> None:
    """The report on weeks, or the table of all nights."""
    from kinegraph.devices.reports.night import weeks, weeks_page
    from kinegraph.stream.system.atomic_file import private_folder, write_complete

    if len(periods) not in (0, 2):
        raise KinegraphError("--compare names one period; give it twice, the earlier one first")
    of = weeks.within(_rows(path, sleeper), *span)
    if not of:
        raise KinegraphError(f"{path} holds no nights{f' of {sleeper}' if sleeper else ''} between these days")
    if action is Action.export:
        file = output or Path("nights.csv")
        private_folder(file.absolute().parent)
        write_complete(file, weeks_page.table(of, *span))
        say(file)
        return
    for begin, end in periods:
        if not any(r.kind == "night" for r in weeks.within(of, begin, end)):
            raise KinegraphError(f"no night lies between {begin} and {end}, so there is nothing to compare")
    folder = output or Path("weeks")
    private_folder(folder)
    for written in weeks_page.write(folder, of, free, periods, months=months):
        say(written)


def _rows(path: Path, sleeper: str) -> list[NightRow]:
    from kinegraph.devices.reports.night import archive, weeks

    found = weeks.rows(path, sleeper, lambda error: log.warning("a night is left out", error=str(error)))
    if not found and not sleeper:
        others = sorted({facts.sleeper for _, facts in archive.nights(path)} - {""})
        if others:
            raise KinegraphError(f"these are the nights of {' and '.join(others)}: name one with --sleeper")
    return found


def _date(text: str) -> date | None:
    try:
        return date.fromisoformat(text) if text else None
    except ValueError:
        raise KinegraphError(f"{text!r} is not a date; give one such as 2026-11-20") from None


def _period(text: str) -> tuple[date, date]:
    begin, end = (_date(part) for part in (*text.partition("..")[::2],))
    if begin is None or end is None or end < begin:
        raise KinegraphError(f"{text!r} is not a period; give one such as 2026-11-02..2026-11-15")
    return begin, end


def _weekdays(text: str) -> tuple[int, ...]:
    given = [day.strip().lower()[:3] for day in text.split(",") if day.strip()]
    for day in given:
        if day not in DAYS:
            raise KinegraphError(f"--free is {text!r}; it must name days such as sat,sun")
    return tuple(DAYS.index(day) for day in given)


def _epochs(folder: Path) -> str:
    """How many there are of a night; a damaged table does not hide the other nights."""
    from kinegraph.devices.reports.night import archive

    try:
        return str(len(archive.read_epochs(folder)))
    except archive.NightError:
        return "damaged"


def _list(root: Path, sleeper: str, free: tuple[int, ...], as_json: bool) -> None:
    from rich.table import Table

    from kinegraph.devices.reports.night import archive, weeks, weeks_page
    from kinegraph.stream.text.screen import Screen

    if as_json:
        nights_there = [(folder, facts) for folder, facts in archive.nights(root) if sleeper in ("", facts.sleeper)]
        print_json([{"night": folder.name, "folder": folder, "facts": facts} for folder, facts in nights_there])
        return
    table = Table(
        "night", "kind", "from", "to", "asleep", "efficiency", "epochs", "report", "size", box=None, header_style="bold"
    )
    found = [(f, facts) for f, facts in archive.nights(root) if not sleeper or facts.sleeper == sleeper]
    of = {who: weeks.rows(root, who) for who in sorted({facts.sleeper for _, facts in found})}
    kinds = {r.name: r.kind for rows in of.values() for r in rows}
    lost = {day.isoformat() for rows in of.values() for day in weeks.missing(rows)} if len(of) == 1 else set()
    shown: dict[str, tuple[str, ...]] = {day: (day, "missing") for day in lost}
    for folder, facts in found:
        zone, n = archive.night_zone(facts), facts.numbers
        begin = archive.clock(int(n.get("onset", facts.begun)), zone)
        asleep = in_hours(n.get("tst") or 0) if n else ""
        shown[folder.name] = (
            folder.name, kinds.get(folder.name, ""), f"{begin:%H:%M}",
            f"{archive.clock(int(n['end']), zone):%H:%M}" if n else "goes on" if not facts.closed else "",
            asleep, f"{n['se']:.0f} %" if n and n["se"] is not None else "", _epochs(folder),
            "yes" if (folder / archive.DRAWN[0]).exists() else "no", f"{archive.bytes_of(folder) / 1000:.0f} kB",
        )  # fmt: skip
    for name in sorted(shown) if lost else shown:
        table.add_row(*shown[name])
    console = Screen()
    console.print(table)
    for folder in archive.damaged(root):
        console.print(f"{folder.name}: cannot be read; kinegraph sleep nights delete {folder.name} removes it")
    for who, rows in of.items():
        if sum(r.kind == "night" for r in rows) > 1:
            console.print(f"\n{who or 'Trends'}:", *weeks_page.words(weeks.trend(rows, free)), sep="\n  ")
    naps = sum(kinds.get(folder.name) == "nap" for folder, _ in found)
    counted = [(len(found) - naps, "night"), (naps, "nap")]
    lines = [f"{n} {what}{'' if n == 1 else 's'}" for n, what in counted if n or (what == "night" and not naps)]
    console.print(f"{' and '.join(lines)} in {root}")
