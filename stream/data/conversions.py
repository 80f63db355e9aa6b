"""A series as what other packages hold: xarray, polars, MNE. Each is imported when it is asked for."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from kinegraph.stream.chunk import Array, StreamSpec, Times
from kinegraph.stream.data.columns import column_names, columns
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.extras import optional

VOLTS = {"V": 1.0, "mV": 1e-3, "uV": 1e-6, "µV": 1e-6, "nV": 1e-9}
"""Units that MNE takes as voltages, in volts."""


class HeldSeries(Protocol):
    """A `stream.data.series.Series`, as far as it is read here."""

    @property
    def name(self) -> str: ...

    @property
    def spec(self) -> StreamSpec: ...

    @property
    def time(self) -> Times: ...

    @property
    def data(self) -> Array: ...


def to_xarray(series: HeldSeries) -> Any:
    """An xarray.DataArray (time, channel), or (time, axis, ...) for markers and frames; events: a Dataset with a variable per field."""
    xarray = optional("xarray", "an xarray array", "pip install xarray")
    spec, time = series.spec, ("time", series.time.astype("datetime64[ns]"))
    if spec.is_event:
        names = [name for name, _ in column_names(spec)]
        fields = dict(zip(names, columns(spec, series.data), strict=True))
        return xarray.Dataset({name: ("time", values) for name, values in fields.items()}, coords={"time": time})
    dims = ["time", *(f"axis{i + 1}" for i in range(len(spec.shape)))]
    coords: dict[str, Any] = {"time": time}
    if spec.channels:
        at = 1 + spec.channel_axis
        dims[at] = "channel"
        coords["channel"] = ("channel", list(spec.channels))
        if len(spec.units) == len(spec.channels):
            coords["unit"] = ("channel", list(spec.units))
    attributes = {"rate_hz": spec.rate_hz, "units": ", ".join(dict.fromkeys(spec.units))}
    return xarray.DataArray(series.data, coords=coords, dims=dims, name=series.name, attrs=attributes)


def to_polars(series: HeldSeries) -> Any:
    """A polars.DataFrame with the columns of `Series.to_pandas`, and `time` in UTC."""
    polars = optional("polars", "a polars table", "pip install polars")
    stamps = polars.Series("time", series.time).cast(polars.Datetime("ns", "UTC"))
    names = [name for name, _ in column_names(series.spec)]
    return polars.DataFrame([stamps, *map(polars.Series, names, map(plain_values, columns(series.spec, series.data)))])


def to_mne(series: HeldSeries, kind: str = "emg") -> Any:
    """An mne.io.RawArray of a regular signal, in volts where the unit is one; each gap is filled with zeros and annotated BAD_gap.

    `kind`: MNE's channel type ("emg", "eeg", "bio", "misc"). Raises KinegraphError for what is no regular signal.
    """
    mne = optional("mne", "MNE's Raw", "pip install mne")
    spec = series.spec
    if not (spec.is_signal and spec.rate_hz and len(series.time)):
        raise KinegraphError(
            f"{series.name}: MNE takes regular signals; this is {spec.describe()}, {len(series.time)} samples"
        )
    places = np.rint((series.time - series.time[0]) * (spec.rate_hz / 1e9)).astype(np.int64)
    places = np.maximum.accumulate(np.maximum(places, np.arange(len(places))))
    whole = np.zeros((spec.shape[0], int(places[-1]) + 1))
    units = list(spec.units) if len(spec.units) > 1 else list(spec.units or ("",)) * spec.shape[0]
    whole[:, places] = (series.data * np.array([VOLTS.get(unit, 1.0) for unit in units])).T
    names = [name for name, _ in column_names(spec)]
    kinds = [kind if unit in VOLTS else "misc" for unit in units]
    raw = mne.io.RawArray(whole, mne.create_info(names, spec.rate_hz, kinds), verbose="error")
    holes = np.flatnonzero(np.diff(places) > 1)
    if len(holes):
        onset = (places[holes] + 1) / spec.rate_hz
        raw.set_annotations(mne.Annotations(onset, (np.diff(places)[holes] - 1) / spec.rate_hz, "BAD_gap"))
    return raw


def plain_values(column: Array) -> Any:
    """A column's numbers as they are; texts without the zeros that fill them."""
    if column.dtype.kind == "S":
        return [value.decode("utf-8", "replace") for value in column]
    return [str(value) for value in column] if column.dtype.kind == "U" else np.ascontiguousarray(column)
