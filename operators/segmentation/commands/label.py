"""`kinegraph motion label`: names of exercises, from a recording in which a person shows them."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.text.safe_text import say
from kinegraph.stream.text.short_names import whole_name

if TYPE_CHECKING:
    from kinegraph.stream.chunk import Array, Samples, StreamSpec
    from kinegraph.stream.recording import Recording

PRIMITIVE = {"onset", "end", "activity", "repetition", "cluster"}


@dataclass(frozen=True, slots=True)
class Exemplar:
    """An exercise, and from when to when it is shown, in seconds from the recording's start."""

    name: str
    first_s: float
    last_s: float


def label(
    recording: Annotated[
        File,
        typer.Argument(metavar="RECORDING", help="what `kinegraph run` or `replay` made of segment_mocap"),
    ],
    shown: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME=FROM-TO",
            help='an exercise, and from which second to which it is shown; left out: as annotations such as "this is: squat" say',
        ),
    ] = None,
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("exercises.npz"),
    features: Annotated[str, typer.Option(metavar="STREAM", help="what was segmented")] = "stack",
    node: Annotated[str, typer.Option(help="the node whose segments these are, if there are several")] = "",
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
) -> None:
    """Name exercises by examples in a recording.

    The repetitions found in the given seconds are kept as examples.

    kinegraph motion label session "squat=12.0-30.5" "arms=1-12" -o exercises.npz
    kinegraph motion label session                       (by annotations made while it ran: "this is: squat")

    Then name the model in the graph: `model: exercises.npz` of operators.segmentation.names.naming.NameRepetitions. The same name may be
    given several times.
    """
    from kinegraph.operators.segmentation.names.taught import taught
    from kinegraph.stream.recording import Recording

    wanted = [read_shown(text) for text in shown or []]
    if output.exists() and not overwrite:
        raise KinegraphError(f"{output} exists; --overwrite replaces it, --out names another file")
    with Recording.open(recording) as opened:
        spec, time, frames = _features(opened, features)
        repetitions, radius = _repetitions(opened, node)
        chosen = _chosen(wanted or _annotated(opened, repetitions), repetitions, _zero(opened), recording)
        found = {name: _cut(repetitions[mine], time, frames) for name, mine in chosen.items()}
        steps = {name for name, mine in chosen.items() if _sides(repetitions[mine]).all()}
    model = taught(list(found.items()), radius)
    try:
        model.write(output, spec, recording.name)
    except OSError as error:
        raise KinegraphError(f"{output}: cannot be written: {error.strerror or error}") from None
    for name, all_ in found.items():
        seconds = [len(x) / (spec.rate_hz or 1.0) for x in all_]
        kept = int((model.exercise == model.names.index(name)).sum())
        of = f" of {len(all_)}" if kept < len(all_) else ""
        what = "steps" if name in steps else "repetitions" if len(all_) > 1 else "repetition"
        say(f"{name}: {kept}{of} {what} kept, {min(seconds):.1f} to {max(seconds):.1f} s each")
    say(str(output))


def read_shown(text: str) -> Exemplar:
    """ "squat=12.0-30.5". Raises KinegraphError."""
    from kinegraph.operators.segmentation.names.taught import MOST_LETTERS, UNKNOWN, fit_for_name

    name, _, span = text.partition("=")
    first, _, last = span.partition("-")
    try:
        made = Exemplar(name.strip(), float(first), float(last))
    except ValueError:
        raise KinegraphError(f"{text!r}: must be NAME=FROM-TO in seconds, such as squat=12.0-30.5") from None
    if not fit_for_name(made.name):
        raise KinegraphError(f"{text!r}: a name has 1 to {MOST_LETTERS} letters, and is not {UNKNOWN!r}")
    if not (isfinite(made.first_s) and isfinite(made.last_s) and 0.0 <= made.first_s < made.last_s):
        raise KinegraphError(f"{text!r}: must go from a second to a later one")
    return made


def _annotated(recording: Recording, repetitions: Array) -> list[Exemplar]:
    """What annotations name: the activity that was under way at each, or what ended or began beside it, as while the session ran."""
    from kinegraph.operators.segmentation.names.taught import fit_for_name, name_in

    marks = [entry[0].data for entry in recording.entries("annotations")] if "annotations" in recording.streams else []
    zero, named = _zero(recording), dict[int, str]()
    for mark in [mark for data in marks for mark in data]:
        name = name_in(str(mark["text"]))
        if fit_for_name(name) and (number := _meant(repetitions, int(mark["onset"]), named)) is not None:
            named[number] = name
    if not named:
        raise KinegraphError(
            f"{recording.path}: no annotation names an exercise; mark it while it is done (this is: squat), or give NAME=FROM-TO"
        )
    spans = [(name, repetitions[repetitions["activity"] == number]) for number, name in named.items()]
    return [Exemplar(n, (t["onset"].min() - zero) / 1e9, (t["end"].max() - zero) / 1e9) for n, t in spans]


def _meant(repetitions: Array, said_at: int, named: dict[int, str]) -> int | None:
    """The activity named by an annotation at this time; some have a name already."""
    import numpy as np

    from kinegraph.operators.segmentation.names.taught import of_what_ended

    before, after = repetitions[repetitions["onset"] <= said_at], repetitions[repetitions["onset"] > said_at]
    if not len(before):
        return int(after["activity"][0]) if len(after) else None
    last = int(before["activity"][-1])
    ended = int(repetitions["end"][repetitions["activity"] == last].max())
    after = after[after["activity"] != last]
    begins = int(after["onset"][0]) if len(after) else np.iinfo(np.int64).max
    if of_what_ended(said_at, ended, begins, last in named and len(after) > 0):
        return last
    return int(after["activity"][0]) if len(after) else None


