"""How the page of a graph looks: its panels, as the section `page:` of a graph says."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kinegraph.stream.params import param

PANEL_KINDS = (
    "answer",
    "signal", "events", "table", "cycles", "frame", "scene", "avatar", "hypnogram", "weeks", "map", "similarity", "state", "graph", "log",
)  # fmt: skip
"""Those that the page has itself; operators and outlets bring others."""


@dataclass(frozen=True, slots=True)
class Shown:
    """One thing that an answer shows: of a stream's events, the newest that fits; of a signal, the newest sample.

    of        the stream
    field     the field, or the channel, that is shown
    label     what it is, for people
    unit      default: the field's own
    decimals  of a number
    factor    what a number is multiplied with: 2 makes steps of strides
    values    words for values ({sleep: asleep}); an empty word shows nothing
    where     only events with these values ({final: false}); a list names several
    count     how many events fit, instead of a field; of a signal, how many channels are above `above`
    above     see `count`
    between   two fields, the limits of what is shown, beside it
    since     since when the field has had its value, beside it
    down_s    instead of a field: a countdown from this since the newest event (s), while that one fits
    """

    of: str
    values: dict[str, str] = field(default_factory=dict)
    where: dict[str, Any] = field(default_factory=dict)
    field: str = ""
    label: str = ""
    unit: str = ""
    decimals: int = param(0, least=0, most=6)
    factor: float = 1.0
    count: bool = False
    above: float = 0.0
    between: tuple[str, ...] = ()
    since: bool = False
    down_s: float = param(0.0, least=0.0, most=3600.0)


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
    folded     whether it is among the signals, which are folded away until somebody opens them
    show       what a panel of the kind `answer` shows, the most important first and largest
    """

    kind: str
    title: str = ""
    wide: int = param(1, least=1, most=4)
    tall: float = param(1.0, least=0.5, most=4.0)
    window_s: float = param(0.0, least=0.0, most=86400.0)
    least: float | None = None
    most: float | None = None
    folded: bool = False
    show: tuple[Shown, ...] = ()


@dataclass(frozen=True, slots=True)
class PageOptions:
    """How the page looks.

    unrecorded_pictures   whether pictures that are not recorded may be shown, in a browser on the same machine
    serve                 whether `kinegraph run` serves the page without being asked with --page
    panels                as the page's server takes them: the keys of a `Panel`, and `of`, the names of streams
    avatar                the VRM file that panels of the kind `avatar` show; default: one that comes with the page
    modules               panels of the graph's own parts, and of what is installed: per kind, the file of their JavaScript module
    """

    unrecorded_pictures: bool = False
    serve: bool = False
    avatar: Path | None = None
    panels: tuple[dict[str, Any], ...] = field(default=(), init=False)
    modules: dict[str, Path] = field(default_factory=dict, init=False)

    @property
    def streams(self) -> set[str]:
        """The streams that panels name."""
        return {name for panel in self.panels for name in panel["of"]}
