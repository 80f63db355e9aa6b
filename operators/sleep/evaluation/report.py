"""A validation on paper: the checklist, the table of persons, and the picture, as one HTML page and as CSV tables."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from markupsafe import Markup

from kinegraph.operators.sleep.evaluation.checklist import NOT_GIVEN, STUDY, Evaluated, checklist
from kinegraph.operators.sleep.evaluation.comparison import NOTE
from kinegraph.operators.sleep.evaluation.persons import MEASURES, METRICS, by_person
from kinegraph.stream.data.csv_writer import sheet_text
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete
from kinegraph.stream.text import report

FILES = ("report.html", "checklist.csv", "persons.csv")


def read_study(path: Path) -> dict[str, str]:
    """A table with the columns item and answer, as answers to `STUDY`. Raises KinegraphError."""
    answers = {}
    for line, row in read_records(path):
        key = (row.get("item") or "").strip()
        if key not in STUDY or key in answers:
            what = "is there twice" if key in answers else f"must be one of {', '.join(STUDY)}"
            raise KinegraphError(f"{path}, line {line}: item {key!r} {what}")
        answers[key] = (row.get("answer") or "").strip()
    return answers


def free(folder: Path, overwrite: bool) -> None:
    """Raises KinegraphError where a file of the report is there that may not be replaced."""
    for name in FILES:
        if (folder / name).exists() and not overwrite:
            raise KinegraphError(f"{folder / name} exists; --overwrite replaces it, --report names another folder")


def write_report(of: Evaluated, folder: Path) -> list[Path]:
    """Write `FILES` into a folder. Raises OSError."""
    items, persons = checklist(of), _persons(of)
    shown = [[f"{cell:.3f}" if isinstance(cell, float) else str(cell) for cell in row] for row in persons[1:]]
    shown = [[NOT_GIVEN if cell == "nan" else cell for cell in row] for row in shown]
    page = report.render(
        Path(__file__).with_name("page.html.j2"),
        "Estimated sleep against a reference",
        note=NOTE,
        items=items,
        none_given=NOT_GIVEN,
        missing=sum(i.answer == NOT_GIVEN for i in items),
        head=persons[0],
        rows=shown,
        picture=_picture(of),
    )
    sheet = [("step", "item", "done", "answer"), *((i.step, i.item, i.done, i.answer) for i in items)]
    texts = (page, sheet_text(sheet), sheet_text(persons))
    private_folder(folder)
    for name, text in zip(FILES, texts, strict=True):
        write_complete(folder / name, text)
    return [folder / name for name in FILES]


def _persons(of: Evaluated) -> list[Sequence[object]]:
    """A head, and a row for each person."""
    differences = [f"{name} difference ({unit})" for name, unit in MEASURES.values()]
    head = ["person", "nights", "epochs", "unknown", *(name.replace("_", " ") for name in METRICS), *differences]
    rows: list[Sequence[object]] = [head]
    for one in by_person(of.pairs):
        metrics = [one.metric(name) for name in METRICS]
        rows.append(
            [one.name, one.nights, one.confusion.epochs, one.confusion.unknown, *metrics, *one.differences.tolist()]
        )
    return rows


def _picture(of: Evaluated) -> Markup:
    from kinegraph.operators.sleep.evaluation.pictures import draw

    return report.png(draw(list(of.pairs)), "Bland-Altman plots and hypnograms")
