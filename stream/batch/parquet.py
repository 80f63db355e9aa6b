"""An output's chunks as a Parquet file: a row a sample, named columns with units, and what the sample is of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kinegraph.stream.chunk import Array, Chunk, StreamSpec, add_lost
from kinegraph.stream.data.columns import column_names, columns
from kinegraph.stream.data.conversions import plain_values
from kinegraph.stream.system.extras import optional

if TYPE_CHECKING:
    import pyarrow

ROWS = 1 << 16
"""Rows that wait in memory before they go into the file together."""
TIME, LOST = "time", "lost"


def arrow() -> Any:
    """pyarrow, imported when it is needed. Raises KinegraphError."""
    optional("pyarrow.parquet", "a batch", "pip install 'kinegraph[batch]'")
    return optional("pyarrow", "a batch", "pip install 'kinegraph[batch]'")


class ParquetTable:
    """Writes one output of one job.

    labels   columns that are the same in every row ({"subject": "S01", "smooth.cutoff_hz": 6}), before `time`, `lost` and the samples'

    `time` is in UTC, in ns; `lost` counts the samples missing just before each (-1: an unknown number). The columns are those of
    `Series.to_pandas`, with their units in the fields' metadata. Raises RecordingError for samples that fit no row.
    """

    def __init__(self, path: Path, spec: StreamSpec, labels: Mapping[str, Any]) -> None:
        self.spec, self.rows = spec, 0
        self._names = column_names(spec)
        taken = {TIME, LOST, *(name for name, _ in self._names)}
        self._labels = {f"session.{name}" if name in taken else name: value for name, value in labels.items()}
        self._schema = self._described(arrow())
        self._waiting: list[tuple[Array, Array, Array]] = []
        self._owed = self._held = 0
        self._writer = arrow().parquet.ParquetWriter(path, self._schema, compression="zstd")

    def add(self, chunk: Chunk) -> None:
        """The next chunk of the output."""
        self._owed = add_lost(self._owed, chunk.lost)
        if len(chunk):
            lost = np.zeros(len(chunk), np.int64)
            lost[0], self._owed = self._owed, 0
            self._waiting.append((chunk.time.copy(), lost, chunk.data.copy()))
            self._held += len(chunk)
        if self._held >= ROWS:
            self._flush()

    def close(self) -> None:
        """Raises OSError."""
        self._flush()
        self._writer.close()

    def _described(self, pa: Any) -> pyarrow.Schema:
        labels = [pa.field(name, _label_type(pa, value)) for name, value in self._labels.items()]
        kinds = [column.dtype for column in columns(self.spec, np.zeros((0, *self.spec.shape), self.spec.dtype))]
        samples = [
            pa.field(name, _value_type(pa, kind), metadata={"unit": unit} if unit else None)
            for (name, unit), kind in zip(self._names, kinds, strict=True)
        ]
        facts = {"rate_hz": self.spec.rate_hz, "units": dict(self._names), "spec": self.spec.to_json()}
        own = [pa.field(TIME, pa.timestamp("ns", tz="UTC")), pa.field(LOST, pa.int64())]
        return pa.schema([*labels, *own, *samples], metadata={"kinegraph": json.dumps(facts)})

    def _flush(self) -> None:
        if not self._held:
            return
        pa = arrow()
        time, lost, data = (np.concatenate(parts) for parts in zip(*self._waiting, strict=True))
        same = [
            pa.DictionaryArray.from_arrays(pa.array(np.zeros(len(time), np.int32)), pa.array([str(value)]))
            if pa.types.is_dictionary(kind := self._schema.field(name).type)
            else pa.repeat(pa.scalar(float(value) if pa.types.is_floating(kind) else value, kind), len(time))
            for name, value in self._labels.items()
        ]
        values = [plain_values(column) for column in columns(self.spec, data)]
        arrays = [*same, pa.array(time, pa.timestamp("ns", tz="UTC")), pa.array(lost), *map(pa.array, values)]
        self._writer.write_table(pa.Table.from_arrays(arrays, schema=self._schema))
        self.rows += len(time)
        self._waiting, self._held = [], 0


def _label_type(pa: Any, value: Any) -> Any:
    if isinstance(value, bool):
        return pa.bool_()
    return pa.float64() if isinstance(value, int | float) else pa.dictionary(pa.int32(), pa.string())


def _value_type(pa: Any, dtype: np.dtype[Any]) -> Any:
    return pa.string() if dtype.kind in "SU" else pa.from_numpy_dtype(dtype)
