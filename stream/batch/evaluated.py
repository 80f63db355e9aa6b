"""What an evaluation compares: results with references, given one by one, in a table, or as a batch's folder of results."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from kinegraph.stream.batch.sessions import (
    is_results,
    matched,
    named_in,
    open_session,
    recording_name,
    sessions_at,
    settings_of,
    short_name,
)
from kinegraph.stream.errors import KinegraphError

Reference = TypeVar("Reference")


def compared(
    result: Path | None,
    reference: Reference | None,
    table: Path | None,
    rows: Callable[[Path], list[tuple[Path, Reference]]],
    *,
    words: tuple[str, str, str],
    holds: tuple[str, str],
    names: Callable[[list[Path]], list[str]],
) -> list[tuple[str, str, Path, Reference]]:
    """(name, the settings of a batch's job, result, reference) of each that is to be compared. Raises KinegraphError.

    rows   reads a table: results with their references
    words  what the command calls the result, the reference and the table's option: "RESULT", "TRUTH", "--table"
    holds  what a batch's results are of, and what the table says: "recordings", "truth of each recording"
    names  what the results are called, where they are no batch's
    """
    estimate, known, option = words
    if result is None or not is_results(result):
        if (table is None) == (result is None) or (result is None) != (reference is None):
            raise KinegraphError(f"give {estimate} and {known}, or {option} TABLE.csv")
        found = rows(table) if table else []
        if result and reference is not None:
            found = [(result, reference)]
        named = names([made for made, _ in found])
        return [(name, "", *row) for name, row in zip(named, found, strict=True)]
    if (table is None) == (reference is None):
        one = holds[0].removesuffix("s")
        raise KinegraphError(
            f"{result}: results of a batch; give {known} for its one {one}, or {option} TABLE.csv for several"
        )
    if reference is not None:
        recordings = sorted({recording_name(open_session(path)) for path in sessions_at([result])})
        if len(recordings) > 1:
            raise KinegraphError(f"{result}: holds {len(recordings)} {holds[0]}; {option} says {holds[1]}")
        of = {recordings[0]: reference}
    else:
        of = {named_in(table, made): value for made, value in rows(table)} if table else {}
    return [
        (short_name(entry), ", ".join(settings_of(entry)), path, value) for path, entry, value in matched(result, of)
    ]
