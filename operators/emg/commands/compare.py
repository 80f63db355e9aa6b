"""`kinegraph emg compare`: muscle activity of several sessions or legs beside each other."""

from __future__ import annotations

from pathlib import Path as File
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say


def compare(
    sessions: Annotated[
        list[File],
        typer.Argument(
            help="recorded sessions, or results of `kinegraph batch`, with closed, cycles and maxima",
            metavar="SESSION",
        ),
    ],
    output: Annotated[File, typer.Option("-o", "--out", help="folder for comparison.html and comparison.csv")] = File(
        "comparison"
    ),
    node: Annotated[
        str,
        typer.Option(
            metavar="NODE", help="the node or limb (left) to compare, if a session has cycles of several legs"
        ),
    ] = "",
    relevant: Annotated[
        float, typer.Option(min=0.0, max=100.0, help="show no difference below this part (%) of the larger peak")
    ] = 5.0,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace files that exist")] = False,
    as_json: AsJson = False,
) -> None:
    """Compare EMG sessions: before and after, left and right, or a group.

    The report shows the scatter of cycles, the divergence of mixtures, which sessions resemble each other, and where mean curves differ.

    Each leg is compared with the same leg, each stage with the same stage; the legs of a single recording with each other. A job of a
    batch counts as a recording. It refuses sessions with curves normalised or filtered differently.
    """
    from kinegraph.operators.emg.commands.comparison import compare_sessions
    from kinegraph.operators.emg.commands.comparison_groups import by_stage, groups_of
    from kinegraph.operators.emg.commands.comparison_page import stretches, write_page, write_tables
    from kinegraph.operators.emg.commands.session_cycles import MAX_CYCLES, check_alike, read_sessions
    from kinegraph.operators.emg.mixtures.operator import PeakMixtures
    from kinegraph.stream.batch.sessions import sessions_at
    from kinegraph.stream.system.atomic_file import private_folder

    page, table = output / "comparison.html", output / "comparison.csv"
    for path in (page, table):
        if path.exists() and not overwrite:
            raise KinegraphError(f"{path} exists; --overwrite replaces it, --out names another folder")
    compared = [*sessions_at(sessions)]
    recordings = [[part for leg in read_sessions(path, node) for part in by_stage(leg)] for path in compared]
    read = [session for recording in recordings for session in recording]
    if len(read) < 2:
        raise KinegraphError("one session alone has nothing to be compared with; name two, or one with two legs")
    check_alike(read)
    shared = set.intersection(*(set(session.muscles) for session in read))
    if not shared:
        raise KinegraphError(
            "the sessions have no muscle in common: " + "; ".join(f"{s.label}: {', '.join(s.muscles)}" for s in read)
        )
    groups, notes = groups_of(recordings)
    found = compare_sessions(read, PeakMixtures(cycles=MAX_CYCLES), groups, relevant)
    private_folder(output)
    write_page(found, page, " and ".join(found.labels) if len(read) < 4 else f"{len(compared)} sessions compared")
    write_tables(found, table)
    if as_json:
        bands = [
            {
                "name": band.name,
                "divergence": found.distances[band.muscle][band.pair],
                "differs_pct": band.places,
                "mean_difference": band.difference,
                "band": band.width,
            }
            for band in found.bands
        ]
        sessions_read = dict(zip(found.labels, found.cycles, strict=True))
        print_json(
            {"page": page, "table": table, "cycles": sessions_read, "muscles": bands, "notes": [*notes, *found.speeds]}
        )
        return
    for note in (*notes, *found.speeds):
        say(note)
    for band in found.bands:
        where = f"at {stretches(band.places)} % of the cycle" if band.places else "nowhere"
        say(f"{band.name}: divergence {found.distances[band.muscle][band.pair]:.3f}, means differ {where}")
    say(f"{page}: {', '.join(f'{label} ({n} cycles)' for label, n in zip(found.labels, found.cycles, strict=True))}")
