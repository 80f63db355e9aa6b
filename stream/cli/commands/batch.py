"""`kinegraph batch`: one graph over many recordings and parameter values, into Parquet tables."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.graph_options import GraphFile, Quiet, TrustedOnly
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from kinegraph.stream.batch.manifest import JobEntry
    from kinegraph.stream.batch.study import BatchState

SHOWN = 10
"""Failures that are printed; all of them are in failed.parquet."""


def batch(
    config: GraphFile,
    recordings: Annotated[
        list[Path], typer.Argument(help="recordings: .mcap files, or sessions' folders", metavar="FILE")
    ],
    out: Annotated[Path, typer.Option("-o", "--out", help="the folder of the results; a second run goes on in it")],
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NODE.PARAMETER=VALUE[,VALUE...]",
            help="a parameter of the graph and its values; several options: every combination",
        ),
    ] = None,
    cluster: Annotated[
        str,
        typer.Option(metavar="WHERE", help="local, slurm, pbs, or the address of a Dask scheduler"),
    ] = "local",
    workers: Annotated[
        int, typer.Option(help="jobs at the same time; 0: one for each core, as far as the memory goes", min=0)
    ] = 0,
    retries: Annotated[int, typer.Option(help="how often a job is tried again after its worker died", min=0)] = 1,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="do again what is done already")] = False,
    as_json: AsJson = False,
    quiet: Quiet = False,
    trusted_only: TrustedOnly = False,
) -> None:
    """Replay a graph over many recordings and parameter values; each output that it records becomes a Parquet table.

    A job is done again where anything has changed on which its results depend: graph, settings, recording, code, models. A recording that
    cannot be replayed is a row in failed.parquet. Exit code 1: a job failed; 5: an output is in no table; 6: a recording is incomplete.
    """
    from kinegraph.stream.batch.jobs import jobs, read_grid
    from kinegraph.stream.batch.study import batch as run
    from kinegraph.stream.batch.work import Common
    from kinegraph.stream.cli.commands import logs
    from kinegraph.stream.engine.shortfall import NotDelivered
    from kinegraph.stream.graph.reading.load import read_text

    logs.set_up()
    path, text = read_text(config)
    wanted = jobs(recordings, read_grid(settings or []))
    common = Common(text, path.stem, str(path.absolute()), trusted_only=trusted_only, again=overwrite)
    with _shown(len(wanted), quiet) as progress:
        tally = run(common, wanted, out, where=cluster, count=workers, retries=retries, progress=progress)
    if as_json:
        failed = [{"job": entry.describe(), "error": entry.error} for entry in tally.failed]
        done = {"done": tally.made["done"] + tally.made["incomplete"], "unchanged": tally.kept, "failed": failed}
        print_json({**done, "seconds": tally.seconds, "left_out": tally.left_out, "folder": out})
    else:
        _report(tally, out)
    if tally.failed:
        sys.exit(1)
    if tally.incomplete:
        raise SomeIncomplete(tally.incomplete)
    if tally.left_out:
        raise NotDelivered(tally.left_out)


class SomeIncomplete(KinegraphError):
    """Recordings were replayed that were not closed cleanly: their results are right as far as they go."""

    exit_code = 6

    def __init__(self, entries: list[JobEntry]) -> None:
        names = ", ".join(dict.fromkeys(entry.name for entry in entries[:SHOWN]))
        super().__init__(
            f"{len(entries)} jobs are of recordings that were not closed cleanly: {names}; jobs.parquet says what is missing"
        )


def _report(tally: BatchState, out: Path) -> None:
    done = tally.made["done"] + tally.made["incomplete"]
    say(
        f"{done} jobs done, {tally.kept} unchanged, {len(tally.failed)} failed; {tally.seconds:.0f} s replayed; results in {out}"
    )
    for entry in tally.failed[:SHOWN]:
        say(f"  {entry.describe()}: {entry.error}", err=True)
    if len(tally.failed) > SHOWN:
        say(f"  and {len(tally.failed) - SHOWN} more, in {out / 'failed.parquet'}", err=True)


@contextmanager
def _shown(total: int, quiet: bool) -> Iterator[Callable[[BatchState], None]]:
    """Within: a bar with the jobs that are finished, and the time left."""
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    from kinegraph.stream.text.screen import Screen

    console = Screen(stderr=True)
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("jobs"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, disable=quiet or not console.is_terminal) as shown:
        task = shown.add_task("batch", total=total)

        def progress(tally: BatchState) -> None:
            failed = f", {len(tally.failed)} failed" if tally.failed else ""
            done = " ".join(str(n) for _, n in sorted(tally.workers.items())[:SHOWN])
            each = f", by worker {done}" if len(tally.workers) > 1 else ""
            shown.update(task, completed=tally.finished, description=f"batch{failed}{each}")

        yield progress
