"""The section `page:` of a graph, read: which panels its page has, and in which order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from stream.graph.draft import build_from
from stream.graph.page_options import PageOptions, Panel
from stream.graph.problems import Problems
from stream.graph.wiring import Wiring
from stream.graph.yaml_lines import Located

PANELS = "panels"


def read_page(given: Mapping[str, Located], wiring: Wiring, problems: Problems) -> PageOptions:
    """The section, its streams looked up; what is wrong is added to `problems`."""
    own = {key: at for key, at in given.items() if key != PANELS}
    options = build_from(PageOptions, own, problems, "page: ") or PageOptions()
    written = given.get(PANELS)
    if written is None or written.value is None:
        return options
    if not isinstance(written.value, list):
        problems.add(f"page: panels is {written.kind}; it must be a list", written)
        return options
    panels = [panel for at in written.value if (panel := _panel(at, wiring, problems))]
    object.__setattr__(options, "panels", tuple(panels))
    return options


def _panel(at: Located, wiring: Wiring, problems: Problems) -> dict[str, Any] | None:
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
    default = Panel(panel.kind)
    said = {f.name: getattr(panel, f.name) for f in fields(Panel) if getattr(panel, f.name) != getattr(default, f.name)}
    return {"kind": panel.kind, "of": [str(edge) for edge in edges], **said}
