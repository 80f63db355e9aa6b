"""What annotators say about a recording: which action when, how often it is repeated, and key points of repetitions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from kinegraph.stream.chunk import Array, Samples
from kinegraph.stream.data.bounded import arrays, reading
from kinegraph.stream.data.tables import read_records
from kinegraph.stream.errors import KinegraphError

TRANSITIONS = {"", "-", "-1", "?", "transition", "uncertain", "none", "nan"}
"""Labels, in small letters, of what is no action."""

LONGEST_TRANSITION_S = 4.0
"""A longer stretch between two actions is no transition, but something of its own: both its ends are boundaries."""


@dataclass(frozen=True, slots=True)
class Truth:
    """Annotated actions in order, seconds from the recording's start.

    start, end   (n,)   of each action
    label        n names; what lies between actions is a transition, or uncertain
    repetitions  (n,)   how often it was repeated; NaN where not counted
    keys         (m,)   key points, one in each repetition
    cuts         (b,)   where annotators marked that one action turns into another
    """

    start: Samples
    end: Samples
    label: list[str]
    repetitions: Samples
    keys: Samples
    cuts: Samples | None = None

    def boundaries(self) -> Samples:
        """Where one action goes over into another, as annotated, else in the middle of the transition; both its ends where it is long."""
        if self.cuts is not None:
            return self.cuts
        made: list[float] = []
        for i in range(1, len(self.start)):
            gap = self.start[i] - self.end[i - 1]
            if gap > LONGEST_TRANSITION_S:
                made += [self.end[i - 1], self.start[i]]
            elif self.label[i] != self.label[i - 1]:
                made.append(self.end[i - 1] + gap / 2.0)
        return np.array(made)

    def labels(self, time: Samples) -> Array:
        """The number of the action's name at each time, in the order of first appearance; -1 in transitions."""
        names = list(dict.fromkeys(self.label))
        made = np.full(len(time), -1)
        for start, end, label in zip(self.start, self.end, self.label, strict=True):
            made[(time >= start) & (time < end)] = names.index(label)
        return made


def read_truth(path: Path, offset_s: float = 0.0) -> Truth:
    """Annotations from a CSV table or an NPZ archive; `offset_s` is added to its times.

    CSV: columns start_s, end_s, label, and perhaps repetitions; a row without end_s is a key point. NPZ: `label`, a number for each frame
    at `rate` Hz, names in `label_names`, -1 for transitions; perhaps `label_cut`, the same without transitions: its changes are then
    the boundaries; and, or instead, `tag_frame`, the frames of key points, at `rate` or with times in `t_us`. Raises KinegraphError with
    file and line.
    """
    if not path.is_file():
        raise KinegraphError(f"{path}: there is no such file")
    rows, keys, cuts = _npz(path) if path.suffix.lower() == ".npz" else (*_csv(path), None)
    if not rows and not len(keys):
        raise KinegraphError(f"{path}: holds no annotations")
    rows.sort()
    for (_, end, _, _), (start, *_) in pairwise(rows):
        if start < end - 1e-9:
            raise KinegraphError(
                f"{path}: actions overlap: one begins at {start:g} s, before another ends at {end:g} s"
            )
    starts, ends = (np.array([row[k] for row in rows], np.float64) + offset_s for k in (0, 1))
    counted = np.array([row[3] for row in rows], np.float64)
    return Truth(
        starts,
        ends,
        [row[2] for row in rows],
        counted,
        np.sort(keys) + offset_s,
        None if cuts is None else cuts + offset_s,
    )


Rows = list[tuple[float, float, str, float]]


