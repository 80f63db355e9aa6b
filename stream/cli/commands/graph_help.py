"""What may be set in a graph, for the help of a command that is called with one: `kinegraph run treadmill_emg --help`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import read_expanded
from kinegraph.stream.graph.reading.overrides import value_at
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.yaml_lines import Located
from kinegraph.stream.graph.settings import GraphSetting
from kinegraph.stream.graph.shipped import resolve

COMMANDS = ("run", "replay", "check", "draw")


def settings_help(command: str, arguments: Sequence[str]) -> str:
    """The settings of the graph that the arguments name, one a line; empty without a graph."""
    if command not in COMMANDS:
        return ""
    named = next((resolve(Path(a)) for a in arguments if not a.startswith("-") and resolve(Path(a)).is_file()), None)
    if named is None or named.suffix not in (".yaml", ".yml"):
        return ""
    try:
        top = read_expanded(named).items()
    except KinegraphError as error:
        return f"{named.stem} cannot be read: {error}"
    settings = outermost(read_settings(top.get("settings"), Problems(str(named))))
    if not settings:
        return f"{named.stem} declares no settings; --set NODE.PARAMETER=VALUE changes any parameter."
    width = max(map(len, settings))
    rows = [f"  {name:<{width}}  {_described(name, setting, top)}" for name, setting in settings.items()]
    return "\n".join([f"Settings of {named.stem} (--set NAME=VALUE):", *rows])


def outermost(settings: Mapping[str, GraphSetting]) -> dict[str, GraphSetting]:
    """Without those of inner parts that feed what an outer setting feeds."""
    shown: dict[str, GraphSetting] = {}
    fed: set[str] = set()
    for name, setting in settings.items():
        if not setting.targets or not fed.issuperset(setting.targets):
            shown[name] = setting
        fed.update(setting.targets)
    return shown


def _described(name: str, setting: GraphSetting, top: Mapping[str, Located]) -> str:
    """One setting for people: "Low-pass: smoother below (a number from 1 to 60 Hz; default 20)"."""
    words = ": ".join(filter(None, [setting.label if setting.label != name else "", setting.help]))
    value = present(setting, top)
    facts = "; ".join(filter(None, [setting.accepts() or setting.unit, "" if value is None else f"default {value}"]))
    return f"{words} ({facts})" if words and facts else words or facts


def present(setting: GraphSetting, top: Mapping[str, Located]) -> Any:
    """The value that the graph gives to the first parameter that a setting feeds."""
    for target in setting.targets:
        if (at := value_at(top, target)) is not None:
            return at.plain()
    return setting.default
