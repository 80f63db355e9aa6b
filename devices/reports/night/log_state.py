"""What a night's log remembers over a restart."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class LogState:
    """
    held   what is known of epochs that are not final yet, as JSON by onset
    bed    what the bed is now
    rests  the night is over, but somebody is still in bed: the next begins when the bed was left
    run    which session this is, over all its restarts
    """

    held: str = "{}"
    bed: str = ""
    rests: bool = False
    run: str = ""
