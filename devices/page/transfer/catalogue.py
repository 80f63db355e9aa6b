"""What of a graph the page offers: its streams by kind, its nodes and edges, the values that may be changed, and the panels."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping
from typing import Any, Literal, TypeAlias

from kinegraph.devices.page.transfer.poses import avatar_bones, bones_of
from kinegraph.devices.page.transfer.wire import MAX_TEXT
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.domain.axes import Axes
from kinegraph.stream.domain.mesh import Topology
from kinegraph.stream.errors import InputError, KinegraphError, blaming
from kinegraph.stream.filter import SampleWise
from kinegraph.stream.graph import Edge, Graph
from kinegraph.stream.graph.page_options import PageOptions
from kinegraph.stream.graph.reading.load import RecordedPage
from kinegraph.stream.manual import Annotations, Value
from kinegraph.stream.operator import Operator
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.recording.format.image import is_picture
from kinegraph.stream.text.units import shown as micro

Kind: TypeAlias = Literal["signal", "events", "frame", "points", "curves", "mesh", "pose"]

SLOW_BYTES_S = 4096
"""A signal below this is kept from the beginning, whether or not somebody looks at it."""
MANY_CHANNELS = 32
"""A signal of more channels has no panel unless it is asked for."""
MAX_WORDS = 40
MAX_MODULE = 256 << 10
"""Characters of a panel's module."""


def kind_of(spec: StreamSpec) -> Kind | None:
    """How a stream is drawn; None: it is not."""
    if spec.is_event:
        return "events" if not spec.shape else None
    if spec.dtype.kind not in "fiub":
        return None
    if spec.is_signal:
        return "pose" if bones_of(spec) else "signal"
    if len(spec.shape) != 2:
        return None
    if "mesh" in spec.meta and _is_whole(spec):
        return "mesh"
    if spec.shape[1] == 3 and spec.channel_axis == 0 and (spec.channels or spec.dtype.kind == "f"):
        return "points"
    return "curves" if spec.channels and spec.channel_axis == 1 else "frame"


def _is_whole(spec: StreamSpec) -> bool:
    """Whether these are all vertices of the mesh in the spec. Recordings hold markers, chosen of them by name, that kept its facts."""
    if not spec.channels:
        return True
    try:
        Topology.of(spec)
    except InputError:
        return False
    return True


def is_newest_only(spec: StreamSpec) -> bool:
    """Whether of several samples only the last is worth showing."""
    return kind_of(spec) in ("frame", "points", "mesh", "pose")


def always_kept(spec: StreamSpec) -> bool:
    """Whether the page's server keeps the stream from the beginning, for those who look later."""
    kind = kind_of(spec)
    slow = (spec.rate_hz or 10.0) * spec.sample_bytes <= SLOW_BYTES_S
    return kind in ("events", "curves") or (kind == "signal" and slow)


def offered(graph: Graph, *, outside: bool) -> dict[str, StreamSpec]:
    """The streams that can be looked at, by name. Left out: what lies within a row of filters that run as one, unless it is recorded;
    pictures that the graph may not record, unless it says `unrecorded_pictures`, and outside this machine in any case."""
    found = {}
    for node in graph.nodes.values():
        for output, spec in node.specs.items():
            edge = Edge(node.name, output)
            kept = edge in graph.record
            hidden = _is_image(spec) and not kept and (outside or not graph.page.unrecorded_pictures)
            if kind_of(spec) and not hidden and (kept or not _between_filters(graph, edge)):
                found[str(edge)] = spec
    return found


def _is_image(spec: StreamSpec) -> bool:
    """Whether it shows a room: images of any kind, also coarse ones that an operator makes."""
    return is_picture(spec) or kind_of(spec) == "frame"


def _between_filters(graph: Graph, edge: Edge) -> bool:
    readers = graph.readers(edge)
    one = len(readers) == 1 and isinstance(readers[0][0].part, SampleWise)
    return one and isinstance(graph.nodes[edge.node].part, SampleWise) and str(edge) not in graph.page.streams


