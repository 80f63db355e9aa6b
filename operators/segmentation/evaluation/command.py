"""`kinegraph motion evaluate`: actions and repetitions that were found against annotations."""

from __future__ import annotations

from dataclasses import asdict
from math import isfinite
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.data.csv_writer import Sheet
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.operators.segmentation.evaluation.as_in_thesis import ThesisScores
    from kinegraph.operators.segmentation.evaluation.found import Found
    from kinegraph.operators.segmentation.evaluation.scores import Scores
    from kinegraph.operators.segmentation.evaluation.truth import Truth

SHOWN = {
    "f1": "boundary F1 within 1 s",
    "precision": "precision",
    "recall": "recall",
    "covering": "covering",
    "strict": "frames, strict",
    "tolerant": "frames, tolerant",
    "repetitions": "repetitions, mean error",
    "within_1": "repetitions within +-1",
    "count_error": "repetitions, error as a share",
    "distance_s": "start and end to next cut (s)",
    "overlap": "overlap with one unit",
    "key_place": "key point's place",
    "key_sd": "key point's circular sd",
}
AS_IN_THESIS = {
    "strict": "frames by cluster, strict",
    "tolerant": "frames by cluster, tolerant",
    "matched": "frames, one cluster a label",
    "clusters": "clusters",
    "variance": "variance in clusters (eq. 2.5)",
    "variance_sd": "its sd over clusters",
    "distance": "start and end to next cut (1/30 s)",
    "distance_sd": "its sd",
    "overlap": "overlap with one unit",
    "overlap_sd": "its sd",
    "key_place": "key point's place",
    "key_sd": "key point's sd",
}


def evaluate(
    result: Annotated[
        File | None,
        typer.Argument(
            metavar="RESULT", help="a recording with segments, a CSV of them, or results of `kinegraph batch`"
        ),
    ] = None,
    truth: Annotated[File | None, typer.Argument(metavar="TRUTH", help="annotations: CSV or NPZ")] = None,
    table: Annotated[
        File | None,
        typer.Option(
            metavar="CSV",
            help="many recordings: columns result, truth, offset_s (may be missing); of a batch: its recordings",
        ),
    ] = None,
    offset: Annotated[float, typer.Option(metavar="SECONDS", help="added to the annotations' times")] = 0.0,
    node: Annotated[str, typer.Option(help="the node whose segments these are, if there are several")] = "",
    features: Annotated[str, typer.Option(help="the recorded stream that was segmented: draws the matrix")] = "",
    radius: Annotated[
        float, typer.Option(min=0.0, help="of the matrix, in the features' unit [default: as it was found]")
    ] = 0.0,
    output: Annotated[File | None, typer.Option("-o", "--out", help="folder for the pictures and scores.csv")] = None,
    as_in_thesis: Annotated[
        bool,
        typer.Option("--as-in-thesis", help="the thesis's own measures instead; variances need --features"),
    ] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files that exist")] = False,
    as_json: AsJson = False,
) -> None:
    """Boundary F1, covering, accuracy and repetitions against annotations, with a picture of each recording.

    kinegraph motion evaluate walk.mcap walk.csv --features stack -o scores

    kinegraph motion evaluate results --table truth.csv

    Of a batch's results every job is evaluated, and each combination of settings has its own mean.
    """
    from kinegraph.operators.segmentation.evaluation.as_in_thesis import thesis_means, thesis_scores
    from kinegraph.operators.segmentation.evaluation.found import read_found
    from kinegraph.operators.segmentation.evaluation.picture import draw
    from kinegraph.operators.segmentation.evaluation.scores import intervals, score
    from kinegraph.operators.segmentation.evaluation.truth import read_truth
    from kinegraph.stream.text.screen import Screen

    if not isfinite(offset):
        raise KinegraphError(f"--offset {offset}: must be a number of seconds")
    wanted = _wanted(result, truth, table, offset)
    scores: dict[str, Scores] = {}
    groups: dict[str, dict[str, Scores]] = {}
    as_printed: dict[str, ThesisScores] = {}
    for name, settings, made, (annotated, late) in wanted:
        found, known = read_found(made, node, features), read_truth(annotated, late)
        _meet(made, found, annotated, known)
        if as_in_thesis:
            as_printed[name] = thesis_scores(found, known)
            continue
        scores[name] = groups.setdefault(settings, {})[name] = score(found, known)
        if output:
            picture = f"{name.replace('/', '_')}.png"
            _save(output, picture, overwrite)
            draw(name, found, known, radius or float("nan")).savefig(output / picture, dpi=120)
    if as_in_thesis:
        _show_as_in_thesis(as_printed, thesis_means(list(as_printed.values())), as_json)
        return
    if as_json:
        means = {settings: intervals(list(of.values())) for settings, of in groups.items()}
        print_json({"recordings": scores, "mean_and_95_percent_interval": means})
    for settings, of in groups.items() if not as_json else ():
        Screen().print(_summary(of, settings))
    if output:
        _save(output, "scores.csv", overwrite)
        _sheet(output / "scores.csv", scores)
        say(str(output), err=as_json)


