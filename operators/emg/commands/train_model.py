"""`kinegraph emg train-model`: how a person's muscles are usually active, learned from recorded sessions."""

from __future__ import annotations

from pathlib import Path as File
from typing import TYPE_CHECKING, Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError

if TYPE_CHECKING:
    from rich.table import Table

    from kinegraph.operators.emg.mixtures.reference import References


def emg_model(
    sessions: Annotated[
        list[File],
        typer.Argument(
            help="recorded sessions, or results of `kinegraph batch`, with closed, cycles and maxima",
            metavar="SESSION",
        ),
    ],
    output: Annotated[File, typer.Option("-o", "--out", help="the model to be made")] = File("emg-model.npz"),
    node: Annotated[str, typer.Option(metavar="NODE", help="the node with the cycles, if a session has several")] = "",
    cycles: Annotated[int, typer.Option(min=2, max=100, help="of the window that will be compared with it")] = 3,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace a model that exists")] = False,
    as_json: AsJson = False,
) -> None:
    """Mixtures of each muscle's activation peaks over all accepted cycles, for `reference` of operators.emg.mixtures.drift.MixtureDrift.

    Beyond the limit a session has moved away: the 99th percentile of divergences between `--cycles` of these, at random, and the rest.
    """
    import numpy as np

    from kinegraph.operators.emg.commands.session_cycles import (
        MAX_CYCLES,
        check_alike,
        joined,
        other_speeds,
        read_sessions,
    )
    from kinegraph.operators.emg.mixtures.emg_model import write_references
    from kinegraph.operators.emg.mixtures.operator import PeakMixtures
    from kinegraph.operators.emg.mixtures.reference import References
    from kinegraph.stream.batch.sessions import sessions_at
    from kinegraph.stream.text.safe_text import say
    from kinegraph.stream.text.screen import Screen

    if output.exists() and not overwrite:
        raise KinegraphError(f"{output} exists; --overwrite replaces it, --out names another file")
    read = [found for path in sessions_at(sessions) for found in read_sessions(path, node)]
    check_alike(read)
    legs = [joined([one for one in read if one.limb == limb]) for limb in dict.fromkeys(one.limb for one in read)]
    mixer = PeakMixtures(cycles=MAX_CYCLES)
    parts = [leg.references(mixer, 100, cycles)[0] for leg in legs]
    made = References(*(np.concatenate([getattr(part, name) for part in parts]) for name in References.__slots__))
    names = [name for leg in legs for name in leg.channels or leg.muscles]
    count, whole = sum(len(leg.curves) for leg in legs), legs[0]
    if not (made.modes > 0).any():
        raise KinegraphError(f"no muscle has a burst in {count} cycles; there is nothing to make a model of")
    about = {
        "subjects": sorted({s.subject for s in read if s.subject}), "sessions": [s.label for s in read], "window": cycles,
        "input": {"muscles": names, "unit": whole.alike["height_unit"]},
    }  # fmt: skip
    write_references(output, made, names, {**whole.alike, "fitting": {"circular": mixer.circular}}, about)
    if as_json:
        muscles = [
            {
                "muscle": name,
                "cycles": made.cycles[k],
                "modes": max(made.modes[k], 0),
                "limit": made.limit[k],
                "all_points": made.full[k],
                "noise": made.noise[k],
            }
            for k, name in enumerate(names)
        ]
        print_json({"file": output, "cycles": count, **about, "muscles": muscles, "speeds": other_speeds(read)})
        return
    title = f"{output}: {count} cycles of {len(read)} sessions, amplitudes: {whole.alike['normalisation']}"
    Screen().print(_table(title, names, made))
    for speed in (speeds := other_speeds(read)):
        say(speed)
    if speeds:
        say(f"{output} takes all these speeds for usual")


def _table(title: str, names: list[str], made: References) -> Table:
    """What the model knows of each muscle."""
    import numpy as np
    from rich.table import Table

    table = Table(title=title, box=None)
    for heading in ("muscle", "cycles", "modes", "limit", "all points", "noise"):
        table.add_column(heading, justify="left" if heading == "muscle" else "right")
    for k, name in enumerate(names):
        numbers = [
            f"{value:.3f}" if np.isfinite(value) else "not known"
            for value in (made.limit[k], made.full[k], made.noise[k])
        ]
        table.add_row(
            name, str(made.cycles[k]), str(max(made.modes[k], 0)) if made.modes[k] > 0 else "no burst", *numbers
        )
    return table
