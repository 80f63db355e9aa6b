"""What rich draws, without its markup: a text that holds [brackets] or control characters is shown as it is written."""

from __future__ import annotations

from collections.abc import Iterable
from typing import IO

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from kinegraph.stream.text.safe_text import HARMFUL, plain
from kinegraph.stream.text.units import MICRO, shown

ROOMY = 200
"""Columns of what is no terminal (a pipe, a file), which is as wide as it takes."""


class Screen(Console):
    """The one console of all commands. Styles are given apart from texts: `print(text, style="dim")`, or as a `Text`."""

    def __init__(self, *, stderr: bool = False, file: IO[str] | None = None) -> None:
        super().__init__(stderr=stderr, file=file, markup=False, emoji=False, highlight=False)
        if not self.is_terminal:
            self.width = ROOMY

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """As rich does, with texts made plain and the micro sign in units; control sequences of rich's own are segments apart, and stay."""
        for segment in super().render(renderable, options):
            if segment.control is None and (HARMFUL.search(segment.text) or MICRO.search(segment.text)):
                yield Segment(shown(plain(segment.text)), segment.style)
            else:
                yield segment