def _zero(recording: Recording) -> int:
    """When the recording begins, ns."""
    return min((s.first for s in recording.streams.values() if s.role == "input" and s.first is not None), default=0)


def _features(recording: Recording, name: str) -> tuple[StreamSpec, Array, Samples]:
    import numpy as np

    name = whole_name(name, recording.streams)
    if name not in recording.streams:
        known = nearest(name, recording.streams)
        raise KinegraphError(
            f"{recording.path}: there is no stream {name}; {known}. A recording of raw joints goes through "
            "`kinegraph replay segment_mocap RECORDING -o MADE` first; teach from MADE"
        )
    spec = recording.stream(name).spec
    if not spec.is_signal:
        raise KinegraphError(f"{recording.path}: {name} is {spec.describe()}; --features must name a signal")
    chunks = [entry[0] for entry in recording.entries(name) if len(entry[0].time)]
    if not chunks:
        raise KinegraphError(f"{recording.path}: {name} holds no samples")
    data = np.concatenate([chunk.data for chunk in chunks])
    return spec, np.concatenate([chunk.time for chunk in chunks]), np.ascontiguousarray(data, np.float64)


def _repetitions(recording: Recording, node: str) -> tuple[Array, float]:
    """The repetitions that were found, and the median radius in which they were."""
    import numpy as np

    def only(fields: set[str]) -> str:
        names = [
            name
            for name, stream in recording.streams.items()
            if fields <= set(stream.spec.dtype.names or ()) and (not node or name.rpartition(".")[0] == node)
        ]
        names = [n for n in names if "name" not in (recording.streams[n].spec.dtype.names or ())]
        if fields == {"radius"}:
            names = [n for n in names if recording.streams[n].spec.dtype.names == ("radius",)]
        if len(names) > 1:
            raise KinegraphError(f"{recording.path}: {', '.join(names)} all hold segments; choose one with --node")
        return names[0] if names else ""

    name, radii = only(PRIMITIVE), only({"radius"})
    if not name:
        raise KinegraphError(
            f"{recording.path}: holds no repetitions; record the segmentation's `primitive` and `radius`"
        )
    repetitions = [entry[0].data for entry in recording.entries(name)]
    table = np.concatenate(repetitions) if repetitions else np.empty(0, recording.stream(name).spec.dtype)
    found = [entry[0].data["radius"] for entry in recording.entries(radii)] if radii else []
    values = np.concatenate(found) if found else np.empty(0)
    return table[table["repetition"] > 0], float(np.median(values)) if len(values) else 0.0


def _chosen(shown: list[Exemplar], repetitions: Array, zero: int, recording: File) -> dict[str, Array]:
    """By name, which of the repetitions are shown. Raises KinegraphError where one of them would have two names."""
    import numpy as np

    chosen: dict[str, Array] = {}
    for one in shown:
        chosen[one.name] = chosen.get(one.name, np.zeros(len(repetitions), bool)) | _within(
            one, repetitions, zero, recording
        )
    names = list(chosen)
    for k, name in enumerate(names):
        for other in names[:k]:
            if len(both := repetitions[chosen[name] & chosen[other]]):
                at = (both["onset"][0] - zero) / 1e9
                raise KinegraphError(
                    f"{other} and {name}: the repetition at {at:.1f} s cannot be both; their seconds must not overlap"
                )
        kinds = np.unique(repetitions["cluster"][chosen[name] & (repetitions["cluster"] >= 0)])
        if len(kinds) > 1:
            say(
                f"{name}: its repetitions are of {len(kinds)} kinds, as the segmentation tells them apart; are the seconds right?"
            )
    return chosen


def _within(one: Exemplar, repetitions: Array, zero: int, recording: File) -> Array:
    """Which repetitions have their middle in the seconds given; of two steps each is one."""
    middle = ((repetitions["onset"] + repetitions["end"]) / 2.0 - zero) / 1e9
    mine: Array = (middle >= one.first_s) & (middle <= one.last_s)
    if not mine.any():
        times = ", ".join(f"{m:.1f}" for m in middle[:8])
        raise KinegraphError(
            f"{recording}: no repetition was found between {one.first_s:g} and {one.last_s:g} s"
            + (f"; there are some at {times} s" if times else "; there are no others")
        )
    return mine


def _sides(repetitions: Array) -> Array:
    """Which step of a repetition each is; 0: a whole one."""
    import numpy as np

    sides: Array = (
        repetitions["side"] if "side" in (repetitions.dtype.names or ()) else np.zeros(len(repetitions), np.int32)
    )
    return sides


def _cut(repetitions: Array, time: Array, frames: Samples) -> list[Samples]:
    """The frames of each; steps of one side before those of the other, so that some of both are kept where not all are."""
    import numpy as np

    repetitions = repetitions[np.argsort(_sides(repetitions), kind="stable")]
    spans = [np.searchsorted(time, [event["onset"], event["end"] + 1]) for event in repetitions]
    return [np.ascontiguousarray(frames[first:last]) for first, last in spans if last - first > 1]
