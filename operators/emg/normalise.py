"""Amplitude normalisation of an EMG envelope by a frozen reference (thesis 6.2.3 scales to [0, 1])."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from kinegraph.operators.emg.amplitude_reference import METHODS, AmplitudeReference, CalibrationError
from kinegraph.stream.chunk import Chunk, Samples, Specs, StreamSpec
from kinegraph.stream.errors import InputError, ParameterError
from kinegraph.stream.operator import Case, Input, Operator, grid
from kinegraph.stream.params import param


@dataclass(slots=True)
class NormaliseState:
    """scale (channels,): what a sample is multiplied with."""

    scale: Samples


@dataclass(frozen=True, slots=True)
class Normalise(Operator[NormaliseState]):
    """An envelope (channels,) in, the same in per cent of a reference out. No delay.

    `method` is what the reference stands for: `mvc` the strongest voluntary contraction, `rest` the mean at rest, `task_peak` and
    `task_mean` the peak and the mean of the mean cycle in a calibration walk, or `none`, which changes nothing and needs no reference.
    The reference is a file that `kinegraph emg calibrate` wrote. It is read once, when the graph is opened, and is refused if its muscles,
    its unit or its envelope's parameters are others than those of the input, or if it was taken of another subject than the session's
    (unless `any_subject`).

    The thesis scales every signal to [0, 1]; done cycle by cycle that hides every change in strength. A reference that is frozen before
    the session keeps cycles, muscles and sessions comparable. `meta["normalisation"]` names the method on this and every stream made from
    it, `meta["normalisation_reference"]` holds the reference's values, person and date: so does every recording.

    >>> Normalise()(np.array([1.0, 2.0]), rate_hz=100)
    array([1., 2.])
    """

    inputs = {"in": Input(finite=True)}
    method: Literal["mvc", "rest", "task_peak", "task_mean", "none"] = param("none", help="what 100 % stands for")
    reference: str = param("", help="the file that `kinegraph emg calibrate` wrote")
    any_subject: bool = param(False, help="use the reference even if it was taken of somebody else")

    def open(self, specs: Specs) -> Specs:
        spec = specs["in"]
        if not spec.is_signal or spec.dtype.kind not in "iuf":
            raise InputError("in", spec.describe(), "a signal of channels")
        if self.method == "none":
            if self.reference:
                raise ParameterError("reference", self.reference, "left out where `method` is none")
            self.set_state(NormaliseState(np.ones(spec.shape[0])))
            return {"out": spec.derive(dtype=np.dtype(np.float64), meta={**spec.meta, "normalisation": "none"})}
        if spec.meta.get("normalisation", "none") != "none":
            raise InputError("in", f"normalised already ({spec.meta['normalisation']})", "an envelope that is not")
        if not self.reference:
            raise ParameterError("reference", self.reference, f"the file that holds the {self.method} reference")
        found = AmplitudeReference.read(Path(self.reference))
        try:
            reference = found.scale(self.method, spec)
        except CalibrationError as error:
            raise ParameterError("reference", self.reference, f"one for this envelope: {error}") from None
        self.set_state(NormaliseState(100.0 / reference))
        about = {
            "values": dict(zip(spec.channels, reference.tolist(), strict=True)),
            "unit": found.unit,
            "subject": found.subject,
            "date": found.date,
            "source": found.source,
        }
        meta = {**spec.meta, "normalisation": self.method, "normalisation_reference": about}
        return {"out": spec.derive(dtype=np.dtype(np.float64), units=(METHODS[self.method],), meta=meta)}

    def check_session(self, session: Mapping[str, Any]) -> None:
        """Refuse a reference of somebody else than the session's subject, where both are known."""
        if self.method == "none" or self.any_subject:
            return
        owner, subject = AmplitudeReference.read(Path(self.reference)).subject, str(session.get("subject") or "")
        if owner.strip() and subject.strip() and owner.strip().casefold() != subject.strip().casefold():
            accepts = (
                f"one of the session's subject: it was taken of {owner!r}, and the session is of {subject!r}; `any_subject: true` "
                f"uses it all the same, `session.subject` names the session's subject"
            )
            raise ParameterError("reference", self.reference, accepts)

    def process(self, port: str, chunk: Chunk) -> Chunk:
        return Chunk(chunk.time, chunk.data * self.state.scale, chunk.until, chunk.lost)

    @classmethod
    def cases(cls) -> list[Case]:
        spec = StreamSpec((2,), rate_hz=100.0, channels=("TA", "SO"), units=("uV",))
        return [Case(cls(), {"in": (spec, grid(100.0, 60), np.random.default_rng(8).random((60, 2)))}, least=60)]
