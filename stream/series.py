"""A whole stream in memory: as a file held it, as it is given from Python, or as a graph gave it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from stream.chunk import Array, StreamSpec, Times
from stream.errors import KinegraphError

if TYPE_CHECKING:
    import pandas


@dataclass(slots=True)
class Series:
    """A stream.

    time   (n,) int64 ns, never decreasing
    data   (n, *shape)
    lost   (n,) int64: samples missing just before each (-1: an unknown number); None: none anywhere
    """

    name: str
    spec: StreamSpec
    time: Times
    data: Array
    lost: Array | None = None

    def __len__(self) -> int:
        return len(self.time)

    def to_pandas(self) -> pandas.DataFrame:
        """A table with a row per sample and a column per channel, coordinate or field, by UTC stamps; units and rate in its `attrs`.

        Stamps within events (`onset`, `end`) stay int64 ns. pandas comes with `pip install 'kinegraph[pandas]'`.
        """
        try:
            import pandas
        except ModuleNotFoundError:
            raise KinegraphError("pandas is not installed; install it: pip install 'kinegraph[pandas]'") from None
        from stream.columns import column_names, columns

        named = column_names(self.spec)
        index = pandas.DatetimeIndex(pandas.to_datetime(self.time, unit="ns", utc=True), name="time")
        table = pandas.DataFrame(
            {name: column for (name, _), column in zip(named, columns(self.spec, self.data), strict=True)}, index=index
        )
        table.attrs = {"name": self.name, "rate_hz": self.spec.rate_hz, "units": dict(named)}
        return table