def _csv(path: Path) -> tuple[Rows, Samples]:
    rows: Rows = []
    keys: list[float] = []
    for line, row in read_records(path):
        try:
            start = float(row["start_s"])
            if not np.isfinite(start):
                raise KinegraphError(f"{path}: line {line}: start_s is {start}; it must be a time in seconds")
            if not (row.get("end_s") or "").strip():
                keys.append(start)
                continue
            end, label = float(row["end_s"]), row.get("label") or ""
            count = float(row.get("repetitions") or "nan")
        except (KeyError, TypeError, ValueError):
            raise KinegraphError(
                f"{path}: line {line}: start_s, end_s (numbers) and label are needed, and repetitions as a number if it is there"
            ) from None
        if not start < end < np.inf:
            raise KinegraphError(f"{path}: line {line}: an action from {start:g} to {end:g} s is impossible")
        if count < 0:
            raise KinegraphError(f"{path}: line {line}: {count:g} repetitions are impossible")
        if label.strip().lower() not in TRANSITIONS:
            rows.append((start, end, label.strip(), count))
    return rows, np.array(keys)


def _npz(path: Path) -> tuple[Rows, Samples, Samples | None]:
    with reading(path, "an NPZ file", KinegraphError):
        found = arrays(path, ("label", "label_cut", "label_names", "rate", "tag_frame", "t_us"))
    if not {"label", "tag_frame"} & found.keys() or not {"rate", "t_us"} & found.keys():
        raise KinegraphError(
            f"{path}: `label` or `tag_frame` is needed, and `rate` or `t_us`; there are {', '.join(found) or 'other arrays'}"
        )
    _check(path, found)
    clock = (found["t_us"] - found["t_us"][0]) / 1e6 if "t_us" in found else None
    keys = _seconds(found["tag_frame"], clock, found) if "tag_frame" in found else np.empty(0)
    rows: Rows = []
    if "label" in found:
        label, names = found["label"], found.get("label_names")
        edges = np.flatnonzero(np.diff(label)) + 1
        for first, last in zip([0, *edges], [*edges, len(label)], strict=True):
            if label[first] >= 0:
                name = str(names[label[first]]) if names is not None else str(label[first])
                start, end = _seconds(np.array([first, last]), clock, found)
                rows.append((float(start), float(end), name, np.nan))
    hard = found.get("label_cut")
    return rows, keys, None if hard is None else _seconds(np.flatnonzero(np.diff(hard)) + 1, clock, found)


def _check(path: Path, found: dict[str, Array]) -> None:
    """Raises where an array is not what it must be."""
    for name in {"label", "label_cut", "tag_frame"} & found.keys():
        if found[name].ndim != 1 or found[name].dtype.kind not in "iu":
            raise KinegraphError(f"{path}: `{name}` must be a row of whole numbers, one per frame")
    clock = found.get("t_us")
    if clock is not None and (clock.ndim != 1 or clock.dtype.kind not in "iuf" or not (np.diff(clock) > 0).all()):
        raise KinegraphError(f"{path}: `t_us` must be a row of times that grow")
    if clock is None and (found["rate"].size != 1 or not 0.0 < float(found["rate"].ravel()[0]) < np.inf):
        raise KinegraphError(f"{path}: `rate` is {found['rate']}; it must be a positive number of Hz")
    frames = len(found.get("label", found.get("t_us", ())))
    if any(name in found and len(found[name]) != frames for name in ("t_us", "label_cut")) and "label" in found:
        raise KinegraphError(f"{path}: `label`, `label_cut` and `t_us` must be of one length, where they are there")
    keys = found.get("tag_frame", np.empty(0))
    if (keys < 0).any() or (frames and (keys > frames).any()):
        raise KinegraphError(f"{path}: `tag_frame` names frames that do not exist")
    names = found.get("label_names")
    if names is not None and "label" in found and found["label"].max(initial=-1) >= names.size:
        raise KinegraphError(f"{path}: `label` goes up to {found['label'].max()}, but `label_names` holds {names.size}")


def _seconds(frames: Array, clock: Samples | None, found: dict[str, Array]) -> Samples:
    """When frames began, by the recording's clock, or by its rate."""
    made: Samples = (
        frames / float(found["rate"].ravel()[0]) if clock is None else clock[np.minimum(frames, len(clock) - 1)]
    )
    return made
