"""Reading what came of a batch."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinegraph.stream.batch.manifest import JOBS, JobEntry, Manifest
from kinegraph.stream.batch.parquet import arrow
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.system.atomic_file import complete

if TYPE_CHECKING:
    import pandas
    import pyarrow

LISTS = {"jobs": False, "failed": True}
"""Tables of the jobs themselves: all of them, and those that failed."""


class BatchResults:
    """The results of `kinegraph batch`: a table for each recorded output, over all recordings and settings.

    results = kinegraph.BatchResults("results")
    results.outputs                              # ["cycles.closed", "smooth"]
    results.to_pandas("smooth")                  # with columns recording, subject, smooth.cutoff_hz, time, lost, TA, SO
    results.failed                               # [JobEntry(...)]
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = Path(folder)
        if not (self.folder / JOBS).is_dir():
            raise KinegraphError(f"{folder}: no results of `kinegraph batch` lie there")
        self.entries = tuple(Manifest(self.folder))

    @property
    def failed(self) -> list[JobEntry]:
        return [entry for entry in self.entries if entry.failed]

    @property
    def outputs(self) -> list[str]:
        return sorted({name for entry in self.entries for name in entry.tables})

    def to_arrow(self, output: str) -> pyarrow.Table:
        """All rows of an output; columns that only some recordings have are empty in the others. Raises KinegraphError."""
        pa = arrow()
        import pyarrow.dataset as dataset

        names = [entry.tables[output] for entry in self.entries if output in entry.tables]
        if not names:
            raise KinegraphError(f"{self.folder}: there is no table of {output!r}; {nearest(output, self.outputs)}")
        fragments = dataset.dataset(
            [str(self.folder / name) for name in names],
            format="parquet",
            partitioning=dataset.partitioning(flavor="hive"),
            partition_base_dir=str(self.folder / output),
        )
        schemas = [piece.physical_schema for piece in fragments.get_fragments()]
        whole = pa.unify_schemas(
            [pa.schema([pa.field("recording", pa.string())]), *schemas], promote_options="permissive"
        )
        return fragments.replace_schema(whole).to_table()

    def to_pandas(self, output: str) -> pandas.DataFrame:
        """`to_arrow` as a pandas table. pandas comes with `pip install 'kinegraph[pandas]'`."""
        table: pandas.DataFrame = self.to_arrow(output).to_pandas()
        return table


def write_lists(manifest: Manifest) -> None:
    """Write `jobs.parquet` and `failed.parquet`: a row for every job of the folder, whichever call did it. Raises OSError."""
    pa = arrow()
    entries = list(manifest)
    names = sorted({name for entry in entries for name in entry.facts})
    for name, only_failed in LISTS.items():
        rows = [_row(entry, names) for entry in entries if entry.failed or not only_failed]
        columns = {key: [row[key] for row in rows] for key in _row(JobEntry("", "", {}, "", ""), names)}
        with complete(manifest.folder / f"{name}.parquet") as draft:
            pa.parquet.write_table(pa.table(columns, schema=_schema(pa, columns)), draft)


def _schema(pa: Any, columns: dict[str, list[Any]]) -> Any:
    numbers = {"seconds", "took_s"}
    return pa.schema([(name, pa.float64() if name in numbers else pa.string()) for name in columns])


def _row(entry: JobEntry, facts: list[str]) -> dict[str, Any]:
    record = asdict(entry)
    row: dict[str, Any] = {
        "recording": entry.name,
        "settings": json.dumps(record["settings"], default=str),
        "status": entry.status,
    }
    row |= {"error": entry.error, "digest": entry.digest, "seconds": entry.seconds, "took_s": entry.took_s}
    row |= {"left_out": json.dumps(record["left_out"]), "graph_digest": entry.graph}
    row |= {"recording_digest": entry.recording.get("sha256", ""), "version": entry.version, "worker": entry.worker}
    return row | {
        f"session.{name}" if name in row else name: None if name not in entry.facts else str(entry.facts[name])
        for name in facts
    }
