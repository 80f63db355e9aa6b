"""The kit of all reports: one HTML file that needs nothing else, readable on a screen and on A4 paper, and figures drawn into it."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kinegraph.stream.text.html import table_html
from kinegraph.stream.text.time_text import now

if TYPE_CHECKING:
    from markupsafe import Markup
    from matplotlib.figure import Figure

INK = "#12395b"
COLOURS = (INK, "#b25b00", "#2f7d4f", "#a3211b", "#7a3b8f", "#55534e", "#0b7d8f", "#8f6b0b")
"""Of curves over one another."""
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "kinegraph",  # the same figure gives the same file
    "font.family": "sans-serif",
    "font.size": 6.5,
    "axes.linewidth": 0.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "xtick.major.width": 0.5,
    "ytick.major.width": 0.5,
    "xtick.major.size": 2.0,
    "ytick.major.size": 2.0,
}
"""For matplotlib's `rc_context`."""


def render(template: Path, title: str, **values: Any) -> str:
    """The page of a template that extends `report.html.j2`. All values are escaped, except figures (`svg`, `png`).

    `versions`, a list of (package, version), is shown at the page's foot. `table(head, rows)` writes a table.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup

    def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> Markup:
        return Markup(f'<div class="wide left">{table_html(head, rows)}</div>')

    loader = FileSystemLoader([template.parent, Path(__file__).parent])
    page = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=False)
    return page.get_template(template.name).render({"versions": [], **values}, title=title, made=now(), table=table)


def svg(figure: Figure, label: str) -> Markup:
    """A figure as an SVG element in the page's own font, with `label` for screen readers.

    Coordinates have two decimals, which makes a page a third as large; numbers that people read are text between the tags and keep theirs.
    Ids begin with the label's letters: several figures of one page would share them.
    """
    from markupsafe import Markup

    text = io.StringIO()
    metadata = {"Date": None, "Creator": None, "Format": None, "Type": None}
    figure.savefig(text, format="svg", dpi=220, metadata=metadata)
    body = text.getvalue()
    body = re.sub(r"<metadata>.*?</metadata>", "", body[body.index("<svg") :], flags=re.DOTALL)
    body = re.sub(r"<[^>]*>", lambda tag: re.sub(r"-?\d+\.\d{3,}", _shorter, tag.group()), body)
    mark = re.sub(r"\W", "", label)
    body = re.sub(r'(id="|href="#|url\(#)', rf"\g<1>{mark}-", body)
    return Markup(body.replace("<svg ", f'<svg role="img" aria-label="{escape(label)}" ', 1))


def _shorter(number: re.Match[str]) -> str:
    return f"{float(number.group()):.2f}"


def png(figure: Figure, label: str) -> Markup:
    """A figure as an image element: for pictures of too many shapes for an SVG."""
    from markupsafe import Markup

    held = io.BytesIO()
    figure.savefig(held, format="png", dpi=110)
    data = base64.b64encode(held.getvalue()).decode()
    return Markup('<img alt="{}" src="data:image/png;base64,{}">').format(label, data)
