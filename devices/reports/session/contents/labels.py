"""The words of a report: what the graph's settings, a session's facts and a stream's fields are called on paper."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from importlib.metadata import version
from math import floor, log10
from typing import Any

import numpy as np

from kinegraph.devices.reports.session.contents.data import Column, Setting
from kinegraph.devices.reports.session.contents.paths import recording_of
from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.graph import Graph
from kinegraph.stream.outlet import Outlet

COLUMNS = {
    "peak": ("Peak", 1, "highest point of a cycle."),
    "peak_pct": ("Peak at", 1, "place of the highest point; averaged on a circle, since 99 % and 1 % are neighbours."),
    "mean": ("Mean", 1, "mean over a cycle."),
    "integrated": ("iEMG", 2, "integrated EMG: mean times duration."),
    "mean_stance": ("Mean in stance", 1, ""),
    "mean_swing": ("Mean in swing", 1, ""),
    "deviation": ("Deviation", 2, "Euclidean distance of a cycle from the mean curve of those before it, over 100 points."),
    "cv_pct": ("CV", 0, "Winter's coefficient of variation: root mean square deviation over the mean curve's mean."),
    "variance_ratio": ("VR", 2, "variance ratio (Hershler and Milner): 0, all cycles alike; 1, nothing repeats. Given from ten cycles on."),
}  # fmt: skip
"""Heading, decimals and note of the fields that the table of muscles shows."""

METHODS = {
    "mvc": "the strongest voluntary contraction",
    "rest": "the mean at rest",
    "task_peak": "the peak of the mean cycle of a calibration walk",
    "task_mean": "the mean of the mean cycle of a calibration walk",
}
"""What 100 % stands for, by the method's name."""

PAIRS = (
    "Index of Falconer and Winter: 2 × sum of the smaller / sum of both, mean over all cycles. It compares the sizes of two muscles, and so"
    " depends on how they were normalised ({normalisation})."
)

REASONS = {
    "gap": "gap in the signal or the contacts",
    "settling": "filters not settled",
    "incomplete": "signal missing at an end, or contact reported too late",
    "order": "a touch-down was missed between two lift-offs",
    "stance": "impossible share of stance",
    "irregular": "duration far from that of its neighbours",
    "missing": "no valid sample",
    "quality": "no muscle's signal was good enough",
    "by hand": "left out by hand",
    "turning": "turning",
    "contacts": "an alarm says that its contacts are wrong",
    "too short": "too short for a stride",
    "too long": "too long for a stride",
}
"""Why cycles are rejected, as a reader understands it."""

UNITS = {
    "m_s": "m/s",
    "km_h": "km/h",
    "kmh": "km/h",
    "kg": "kg",
    "cm": "cm",
    "mm": "mm",
    "m": "m",
    "s": "s",
    "hz": "Hz",
    "percent": "%",
    "years": "years",
}
SITES = ("sites", "electrodes", "electrode_sites")


AMPLITUDES = ("peak", "mean", "integrated", "mean_stance", "mean_swing", "integrated_stance", "integrated_swing")
"""The fields in the signal's unit."""
UNSIGNED = ("integrated", "deviation", "cv_pct")
"""The fields that only amplitudes above 0 have a use for."""


def decimals(field: str, least: int, values: Samples) -> int:
    """How many decimals a field's `values` are written with: `least`, or as many as leave three figures to amplitudes below 1 (mV)."""
    amounts = np.abs(values[np.isfinite(values)])
    largest = float(amounts.max(initial=0.0))
    return max(least, 2 - floor(log10(largest))) if field in AMPLITUDES and 0 < largest < 1 else least


def column(field: str, spec: StreamSpec) -> Column | None:
    """How a field of a muscle's events is shown; None if it is left to the CSV file."""
    if field not in COLUMNS or (field in UNSIGNED and is_angle(spec)):
        return None
    heading, decimals, note = COLUMNS[field]
    if field == "deviation":
        scale = spec.meta.get("deviation_scale", "")
        note += {
            "session": " Relative to the muscle's highest value in the session.",
            "cycle": " Relative to each cycle's own maximum.",
        }.get(scale, "")
    unit = spec.unit_of(field)
    if field == "integrated" and not unit.startswith(("V", "mV", "uV", "%")):
        heading, note = "Integral", "mean times duration."
    return Column(heading, "% of cycle" if field == "peak_pct" else unit, decimals, note)


