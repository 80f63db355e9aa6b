"""`kinegraph files compare-clocks`: how the clocks of two recordings lie, by a train of pulses in both."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from kinegraph.stream.chunk import NS, Samples
from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.text.safe_text import say


def compare_clocks(
    first: Annotated[Path, typer.Argument(help="the recording with the reference clock", metavar="FIRST")],
    second: Annotated[Path, typer.Argument(help="the other recording", metavar="SECOND")],
    stream: Annotated[
        str, typer.Option("--stream", help="the pulses in the first: events, or a channel STREAM:CHANNEL")
    ],
    other: Annotated[str, typer.Option("--other", help="the pulses in the second; the same name where left out")] = "",
    threshold: Annotated[
        float | None, typer.Option(help="where a channel's pulse begins; else half of its range")
    ] = None,
    within_ms: Annotated[float, typer.Option(help="pulses that match lie this near to each other")] = 20.0,
    as_json: AsJson = False,
) -> None:
    """Compare two recordings' clocks by a trigger that both recorded (TTL line, LSL markers, switch).

    Prints offset, drift and residual, and what to add to the second's times. Refused where fewer than three pulses match, or evenly
    spaced pulses fit in several ways.
    """
    from kinegraph.operators.contacts.pulse_match import match_pulses

    found = match_pulses(
        read_pulses(first, stream, threshold), read_pulses(second, other or stream, threshold), within_ms / 1000
    )
    if as_json:
        print_json(found)
        return
    say(
        f"{second} + {found.offset_s:.6f} s, drift {found.drift_ppm:+.1f} ppm from {found.start_s:.3f} s on: "
        f"{found.matched} of {found.first} and {found.second} pulses match, residual {found.residual_ms:.2f} ms rms, "
        f"{found.worst_ms:.2f} ms at most"
    )


def read_pulses(path: Path, name: str, threshold: float | None) -> Samples:
    """The onsets (n,) of pulses in a recording, in s of its clock: events, or a channel's rises through `threshold`."""
    from kinegraph.stream.recording import Recording

    stream, _, channel = name.partition(":")
    with Recording.open(path) as recording:
        spec = recording.stream(stream).spec
        time, data = recording.read(stream)
    if spec.is_event:
        return np.asarray(data["onset"] if "onset" in (data.dtype.names or ()) else time, float) / NS
    if channel not in spec.channels or not spec.is_signal:
        raise KinegraphError(f"{path}: name a channel of {stream}, as in {stream}:{(spec.channels or ('TTL',))[0]}")
    level = np.asarray(data[:, spec.channels.index(channel)], float)
    limit = threshold if threshold is not None else (np.nanmin(level) + np.nanmax(level)) / 2
    rises = np.flatnonzero((level[:-1] < limit) & (level[1:] >= limit))
    share = (limit - level[rises]) / (level[rises + 1] - level[rises])
    return np.asarray(time[rises] / NS + share * (time[rises + 1] - time[rises]) / NS)
