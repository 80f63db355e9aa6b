"""`kinegraph recover`: finish a recording that a killed process or a power cut left."""

from __future__ import annotations

from pathlib import Path as File
from typing import Annotated

import typer

from kinegraph.stream.cli.commands.json_option import AsJson, print_json
from kinegraph.stream.text.safe_text import say


def recover(
    recording: Annotated[File, typer.Argument(help="the recording: a file or a session's folder", metavar="FILE")],
    output: Annotated[
        File | None,
        typer.Option(
            "-o",
            "--out",
            help="write it here; otherwise it replaces the file, and the original is kept as *.unfinished",
        ),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Rewrite a recording with all that can be read of it, and add its end and index. Replay and info need neither."""
    from kinegraph.stream.recording.recover import rewrite
    from kinegraph.stream.text.progress import bar

    with bar(f"recovering {recording.name}") as progress:
        found = rewrite(recording, output, progress)
    if as_json:
        print_json(found)
        return
    for part in found:
        damage = f"; {part.damaged} damaged places were skipped" if part.damaged else ""
        say(f"{part.path}: {part.messages} messages, {part.samples} samples{damage}")
        if part.missing and part.missing.bytes:
            lost = f"at least {part.missing.seconds:.1f} s" if part.missing.seconds else "how long it was is not known"
            say(f"  {part.missing.bytes} bytes at its end are not a complete record and could not be recovered: {lost}")
        elif part.missing and part.missing.seconds:
            say(
                f"  at least {part.missing.seconds:.1f} s more had been recorded, according to the session's checkpoint, and are lost"
            )
    if not found:
        say(f"{recording}: already complete, nothing to do")
