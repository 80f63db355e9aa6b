"""`kinegraph emg sessions`: an index of the sessions in a folder."""

from __future__ import annotations

import csv
import sys
from pathlib import Path as File
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say


def sessions(
    folder: Annotated[File, typer.Argument(help="where recordings lie, in it and below", metavar="FOLDER")] = File(),
    output: Annotated[File | None, typer.Option("-o", "--out", help="a CSV file instead of a table")] = None,
    subject: Annotated[str, typer.Option(help="only sessions of this subject")] = "",
    as_json: AsJson = False,
) -> None:
    """List recordings: subject, date, length, facts, gait cycles (accepted and rejected), channels that were not good.

    Cycles and quality are there where the session recorded them (`closed` of cycles or of a review, `quality`). A file that cannot be read
    is listed with the reason. Exit code 0, or 1 where there is no recording at all.
    """
    from kinegraph.operators.emg.commands.session_index import COLUMNS, index
    from kinegraph.stream.data.csv_writer import Sheet
    from kinegraph.stream.system.atomic_file import complete

    if not folder.is_dir():
        raise KinegraphError(f"{folder}: there is no such folder")
    rows = [row for row in index(folder) if not subject or row["subject"] == subject]
    if not rows:
        raise KinegraphError(f"{folder}: there is no recording{f' of {subject}' if subject else ''}")
    if output is not None:
        with complete(output) as draft, draft.open("w", newline="", encoding="utf-8") as file:
            sheet = Sheet(file)
            sheet.writerow(COLUMNS)
            sheet.writerows([row[name] for name in COLUMNS] for row in rows)
        say(f"{output}: {len(rows)} sessions")
        return
    if as_json:
        print_json([{name: row[name] for name in COLUMNS} for row in rows])
        return
    if not sys.stdout.isatty():
        plain = csv.writer(sys.stdout, delimiter="\t", lineterminator="\n")
        plain.writerows([COLUMNS, *([row[name] for name in COLUMNS] for row in rows)])
        return
    _show(rows, COLUMNS)


def _show(rows: list[dict[str, str]], columns: tuple[str, ...]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(box=None, pad_edge=False, header_style="dim")
    for name in columns:
        table.add_column(name)
    for row in rows:
        table.add_row(*(row[name] for name in columns))
    Console().print(table)
