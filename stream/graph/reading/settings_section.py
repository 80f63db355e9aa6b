"""The section `settings:` of a graph or a part."""

from __future__ import annotations

import re

from kinegraph.stream.graph.reading.draft import NODE_NAME, build_from
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.yaml_lines import Located
from kinegraph.stream.graph.settings import GraphSetting


def read_settings(section: Located | None, problems: Problems, node: str = "") -> dict[str, GraphSetting]:
    """The settings by name; what is wrong is added to `problems`."""
    if section is None or section.value is None:
        return {}
    if not isinstance(section.value, dict):
        problems.add(f"settings is {section.kind}; it must be a mapping", section, node)
        return {}
    found: dict[str, GraphSetting] = {}
    for name, at in section.items().items():
        if not isinstance(at.value, dict | None):
            problems.add(f"settings: {name} is {at.kind}; it must be a mapping, as in {{label: Subject}}", at, node)
            continue
        if not re.fullmatch(NODE_NAME, name):
            problems.add(f"settings: {name!r}: a name is made of letters (a-z), digits, '_' and '-'", at, node)
            continue
        setting = build_from(GraphSetting, at.items(), problems, f"settings: {name}: ", node, entry=at)
        if setting is None:
            continue
        if setting.default is not None and (why := setting.refusal("default", setting.default)):
            problems.add(f"settings: {name}: {why}", at.items()["default"], node)
        found[name] = setting
    return found
