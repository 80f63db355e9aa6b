"""Labelled steps from recordings and a table of labels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.operators.steps.commands.validation import Labelled
from kinegraph.operators.steps.steps import STEP, Steps
from kinegraph.stream.batch.sessions import open_session, recording_name
from kinegraph.stream.chunk import FOREVER, Array, Chunk, StreamSpec
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import InputError, KinegraphError, nearest

GROUPS = ("low", "middle", "high")


@dataclass(frozen=True, slots=True)
class Walk:
    """The walking steps of one recording, and the meta of their stream."""

    name: str
    steps: Array
    meta: dict[str, Any]


def read_labels(path: Path, target: str) -> dict[str, tuple[str, str]]:
    """Of each recording in a CSV table (columns recording, person, and the target): person and class. Raises KinegraphError."""
    found = dict[str, tuple[str, str]]()
    for number, row in read_records(path):
        for column in ("recording", "person", target):
            if not (row.get(column) or "").strip():
                raise KinegraphError(
                    f"{path}, line {number}: there is no {column}; {nearest(column, [c for c in row if c])}"
                )
        name = Path(row["recording"].strip()).stem
        if name in found:
            raise KinegraphError(f"{path}, line {number}: recording {name!r} appears twice")
        found[name] = row["person"].strip(), row[target].strip()
    if not found:
        raise KinegraphError(f"{path}: there are no labels")
    return grouped(found, target)


def grouped(labels: dict[str, tuple[str, str]], target: str) -> dict[str, tuple[str, str]]:
    """Numbers with more than five values, such as heights, become three classes with as many people each."""
    by_person = dict(labels.values())
    try:
        values = {person: float(value) for person, value in by_person.items()}
    except ValueError:
        return labels
    for person, value in values.items():
        if not np.isfinite(value):
            raise KinegraphError(f"{target} of {person} is {value:g}: not known; leave that person's recordings out")
    if target == "person" or len(set(values.values())) <= 5:
        return labels
    cuts = np.quantile(list(values.values()), [1 / 3, 2 / 3])
    ranges = (f"<{cuts[0]:g}", f"{cuts[0]:g}-{cuts[1]:g}", f">={cuts[1]:g}")
    return {name: (p, ranges[int(np.searchsorted(cuts, values[p], "right"))]) for name, (p, _) in labels.items()}


def read_walk(path: Path, finder: Steps, stream: str = "") -> Walk:
    """The steps that `finder` finds in a recording's inertial signal, the only one or `stream`. Raises KinegraphError."""
    with open_session(path) as recording:
        names = [stream] if stream else list(recording.streams)
        fitting = [name for name in names if _suits(finder, recording.stream(name).spec)]
        if len(fitting) != 1:
            what = f"{', '.join(fitting)} could be meant" if fitting else "no stream is acceleration at a regular rate"
            raise KinegraphError(f"{path}: --stream must name the inertial sensor's signal; {what}")
        operator = finder.unopened()
        spec = operator.open({"in": recording.stream(fitting[0]).spec})["steps"]
        rows = [np.empty(0, STEP)]
        for chunk in [*recording.chunks(fitting[0]), None]:
            if chunk is not None:
                data = np.where(np.isfinite(chunk.data), chunk.data, np.nan).astype(np.float64)
                made = operator.process("in", Chunk(chunk.time, data, min(chunk.until, FOREVER), chunk.lost))
                rows.append(made.data)
        name = recording_name(recording)
    return Walk(name, np.concatenate(rows), spec.meta)


def labelled(walks: list[Walk], labels: dict[str, tuple[str, str]]) -> Labelled:
    """The walking steps with their labels. Raises KinegraphError where labels and recordings do not match, or sensors differ."""
    names = {walk.name for walk in walks}
    if len(names) < len(walks):
        twice = next(walk.name for k, walk in enumerate(walks) if walk.name in {w.name for w in walks[:k]})
        raise KinegraphError(
            f"recording {twice!r} is given twice, perhaps replayed with several settings; one of each is needed"
        )
    for name in labels:
        if name not in names:
            raise KinegraphError(f"the labels name the recording {name!r}, which was not given; {nearest(name, names)}")
    features, classes, persons, where = list[Array](), list[str](), list[str](), list[str]()
    for walk in walks:
        if walk.name not in labels:
            raise KinegraphError(f"recording {walk.name!r} has no label; {nearest(walk.name, labels)}")
        for key in ("site", "axes", "imu_rate_hz", "imu_channels"):
            if walk.meta.get(key) != walks[0].meta.get(key):
                raise KinegraphError(
                    f"{walk.name}: {key} {walk.meta.get(key)}, {walks[0].name}: {walks[0].meta.get(key)}"
                )
        rows = walk.steps[walk.steps["kind"] == "walk"]
        known = np.isfinite(rows["features"]).all(axis=1) if walk.meta["angular_velocity"] else np.ones(len(rows), bool)
        person, label = labels[walk.name]
        features.append(rows["features"][known])
        for column, value in ((classes, label), (persons, person), (where, walk.name)):
            column += [value] * int(known.sum())
    return Labelled(np.concatenate(features), np.array(classes), np.array(persons), np.array(where))


def _suits(finder: Steps, spec: StreamSpec) -> bool:
    try:
        finder.unopened().open({"in": spec})
    except InputError:
        return False
    return True
