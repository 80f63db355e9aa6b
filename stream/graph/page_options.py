"""How the page of a graph looks: its panels, as the section `page:` of a graph says."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

from stream.params import param

PanelKind = Literal["signal", "events", "table", "cycles", "frame", "scene", "state", "graph", "log"]


@dataclass(frozen=True, slots=True)
class Panel:
    """One panel.

    kind       what it draws
    title      above it; default: the streams' names
    wide       how many columns of the page it takes
    tall       how many times as tall as others it is
    window_s   how much time it shows; 0: the page's own choice
    least      lower limit of the scale; default: what the data take
    most       upper limit of the scale
    """

    kind: PanelKind
    title: str = ""
    wide: int = param(1, least=1, most=4)
    tall: float = param(1.0, least=0.5, most=4.0)
    window_s: float = param(0.0, least=0.0, most=86400.0)
    least: float | None = None
    most: float | None = None


@dataclass(frozen=True, slots=True)
class PageOptions:
    """How the page looks.

    unrecorded_pictures   whether pictures that are not recorded may be shown, in a browser on the same machine
    panels                as the page's server takes them: the keys of a `Panel`, and `of`, the names of streams
    """

    unrecorded_pictures: bool = False
    panels: tuple[dict[str, Any], ...] = field(default=(), init=False)

    @property
    def streams(self) -> set[str]:
        """The streams that panels name."""
        return {name for panel in self.panels for name in panel["of"]}
