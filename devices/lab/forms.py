"""The form of a graph: what a person may set in it, from its `settings:`, its facts of the session, and its devices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, Field, fields, is_dataclass, replace
from importlib.metadata import entry_points
from math import isfinite
from pathlib import Path
from typing import Any

from kinegraph.devices.reports.session.contents.labels import UNITS
from kinegraph.stream.cli.commands.graph_help import outermost, present
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.components import find
from kinegraph.stream.graph.reading.load import read_expanded
from kinegraph.stream.graph.reading.problems import Problems
from kinegraph.stream.graph.reading.settings_section import read_settings
from kinegraph.stream.graph.reading.yaml_lines import Located
from kinegraph.stream.graph.settings import GraphSetting
from kinegraph.stream.graph.shipped import summary
from kinegraph.stream.params import build
from kinegraph.stream.source import Source

SUBJECT = "session.subject"
MANUAL = "stream.manual."
CHECKS = {
    "electrodes": ("operators.emg.",),
    "contacts": ("operators.contacts.", "operators.cycles.cycles.", "operators.cycles.limb_cycles."),
    "mvc": ("operators.emg.normalise.",),
    "bed": ("operators.bed.",),
}
"""Checks that are of use before a session, by what the graph holds."""
BODY_ALONE = "pose-model"
SIMULATORS = "kinegraph.simulators"


def form_of(path: Path) -> dict[str, Any]:
    """The fields of a graph's form, and its devices. Raises KinegraphError where the graph cannot be read."""
    top = read_expanded(path).items()
    settings = outermost(read_settings(top.get("settings"), Problems(str(path))))
    facts = _session(top)
    settings = {
        name: one if one.targets else replace(one, default=facts.get(name, one.default))
        for name, one in settings.items()
    }
    return {
        "graph": str(path),
        "name": path.stem,
        "summary": summary(path),
        "fields": [
            *_facts(top, settings),
            *(_field(n, *_known(one, top)) for n, one in settings.items() if n != "subject"),
        ],
        "devices": [*_devices(top)],
        "networks": _networks(top),
        "checks": [name for name, packages in CHECKS.items() if _uses(top, packages)],
    }


def _uses(top: Mapping[str, Located], packages: tuple[str, ...]) -> bool:
    """Whether a node is of one of these packages."""
    nodes = top["nodes"].items() if "nodes" in top else {}
    used = [str(use.value) for at in nodes.values() if (use := at.items().get("use"))]
    return any(one.startswith(packages) for one in used)


def _networks(top: Mapping[str, Located]) -> dict[str, Any]:
    """The networks that the graph uses and that are not there: what brings them, what they are, their licence, and whether it can
    do without; {}: all are there.
    """
    used = dict[Any, bool]()
    for at in (top["nodes"].items() if "nodes" in top else {}).values():
        given = at.items()
        with suppress(KinegraphError):
            for one in getattr(find(str(given["use"].value)), "networks", ()) if "use" in given else ():
                needed = "needed" not in given or bool(given["needed"].plain())
                used[one] = used.get(one, False) or (needed and "model" not in given)
    missing = [one for one in used if not one.is_kept()]
    if not missing:
        return {}
    return {
        "name": next(
            (one.fetch for one in missing if one.fetch != BODY_ALONE), BODY_ALONE
        ),  # it brings the body's, too
        "what": ", ".join(one.what for one in missing),
        "licence": ", ".join(dict.fromkeys(one.licence for one in missing)),
        "needed": any(used[one] for one in missing),
    }


def _facts(top: Mapping[str, Located], settings: Mapping[str, GraphSetting]) -> Iterator[dict[str, Any]]:
    """The subject, then what else the graph says of the session and no setting asks for."""
    facts = {name: value for name, value in _session(top).items() if name not in settings or name == "subject"}
    yield _field(
        SUBJECT, GraphSetting(label="Subject", type="text", help="an identifier, not a name"), facts.pop("subject", "")
    )
    for name, value in facts.items():
        if isinstance(value, str | int | float):
            unit = next((end for end in sorted(UNITS, key=len, reverse=True) if name.endswith(f"_{end}")), "")
            label = name.removesuffix(f"_{unit}").replace("_", " ")
            yield _field(
                f"session.{name}", GraphSetting(label=label, unit=UNITS.get(unit, ""), type=_type(value)), value
            )


