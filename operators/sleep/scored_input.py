"""What a scorer of sleep may be given: epochs of its length, and counts of its device or what a calibration makes of other motion."""

from __future__ import annotations

from pathlib import Path

from kinegraph.operators.sleep.calibration import Calibration
from kinegraph.operators.sleep.methods import METHODS, MethodName
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import InputError, ParameterError


def epoch_length(method: MethodName, given: float) -> float:
    """The length of epochs (s) as the method knows it. Raises InputError."""
    known = METHODS[method].epochs_s
    for length in known:
        if abs(given - length) < 1e-6 * length:
            return length
    wanted = " or ".join(f"{length:g}" for length in known)
    raise InputError(
        "in",
        f"in epochs of {given:g} s",
        f"in epochs of {wanted} s for {method}; operators.sleep.epochs.Epochs makes them",
    )


def calibration_for(
    method: MethodName, calibration: str, spec: StreamSpec, unit: str, epoch_s: float
) -> Calibration | None:
    """The calibration that is used. Raises where a scorer of counts would be given something else."""
    known = METHODS[method]
    if not known.device:
        if calibration:
            raise ParameterError("calibration", calibration, "left out: thesis takes movement as it is")
        return None
    if calibration:
        found = Calibration.read(Path(calibration))
        if (found.device, found.unit, found.epoch_s) != (known.device, unit, epoch_s):
            raise ParameterError(
                "calibration", calibration,
                f"one from {unit or 'no unit'} to counts of {known.device} at {epoch_s:g} s; "
                f"{found.name!r} is from {found.unit} to {found.device} at {found.epoch_s:g} s",
            )  # fmt: skip
        return found
    meta = spec.meta
    given = f"{spec.describe()}, device {meta.get('device') or 'not named'}, site {meta.get('site') or 'not named'}"
    if unit != "counts" or meta.get("device") != known.device or meta.get("site") != "wrist":
        raise InputError(
            "in", given,
            f"wrist counts of {known.device} for {method}: unit counts, meta device={known.device} and site=wrist; "
            "for other motion name a calibration, or take method thesis",
        )  # fmt: skip
    if known.measure and meta.get("measure") != known.measure:
        raise InputError("in", f"{given}, measure {meta.get('measure')!r}", f"the {known.measure} in each minute")
    return None
