"""Whether a stream's channels are of one kind: volts of muscles and newtons of a plate are never treated alike."""

from __future__ import annotations

from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError

VOLTAGES = ("V", "mV", "uV")


def refuse_mixed(spec: StreamSpec, port: str = "in") -> None:
    """Raises InputError where some channels are voltages and others are not, with what to do."""
    if len(spec.units) == 1 or not any(unit in VOLTAGES for unit in spec.units):
        return
    others = [name for name, unit in zip(spec.channels, spec.units, strict=False) if unit not in VOLTAGES]
    if others:
        kinds = ", ".join(dict.fromkeys(unit or "no unit" for unit in spec.units))
        given = (
            f"{spec.describe()} ({kinds}: {', '.join(others[:3])}{', ...' if len(others) > 3 else ''} beside voltages)"
        )
        raise InputError(port, given, "EMG in one kind of unit; choose its channels with operators.Select before")
