"""The section `page:` of a graph, read: which panels its page has, and in which order."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from dataclasses import fields
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import nearest
from kinegraph.stream.graph.page_options import PANEL_KINDS, PageOptions, Panel, Shown
from kinegraph.stream.graph.reading.draft import build_from
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.wiring import Wiring
from kinegraph.stream.graph.reading.yaml_lines import Located

PANELS = "panels"
GROUP = "kinegraph.panels"
"""Entry points of packages that bring panels without operators: a kind, and where its module's `Path` is written."""


def read_page(
    given: Mapping[str, Located], wiring: Wiring, problems: Problems, parts: Iterable[type] = ()
) -> PageOptions:
    """The section, its streams looked up; what is wrong is added to `problems`. `parts` are the classes that the graph uses."""
    own = {key: at for key, at in given.items() if key != PANELS}
    options = build_from(PageOptions, own, problems, "page: ") or PageOptions()
    options.modules.update(_brought(parts))
    written = given.get(PANELS)
    if written is None or written.value is None:
        return options
    if not isinstance(written.value, list):
        problems.add(f"page: panels is {written.kind}; it must be a list", written)
        return options
    panels = [panel for at in written.value if (panel := _panel(at, wiring, problems, options.modules))]
    object.__setattr__(options, "panels", tuple(panels))
    return options


def _brought(parts: Iterable[type]) -> dict[str, Path]:
    """Panels that parts bring, by kind; a kind of the page's own is never replaced."""
    found: dict[str, Path] = {}
    for part in parts:
        beside = Path(getattr(sys.modules.get(part.__module__), "__file__", None) or "").parent
        found |= {kind: beside / Path(name).name for kind, name in getattr(part, "panels", {}).items()}
    return {kind: path for kind, path in found.items() if kind.isidentifier() and kind not in PANEL_KINDS}


def _installed(kind: str) -> Path | None:
    """The module of a panel that an installed package offers."""
    for entry in entry_points(group=GROUP, name=kind):
        return Path(entry.load())
    return None


def _panel(at: Located, wiring: Wiring, problems: Problems, modules: dict[str, Path]) -> dict[str, Any] | None:
    if not isinstance(at.value, dict):
        problems.add(f"page: a panel is {at.kind}; it must be a mapping with 'kind'", at)
        return None
    keys = at.items()
    of = keys.get("of")
    panel = build_from(Panel, {key: value for key, value in keys.items() if key != "of"}, problems, "page: ", entry=at)
    items = [] if of is None or of.value is None else of.value if isinstance(of.value, list) else [of]
    edges = [edge for item in items if (edge := wiring.edge(item))]
    if panel is None:
        return None
    shown = [(one, wiring.edge(at)) for one, at in zip(panel.show, _streams_shown(keys.get("show")), strict=True)]
    edges += [edge for edge in dict.fromkeys(edge for _, edge in shown) if edge and edge not in edges]
    if panel.kind not in (*PANEL_KINDS, *modules):
        if (path := _installed(panel.kind) if panel.kind.isidentifier() else None) is None:
            problems.add(f"page: kind is {panel.kind!r}; {nearest(panel.kind, (*PANEL_KINDS, *modules))}", keys["kind"])
            return None
        modules[panel.kind] = path
    default = Panel(panel.kind)
    facts = {
        f.name: getattr(panel, f.name) for f in fields(Panel) if getattr(panel, f.name) != getattr(default, f.name)
    }
    if shown:
        facts["show"] = [{**_given(one), "of": str(edge)} for one, edge in shown if edge]
    return {"kind": panel.kind, "of": [str(edge) for edge in edges], **facts}


def _streams_shown(show: Located | None) -> list[Located]:
    """Where the streams are written that an answer shows."""
    items = show.value if show and isinstance(show.value, list) else []
    return [item.items()["of"] for item in items]


def _given(one: Shown) -> dict[str, Any]:
    """What an answer says of one thing, beside the defaults."""
    default = Shown("")
    return {f.name: getattr(one, f.name) for f in fields(Shown) if getattr(one, f.name) != getattr(default, f.name)}