def _wanted(
    result: File | None, truth: File | None, table: File | None, offset: float
) -> list[tuple[str, str, File, tuple[File, float]]]:
    """What is to be compared with what: a name, the settings of a batch's job, the result; its truth, and seconds added to that."""
    from kinegraph.stream.batch.evaluated import compared

    return compared(
        result,
        (truth, offset) if truth else None,
        table,
        _rows,
        words=("RESULT", "TRUTH", "--table"),
        holds=("recordings", "which truth belongs to which result"),
        names=_names,
    )


def _meet(made: File, found: Found, annotated: File, known: Truth) -> None:
    """Raises where nothing that is annotated lies within the recording."""
    end = max([*found.activities[:, 1], *found.primitives[:, 1], *found.time[-1:]], default=0.0)
    marks = [*known.start, *known.end, *known.keys]
    if end and (min(marks) >= end or max(marks) <= 0.0):
        raise KinegraphError(
            f"{annotated}: annotates {min(marks):.4g} to {max(marks):.4g} s, but the segments of {made} end at {end:.4g} s; "
            "--offset shifts the annotations"
        )


def _names(paths: list[File]) -> list[str]:
    """A name for each: the file's, or of several alike also that of the folder."""
    stems = [path.stem for path in paths]
    made = [
        stem if stems.count(stem) == 1 else f"{path.parent.name}_{stem}"
        for path, stem in zip(paths, stems, strict=True)
    ]
    return [name if made.count(name) == 1 else f"{name}_{i + 1}" for i, name in enumerate(made)]


def _summary(scores: dict[str, Scores], settings: str) -> object:
    from rich.table import Table

    from kinegraph.operators.segmentation.evaluation.scores import intervals

    count = f"{len(scores)} recording{'s' if len(scores) != 1 else ''}"
    made = Table(title=", ".join(filter(None, ["segmentation", count, settings])))
    for heading in ("", "mean", "95 % interval"):
        made.add_column(heading, justify="left" if not heading else "right")
    for name, (mean, low, high) in intervals(list(scores.values())).items():
        if mean == mean:
            made.add_row(SHOWN[name], f"{mean:.3f}", f"{low:.3f} to {high:.3f}" if low == low else "-")
    return made


def _show_as_in_thesis(scores: dict[str, ThesisScores], means: dict[str, float], as_json: bool) -> None:
    from rich.table import Table

    from kinegraph.stream.text.screen import Screen

    if as_json:
        print_json({"recordings": scores, "mean": means})
        return
    made = Table(title=f"as in the thesis, {len(scores)} recording{'s' if len(scores) != 1 else ''}")
    made.add_column("")
    made.add_column("mean", justify="right")
    for name, mean in means.items():
        if mean == mean:
            made.add_row(AS_IN_THESIS[name], f"{mean:.3f}")
    Screen().print(made)


def _sheet(path: File, scores: dict[str, Scores]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        sheet = Sheet(file)
        sheet.writerow(["recording", *SHOWN])
        for name, one in scores.items():
            sheet.writerow([name, *(f"{value:.6g}" if value == value else "" for value in asdict(one).values())])


def _save(folder: File, name: str, overwrite: bool) -> None:
    """Make the folder; raises where the file already exists."""
    if (folder / name).exists() and not overwrite:
        raise KinegraphError(f"{folder / name} exists; --overwrite replaces it, --out names another folder")
    try:
        private_folder(folder)
    except OSError as error:
        raise KinegraphError(f"{folder}: cannot be made: {error.strerror or error}") from None


def _rows(table: File) -> list[tuple[File, tuple[File, float]]]:
    """The recordings that a table names; files are looked for beside it."""
    made = []
    for line, row in read_records(table):
        try:
            offset_s = float(row.get("offset_s") or 0.0)
            if not isfinite(offset_s):
                raise ValueError
            made.append((table.parent / row["result"], (table.parent / row["truth"], offset_s)))
        except (KeyError, TypeError, ValueError):
            raise KinegraphError(
                f"{table}: line {line}: must name result and truth, and if needed offset_s (a number)"
            ) from None
    if not made:
        raise KinegraphError(f"{table}: names no recordings")
    return made
