"""The JSON Schema of graphs, for editors: completion and checks of every key while a graph is being written.

It knows every source, operator and outlet that is installed; a `use` that it does not know is taken as anyone's own.
"""

from __future__ import annotations

import re
from typing import Any

from kinegraph.stream.graph import NodeOptions, RecordingOptions
from kinegraph.stream.graph.components import Part, kind_of
from kinegraph.stream.graph.page_options import PANEL_KINDS, PageOptions, Panel
from kinegraph.stream.graph.reading.draft import NODE_NAME, OPERATOR_OPTIONS, SOURCE_OPTIONS, parameters_of
from kinegraph.stream.graph.reading.load import Settings
from kinegraph.stream.graph.reading.part_files import PartInput
from kinegraph.stream.graph.settings import GraphSetting
from kinegraph.stream.operator import ANY, Operator
from kinegraph.stream.params import schema as parameters
from kinegraph.stream.source import Source
from kinegraph.stream.system.names import ROOT

Json = dict[str, Any]

PART = r"\.ya?ml$"
"""What a `use` ends in that names a part's file."""
UNITS = {
    "hz": "Hz",
    "s": "s",
    "ms": "ms",
    "ns": "ns",
    "m": "m",
    "mm": "mm",
    "m_s": "m/s",
    "uv": "uV",
    "mv": "mV",
    "v": "V",
    "n": "N",
    "kg": "kg",
    "g": "g",
    "deg": "degrees",
    "deg_s": "degrees/s",
    "rad_s": "rad/s",
    "percent": "%",
    "mb": "MB",
    "db": "dB",
}
"""Units that stand at the end of a parameter's name."""


def graph_schema(parts: dict[str, Part]) -> Json:
    """The schema of a graph that may use `parts` (class by dotted path) or anything else."""
    definitions: Json = {path: _node(path, part) for path, part in parts.items()}
    for path in list(definitions):
        definitions.update(_lift(definitions[path], path))
    page = _page()
    definitions.update(_lift(page["properties"]["panels"]["items"], "page"))
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "A kinegraph graph",
        "type": "object",
        "required": ["nodes"],
        "additionalProperties": False,
        "properties": {
            **_settings(),
            "part": _part(),
            "settings": _offered(),
            "session": {"type": ["object", "null"], "description": "facts about the session, kept in its recording"},
            "record": {
                "description": "outputs recorded beside the sources, which always are",
                "oneOf": [
                    {"$ref": "#/$defs/edge"},
                    {"type": "array", "items": {"$ref": "#/$defs/edge"}, "uniqueItems": True},
                    {"type": "null"},
                ],
            },
            "page": page,
            "nodes": {
                "type": "object",
                "minProperties": 1,
                "propertyNames": {"pattern": NODE_NAME},
                "additionalProperties": {"$ref": "#/$defs/node"},
            },
        },
        "$defs": {
            "edge": {"type": "string", "pattern": NODE_NAME, "description": "a node, or node.output"},
            "node": _any_node(parts),
            **definitions,
        },
    }


def _settings() -> Json:
    properties: Json = _described(Settings)["properties"]
    recording = _described(RecordingOptions)
    recording.update(additionalProperties=False, type=["object", "null"])
    return {**properties, "recording": recording}


def _part() -> Json:
    """The section `part:` of a part's file."""
    port = _described(PartInput)
    port.update(additionalProperties=False, type="object")
    inputs: Json = {"type": "object", "additionalProperties": {"anyOf": [{"type": ["string", "null"]}, port]}}
    outputs: Json = {"type": "object", "additionalProperties": {"$ref": "#/$defs/edge"}}
    return {
        "type": ["object", "null"],
        "description": "makes this file a part that other graphs use as a node",
        "additionalProperties": False,
        "properties": {"inputs": inputs, "outputs": outputs},
    }


def _offered() -> Json:
    """The section `settings:`."""
    one = _described(GraphSetting)
    one.update(additionalProperties=False, type=["object", "null"])
    return {"type": ["object", "null"], "description": "what a person may set", "additionalProperties": one}


def _page() -> Json:
    """The section `page:` and its panels."""
    page, panel = _described(PageOptions), _described(Panel)
    page.update(additionalProperties=False, type=["object", "null"])
    edge: Json = {"$ref": "#/$defs/edge"}
    panel["properties"]["of"] = {
        "description": "the streams it draws",
        "oneOf": [edge, {"type": "array", "items": edge}],
    }
    panel["properties"]["kind"] = {
        "description": "what it draws; operators and outlets may bring kinds of their own",
        "anyOf": [{"enum": list(PANEL_KINDS)}, {"type": "string", "pattern": r"^[^\W\d]\w*$"}],
    }
    panel.update(additionalProperties=False)
    page["properties"]["panels"] = {"type": ["array", "null"], "items": panel, "description": "what is shown, in order"}
    return page


