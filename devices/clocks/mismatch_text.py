"""What to say of a device that does not send as declared, and what is to be set otherwise."""

from __future__ import annotations

from kinegraph.stream.chunk import NS

UNITS_NS = {"ns": 1.0, "us": 1e3, "ms": 1e6, "s": 1e9, "ticks of 1/1024 s": NS / 1024, "ticks of 1/32768 s": NS / 32768}
NEAR = 0.02


def of_rate(hz: float, declared_hz: float, setting: str) -> str:
    """It sends at `hz`. `setting`: the parameter that holds the rate, or a sentence."""
    ratio = hz / declared_hz
    what = f"it sends {hz:.4g} samples a second, not {declared_hz:g}"
    for times in range(2, 17):
        if abs(ratio / times - 1) < NEAR:
            what += (
                f", {times} times as many: is a divider of {times} set otherwise, or do {times} sensors share the line?"
            )
        elif abs(ratio * times - 1) < NEAR:
            what += f", one in {times}: does it divide its rate by {times}, or send each sample in {times} frames?"
    mend = f"set {setting} to {hz:.4g}" if " " not in setting else setting
    return f"{what}; {mend}, or the device to {declared_hz:g} Hz"


def of_turn(turn_ns: float, unit: str) -> str:
    """Its time, declared to be in `unit`, starts again at a value (ns)."""
    ns = UNITS_NS.get(unit, 0.0)
    fits = [bits for bits in range(1, 64) if ns and abs(turn_ns / ns / 2**bits - 1) < 0.1]
    mend = f": its numbers have {fits[0]} bits; set `time_bits` to {fits[0]}" if fits else "; say where it wraps around"
    return f"its time starts again every {turn_ns / NS:.4g} s{mend}"


def of_unit(pace: float, unit: str) -> str:
    """Its time, declared to be in `unit`, advances by `pace` seconds in a second."""
    what = f"its time advances by {pace:.4g} s in a second"
    declared = UNITS_NS.get(unit, 0.0)
    fits = [name for name, ns in UNITS_NS.items() if declared and abs(declared / pace / ns - 1) < NEAR]
    if fits:
        return f"{what}: its numbers are {fits[0]}, not {unit}; set the time's unit (or its scale)"
    return f"{what}: look at the unit and scale of its time"
