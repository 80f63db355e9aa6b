"""A first graph for a recording, from what it holds: raw EMG to envelopes, and with foot contacts to cycles, alarms and a report."""

from __future__ import annotations

import io
import re
from collections.abc import Mapping, Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

from kinegraph.stream.chunk import StreamSpec

VOLTAGES = ("V", "mV", "uV")
MIN_EMG_HZ = 200.0
SIDES = ("left", "right")
NAMED = [
    (pattern.format(left), pattern.format(right))
    for pattern in ("{}_*", "{} *", "{}-*", "{}.*", "*_{}", "* {}", "*-{}", "*.{}")
    for left, right in (("L", "R"), ("l", "r"), ("LT", "RT"), ("Left", "Right"), ("left", "right"), ("LEFT", "RIGHT"))
] + [("L*", "R*")]
"""How channels may name their side; the star is the muscle."""
WATCHED = {
    "ensemble": "operators.cycles.statistics.ensemble.CycleEnsemble",
    "bursts": "operators.cycles.statistics.bursts.CycleBursts",
    "patterns": "operators.monitors.pattern_watch.PatternWatch",
    "timing": "operators.monitors.timing_watch.TimingWatch",
}
"""What takes the cycles that are used, by the node's name."""
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
    return (
        f"# Proposed by `kinegraph dev new graph` from what {path.name} holds:\n{_holds(specs, edges)}{text.getvalue()}"
    )


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
        nodes[node] = {"use": "devices.recorded.RecordedStreams", "path": str(path)}
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
    return spec.is_signal and (spec.rate_hz or 0.0) >= MIN_EMG_HZ and any(unit in VOLTAGES for unit in spec.units)


def _emg(
    nodes: dict[str, dict[str, Any]],
    record: list[str],
    edges: Mapping[str, str],
    specs: Mapping[str, StreamSpec],
    name: str,
    spec: StreamSpec,
    suffix: str,
) -> None:
    edge, channels = edges[name], list(spec.channels)
    if len(spec.units) > 1:
        chosen = [channel for channel in spec.channels if spec.unit_of(channel) in VOLTAGES]
        unit = spec.unit_of(chosen[0])
        channels = [c for c in chosen if spec.unit_of(c) == unit]
        nodes[f"emg{suffix}"] = {"use": "operators.Select", "from": edge, "channels": channels}
        edge = f"emg{suffix}"
    nodes[f"quality{suffix}"] = {"use": "operators.emg.quality.SignalQuality", "from": edge}
    nodes[f"electrodes{suffix}"] = {
        "use": "operators.monitors.electrode_watch.ElectrodeWatch",
        "from": f"quality{suffix}",
    }
    nodes[f"channels{suffix}"] = {"use": "operators.monitors.channel_watch.ChannelWatch", "from": edge}
    nodes[f"envelope{suffix}"] = {"use": "operators.emg.Envelope", "from": edge}
    record += [f"{name}{suffix}" for name in ("quality", "electrodes", "envelope")]
    found = {
        (side, kind): edges[stream]
        for side in SIDES
        for kind, wanted in (("touchdown", STRIKE), ("liftoff", OFF))
        if (stream := _events(specs, side, wanted))
    }
    down = [side for side in SIDES if (side, "touchdown") in found]
    limbs = _patterns(channels) if len(down) == 2 else {}
    if limbs:
        nodes[f"feet{suffix}"] = {
            "use": "operators.contacts.leg_contacts.LegContacts", "from": {f"{side}_{kind}": edge for (side, kind), edge in found.items()},
        }  # fmt: skip
        feet = {kind: f"feet{suffix}.{kind}" for kind in ("touchdown", "liftoff")}
        _cycles(nodes, record, edge, suffix, "", feet, limbs)
    for side in () if limbs else down:
        contacts = {kind: found[side, kind] for kind in ("touchdown", "liftoff") if (side, kind) in found}
        _cycles(nodes, record, edge, suffix, f"{side}_", contacts, {})
    if not down:
        nodes[f"alarms{suffix}"] = {
            "use": "devices.outlets.terminal.alarms.Alarms",
            "from": [f"electrodes{suffix}", f"channels{suffix}"],
        }


