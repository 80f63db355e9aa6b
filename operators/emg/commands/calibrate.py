"""`kinegraph emg calibrate`: from a recording, the reference that amplitudes are related to from then on."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import asdict, fields
from enum import StrEnum
from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated, Any

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError

if TYPE_CHECKING:
    from rich.table import Table

    from kinegraph.operators.emg.amplitude_reference import AmplitudeReference
    from kinegraph.operators.emg.envelope import Envelope
    from kinegraph.stream.chunk import Samples, Times
    from kinegraph.stream.recording import Recording


class Kind(StrEnum):
    """What was done during the calibration."""

    mvc = "mvc"
    rest = "rest"
    task = "task"


def calibrate(
    kind: Annotated[
        Kind,
        typer.Argument(
            metavar="KIND", help="what the recording shows: mvc (strongest contractions), rest, or the task itself"
        ),
    ],
    recording: Annotated[File, typer.Argument(help="the recording: a file or a session's folder", metavar="FILE")],
    output: Annotated[
        File | None, typer.Option("-o", "--out", help="the reference to be made [default: SUBJECT.KIND.json]")
    ] = None,
    config: Annotated[
        File | None, typer.Option(help="the graph with the envelope to use [default: the recording's own]")
    ] = None,
    emg: Annotated[str, typer.Option(metavar="STREAM", help="the raw EMG [default: the only one in volts]")] = "",
    touchdown: Annotated[
        str, typer.Option(metavar="STREAM", help="for task: the foot's contacts [default: the only one so named]")
    ] = "",
    subject: Annotated[str, typer.Option(help="the person's name [default: as recorded]")] = "",
    window_s: Annotated[
        float, typer.Option(min=0.05, max=10.0, help="for mvc: over how long the strongest mean is taken")
    ] = 0.5,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a reference that exists")] = False,
    as_json: AsJson = False,
) -> None:
    """Make a reference for amplitude normalisation (operators.emg.normalise.Normalise) from a recording.

    mvc: per muscle the highest mean of the envelope over `--window-s`; an annotation "again TA" leaves out what TA did before. rest: the
    envelope's mean, and the raw signal's baseline noise. task: peak and mean of the mean cycle. The envelope is computed as the graph does,
    and the reference is valid for no other.
    """
    from kinegraph.stream.recording import Recording

    with Recording.open(recording) as opened:
        about = opened.header.get("session") or {}
        who = subject or str(about.get("subject", ""))
        target = output or File(f"{_file_name(who) or recording.stem}.{kind.value}.json")
        if target.exists() and not overwrite:
            raise KinegraphError(f"{target} exists; --overwrite replaces it, --out names another file")
        text = _text(config) if config else str(opened.header.get("graph") or "")
        envelope = envelope_of(text, str(config or "the recording's graph"))
        found, flags = reference(opened, kind.value, envelope, emg=emg, touchdown=touchdown, window_s=window_s)
    made = type(found)(**{**asdict(found), "subject": who, "source": recording.name})
    made.write(target)
    if as_json:
        print_json({"file": target, **asdict(made), "quality": dict(zip(made.channels, flags, strict=True))})
    else:
        _show(made, flags, target)


def _file_name(subject: str) -> str:
    """What a subject's file is called: a recording from a stranger may name one with a path."""
    return re.sub(r"[^\w. -]", "_", subject)[:100].strip(" .")


def reference(
    recording: Recording, kind: str, envelope: Envelope, *, emg: str = "", touchdown: str = "", window_s: float = 0.5
) -> tuple[AmplitudeReference, list[str]]:
    """The reference that a recording gives, and per channel what its quality was. Raises KinegraphError."""
    import numpy as np

    from kinegraph.operators.emg.amplitude_reference import AmplitudeReference
    from kinegraph.operators.emg.commands.calibration import highest_mean, mean_cycle, quality, settled_envelope
    from kinegraph.stream.chunk import utc

    name = emg or raw_emg(recording)
    spec = recording.stream(name).spec
    time, data, out = settled_envelope(envelope, spec, recording.chunks(name))
    flags, noise = quality(spec, recording.chunks(name), steady=kind != "task")
    note = f"{len(time) / (out.rate_hz or 1):.1f} s of {name}"
    if kind == "mvc":
        values = {"mvc": highest_mean(time, since_again(recording, spec.channels, time, data), out, window_s)}
        note += f", highest mean over {window_s:g} s"
    elif kind == "rest":
        values = {"rest": np.nanmean(data, axis=0)}
    else:
        contacts = touchdown or _only(
            recording, "touch-downs", lambda s: s.spec.dtype.names == ("onset",), ends="touchdown"
        )
        curve, count = mean_cycle(envelope, spec, recording, name, contacts)
        values = {"task_peak": curve.max(axis=0), "task_mean": curve.mean(axis=0)}
        note += f", mean of {count} cycles"
    for channel, value in zip(spec.channels, next(iter(values.values())), strict=True):
        if not value > 0:
            raise KinegraphError(
                f"{recording.path}: {channel} gives no reference (its envelope comes to {value:g}); was it connected?"
            )
    return AmplitudeReference(
        kind=kind,
        values={method: found.tolist() for method, found in values.items()},
        channels=list(spec.channels),
        unit=spec.units[0],
        envelope=out.meta["envelope"],
        noise=noise.tolist() if kind == "rest" and (noise > 0).all() else [],
        date=utc(int(time[0]))[:10] if time[0] > 10**18 else "",
        note=note,
    ), flags


