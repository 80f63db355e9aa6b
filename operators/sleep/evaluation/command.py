"""`kinegraph sleep evaluate`: estimated sleep against reference hypnograms."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.sleep.evaluation.comparison import Pair


def evaluate(
    estimate: Annotated[
        File | None,
        typer.Argument(
            metavar="ESTIMATE",
            help="a night's hypnogram.edf, its epochs.csv, a recording, or results of `kinegraph batch`",
        ),
    ] = None,
    reference: Annotated[File | None, typer.Argument(metavar="REFERENCE", help="the hypnogram: EDF+ or CSV")] = None,
    nights: Annotated[
        File | None,
        typer.Option(
            metavar="CSV",
            help="many nights: columns estimate, reference, person, offset_s (the last two may be missing); of a batch: "
            "its recordings",
        ),
    ] = None,
    offset: Annotated[
        float, typer.Option(metavar="SECONDS", help="added to the reference's times (its clock was late)")
    ] = 0.0,
    stream: Annotated[str, typer.Option(help="the scored epochs in a recording [default: the only ones]")] = "",
    epoch_s: Annotated[
        float, typer.Option(min=1.0, max=300.0, help="epoch length of CSV tables that do not say")
    ] = 30.0,
    output: Annotated[File | None, typer.Option("-o", "--out", help="folder for agreement.png and nights.csv")] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files that exist")] = False,
    report: Annotated[
        File | None,
        typer.Option(help="folder for report.html, checklist.csv (Menghini 2021) and persons.csv"),
    ] = None,
    study: Annotated[
        File | None,
        typer.Option(metavar="CSV", help="what the report cannot know: columns item, answer"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Sensitivity, specificity, kappa, and Bland-Altman limits of TST, SOL and WASO, against a reference hypnogram.

    kinegraph sleep evaluate nights/2026-11-20/hypnogram.edf psg.edf --offset -12 -o agreement

    kinegraph sleep evaluate results --nights nights.csv

    kinegraph sleep evaluate --nights nights.csv --report validation --study study.csv

    Of a batch's results every job is evaluated, and each combination of settings has its own tables.

    Where the reference's EDF has an effort belt and the estimate breathing rates, these are compared, too.

    An EDF file says no time zone: both then go by the clock on the wall. epochs.csv and recordings are in UTC.
    """
    from kinegraph.operators.sleep.evaluation.comparison import NOTE, results, tables
    from kinegraph.operators.sleep.evaluation.effort import HEADER, breath_agreement
    from kinegraph.stream.text.screen import Screen

    pairs: list[Pair] = []
    groups: dict[str, list[Pair]] = {}
    wanted = _wanted(estimate, reference, nights, offset)
    answers = _study(wanted, report, study, overwrite)
    for name, settings, e, (r, person, late) in wanted:
        pairs.append(_pair(name, e, r, person, late, stream, epoch_s))
        groups.setdefault(settings, []).append(pairs[-1])
    found = [breath_agreement(name, e, r, late) for name, _, e, (r, _, late) in wanted]
    breath = [one for one in found if one is not None]
    if as_json:
        more = {"breath": [asdict(one) for one in breath]} if breath else {}
        print_json([{"settings": settings, **results(of), **more} for settings, of in groups.items()])
    console = Screen(stderr=as_json)
    for settings, of in groups.items() if not as_json else ():
        if settings:
            console.print(settings, style="bold", markup=False)
        for table in tables(of):
            console.print(table)
            console.print()
    if breath and not as_json:
        from rich.table import Table

        table = Table(*HEADER, box=None, title="Breathing beside the effort belt", title_justify="left")
        for one in breath:
            table.add_row(*one.row())
        console.print(table)
        console.print()
    console.print(NOTE)
    if output:
        _write(pairs, output, overwrite)
    if report:
        _report(pairs, wanted, answers, nights, report)


Wanted: TypeAlias = tuple[str, str, File, tuple[File, str, float]]
"""A name, the settings of a batch's job, the estimate; the reference, who slept, and seconds that are added to the reference's times."""


