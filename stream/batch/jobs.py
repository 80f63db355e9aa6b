"""What is to be done: a graph replayed over recordings, once for every combination of parameter values."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph.reading.yaml_lines import parse

MAX = 1_000_000
"""Jobs of one batch; more is a slip of the pen in a `--set`."""


@dataclass(frozen=True, slots=True)
class Job:
    """One replay.

    recording   where the recording is, absolute
    name        how it is called in the results
    settings    {"smooth.cutoff_hz": 6}
    """

    recording: Path
    name: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """The name of this job's files: the same recording with the same settings has the same, whatever else has changed."""
        text = json.dumps([str(self.recording), self.settings], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()[:20]


def jobs(recordings: Iterable[Path], grid: Mapping[str, Sequence[Any]]) -> list[Job]:
    """Every recording with every combination of the grid's values, in order. Raises KinegraphError."""
    combinations = [dict(zip(grid, values, strict=True)) for values in product(*grid.values())]
    found = {path.absolute(): path for path in recordings}
    if not found:
        raise KinegraphError("no recording is given")
    if len(found) * len(combinations) > MAX:
        raise KinegraphError(
            f"{len(found)} recordings x {len(combinations)} combinations of settings are more than {MAX} jobs"
        )
    return [Job(path, _name(path), settings) for path in found for settings in combinations]


def read_grid(settings: Iterable[str]) -> dict[str, list[Any]]:
    """{"smooth.cutoff_hz": [4, 6, 10]} from ["smooth.cutoff_hz=4,6,10"], read as a YAML list's values. Raises KinegraphError."""
    grid: dict[str, list[Any]] = {}
    for setting in settings:
        name, equals, values = setting.partition("=")
        name = name.strip()
        if not equals or not name or not values.strip():
            raise KinegraphError(
                f"--set {setting}: it must be NODE.PARAMETER=VALUE[,VALUE...], as in 'smooth.cutoff_hz=4,6,10'"
            )
        if name in grid:
            raise KinegraphError(f"--set {name} is given twice; put its values into one list: {name}=4,6")
        try:
            grid[name] = parse(f"[{values}]", "").plain()
        except GraphError as error:
            raise KinegraphError(f"--set {setting}: {error}") from None
        if len({json.dumps(value, default=str) for value in grid[name]}) < len(grid[name]):
            raise KinegraphError(f"--set {setting}: a value is given twice")
    return grid


def _name(path: Path) -> str:
    """The path from the current folder where the recording lies below it, otherwise the whole path."""
    whole, here = path.absolute(), Path.cwd()
    return (whole.relative_to(here) if whole.is_relative_to(here) else whole).as_posix()