def described(name: str, spec: StreamSpec) -> dict[str, Any]:
    """A stream, for the page."""
    fields = [[field, spec.dtype[field].kind, symbol(spec.unit_of(field))] for field in scalar_fields(spec)]
    skeleton = bones_of(spec)
    units = [spec.unit_of(c) for c in spec.channels] if spec.channels and not spec.is_event else [*spec.units[:1]]
    return {
        "name": name,
        "kind": "points" if skeleton else kind_of(spec),
        "shape": [len(skeleton.joints), 3] if skeleton else [*spec.shape],
        "rate_hz": spec.rate_hz,
        "channels": skeleton.joints if skeleton else [] if spec.is_event else [*spec.channels],
        "units": []
        if spec.is_event
        else units
        if kind_of(spec) in ("points", "mesh", "pose")
        else [*map(symbol, units)],
        "fields": fields,
        "describe": micro(spec.describe()),
        "avatar": avatar_bones(spec),
        "bones": skeleton.pairs if skeleton else _pairs(spec.meta.get("bones")),
        "down": (axes := Axes.of(spec)) is not None and axes.up == "-y",
        "columns": spec.meta.get("columns") if isinstance(spec.meta.get("columns"), int) else None,
        "faces": Topology.of(spec).faces.tolist() if kind_of(spec) == "mesh" else None,
    }


def symbol(unit: str) -> str:
    """A unit as the page shows it: µV, °/s."""
    return micro(unit).replace("deg", "°", 1) if unit in ("deg", "deg/s") else micro(unit)


def scalar_fields(spec: StreamSpec) -> list[str]:
    """An event's fields that are one number or text each."""
    return [f for f in spec.dtype.names or () if not spec.dtype[f].shape and spec.dtype[f].kind in "fiubUS"]


def _pairs(bones: Any) -> list[list[Any]]:
    return [[*pair] for pair in bones] if isinstance(bones, list | tuple) else []


def hello(graph: Graph, *, outside: bool, mode: str, t0_ns: int) -> dict[str, Any]:
    """All that a page must know of a graph before the first sample."""
    specs = offered(graph, outside=outside)
    return {
        "t": "hello",
        "name": graph.name,
        "mode": mode,
        "t0_ms": t0_ns / 1e6,
        "session": {str(key): as_text(value) for key, value in graph.session.items()},
        "streams": [described(name, spec) for name, spec in specs.items()],
        "nodes": [
            {"name": n.name, "use": n.use, "kind": "source" if n.is_source else "outlet" if n.is_outlet else "operator"}
            for n in graph.nodes.values()
        ],
        "edges": [[str(edge), node.name, port] for node in graph.nodes.values() for port, edge in node.inputs.items()],
        "values": [
            {"node": n.name, "initial": v.initial, "least": v.least, "most": v.most, "unit": v.unit}
            for n in graph.nodes.values()
            if mode == "live" and isinstance(v := n.part, Value)
        ],
        "words": words_of(graph) if mode == "live" else [],
        "panels": panels_of(graph, specs),
    }


def as_text(value: Any) -> str:
    """A value of a graph's session, as people write it."""
    return ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)


def words_of(graph: Graph) -> list[str]:
    """The annotations that operators understand, each once."""
    heard = [
        n
        for n in graph.nodes.values()
        if any(isinstance(graph.nodes[e.node].part, Annotations) for e in n.inputs.values())
    ]
    offered: list[str] = []
    for node in heard:
        if isinstance(node.part, Operator):
            with blaming(node.name, "words"):
                offered += node.part.annotations_understood()
    return [word[:MAX_TEXT] for word in dict.fromkeys(offered)][:MAX_WORDS]


def own_panels(
    parts: Mapping[str, Any], of: Mapping[str, Iterable[str]], modules: Container[str], specs: Container[str]
) -> list[dict[str, Any]]:
    """The panels that nodes bring: an operator's of what it gives, an outlet's of what it is given; `of` names these streams."""
    found = []
    for name, part in parts.items():
        streams = [stream for stream in of[name] if stream in specs]
        kinds = [kind for kind in getattr(part, "panels", {}) if kind in modules]
        found += [{"kind": kind, "of": streams, "title": name} for kind in kinds if streams]
    return found