def _patterns(channels: Sequence[str]) -> dict[str, str]:
    """Which channels are the left leg's and which the right one's, by their names; {} where these do not say so."""
    for left, right in NAMED:
        fits = {pattern: [name for name in channels if fnmatchcase(name, pattern)] for pattern in (left, right)}
        if all(fits.values()) and sum(map(len, fits.values())) == len(channels):
            return {"left": left, "right": right}
    return {}


def _events(specs: Mapping[str, StreamSpec], side: str, wanted: re.Pattern[str]) -> str:
    """The stream of one side's contacts of a kind, or ""."""
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
    nodes: dict[str, dict[str, Any]], record: list[str], emg: str, suffix: str, side: str, contacts: dict[str, str],
    limbs: dict[str, str],
) -> None:  # fmt: skip
    """Cycles of one leg, or of both with limbs as a dimension, with all that watches them, and a report."""

    def name(what: str) -> str:
        return f"{side}{what}{suffix}"

    quality, envelope, electrodes, channels = (
        f"{what}{suffix}" for what in ("quality", "envelope", "electrodes", "channels")
    )
    kind = "operators.cycles.limb_cycles.LimbCycles" if limbs else "operators.cycles.cycles.Cycles"
    nodes[name("cycles")] = {
        "use": kind,
        "from": {"signal": envelope, **contacts},
        **({"limbs": limbs} if limbs else {}),
    }
    watch = "operators.monitors.limb_watch.LimbWatch" if limbs else "operators.monitors.cycle_watch.CycleWatch"
    nodes[name("contacts")] = {"use": watch, "from": {"signal": envelope, "closed": f"{name('cycles')}.closed"}}
    nodes[name("review")] = {
        "use": "operators.cycles.review.CycleReview",
        "from": {"quality": quality, "closed": f"{name('cycles')}.closed", "cycles": f"{name('cycles')}.cycles"},
    }
    used = {port: f"{name('review')}.{port}" for port in ("closed", "cycles")}
    for what, part in WATCHED.items():
        nodes[name(what)] = {"use": part, "from": dict(used)}
    nodes[name("statistics")] = {
        "use": "operators.cycles.statistics.CycleStatistics", "from": {"judged": f"{name('review')}.judged", **used},
    }  # fmt: skip
    report = {
        "emg": emg, **used, "statistics": name("statistics"), "muscles": f"{name('ensemble')}.muscles", "quality": quality,
        "electrodes": electrodes, "contacts": name("contacts"), "channels": channels, "patterns": name("patterns"),
        "timing": name("timing"), "bursts": f"{name('bursts')}.session", "active": f"{name('bursts')}.active",
    }  # fmt: skip
    if limbs:
        nodes[name("footfalls")] = {
            "use": "operators.strides.footfalls.Footfalls",
            "from": contacts,
            "reference": "left",
        }
        nodes[name("symmetry")] = {
            "use": "operators.cycles.statistics.symmetry.LimbSymmetry",
            "from": {"closed": used["closed"], "statistics": name("statistics")},
        }
        report |= {
            "symmetry": name("symmetry"),
            "footfalls": f"{name('footfalls')}.limbs",
            "gait": f"{name('footfalls')}.gait",
        }
    nodes[name("screen")] = {
        "use": "devices.outlets.terminal.cycle_table.CycleTable", "from": {"closed": used["closed"], "statistics": name("statistics")},
    }  # fmt: skip
    alarms = [electrodes, name("contacts"), channels, name("patterns"), name("timing")]
    nodes[name("alarms")] = {"use": "devices.outlets.terminal.alarms.Alarms", "from": alarms}
    nodes[name("report")] = {"use": "devices.reports.session.SessionReport", "from": report}
    record += [
        f"{name('cycles')}.closed", f"{name('cycles')}.cycles", name("contacts"), name("statistics"), f"{name('ensemble')}.muscles",
    ]  # fmt: skip
