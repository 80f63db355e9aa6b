"""A first graph for a recording, from what it holds: raw EMG to envelopes, and with foot contacts to cycles and their statistics."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from stream.chunk import StreamSpec

VOLTAGES = ("V", "mV", "uV")
LEAST_EMG_HZ = 200.0
STRIKE = re.compile(r"foot ?strike|heel ?strike|touch ?down|initial ?contact|^[rl]hs$", re.IGNORECASE)
OFF = re.compile(r"foot ?off|toe ?off|lift ?off|^[rl]to$", re.IGNORECASE)


def graph_text(path: Path, specs: Mapping[str, StreamSpec]) -> str:
    """The YAML of a graph that takes `specs`, the recording's input streams by name, from the recording at `path`."""
    from ruamel.yaml import YAML

    nodes, edges = _sources(path, specs)
    record: list[str] = []
    for number, (name, spec) in enumerate((n, s) for n, s in specs.items() if _is_emg(s)):
        _emg(nodes, record, edges, specs, name, spec, f"_{number + 1}" if number else "")
    top: dict[str, Any] = {**({"record": record} if record else {}), "nodes": nodes}
    text, yaml = io.StringIO(), YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.sort_base_mapping_type_on_output, yaml.width = None, False, 120  # type: ignore[assignment]
    yaml.dump(top, text)
    return f"# Proposed by `kinegraph new graph` from what {path.name} holds:\n{_holds(specs, edges)}{text.getvalue()}"


def _holds(specs: Mapping[str, StreamSpec], edges: Mapping[str, str]) -> str:
    return "".join(f"#   {edges[name]}: {spec.describe()}\n" for name, spec in specs.items())


def _sources(path: Path, specs: Mapping[str, StreamSpec]) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """A node for each beginning of streams' names, and the edge that each stream is."""
    nodes: dict[str, dict[str, Any]] = {}
    edges: dict[str, str] = {}
    for beginning in dict.fromkeys(name.partition(".")[0] for name in specs):
        node = _identifier(beginning)
        while node in nodes:
            node += "_"
        mine = {name: name.partition(".")[2] or "out" for name in specs if name.partition(".")[0] == beginning}
        plain = {name: _identifier(output) for name, output in mine.items()}
        plain = {
            name: output if list(plain.values()).count(output) == 1 else f"{output}_{i}"
            for i, (name, output) in enumerate(plain.items())
        }
        nodes[node] = {"use": "devices.files.RecordedStreams", "path": str(path)}
        if plain == mine:
            nodes[node]["of"] = beginning
        else:
            nodes[node]["streams"] = {output: name for name, output in plain.items()}
        edges |= {name: node if output == "out" else f"{node}.{output}" for name, output in plain.items()}
    return nodes, edges


def _identifier(text: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_") or "file"
    return plain if plain[0].isalpha() else f"file_{plain}"


def _is_emg(spec: StreamSpec) -> bool:
    """Whether some of a signal's channels are voltages, sampled as EMG must be."""
    return spec.is_signal and (spec.rate_hz or 0.0) >= LEAST_EMG_HZ and any(unit in VOLTAGES for unit in spec.units)


def _emg(
    nodes: dict[str, dict[str, Any]],
    record: list[str],
    edges: Mapping[str, str],
    specs: Mapping[str, StreamSpec],
    name: str,
    spec: StreamSpec,
    suffix: str,
) -> None:
    edge = edges[name]
    if len(spec.units) > 1:
        chosen = [channel for channel in spec.channels if spec.unit_of(channel) in VOLTAGES]
        unit = spec.unit_of(chosen[0])
        nodes[f"emg{suffix}"] = {
            "use": "operators.Select", "from": edge, "channels": [c for c in chosen if spec.unit_of(c) == unit],
        }  # fmt: skip
        edge = f"emg{suffix}"
    quality, envelope = f"quality{suffix}", f"envelope{suffix}"
    nodes[quality] = {"use": "operators.emg.quality.SignalQuality", "from": edge}
    nodes[envelope] = {"use": "operators.emg.Envelope", "from": edge}
    record += [quality, envelope]
    for side in ("left", "right"):
        strikes = _events(specs, side, STRIKE)
        if strikes:
            _cycles(
                nodes,
                record,
                envelope,
                quality,
                f"{side}{suffix}",
                edges[strikes],
                edges.get(_events(specs, side, OFF), ""),
            )


def _events(specs: Mapping[str, StreamSpec], side: str, wanted: re.Pattern[str]) -> str:
    """The stream of one side's contacts of a kind; "" where there is none."""
    for name, spec in specs.items():
        label = str(spec.meta.get("label") or name.rpartition(".")[2].replace("_", " "))
        mine = spec.meta.get("side") or (
            "left"
            if re.match(r"(?i)l(eft|hs$|to$)", label)
            else "right"
            if re.match(r"(?i)r(ight|hs$|to$)", label)
            else ""
        )
        if spec.is_event and mine == side and wanted.search(re.sub(r"(?i)^(left|right) ", "", label)):
            return name
    return ""


def _cycles(
    nodes: dict[str, dict[str, Any]],
    record: list[str],
    envelope: str,
    quality: str,
    side: str,
    touchdown: str,
    liftoff: str,
) -> None:
    cycles, review = f"{side}_cycles", f"{side}_review"
    contacts = {"touchdown": touchdown, **({"liftoff": liftoff} if liftoff else {})}
    nodes[cycles] = {"use": "operators.gait.cycles.Cycles", "from": {"signal": envelope, **contacts}}
    nodes[review] = {
        "use": "operators.gait.review.CycleReview",
        "from": {"quality": quality, "closed": f"{cycles}.closed", "cycles": f"{cycles}.cycles"},
    }
    nodes[f"{side}_statistics"] = {
        "use": "operators.gait.statistics.CycleStatistics",
        "from": {"judged": f"{review}.judged", "closed": f"{review}.closed", "cycles": f"{review}.cycles"},
    }
    nodes[f"{side}_ensemble"] = {
        "use": "operators.gait.ensemble.CycleEnsemble",
        "from": {"closed": f"{review}.closed", "cycles": f"{review}.cycles"},
    }
    record += [f"{cycles}.closed", f"{cycles}.cycles", f"{side}_statistics", f"{side}_ensemble.muscles"]
