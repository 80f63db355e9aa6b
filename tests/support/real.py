"""Real recordings: the small ones in tests/recordings/real, and the larger ones that KINEGRAPH_DATA names."""

from __future__ import annotations

import os
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.stream.chunk import Array

REAL = Path(__file__).resolve().parents[1] / "recordings" / "real"
"""The recordings of the repository; their README names source, licence and SHA-256 of each."""


DATA = os.environ.get("KINEGRAPH_DATA", "")


DATA_MARKS = (
    []
    if DATA
    else [pytest.mark.nightly, pytest.mark.skip(reason="KINEGRAPH_DATA (the folder of real recordings) is not set")]
)
"""Of tests of recordings that may not lie in the repository: without KINEGRAPH_DATA they are nightly ones, and skip there."""


def needs_data(test: Any) -> Any:
    """Mark one such test."""
    for mark in DATA_MARKS:
        test = mark(test)
    return test


def real_file(name: str) -> Path:
    """A recording by its path, "emg/emg_santuz_tw12.npz": of the repository or of KINEGRAPH_DATA; a test without it skips."""
    for folder in (REAL, Path(DATA or REAL)):
        if (folder / name).exists():
            return folder / name
    pytest.skip(f"{name}: not in the repository, and KINEGRAPH_DATA (the folder of real recordings) does not hold it")


@cache
def real_arrays(name: str) -> dict[str, Array]:
    """The arrays of a recording, read once and read-only."""
    with np.load(real_file(name)) as file:
        arrays = {key: file[key] for key in file.files}
    for array in arrays.values():
        array.flags.writeable = False
    return arrays
