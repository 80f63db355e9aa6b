"""Settings from the command line (`--set envelope.cutoff_hz=10`) that replace what a graph's file says."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any

from ruamel.yaml import YAML

from kinegraph.stream.errors import GraphError, KinegraphError, nearest
from kinegraph.stream.graph.components import find
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.yaml_lines import Located, locate, parse
from kinegraph.stream.graph.settings import GraphSetting
from kinegraph.stream.text.short_names import whole_name

SECTIONS = ("session", "recording")


def read(settings: Iterable[str]) -> dict[str, Any]:
    """{"envelope.cutoff_hz": 10} from ["envelope.cutoff_hz=10"]; values are read as YAML."""
    found: dict[str, Any] = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or not name:
            raise KinegraphError(f"--set {setting}: it must be NAME=VALUE, as in 'envelope.cutoff_hz=10'")
        if name in found:
            raise KinegraphError(f"--set {name} is given twice")
        try:
            read_value = parse(value, "")
            found[name.strip()] = read_value.fact() if name.startswith("session.") else read_value.plain()
        except GraphError as error:
            raise KinegraphError(f"--set {setting}: {error}") from None
    return found


def placed(root: Located, overrides: Mapping[str, Any], known: Iterable[str]) -> dict[str, Any]:
    """What is set, by the parameters that it goes to: those that a setting of the graph feeds, or the one node's that has such a parameter.

    `known` are the graph's own keys. Raises GraphError for a value that a setting does not accept.
    """
    top = dict(root.items())
    nodes = dict(top["nodes"].items()) if "nodes" in top else {}
    settings = read_settings(top.get("settings"), Problems(""))
    found: dict[str, Any] = {}
    for name, value in overrides.items():
        if setting := _setting(name, settings, known):
            if why := setting.refusal(name, value):
                raise GraphError(why, path=f"--set {name}")
            found |= dict.fromkeys(setting.targets or (f"session.{name}",), value)
            continue
        if "." in name and (short := _in_a_part(name, top, nodes)):
            found[short] = value
            continue
        takers = [] if "." in name or name in known else [node for node, at in nodes.items() if name in _parameters(at)]
        found[f"{takers[0]}.{name}" if len(takers) == 1 else name] = value
    return found


def _setting(name: str, settings: Mapping[str, GraphSetting], known: Iterable[str]) -> GraphSetting | None:
    """The setting of this name, or the only one ("left.cutoff_hz") that ends in it."""
    if name in settings or "." in name or name in known:
        return settings.get(name)
    outer = [whole for whole in settings if whole.rpartition(".")[2] == name]
    outer = [whole for whole in outer if whole.count(".") == min(one.count(".") for one in outer)]
    return settings[outer[0]] if len(outer) == 1 else None


def _in_a_part(name: str, top: Mapping[str, Any], nodes: Mapping[str, Any]) -> str:
    """ "envelope.cutoff_hz" where the one node that is called so is in a part: "left.envelope.cutoff_hz"; else empty."""
    node, _, key = name.rpartition(".")
    whole = whole_name(node, nodes)
    return f"{whole}.{key}" if whole in nodes and place_of(name, top) is None else ""


def _parameters(node: Located) -> list[str]:
    """The names of a node's parameters; empty if its class cannot be imported, which the loader reports."""
    use = dict(node.items()).get("use")
    try:
        return [one.name for one in fields(find(str(use.value)))] if use else []  # type: ignore[arg-type]
    except KinegraphError:
        return []


def override(root: Located, overrides: Mapping[str, Any], problems: Problems) -> Located:
    """The graph with these settings in place of its own."""
    top = dict(root.items())
    for name, value in overrides.items():
        new = locate(value, 0, f"--set {name}")
        place = place_of(name, top)
        if place is None:
            problems.add(_unknown(name, top), new)
            continue
        put(top, place, new)
    return Located(top, root.line) if overrides and isinstance(root.value, dict) else root


def _unknown(name: str, top: Mapping[str, Located]) -> str:
    """Why `name` can be no setting, and the nearest that can."""
    nodes = dict(top["nodes"].items()) if "nodes" in top else {}
    part = name.partition(".")[0]
    if any(node.startswith(f"{part}.") for node in nodes):
        settings = [one for one in read_settings(top.get("settings"), Problems("")) if one.startswith(f"{part}.")]
        return f"the part {part!r} has no setting {name!r}; {nearest(name, settings)}"
    return f"there is no node {part!r}; {nearest(part, nodes)}"


def rewrite(text: str, overrides: Mapping[str, Any], wanted: Located) -> str:
    """The graph's text with the settings written into it, comments kept: what a recording remembers as the graph that made it.

    Where that would change more than is `wanted` (a setting of a mapping that others share by an anchor), comments are lost.
    """
    yaml = _round_trip()
    root = yaml.load(text)
    for name, value in overrides.items():
        *way, key = place_of(name, root) or ()
        inner = root
        for step in way:
            if inner.get(step) is None:
                inner[step] = {}
            inner = inner[step]
        inner[key] = value
    written = dump(root, yaml)
    return written if parse(written, "").plain() == wanted.plain() else dump(wanted.plain())


def _round_trip() -> YAML:
    yaml = YAML(typ="rt")
    yaml.preserve_quotes, yaml.width = True, 1000
    return yaml


def dump(root: Any, yaml: YAML | None = None) -> str:
    """Plain values, or what this YAML loaded, as text."""
    yaml = yaml or _round_trip()
    out = io.StringIO()
    yaml.dump(root, out)
    return out.getvalue()


def place_of(name: str, top: Mapping[str, Any]) -> tuple[str, ...] | None:
    """The keys under which a setting stands: a node's, a section's, or the graph's own; None if it names an unknown node."""
    head, dot, key = name.partition(".")
    nodes = top.get("nodes")
    known = dict(nodes.items() if isinstance(nodes, Located) else nodes or {})
    if not dot:
        return (name,)
    for node in known:
        if name.startswith(f"{node}."):
            return ("nodes", node, name.removeprefix(f"{node}."))
    return (head, key) if head in SECTIONS else None


def value_at(top: Mapping[str, Located], name: str) -> Located | None:
    """What a graph gives for a parameter ("envelope.cutoff_hz"); None if it gives nothing."""
    first, *rest = place_of(name, top) or ("",)
    at = top.get(first)
    for key in rest:
        at = at.items().get(key) if at else None
    return at


def put(inside: dict[str, Located], place: tuple[str, ...], new: Located) -> None:
    head, *rest = place
    if rest:
        old = inside.get(head, Located({}, new.line, new.origin))
        entries = dict(old.items())
        put(entries, tuple(rest), new)
        inside[head] = replace(old, value=entries)
    else:
        inside[head] = new