def _session(top: Mapping[str, Located]) -> dict[str, Any]:
    section = top.get("session")
    return {name: at.plain() for name, at in section.items().items()} if section and section.value else {}


def _known(setting: GraphSetting, top: Mapping[str, Located]) -> tuple[GraphSetting, Any]:
    """A setting with what the parameter that it feeds says of itself: its value, and its bounds."""
    value, parameter = present(setting, top), _parameter(setting, top)
    if parameter is None:
        return setting, value
    facts = parameter.metadata.get("kinegraph", {})
    if value is None and parameter.default is not MISSING:
        value = [*parameter.default] if isinstance(parameter.default, tuple) else parameter.default
    low, high = (next((facts[n] for n in names if n in facts), None) for names in (("least", "min"), ("most", "max")))
    known = replace(
        setting,
        help=setting.help or facts.get("description", ""),
        min=low if setting.min is None else setting.min,
        max=high if setting.max is None else setting.max,
    )
    return known, plain(value)


def plain(value: Any) -> Any:
    """A default as JSON holds it; None where it cannot."""
    if isinstance(value, tuple | list):
        return [plain(one) for one in value]
    if is_dataclass(value) and not isinstance(value, type):
        return {
            f.name: plain(getattr(value, f.name)) for f in fields(value) if getattr(value, f.name) not in (None, "")
        }
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, float) and not isfinite(value):
        return None
    return value if isinstance(value, str | int | float | bool | None) else str(value)


def _parameter(setting: GraphSetting, top: Mapping[str, Located]) -> Field[Any] | None:
    """The parameter that a setting feeds first; None where it feeds nothing, or its node cannot be found."""
    for target in setting.targets:
        node, _, name = target.rpartition(".")
        use = top["nodes"].items()[node].items().get("use") if "nodes" in top and node in top["nodes"].items() else None
        with suppress(KinegraphError):
            if use is not None:
                return next((f for f in fields(find(str(use.value))) if f.name == name), None)  # type: ignore[arg-type]
    return None


def _type(value: object) -> Any:
    return "boolean" if isinstance(value, bool) else "number" if isinstance(value, int | float) else "text"


def _field(name: str, setting: GraphSetting, value: Any) -> dict[str, Any]:
    numeric = setting.min is not None or setting.max is not None
    by_value = {bool: "boolean", int: "number", float: "number", str: "text", list: "list", dict: "mapping"}
    return {
        "name": name,
        "label": setting.label or name.rpartition(".")[2].replace("_", " "),
        "unit": setting.unit,
        "help": setting.help,
        "type": setting.type or ("number" if numeric else by_value.get(type(value), "")),
        "min": setting.min,
        "max": setting.max,
        "choices": [*setting.choices],
        "value": value,
        "part": name.rpartition(".")[0] if not name.startswith("session.") else "",
    }


def _devices(top: Mapping[str, Located]) -> Iterator[dict[str, Any]]:
    """The sources that are devices: what stands for one, and whether it can be simulated."""
    simulated = {entry.name for entry in entry_points(group=SIMULATORS)}
    nodes = top["nodes"].items() if "nodes" in top else {}
    for name, at in nodes.items():
        use = at.items().get("use")
        if use is None or not isinstance(use.value, str) or use.value.startswith(MANUAL):
            continue
        try:
            part = find(use.value)
        except KinegraphError:
            continue
        if issubclass(part, Source):
            given = {key: one.plain() for key, one in at.items().items() if key not in ("use", "from")}
            tried: dict[str, dict[str, Any]] = {}
            with suppress(KinegraphError):
                tried = getattr(build(part, given), "rehearsals", dict)()  # most sources have nothing to try
            yield {
                "node": name,
                "use": use.value,
                "can_simulate": use.value in simulated,
                "given": given,
                "rehearsals": {
                    text: {f"{name}.{key}": value for key, value in made.items()} for text, made in tried.items()
                },
            }


def reports_of(path: Path) -> list[str]:
    """The nodes that write reports."""
    nodes = read_expanded(path).items()["nodes"].items()
    used = {name: at.items().get("use") for name, at in nodes.items()}
    return [
        name
        for name, use in used.items()
        if use and str(use.value).startswith("devices.reports.") and "past" not in name
    ]