def since_again(recording: Recording, channels: Sequence[str], time: Times, data: Samples) -> Samples:
    """The envelope without what a muscle did before the last annotation "again MUSCLE": its contraction was taken again."""
    import numpy as np

    if "annotations" not in recording.streams:
        return data
    _, notes = recording.read("annotations")
    data = data.copy()
    for onset, text in zip(notes["onset"].tolist(), notes["text"].tolist(), strict=True):
        word, _, name = str(text).partition(" ")
        if word == "again" and name in channels:
            data[time < onset, list(channels).index(name)] = np.nan
    return data


def raw_emg(recording: Recording) -> str:
    """The one stream of raw EMG: a signal in volts. Raises KinegraphError where it is not plain which."""
    volts = ("uV", "µV", "mV", "V")
    return _only(recording, "EMG", lambda s: s.spec.is_signal and s.spec.rate_hz and s.spec.units[0] in volts)


def envelope_of(text: str, where: str) -> Envelope:
    """The envelope that a graph's text describes; the default one without any. Raises KinegraphError for several."""
    from ruamel.yaml import YAML

    from kinegraph.operators.emg.envelope import Envelope
    from kinegraph.stream.params import build

    known = {f.name for f in fields(Envelope)}
    nodes = (YAML(typ="safe").load(text) or {}).get("nodes") or {}
    found = {
        name: node
        for name, node in nodes.items()
        if isinstance(node, dict) and node.get("use") == "operators.emg.Envelope"
    }
    made = {name: build(Envelope, {k: v for k, v in node.items() if k in known}) for name, node in found.items()}
    if len(set(made.values())) > 1:
        raise KinegraphError(f"{where}: the envelopes {', '.join(made)} differ; name a graph with one by --config")
    return next(iter(made.values()), Envelope())


def _text(config: File) -> str:
    from kinegraph.stream.graph.reading.load import read_expanded
    from kinegraph.stream.graph.reading.overrides import dump

    return dump(read_expanded(config).plain())


def _only(recording: Recording, what: str, fits: Any, ends: str = "") -> str:
    """The one stream that fits; those of the devices go before what was computed. Raises KinegraphError where it is not plain which."""
    fitting = {name: stream for name, stream in recording.streams.items() if fits(stream) and name.endswith(ends)}
    names = [name for name, stream in fitting.items() if stream.role == "input"] or list(fitting)
    if len(names) == 1:
        return names[0]
    some = f"it may be {' or '.join(names)}" if names else f"no stream of {', '.join(recording.streams)} seems to"
    raise KinegraphError(
        f"{recording.path}: which stream holds the {what}? Name it with {'--touchdown' if ends else '--emg'}; {some}"
    )


def _show(made: AmplitudeReference, flags: list[str], target: File) -> None:
    from kinegraph.stream.text.screen import Screen

    console = Screen()
    console.print(_table(made, flags))
    console.print(
        f"{target}: {made.kind} of {made.subject or 'an unnamed person'}, {made.date or 'on an unknown day'}, {made.note}"
    )


def _table(made: AmplitudeReference, flags: list[str]) -> Table:
    from rich.table import Table

    table = Table(box=None)
    for column in (
        "muscle",
        *(f"{method} ({made.unit})" for method in made.values),
        *([f"noise ({made.unit})"] if made.noise else []),
        "quality",
    ):
        table.add_column(column, justify="left" if column in ("muscle", "quality") else "right")
    for k, channel in enumerate(made.channels):
        numbers = [f"{values[k]:.3g}" for values in [*made.values.values(), *([made.noise] if made.noise else [])]]
        table.add_row(channel, *numbers, flags[k])
    return table