def _any_node(parts: dict[str, Part]) -> Json:
    """A node: what it may hold depends on its `use`."""
    return {
        "type": "object",
        "required": ["use"],
        "properties": {
            "use": {
                "description": "the dotted path of a source, an operator or an outlet, or the file of a part",
                "anyOf": [
                    {"enum": list(parts)},
                    {"type": "string", "pattern": r"^[^\W\d]\w*(\.[^\W\d]\w*)+$"},
                    {"type": "string", "pattern": PART},
                ],
            }
        },
        "allOf": [
            {
                "if": {"properties": {"use": {"enum": _spellings(path, part)}}, "required": ["use"]},
                "then": {"$ref": f"#/$defs/{path}"},
            }
            for path, part in parts.items()
        ],
    }


def _spellings(path: str, part: Part) -> list[str]:
    """The paths under which a class can be named: where it is offered, and where it is written."""
    return list(dict.fromkeys([path, f"{part.__module__}.{part.__qualname__}".removeprefix(ROOT)]))


def _node(path: str, part: Part) -> Json:
    """The keys of a node that uses `part`."""
    made = _described(part)
    options = _described(NodeOptions)["properties"]
    is_source = issubclass(part, Source)
    allowed = SOURCE_OPTIONS if is_source else OPERATOR_OPTIONS
    properties: Json = {"use": {"description": f"{kind_of(part)}: {_summary(part)}"}}
    required = ["use", *made.get("required", [])]
    node: Json = {"type": "object", "additionalProperties": False, "description": _summary(part)}
    if issubclass(part, Operator):
        properties["from"] = _from(part)
        required.append("from")
    if kind_of(part) == "operator":
        node["dependentRequired"] = {"queue": ["worker"], "policy": ["worker"]}
    node["properties"] = {**properties, **made.get("properties", {}), **{key: options[key] for key in allowed}}
    node["required"] = required
    if "$defs" in made:
        node["$defs"] = made["$defs"]
    return node


def _from(part: type[Operator[Any]]) -> Json:
    """What feeds the inputs of an operator."""
    edge: Json = {"$ref": "#/$defs/edge"}
    if ANY in part.inputs:
        many: Json = {"type": "array", "items": edge, "minItems": 1, "uniqueItems": True}
        named: Json = {"type": "object", "additionalProperties": edge, "minProperties": 1}
        return {"oneOf": [edge, many, named], "description": "one or more inputs"}
    required = [port for port, declared in part.inputs.items() if not declared.optional]
    ports: Json = {
        "type": "object",
        "properties": dict.fromkeys(part.inputs, edge),
        "additionalProperties": False,
        "required": required,
        "minProperties": 1,
    }
    one: list[Json] = [edge] if len(required) <= 1 else []
    if len(part.inputs) == 1:
        one.append({"type": "array", "items": edge, "minItems": 1, "maxItems": 1})
    return {"oneOf": [*one, ports], "description": f"inputs: {', '.join(part.inputs)}"}


def _described(cls: Any) -> Json:
    """The schema of a dataclass's parameters, each described by its `help` or by its line in the docstring, with its unit."""
    made = parameters(cls)
    known = parameters_of(cls)
    lines = docstring_lines(cls.__doc__ or "", known)
    properties = {name: entry for name, entry in made.get("properties", {}).items() if name in known}
    for name, entry in properties.items():
        text = entry.get("description") or lines.get(name, "")
        unit = unit_of(name)
        if unit and not re.search(rf"\b{re.escape(unit)}(?!\w)", text):
            text = f"{text} ({unit})" if text else f"in {unit}"
        entry.pop("description", None)
        if text:
            entry["description"] = text
    made["properties"] = properties
    made.pop("description", None)
    return made


def docstring_lines(doc: str, names: list[str]) -> dict[str, str]:
    """What a docstring says in lines such as "    cutoff_hz   where the filter halves the power"."""
    found = re.findall(r"^\s+(\w+)\s{2,}(\S.*)$", doc, flags=re.MULTILINE)
    return {name: text for name, text in found if name in names}


def unit_of(name: str) -> str:
    """The unit in which a parameter of this name is given; empty if its name has no unit."""
    parts = name.split("_")
    return next((UNITS[end] for n in (2, 1) if len(parts) > n and (end := "_".join(parts[-n:])) in UNITS), "")


def _summary(part: Part) -> str:
    text = (part.__doc__ or "").strip()
    return "" if text.startswith(f"{part.__name__}(") else " ".join(text.partition("\n\n")[0].split())


def _lift(definition: Json, path: str) -> Json:
    """Move the definitions inside one part's schema to the top, under names of their own."""
    inner = definition.pop("$defs", {})
    names = {name: f"{path}.{name}" for name in inner}
    lifted = {names[name]: entry for name, entry in inner.items()}
    for entry in (definition, *lifted.values()):
        _rename(entry, names)
    return lifted


def _rename(entry: Any, names: dict[str, str]) -> None:
    """Point every reference at the new name."""
    if isinstance(entry, list):
        for item in entry:
            _rename(item, names)
    elif isinstance(entry, dict):
        name = str(entry.get("$ref", "")).removeprefix("#/$defs/")
        if name in names:
            entry["$ref"] = f"#/$defs/{names[name]}"
        for item in entry.values():
            _rename(item, names)
