"""A report's tables once more, as an Excel workbook or a MATLAB file."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.system.atomic_file import complete

KINDS = ("xlsx", "mat")
MATLAB_NAME = 63


def missing(kind: str) -> str:
    """What has to be installed before a file of this kind can be written; "" if nothing."""
    return "pip install 'kinegraph[excel]'" if kind == "xlsx" and find_spec("openpyxl") is None else ""


def write_tables(path: Path, tables: Mapping[str, Path]) -> None:
    """The CSV files `tables`, by name, as sheets of an .xlsx or structures of a .mat, whole or not at all. Raises OSError."""
    read = {name: _columns(table) for name, table in tables.items()}
    with complete(path) as draft:
        (_workbook if path.suffix == ".xlsx" else _matlab)(draft, read)


def _columns(table: Path) -> dict[str, list[Any]]:
    """A table's columns: numbers where every cell is one or empty, else texts."""
    with table.open(newline="", encoding="utf-8") as file:
        head, *rows = csv.reader(file)
    return {name: _numbers([row[i] for row in rows]) for i, name in enumerate(head)}


def _numbers(cells: list[str]) -> list[Any]:
    try:
        return [float(cell) if cell else float("nan") for cell in cells]
    except ValueError:
        return list(cells)


def _workbook(draft: Path, tables: Mapping[str, Mapping[str, list[Any]]]) -> None:
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    for name, columns in tables.items():
        sheet = book.create_sheet(name)
        sheet.append(list(columns))
        for row in zip(*columns.values(), strict=True):
            sheet.append([None if isinstance(cell, float) and not np.isfinite(cell) else cell for cell in row])
    with draft.open("wb") as file:
        book.save(file)


def _matlab(draft: Path, tables: Mapping[str, Mapping[str, list[Any]]]) -> None:
    import scipy.io

    made = {}
    for table, columns in tables.items():
        fields: dict[str, Any] = {"columns": np.array(list(columns), object)}
        for name, cells in columns.items():
            fields[_field(name, fields)] = np.array(cells, object if cells and isinstance(cells[0], str) else float)
        made[table] = fields
    scipy.io.savemat(str(draft), made, appendmat=False, do_compression=True, long_field_names=True, oned_as="column")


def _field(name: str, taken: Mapping[str, Any]) -> str:
    """A column's name as MATLAB allows it, which no other field has; `columns` holds the names as they are."""
    plain = re.sub(r"\W+", "_", name).strip("_")[: MATLAB_NAME - 3]
    plain = plain if plain[:1].isalpha() else f"c_{plain}"
    field, count = plain, 1
    while field in taken:
        count += 1
        field = f"{plain}_{count}"
    return field