def _wanted(estimate: File | None, reference: File | None, nights: File | None, offset: float) -> list[Wanted]:
    """What is to be compared with what. Raises KinegraphError."""
    from kinegraph.stream.batch.evaluated import compared

    return compared(
        estimate,
        (reference, "", offset) if reference else None,
        nights,
        _rows,
        words=("ESTIMATE", "REFERENCE", "--nights"),
        holds=("nights", "which reference belongs to which estimate"),
        names=lambda paths: [path.stem for path in paths],
    )


def _pair(
    name: str, estimate: File, reference: File, person: str, offset_s: float, stream: str, epoch_s: float
) -> Pair:
    from kinegraph.operators.sleep.evaluation.comparison import pair
    from kinegraph.operators.sleep.evaluation.reference import read_hypnogram

    found = read_hypnogram(estimate, stream=stream, epoch_s=epoch_s)
    truth = read_hypnogram(reference, epoch_s=epoch_s)
    for path, read in ((estimate, found), (reference, truth)):
        if read.damage:
            say(f"{path} is damaged, and what is intact was read: {read.damage}", err=True)
    if found.dated and truth.dated and found.zoned != truth.zoned:
        bare, shift = (reference, -3600) if found.zoned else (estimate, 3600)
        note = f"{bare} gives no time zone; UTC is assumed; --offset {shift} if its clock was an hour ahead of UTC"
        say(note, err=True)
    return pair(name, person or name, found, truth, offset_s)


def _rows(table: File) -> list[tuple[File, tuple[File, str, float]]]:
    """The nights that a table names; files are looked for beside it."""
    made = []
    for line, row in read_records(table):
        if why := (row.get("exclude") or "").strip():
            say(f"left out: {row.get('estimate') or f'line {line}'}: {why}")
            continue
        try:
            offset_s = float(row.get("offset_s") or 0.0)
            side = table.parent / row["reference"], row.get("person") or "", offset_s
            made.append((table.parent / row["estimate"], side))
        except (KeyError, TypeError, ValueError):
            raise KinegraphError(
                f"{table}, line {line}: must name estimate and reference, and if needed person and offset_s (a number)"
            ) from None
    if not made:
        raise KinegraphError(f"{table}: names no nights")
    return made


def _study(wanted: list[Wanted], report: File | None, study: File | None, overwrite: bool) -> dict[str, str]:
    """What the study's table says; whether there can be a report is known before anything is reckoned. Raises KinegraphError."""
    from kinegraph.operators.sleep.evaluation.report import free, read_study

    if report is None:
        if study:
            raise KinegraphError(f"{study}: belongs to a report; --report names its folder")
        return {}
    if len(settings := {one[1] for one in wanted}) > 1:
        raise KinegraphError(
            f"a report is of one combination of settings, and here are {len(settings)}: {'; '.join(sorted(settings))}"
        )
    free(report, overwrite)
    return read_study(study) if study else {}


def _report(
    pairs: list[Pair], wanted: list[Wanted], answers: dict[str, str], nights: File | None, folder: File
) -> None:
    from kinegraph.operators.sleep.evaluation.checklist import Evaluated
    from kinegraph.operators.sleep.evaluation.report import write_report

    rows = [row for _, row in read_records(nights)] if nights else []
    left_out = [(row.get("estimate") or "", why) for row in rows if (why := (row.get("exclude") or "").strip())]
    for path in write_report(Evaluated(pairs, answers, [one[-1][-1] for one in wanted], left_out), folder):
        say(str(path))


def _write(pairs: list[Pair], folder: File, overwrite: bool) -> None:
    from kinegraph.operators.sleep.evaluation.comparison import write_table
    from kinegraph.operators.sleep.evaluation.pictures import draw

    picture, sheet = folder / "agreement.png", folder / "nights.csv"
    for path in (picture, sheet):
        if path.exists() and not overwrite:
            raise KinegraphError(f"{path} exists; --overwrite replaces it, --out names another folder")
    private_folder(folder)
    draw(pairs).savefig(picture, dpi=130)
    write_table(pairs, sheet)
    say(f"{picture}\n{sheet}")
