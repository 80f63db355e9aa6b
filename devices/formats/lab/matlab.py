"""MATLAB files as named arrays: version 5 through scipy, version 7.3 (HDF5) through h5py. Nothing in them is run."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Array
from kinegraph.stream.data.bounded import check_size
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.system.extras import optional

RATES = re.compile(
    r"(^|\.)(fs|srate|rate|rate_hz|fs_hz|sampling_?rate|sampling_?frequency|sample_?rate|frame_?rate|frequency|freq)$",
    re.IGNORECASE,
)
DEEPEST = 8
HEAD = re.compile(rb"MATLAB [5-7]\.\d MAT-file")
HDF5 = b"\x89HDF\r\n\x1a\n"
"""Stands after the header (512 bytes) of a file of version 7.3; the header's own words name an older version in files of MATLAB 7.4."""


def knows(head: bytes) -> bool:
    return bool(HEAD.match(head))


def read_arrays(path: Path) -> dict[str, Array]:
    """Every array of numbers or texts by its name, with dots where it is part of a structure; the longer axis of a matrix comes first.

    Raises RecordingError, also for version 7.3 where h5py is not installed.
    """
    with path.open("rb") as file:
        newer = file.read(512 + len(HDF5)).endswith(HDF5)
    found = dict(_newer(path) if newer else _older(path))
    return {name: _time_first(array) for name, array in found.items()}


def rate_of(arrays: dict[str, Array], name: str) -> float | None:
    """The one number called a rate that stands beside an array, else in the structure around it, or None, or several."""
    inside = name
    while inside:
        inside = inside.rpartition(".")[0]
        mine = [n for n in arrays if RATES.search(n) and n.rpartition(".")[0] == inside]
        rates = {float(arrays[n].ravel()[0]) for n in mine if arrays[n].size == 1 and arrays[n].dtype.kind in "iuf"}
        if rates:
            return rates.pop() if len(rates) == 1 else None
    return None


def _time_first(array: Array) -> Array:
    if array.ndim == 2 and 1 in array.shape:
        return np.ascontiguousarray(array.ravel())
    if array.ndim == 2 and array.shape[1] > array.shape[0]:
        return np.ascontiguousarray(array.T)
    if array.ndim == 3 and array.shape[2] > max(array.shape[:2]):
        return np.ascontiguousarray(
            np.moveaxis(array, 2, 0)
        )  # markers x coordinates x frames, as motion capture has it
    return array


def _older(path: Path) -> Iterator[tuple[str, Array]]:
    import scipy.io

    found = scipy.io.loadmat(path, squeeze_me=False, struct_as_record=True, verify_compressed_data_integrity=True)
    for name, value in found.items():
        if not name.startswith("__"):
            yield from _unfolded(name, value)


def _unfolded(name: str, value: Any, depth: int = 0) -> Iterator[tuple[str, Array]]:
    """Arrays of a value of scipy's: structures by field, cells of texts as texts."""
    if not isinstance(value, np.ndarray) or depth > DEEPEST:
        return
    if value.dtype.names:
        for one, at in zip(value.ravel()[:64], range(64), strict=False):
            inner = name if value.size == 1 else f"{name}{at + 1}"
            for field in value.dtype.names:
                yield from _unfolded(f"{inner}.{field}", one[field], depth + 1)
    elif value.dtype.kind == "O":
        cells = [np.asarray(cell).ravel() for cell in value.ravel()]
        if cells and all(cell.dtype.kind == "U" and cell.size <= 1 for cell in cells):
            yield name, np.array([str(cell[0]) if cell.size else "" for cell in cells])
        elif value.size <= 64:
            for i, cell in enumerate(value.ravel()):
                yield from _unfolded(name if value.size == 1 else f"{name}{i + 1}", np.asarray(cell), depth + 1)
    elif value.dtype.kind in "iufbU" and value.size:
        yield name, value


def _newer(path: Path) -> Iterator[tuple[str, Array]]:
    h5py = optional("h5py", f"{path}: MATLAB's version 7.3", "pip install 'kinegraph[matlab]'", RecordingError)
    with h5py.File(path, "r") as file:
        yield from _group(path, file, file, "", 0)


def _group(path: Path, file: Any, group: Any, prefix: str, depth: int) -> Iterator[tuple[str, Array]]:
    import h5py

    if depth > DEEPEST:
        return
    for name in group:
        if name.startswith("#") or not isinstance(group.get(name, getlink=True), h5py.HardLink):
            continue  # another file's, or HDF5's own
        item, full = group[name], f"{prefix}{name}"
        if isinstance(item, h5py.Group):
            yield from _group(path, file, item, f"{full}.", depth + 1)
        elif (array := _dataset(path, file, item)) is not None:
            yield full, array


def _dataset(path: Path, file: Any, item: Any) -> Array | None:
    """A dataset as MATLAB has it (HDF5 has its axes in the other order); None for what is neither numbers nor texts."""
    import h5py

    kind = item.attrs.get("MATLAB_class", b"")
    if item.external or item.is_virtual or item.attrs.get("MATLAB_empty", 0):
        return None
    check_size(int(item.size) * item.dtype.itemsize, path.stat().st_size, item.name)
    if kind == b"cell" and item.dtype == h5py.ref_dtype:
        texts = [_text(file, reference) for reference in item[()].ravel()[:10_000]]
        return np.array(texts) if texts and all(text is not None for text in texts) else None
    if kind == b"char":
        return np.array([_letters(item[()])])
    return np.asarray(item[()]).T if item.dtype.kind in "iufb" and item.size else None


def _text(file: Any, reference: Any) -> str | None:
    target = file[reference] if reference else None
    return _letters(target[()]) if target is not None and target.attrs.get("MATLAB_class", b"") == b"char" else None


def _letters(codes: Array) -> str:
    return "".join(chr(int(code)) for code in np.asarray(codes).ravel()[:1000])
