"""A stored reference of muscle activity (`kinegraph emg train-model`): mixtures by muscle, and what they may be compared with."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.operators.emg.mixtures.events import MOST_MODES
from kinegraph.operators.emg.mixtures.reference import References
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.data.model_file import ModelError, read_model, write_model
from kinegraph.stream.errors import InputError, nearest

KIND = "emg-model"


def made_alike(meta: dict[str, Any]) -> dict[str, Any]:
    """What two mixtures must have in common to be compared, from the meta of a stream that was made from cycles."""
    return {
        "normalisation": meta.get("normalisation", "none"),
        "envelope": meta.get("envelope"),
        "height_unit": meta.get("height_unit", ""),
    }


def write_references(
    path: Path, references: References, names: list[str], meta: dict[str, Any], about: dict[str, Any]
) -> None:
    """Write the references of these muscles; `meta` as the mixtures' stream has it. Raises OSError."""
    header = {**about, **made_alike(meta), "muscles": names, "circular": bool(meta["fitting"]["circular"])}
    arrays = {name: getattr(references, name) for name in References.__slots__}
    write_model(path, KIND, header, arrays)


def read_references(path: Path, mixture: StreamSpec, names: list[str]) -> References:
    """The stored references of these muscles, in their order. Raises ModelError, and InputError for mixtures made otherwise."""
    model = read_model(path, KIND, "emg train-model")
    header = model.header
    mine = {**made_alike(mixture.meta), "circular": mixture.meta["fitting"]["circular"]}
    for what, value in mine.items():
        if header.get(what) != value:
            raise InputError("mixture", f"{what} {value!r}", f"{what} {header.get(what)!r}, as {path} was made from")
    stored = [str(name) for name in header.get("muscles") or ()]
    for name in names:
        if name not in stored:
            raise InputError("mixture", f"muscle {name!r}", f"the muscles of {path}; {nearest(name, stored)}")
    order = [stored.index(name) for name in names]
    count, k = len(stored), MOST_MODES
    modes = model.array("modes", (count,), np.int64)
    if ((modes < 0) | (modes > k)).any():
        raise ModelError(f"{path}: array 'modes' must hold 0 to {k}")
    shapes = {"weights": (count, k), "means": (count, k, 2), "covariances": (count, k, 3)}
    weights, means, covariances = (model.array(name, shape)[order] for name, shape in shapes.items())
    covariance = covariances[np.arange(k) < modes[order, None]]
    if (covariance[:, 0] * covariance[:, 2] <= covariance[:, 1] ** 2).any():
        raise ModelError(f"{path}: a covariance is not positive definite")
    limits = [
        np.asarray(model.arrays.get(name, np.full(count, np.nan)), np.float64) for name in ("limit", "full", "noise")
    ]
    if any(limit.shape != (count,) for limit in limits):
        raise ModelError(f"{path}: limit, full and noise must hold a number per muscle")
    cycles = model.array("cycles", (count,), np.int64)
    limit, full, noise = (values[order] for values in limits)
    return References(modes[order], weights, means, covariances, cycles[order], limit, full, noise)
