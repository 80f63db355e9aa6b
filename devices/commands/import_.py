"""`kinegraph files import`: files of other programs as a recording that replays as if it had been live."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path as File
from typing import TYPE_CHECKING

from kinegraph.devices.commands import import_arguments as argument
from kinegraph.devices.commands.import_options import options_of, pairs, value
from kinegraph.devices.formats.importer import read_files
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import RecordingError
from kinegraph.stream.text.safe_text import say

if TYPE_CHECKING:
    from collections.abc import Sequence

    from kinegraph.devices.formats.column_table import ImportOptions
    from kinegraph.stream.recording.series import Series


def import_(
    files: argument.ImportedFiles,
    output: argument.Output = None,
    preview: argument.PreviewOnly = False,
    stream: argument.NamedColumns = None,
    events: argument.EventColumns = None,
    time: argument.TimeColumn = None,
    time_unit: argument.TimeUnit = None,
    rate: argument.Rate = None,
    counter: argument.CounterColumn = None,
    names: argument.ChannelNames = None,
    unit: argument.Unit = None,
    scale: argument.Scale = None,
    up: argument.PointsUp = None,
    forward: argument.FacesForward = None,
    bones: argument.BoneNames = None,
    meta: argument.StreamFacts = None,
    fact: argument.SessionFacts = None,
    start: argument.Start = "",
    skip_rows: argument.SkippedRows = None,
    chunk_ms: argument.ChunkLength = 20.0,
    repeated: argument.RepeatedTimes = False,
    text_width: argument.TextWidth = None,
    dejitter: argument.Dejitter = True,
    claims: argument.ClaimPolicy = "warn",
    kinect: argument.KinectColumns = False,
    clock_sync: argument.ClockSync = True,
    untried: argument.UntriedFormats = False,
    overwrite: argument.Overwrite = False,
    as_json: AsJson = False,
) -> None:
    """Turn files of other programs into one recording.

    With --preview it only shows what would be read.

    kinegraph files import emg.csv -o emg.mcap --stream board.emg=TA,GM --time time --unit uV
    """
    from kinegraph.stream.cli.commands import logs

    logs.set_up()
    record = {"stream": stream, "events": events, "time": time, "time_unit": time_unit, "rate": rate, "counter": counter,
            "names": names, "unit": unit, "scale": scale, "meta": meta}  # fmt: skip
    options = options_of(record, start, repeated=repeated, text_width=text_width, dejitter=dejitter, clock_sync=clock_sync,
                       skip_rows=skip_rows, preview=preview, untried=untried, claims=claims)  # fmt: skip
    facts = {key: value(text) for key, text in pairs("fact", fact, named=True).items()}
    if output is None and not preview:
        raise RecordingError(
            "--out is missing: name the recording to be made, as in -o NAME.mcap, or look with --preview"
        )
    if output is not None and output.suffix != ".mcap":
        raise RecordingError(f"--out {output}: the recording's name must end in .mcap")
    series = read_files(files, options, kinect=kinect)
    _check_names(series)
    _declare_axes(series, pairs("up", up), pairs("forward", forward))
    if bones:
        _name_bones(series, pairs("bones", bones, named=True))
    if output is not None and not preview:
        _write(files, series, options, facts, output, chunk_ms / 1000, overwrite=overwrite)
    if as_json:
        found = options.findings
        print_json(
            {
                "recording": None if preview else output,
                "kinds": {str(file): kind for file, kind in found.kinds.items()},
                "streams": {one.name: {"samples": len(one), **one.spec.to_json()} for one in series},
                "facts": {**found.facts, **facts},
                "doubts": found.doubts,
                "findings": [finding.facts() for finding in found.claims],
            }
        )
    elif preview:
        from kinegraph.devices.commands.preview import show

        show(series, options.findings)
    else:
        _show_written(series, options)


def _write(
    files: Sequence[File],
    series: Sequence[Series],
    options: ImportOptions,
    facts: dict[str, str | int | float],
    output: File,
    chunk_s: float,
    *,
    overwrite: bool,
) -> None:
    from kinegraph.stream.recording import versions
    from kinegraph.stream.recording.series import write_recording
    from kinegraph.stream.text.progress import bar

    if not any(len(one.time) for one in series):
        raise RecordingError(f"{', '.join(map(str, files))}: there are no samples to record")
    doubts, found = options.findings.doubts, [finding.facts() for finding in options.findings.claims]
    imported = {"files": [file.name for file in files], "at": datetime.now(UTC).isoformat(timespec="seconds")}
    header = {
        "graph": "",
        "session": {**options.findings.facts, **facts},
        "imported": {**imported, **({"doubts": doubts} if doubts else {}), **({"findings": found} if found else {})},
        "versions": versions(),
    }
    with bar(f"importing {', '.join(file.name for file in files)}") as progress:
        write_recording(output, series, header, chunk_s=chunk_s, overwrite=overwrite, progress=progress)


def _show_written(series: Sequence[Series], options: ImportOptions) -> None:
    for one in series:
        say(f"{one.name}: {len(one.time)} samples, {one.spec.describe()}")
    for text in (*options.findings.doubts, *(finding.text for finding in options.findings.claims)):
        say(f"doubtful: {text}", err=True)


def _declare_axes(series: Sequence[Series], up: dict[str, str], forward: dict[str, str]) -> None:
    """Declare the axes of points and meshes, as the options say. Raises RecordingError where files say it themselves."""
    from kinegraph.stream.domain.axes import Axes, has_places, in_axes

    for name in (*up, *forward):
        if name and not any(one.name == name and has_places(one.spec) for one in series):
            raise RecordingError(f"--up {name}=...: there is no stream of points or of a mesh with a unit of that name")
    for one in series:
        way = up.get(one.name, up.get("", ""))
        if not way or not has_places(one.spec) or ("skeleton" in one.spec.meta and one.name not in up):
            continue
        if declared := Axes.of(one.spec):
            raise RecordingError(
                f"--up {way}: {one.name} declares its axes itself ({declared.describe()}); leave it out"
            )
        try:
            axes = Axes(way, forward.get(one.name, forward.get("", "")))
        except ValueError as error:
            raise RecordingError(f"--up {way}: {error}") from None
        one.spec = one.spec.derive(meta=in_axes(one.spec, axes))
    if forward and not up:
        raise RecordingError("--forward: say which axis points up, too, with --up")


def _name_bones(series: Sequence[Series], bones: dict[str, str]) -> None:
    """Give the joints of poses the names of the bones that they are. Raises RecordingError where they are no body even so."""
    from dataclasses import replace

    from kinegraph.stream.domain.humanoid import find_bones
    from kinegraph.stream.domain.skeleton import JointTree
    from kinegraph.stream.errors import KinegraphError

    posed = [one for one in series if "skeleton" in one.spec.meta and len(one.spec.shape) == 1]
    if not posed:
        raise RecordingError(
            "--bones: there are no poses in these files; a BVH file has them with --unit, as in --unit cm"
        )
    for one in posed:
        tree = JointTree.of(one.spec)
        try:
            find_bones(tree.joints, bones)
            named = {joint: bone for bone, joint in bones.items()}
            tree = replace(tree, joints=tuple(named.get(joint, joint) for joint in tree.joints))
        except (KinegraphError, ValueError) as error:
            raise RecordingError(f"--bones: {one.name}: {error}") from None
        one.spec = tree.spec(one.spec.rate_hz, meta=one.spec.meta)


def _check_names(series: Sequence[Series]) -> None:
    for one in series:
        if sum(one.name == other.name for other in series) > 1:
            raise RecordingError(f"two streams are named {one.name!r}; name them with --stream")
