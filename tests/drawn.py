"""What a figure of matplotlib shows, in numbers: coordinates, colours and words of all that is drawn, one line for each of its axes.

A picture's pixels say little (a bar that is one second off moves none of a hundred tiles) and differ between fonts; this does not.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text

from stream.chunk import Array
from tests import golden

NUMBER = re.compile(r"\d+(?:\.\d+)?")


def saved(figures: list[str]) -> Any:
    """A replacement for `Figure.savefig` that saves as usual and adds to `figures` what the figure shows."""
    save = Figure.savefig

    def saving(figure: Figure, *arguments: Any, **named: Any) -> None:
        save(figure, *arguments, **named)
        figures.extend(shown(figure))

    return saving


def shown(figure: Figure) -> Iterator[str]:
    """A line for the figure itself, and one for each of its axes. Where axes are is left out: that depends on fonts."""
    own = [a for a in figure.get_children() if not isinstance(a, Axes)]
    yield f"figure {' '.join((f'inches={golden._sums(figure.get_size_inches())}', *_of(own)))}"
    for axes in figure.axes:
        limits = np.array([*axes.get_xlim(), *axes.get_ylim()])
        labels = [axes.xaxis.label, axes.yaxis.label]
        legend = axes.get_legend()
        keys = [] if legend is None else [*legend.get_patches(), *legend.get_lines(), *legend.get_texts()]
        yield f"axes {' '.join((f'limits={golden._sums(limits)}', *_of([*axes.get_children(), *labels, *keys])))}"


def _of(artists: Sequence[Artist]) -> Iterator[str]:
    for kind in (Line2D, Patch, Collection, AxesImage, Text):
        if found := [a for a in artists if isinstance(a, kind)]:
            places = np.concatenate([np.ravel(_places(a)) for a in found])
            yield f"{kind.__name__}={len(found)},{golden._sums(places)} looks=#{_looks(found)}"


def _places(artist: Artist) -> Array:
    """Where it is, in the axes' own numbers; of an image what it shows, too."""
    match artist:
        case Line2D():
            return np.asarray(artist.get_xydata(), np.float64)
        case Patch():
            return np.asarray(artist.get_patch_transform().transform(artist.get_path().vertices), np.float64)
        case Collection():
            paths = [np.ravel(path.vertices) for path in artist.get_paths()]
            by_number = np.zeros(0) if artist.get_array() is None else np.ravel(artist.get_array())
            return np.concatenate([np.ravel(np.ma.filled(artist.get_offsets(), np.nan)), *paths, by_number])
        case AxesImage():
            image = np.ma.filled(np.ma.asarray(artist.get_array(), np.float64), np.nan)
            return np.concatenate([artist.get_extent(), np.ravel(image)])
        case Text():
            return np.array([*artist.get_position(), *map(float, NUMBER.findall(artist.get_text()))])
    return np.zeros(0)


def _looks(found: list[Any]) -> int:
    """Colours, widths and words, as a checksum."""
    return zlib.crc32(repr([_look(a) for a in found]).encode())


def _look(artist: Artist) -> list[Any]:
    match artist:
        case Line2D():
            colour = to_rgba(artist.get_color())
            return [colour, artist.get_linewidth(), artist.get_linestyle(), artist.get_marker()]
        case Patch():
            return [artist.get_facecolor(), artist.get_edgecolor(), artist.get_linewidth()]
        case Collection():
            colour = artist.get_facecolor() if artist.get_array() is None else artist.get_cmap().name
            return [np.asarray(colour).tolist(), np.asarray(artist.get_linewidth()).tolist()]
        case AxesImage():
            return [artist.get_clim(), artist.get_interpolation(), artist.get_cmap().name]
        case Text():
            return [NUMBER.sub("", artist.get_text())]
    return []
