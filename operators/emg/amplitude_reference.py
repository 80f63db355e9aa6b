"""An amplitude reference: what each muscle's envelope came to in a calibration, frozen in a plain JSON file."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from kinegraph.stream.chunk import Samples, StreamSpec
from kinegraph.stream.data.json_file import read_json, write_json
from kinegraph.stream.errors import KinegraphError, nearest
from kinegraph.stream.params import adapter

FORMAT = "kinegraph amplitude reference 1"
METHODS = {
    "mvc": "% MVC",
    "rest": "% rest",
    "task_peak": "% task peak",
    "task_mean": "% task mean",
}
"""The methods, and the unit of what was divided by their reference."""


class CalibrationError(KinegraphError):
    """A reference that cannot be read, or was made from other muscles, units or filters."""


@dataclass(frozen=True, slots=True)
class AmplitudeReference:
    """What a calibration found.

    kind       mvc, rest or task
    values     per method of `METHODS` that the kind offers: one number per channel, in `unit`
    channels   the channels of these values, in order; unit: of the raw signal
    envelope   the envelope's parameters; a reference is valid only for envelopes made alike
    noise      baseline noise per channel (rms of the quietest 100 ms), in `unit`; from rest only
    subject, date, source, note   of whom, when, from which recording, and how it was taken
    """

    kind: str
    values: dict[str, list[float]]
    channels: list[str]
    unit: str
    envelope: dict[str, Any]
    noise: list[float] = field(default_factory=list)
    subject: str = ""
    date: str = ""
    source: str = ""
    note: str = ""

    def write(self, path: Path) -> None:
        """Raises CalibrationError where the file cannot be written."""
        write_json(path, {"format": FORMAT, **asdict(self)}, CalibrationError)

    @staticmethod
    def read(path: Path) -> AmplitudeReference:
        """Raises CalibrationError for a file that is missing, broken or something else."""
        from pydantic import ValidationError

        record = read_json(
            path, "an amplitude reference", CalibrationError, "`kinegraph emg calibrate` makes references"
        )
        if record.pop("format", None) != FORMAT:
            raise CalibrationError(f"{path}: is not an amplitude reference; it must hold the format {FORMAT!r}")
        try:
            found: AmplitudeReference = adapter(AmplitudeReference).validate_python(record)
        except ValidationError as error:
            first = error.errors()[0]
            raise CalibrationError(
                f"{path}: field {'.'.join(map(str, first['loc']))!r}: {first['msg'].lower()}"
            ) from None
        lists = [*found.values.values(), *([found.noise] if found.noise else [])]
        if any(len(values) != len(found.channels) or not all(value > 0 for value in values) for values in lists):
            raise CalibrationError(f"{path}: must hold one positive number per channel ({len(found.channels)})")
        return found

    def scale(self, method: str, spec: StreamSpec) -> Samples:
        """The reference of every channel of `spec` (channels,). Raises CalibrationError where it was made for something else."""
        if method not in self.values:
            offers = ", ".join(self.values) or "nothing"
            raise CalibrationError(f"the reference was taken at {self.kind} and offers {offers}, not {method!r}")
        for channel in spec.channels:
            if channel not in self.channels:
                raise CalibrationError(f"the reference has no muscle {channel!r}; {nearest(channel, self.channels)}")
            if spec.unit_of(channel) != self.unit:
                raise CalibrationError(
                    f"the reference is in {self.unit!r}, channel {channel!r} in {spec.unit_of(channel)!r}"
                )
        if spec.meta.get("envelope") != self.envelope:
            raise CalibrationError(
                f"the reference was made from envelopes with {_told(self.envelope)}; these have {_told(spec.meta.get('envelope', {}))}"
            )
        values = dict(zip(self.channels, self.values[method], strict=True))
        return np.array([values[channel] for channel in spec.channels])


def _told(envelope: dict[str, Any]) -> str:
    return ", ".join(f"{name} {value}" for name, value in envelope.items()) or "parameters that are not known"
