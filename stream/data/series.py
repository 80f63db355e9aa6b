"""A whole stream in memory: as a file held it, as it is given from Python, or as a graph gave it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from kinegraph.stream.chunk import Array, Chunk, StreamSpec, Times, add_lost
from kinegraph.stream.system.extras import optional

if TYPE_CHECKING:
    import pandas


@dataclass(slots=True, repr=False)
class Series:
    """A stream.

    time   (n,) int64 ns, never decreasing
    data   (n, *shape)
    lost   (n,) int64: samples missing just before each (-1: an unknown number); None: nothing is missing
    """

    name: str
    spec: StreamSpec
    time: Times
    data: Array
    lost: Array | None = None

    @classmethod
    def of_chunks(cls, name: str, spec: StreamSpec, chunks: Iterable[Chunk]) -> Self:
        """Chunks of a stream, joined."""
        kept = list(chunks)
        time = np.concatenate([np.empty(0, np.int64), *(chunk.time for chunk in kept)])
        data = np.concatenate([np.empty((0, *spec.shape), spec.dtype), *(chunk.data for chunk in kept)])
        lost = np.zeros(len(time), np.int64)
        at = pending_gap = 0
        for chunk in kept:
            pending_gap = add_lost(pending_gap, chunk.lost)
            if len(chunk):
                lost[at], pending_gap = pending_gap, 0
                at += len(chunk)
        return cls(name, spec, time, data, lost if lost.any() else None)

    def __len__(self) -> int:
        return len(self.time)

    def to_pandas(self) -> pandas.DataFrame:
        """A table with a row per sample and a column per channel, coordinate or field, by UTC stamps; units and rate in its `attrs`.

        Stamps within events (`onset`, `end`) stay int64 ns. pandas comes with `pip install 'kinegraph[pandas]'`.
        """
        frames = optional("pandas", "a table", "pip install 'kinegraph[pandas]'")
        from kinegraph.stream.data.columns import column_names, columns

        named = column_names(self.spec)
        index = frames.DatetimeIndex(frames.to_datetime(self.time, unit="ns", utc=True), name="time")
        table: pandas.DataFrame = frames.DataFrame(
            {name: column for (name, _), column in zip(named, columns(self.spec, self.data), strict=True)}, index=index
        )
        table.attrs = {"name": self.name, "rate_hz": self.spec.rate_hz, "units": dict(named)}
        return table

    def between(self, start_s: float = 0.0, end_s: float | None = None) -> Series:
        """The samples from `start_s` to before `end_s`, in seconds after the first one; no copy is made."""
        begin = int(self.time[0]) if len(self) else 0
        low, high = np.searchsorted(self.time, [begin + round(start_s * 1e9), begin + round((end_s or 0.0) * 1e9)])
        part = slice(int(low), None if end_s is None else int(high))
        lost = None if self.lost is None else self.lost[part]
        return Series(self.name, self.spec, self.time[part], self.data[part], lost)

    def to_xarray(self) -> Any:
        """An xarray.DataArray by time and channel; of events, a Dataset with a variable per field."""
        from kinegraph.stream.data.conversions import to_xarray

        return to_xarray(self)

    def to_polars(self) -> Any:
        """A polars.DataFrame with the columns of `to_pandas`, and `time` in UTC."""
        from kinegraph.stream.data.conversions import to_polars

        return to_polars(self)

    def to_mne(self, kind: str = "emg") -> Any:
        """An mne.io.RawArray of a regular signal, in volts; gaps are annotated BAD_gap. `kind`: MNE's channel type."""
        from kinegraph.stream.data.conversions import to_mne

        return to_mne(self, kind)

    def __repr__(self) -> str:
        return f"Series {self.name!r}: {len(self)} samples of {self.spec.describe()}"