def is_angle(spec: StreamSpec | None) -> bool:
    """Whether amplitudes are angles, which have two signs and no natural zero: shares of them mean nothing."""
    if spec is None or (spec.is_event and "peak" not in spec.channels):
        return False
    return (spec.unit_of("peak") if spec.is_event else "".join(set(spec.units))) == "deg"


def facts(session: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """A session's facts as label and value; a unit at the end of a name goes to the value ("speed_m_s: 1.2": Speed 1.2 m/s)."""
    for name, value in session.items():
        if name in SITES or value in (None, "", [], {}):
            continue
        unit = next((u for u in sorted(UNITS, key=len, reverse=True) if name.endswith(f"_{u}")), "")
        label = name.removesuffix(f"_{unit}") if unit else name
        if isinstance(value, Mapping):
            value = ", ".join(f"{k}: {v}" for k, v in value.items())
        elif isinstance(value, list | tuple):
            value = ", ".join(map(str, value))
        yield label.replace("_", " ").capitalize(), f"{value} {UNITS[unit]}" if unit else str(value)


def normalisation(meta: Mapping[str, Any]) -> str:
    """What amplitudes are relative to, with the person and date of the reference; "none" if to nothing."""
    method = str(meta.get("normalisation", "none"))
    if method == "none":
        return method
    about = meta.get("normalisation_reference") or {}
    owner = ", ".join(str(about[name]) for name in ("subject", "date") if about.get(name))
    return f"{METHODS.get(method, method)}{f' (reference of {owner})' if owner else ''}"


def relative_to(meta: Mapping[str, Any]) -> str:
    """The same as it is printed beside a number: "not normalised", "normalised to ..."."""
    return normalisation_text(normalisation(meta))


def normalisation_text(normalisation: str) -> str:
    """The normalisation as it is named at every amplitude."""
    return "not normalised" if normalisation in ("", "none") else f"normalised to {normalisation}"


def sites(session: Mapping[str, Any], meta: Mapping[str, Any]) -> dict[str, str]:
    """Where the electrodes sat, by channel: as the session says, else as the device does."""
    for place in (session, meta):
        for name in SITES:
            if isinstance(place.get(name), Mapping):
                return {str(k): str(v) for k, v in place[name].items()}
    return {}


def recording(graph: Graph | None) -> Iterator[tuple[str, str]]:
    """Where a replay's samples come from, and a session's lie."""
    if graph and (name := recording_of(graph)):
        yield "Recording", name + (f" (from {', '.join(graph.imported)})" if graph.imported else "")


def settings(graph: Graph) -> Iterator[Setting]:
    """Every source and operator with all its parameters, given or not. Imported streams have no parameters."""
    for node in graph.nodes.values():
        if isinstance(node.part, Outlet) or getattr(node.part, "background", False):
            continue
        parameters = [(f.name, getattr(node.part, f.name)) for f in fields(node.part)]  # type: ignore[arg-type]
        text = ", ".join(f"{name}: {_plain(value)}" for name, value in parameters if value not in (None, "", ()))
        delay = float("nan") if node.is_source else node.declared.delay_s * 1000
        if graph.imported and node.is_source:
            yield Setting(node.name, "recording", f"{graph.replays}, in place of {node.use}", delay)
        else:
            yield Setting(node.name, node.use, text, delay)


def _plain(value: Any) -> str:
    if is_dataclass(value):
        given = [(f.name, getattr(value, f.name)) for f in fields(value) if getattr(value, f.name) != f.default]
        return f"{{{', '.join(f'{name}: {_plain(v)}' for name, v in given)}}}"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_plain, value))}]"
    return f"{value:g}" if isinstance(value, float) else str(value)


def versions() -> list[tuple[str, str]]:
    """What made the report."""
    packages = ("kinegraph", "numpy", "scipy", "numba")
    return [*((name, version(name)) for name in packages), ("Python", platform.python_version())]
