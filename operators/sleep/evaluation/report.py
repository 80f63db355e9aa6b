"""A validation on paper: the checklist, the table of persons, and the picture, as one HTML page and as CSV tables."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from pathlib import Path

from kinegraph.operators.sleep.evaluation.checklist import NOT_GIVEN, STUDY, Evaluated, checklist
from kinegraph.operators.sleep.evaluation.comparison import NOTE
from kinegraph.operators.sleep.evaluation.persons import MEASURES, METRICS, by_person
from kinegraph.stream.data.csv_writer import sheet_text
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import complete, private_folder

FILES = ("report.html", "checklist.csv", "persons.csv")
PAGE = """<!doctype html><html lang="en"><head><meta charset="utf-8"><title>Estimated sleep against a reference</title><style>
body{font:14px/1.4 sans-serif;max-width:75em;margin:2em auto;padding:0 1em}table{border-collapse:collapse;margin:1em 0}
td,th{padding:.2em .6em;text-align:left;vertical-align:top;border-bottom:1px solid #ddd}.missing{color:#a3211b}img{max-width:100%}
.wide{overflow-x:auto}</style></head><body>
<h1>Estimated sleep against a reference</h1>
<p>{{ note }}</p>
<h2>Checklist</h2>
<p>After the steps of Menghini et al. 2021 (Sleep 44(2), zsaa170). {{ missing }} of {{ items|length }} items are not given.</p>
<table><tr><th>step</th><th>item</th><th>what was done</th><th>answer</th></tr>
{% for i in items %}<tr><td>{{ i.step }}</td><td>{{ i.item }}</td><td>{{ i.done }}</td>
<td{% if i.answer == none_given %} class="missing"{% endif %}>{{ i.answer }}</td></tr>
{% endfor %}</table>
<h2>Persons</h2>
<p>Of all epochs of a person's nights; differences are the nights' mean of estimate less reference.</p>
<div class="wide"><table><tr>{% for h in head %}<th>{{ h }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for cell in row %}<td>{{ cell }}</td>{% endfor %}</tr>
{% endfor %}</table></div>
<h2>Nights</h2>
<img alt="Bland-Altman plots and hypnograms" src="data:image/png;base64,{{ picture }}">
</body></html>
"""


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
    from jinja2 import Environment

    page = Environment(autoescape=True).from_string(PAGE).render(
        note=NOTE, items=items, none_given=NOT_GIVEN, missing=sum(i.answer == NOT_GIVEN for i in items), head=persons[0],
        rows=shown, picture=_picture(of),
    )  # fmt: skip
    sheet = [("step", "item", "done", "answer"), *((i.step, i.item, i.done, i.answer) for i in items)]
    texts = (page, sheet_text(sheet), sheet_text(persons))
    private_folder(folder)
    for name, text in zip(FILES, texts, strict=True):
        with complete(folder / name) as draft:
            draft.write_text(text, encoding="utf-8")
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


def _picture(of: Evaluated) -> str:
    from kinegraph.operators.sleep.evaluation.pictures import draw

    file = io.BytesIO()
    draw(list(of.pairs)).savefig(file, format="png", dpi=110)
    return base64.b64encode(file.getvalue()).decode("ascii")