def own_modules(page: PageOptions) -> dict[str, str]:
    """The JavaScript of panels that are not the page's own, by kind. Raises KinegraphError for one that cannot be read."""
    found = {}
    for kind, path in page.modules.items():
        try:
            found[kind] = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise KinegraphError(f"the panel {kind!r} cannot be read: {path}: {error}") from None
        if len(found[kind]) > MAX_MODULE:
            raise KinegraphError(f"the panel {kind!r} is too large: {path} has more than {MAX_MODULE} characters")
    return found


def panels_of(graph: Graph, specs: dict[str, StreamSpec]) -> list[dict[str, Any]]:
    """The panels as the graph arranges them under `page`, else one or more for each kind of stream there is."""
    if graph.page.panels:
        return arranged(graph.page, specs)
    inputs = {node.name: [str(edge) for edge in node.inputs.values()] for node in graph.nodes.values()}
    of = {
        n.name: inputs[n.name] if n.is_outlet else [str(Edge(n.name, o)) for o in n.specs] for n in graph.nodes.values()
    }
    between = {str(edge) for node in graph.nodes.values() if not node.is_outlet for edge in node.inputs.values()}
    between -= {str(edge) for edge in graph.record}
    return [
        *own_panels({node.name: node.part for node in graph.nodes.values()}, of, graph.page.modules, specs),
        *default_panels(specs, inputs, between),
        *({"kind": kind, "of": [], "wide": wide} for kind, wide in (("state", 1), ("graph", 2), ("log", 2))),
    ]


def recorded_panels(page: RecordedPage, specs: dict[str, StreamSpec]) -> list[dict[str, Any]]:
    """The panels of a recording, as the graph that made it arranges them, else by the streams' kinds."""
    options = page.options
    if options.panels:
        return [panel for panel in arranged(options, specs) if panel["of"]]
    given = {name: [stream for stream in specs if stream.partition(".")[0] == name] for name in page.parts}
    of = {name: page.reads[name] if issubclass(part, Outlet) else given[name] for name, part in page.parts.items()}
    return [*own_panels(page.parts, of, options.modules, specs), *default_panels(specs, page.reads)]


def arranged(page: PageOptions, specs: dict[str, StreamSpec]) -> list[dict[str, Any]]:
    """Panels as the graph says; streams that are not offered (a picture, outside this machine) are named, so that the page can say so."""
    return [{**panel, "missing": [name for name in panel["of"] if name not in specs]} for panel in page.panels]


def with_avatar(panels: list[dict[str, Any]], specs: dict[str, StreamSpec]) -> list[dict[str, Any]]:
    """The panels, and before them an avatar that follows the last humanoid pose, if there is one and the panels have no avatar."""
    followed = [name for name, spec in specs.items() if avatar_bones(spec)][-1:]
    shown = any(panel["kind"] == "avatar" for panel in panels)
    return panels if shown or not followed else [{"kind": "avatar", "of": followed}, *panels]


def default_panels(
    specs: dict[str, StreamSpec], inputs: dict[str, list[str]], between: Container[str] = ()
) -> list[dict[str, Any]]:
    """Panels by the streams' kinds; `inputs` says what each node reads. Signals in `between`, on the way to what is wanted, are folded."""
    of = {
        kind: [n for n, s in specs.items() if kind_of(s) == kind]
        for kind in ("signal", "events", "frame", "points", "pose", "mesh")
    }
    panels = with_avatar([], specs)
    panels += [{"kind": "scene", "of": [name]} for name in [*of["mesh"], *of["pose"], *of["points"]]]
    panels += [{"kind": "frame", "of": [name]} for name in of["frame"]]
    for name in specs:
        node, _, output = name.rpartition(".")
        if output == "mean" and f"{node}.sd" in specs:
            last = [source for source in inputs.get(node, ()) if source in specs and kind_of(specs[source]) == "curves"]
            panels.append({"kind": "cycles", "of": [name, f"{node}.sd", *last[:1]], "wide": 2})
    signals = [
        n for n in of["signal"] if len(specs[n].channels) <= MANY_CHANNELS and specs[n].shape[0] <= MANY_CHANNELS
    ]
    for name in signals:
        panels.append({"kind": "signal", "of": [name], "wide": 2, **({"folded": True} if name in between else {})})
    if of["events"]:
        panels += [{"kind": "events", "of": of["events"], "wide": 4, "title": "events"}]
        panels += [{"kind": "table", "of": of["events"], "title": "table of events"}]
    return panels
