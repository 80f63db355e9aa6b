"""The arguments and options of `kinegraph files import`; `devices.commands.import_options` reads those about streams."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, TypeAlias

import typer

from kinegraph.devices.commands.import_options import Many
from kinegraph.devices.formats.findings import Claims
from kinegraph.devices.formats.importer import listed

ImportedFiles: TypeAlias = Annotated[
    list[Path],
    typer.Argument(help=f"files, recognised by their content or the ends of their names. {listed()}", metavar="FILE"),
]
Output: TypeAlias = Annotated[
    Path | None, typer.Option("-o", "--out", help="the recording to be made, ending in .mcap")
]
PreviewOnly: TypeAlias = Annotated[
    bool, typer.Option("--preview", help="only say what was understood; nothing is written")
]
NamedColumns: TypeAlias = Annotated[
    Many,
    typer.Option(
        metavar="NAME=COLUMNS",
        help="a stream from an array, from columns (a,b,c), or from a stream of a file that has streams",
    ),
]
EventColumns: TypeAlias = Annotated[
    Many, typer.Option(metavar="NAME=COLUMN", help="an event stream from a column of times")
]
TimeColumn: TypeAlias = Annotated[
    Many, typer.Option(metavar="[NAME=]COLUMN", help="the column or array with the samples' times")
]
TimeUnit: TypeAlias = Annotated[
    Many,
    typer.Option(metavar="[NAME=]UNIT", help="s, ms, us, ns, min or samples (default: by the column's name, else s)"),
]
Rate: TypeAlias = Annotated[
    Many, typer.Option(metavar="[NAME=]HZ", help="sampling rate: a number, or the array that holds it")
]
CounterColumn: TypeAlias = Annotated[
    Many, typer.Option(metavar="[NAME=]COLUMN", help="a packet counter, which tells what was lost")
]
ChannelNames: TypeAlias = Annotated[
    Many, typer.Option(metavar="[NAME=]NAMES", help="channel names: a,b,c, or the array that holds them")
]
Unit: TypeAlias = Annotated[
    Many, typer.Option(metavar="[NAME=]UNIT", help="unit of the samples, e.g. uV; or one for each channel: a,b,c")
]
Scale: TypeAlias = Annotated[Many, typer.Option(metavar="[NAME=]FACTOR", help="multiply the samples")]
PointsUp: TypeAlias = Annotated[
    Many,
    typer.Option(
        metavar="[NAME=]AXIS", help="for points and meshes in files that do not say it: the axis that points up"
    ),
]
FacesForward: TypeAlias = Annotated[
    Many, typer.Option(metavar="[NAME=]AXIS", help="with --up: the axis along which bodies face, if it is known")
]
BoneNames: TypeAlias = Annotated[
    Many,
    typer.Option(
        metavar="BONE=JOINT",
        help="poses: which joint is which bone (LeftUpperArm=Bone_17), where its name does not show it",
    ),
]
StreamFacts: TypeAlias = Annotated[
    Many, typer.Option(metavar="NAME:KEY=VALUE", help="a fact about a stream, e.g. side=right")
]
SessionFacts: TypeAlias = Annotated[
    Many, typer.Option(metavar="KEY=VALUE", help="a fact about the session, e.g. subject=S01")
]
Start: TypeAlias = Annotated[
    str, typer.Option(metavar="ISO", help="when time 0 was, e.g. 2024-05-01T09:30:00+02:00 (UTC without an offset)")
]
SkippedRows: TypeAlias = Annotated[
    int | None,
    typer.Option(min=0, metavar="N", help="text files: pass over N lines; below them the header may be missing"),
]
ChunkLength: TypeAlias = Annotated[
    float, typer.Option(min=1.0, max=1000.0, help="samples arrive in windows of this many ms")
]
RepeatedTimes: TypeAlias = Annotated[
    bool,
    typer.Option(help="accept repeated times (a coarse clock); leave out packets with a repeated counter"),
]
TextWidth: TypeAlias = Annotated[
    int | None,
    typer.Option(min=1, max=65536, help="characters that a marker of an XDF file may have (default: as it has)"),
]
Dejitter: TypeAlias = Annotated[bool, typer.Option(help="XDF: remove the jitter of regular streams' times")]
ClaimPolicy: TypeAlias = Annotated[
    Claims,
    typer.Option(
        help="of a stream that is not as its file claims: warn of it, refuse the file, or use the measured rate"
    ),
]
KinectColumns: TypeAlias = Annotated[
    bool, typer.Option(help="CSV: x, y and z of a skeleton's joints, as points; NPY: 33 landmarks of a video's frames")
]
ClockSync: TypeAlias = Annotated[bool, typer.Option(help="XDF: apply the clock offsets that were measured")]
UntriedFormats: TypeAlias = Annotated[
    bool, typer.Option("--untried", help="also read formats of which no real file was at hand to try: MVNX")
]
Overwrite: TypeAlias = Annotated[bool, typer.Option("--overwrite", help="replace a recording that already exists")]
