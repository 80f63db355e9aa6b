"""What a session's report may be given, and what each of its inputs must hold."""

from __future__ import annotations

from kinegraph.devices.reports.session.contents.peaks import MODE, MOVED
from kinegraph.devices.reports.session.contents.tally import ALARM_PORTS, GAIT
from kinegraph.stream.chunk import Specs
from kinegraph.stream.errors import InputError

PORTS = (
    "emg", "closed", "cycles", "statistics", "muscles", "pairs", "quality", "electrodes", "contacts", "changes",
    "channels", "patterns", "timing", "markers", "symmetry", "footfalls", "gait", "bursts", "active", "modes", "distance", "low",
    "high", "annotations", "each_burst", "frequency",
)  # fmt: skip
NEEDED = ("closed", "cycles")
FIELDS = {
    "closed": (*GAIT, "onset", "number", "rejected"),
    "statistics": ("number", "muscle"),
    "muscles": ("muscle", "verdict"),
    "pairs": ("first", "second", "mean_pct"),
    "symmetry": ("name", "measure", "mean_pct", "low_pct", "high_pct", "pairs"),
    "footfalls": ("limb", "phase_pct", "duty_pct"),
    "bursts": ("name", "cycles", "per_cycle", "on_pct", "off_pct", "duration_pct"),
    "gait": ("gait", "double_support_pct", "flight_pct", "feet"),
    "modes": ("name", "number", *MODE),
    "distance": ("name", *MOVED),
    "each_burst": ("number", "muscle", "on_pct", "duration_pct", "peak"),
    "frequency": ("number", "name", "median_hz", "slope_pct_per_min"),
    "annotations": ("onset", "text"),
    "quality": ("name", "flag", "reason", "session_flag", "session_reason"),
    **dict.fromkeys(ALARM_PORTS, ("onset", "subject", "state", "what")),
}
"""Per port of events, the fields that they must have."""
SHAPED = {
    "active": "operators.cycles.statistics.bursts.CycleBursts",
    "low": "operators.cycles.statistics.norms.NormativeBands",
    "high": "operators.cycles.statistics.norms.NormativeBands",
}
"""Ports with the shape of cycles, and the operator that has an output of that name."""


def check_ports(specs: Specs) -> None:
    """Raises InputError for the first input that is not what the report reads."""
    cycles = specs["cycles"]
    if cycles.is_event or len(cycles.shape) != 2 or cycles.channel_axis != 1 or not cycles.channels:
        raise InputError(
            "cycles", cycles.describe(), "cycles (points, muscles), as operators.cycles.cycles.Cycles gives"
        )
    for port, needed in FIELDS.items():
        if port in specs and not set(needed) <= set(specs[port].dtype.names or ()):
            raise InputError(port, specs[port].describe(), f"events with the fields {', '.join(needed)}")
    for port, operator in SHAPED.items():
        if port in specs and specs[port].shape != cycles.shape:
            raise InputError(port, specs[port].describe(), f"`{port}` of {operator}")
