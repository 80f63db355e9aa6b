"""`kinegraph motion train map`: from recordings of motion, a map of all poses in them."""

from __future__ import annotations

from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import one_line, say

if TYPE_CHECKING:
    from kinegraph.operators.maps.pose_map.commands.gather import GatheredPoses
    from kinegraph.stream.domain.pose_map import MotionIndex


def map_(
    recordings: Annotated[list[File], typer.Argument(help="recordings of markers or poses", metavar="RECORDING")],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("map.npz"),
    markers: Annotated[File | None, typer.Option(metavar="FILE", help="YAML: which markers; see below")] = None,
    origin: Annotated[str, typer.Option(help="without --markers: the marker that positions are relative to")] = "",
    ahead: Annotated[str, typer.Option(help="without --markers: the marker that is turned ahead")] = "",
    rate_hz: Annotated[float, typer.Option(min=1.0, max=1000.0, help="poses per second")] = 60.0,
    rows: Annotated[int, typer.Option(min=1, max=40, help="rows of the grid")] = 12,
    columns: Annotated[int, typer.Option(min=1, max=40, help="columns of the grid")] = 12,
    seed: Annotated[int, typer.Option(min=0, help="another seed, another order of learning")] = 0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
) -> None:
    """Learn a map of all poses in recordings: a PCA, a self-organising map, and what outliers are (thesis, chapter 5).

    The file of markers says, for recordings of different set-ups,

    origin: withers   # positions are relative to it

    ahead: sacrum     # it is turned into the x-y plane; y points up

    markers: {withers: [withers, T6], sacrum: [sacrum, S1 + S2], poll: }   # what each may be called; S1 + S2: their mean

    bones: [[withers, sacrum], [withers, poll]]   # optional; up: z, if z points up in the recordings

    Without it the first recording's own markers are the set. `kinegraph motion map` shows the map.
    """
    from kinegraph.operators.maps.pose_map.commands.build import build_index
    from kinegraph.operators.maps.pose_map.commands.gather import PoseReading
    from kinegraph.operators.maps.pose_map.commands.marker_table import read_table

    if output.exists() and not overwrite:
        raise KinegraphError(f"{output}: exists; choose another --out, or replace it with --overwrite")
    reading = PoseReading(rate_hz, read_table(markers) if markers else None, origin, ahead)
    found: list[GatheredPoses] = []
    for path in recordings:
        made = reading.read(path)
        found += made
        say(f"{path}: {sum(len(g.poses) for g in made) / rate_hz:.1f} s in {len(made)} sequences")
    if not found or reading.table is None:
        raise KinegraphError("no sequence of two poses or more in these recordings")
    index = build_index(reading.table, found, rate_hz, rows, columns, seed)
    try:
        index.write(output, {"trained_on": [path.name for path in recordings]})
    except OSError as error:
        raise KinegraphError(f"{output}: cannot be written: {error.strerror or error}") from None
    report(output, index)


def report(output: File, index: MotionIndex) -> None:
    """What came out, for people."""
    rows = len(index.codes) // index.columns
    explained = " + ".join(f"{100 * share:.0f}" for share in index.explained)
    say(
        f"{output}: {len(index.poses)} poses of {len(index.sequences)} sequences; PCA holds {explained} % of the variance; "
        f"{rows} x {index.columns} cells: quantisation error {100 * index.quantisation:.1f} cm, topographic error {index.topographic:.3f}"
    )
    for one in index.sequences:
        if one.missing:
            say(one_line(f"  {one.name}: lacks {', '.join(one.missing)}"))
    out = [name for k, name in enumerate(index.markers) if k not in index.used]
    if out:
        say(f"  left out of the map, since not all sequences have them: {', '.join(out)}")
    lost = int((index.cell < 0).sum())
    if lost:
        say(f"  {lost} poses have no place: a marker is hidden")
