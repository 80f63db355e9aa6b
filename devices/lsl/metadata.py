"""What an LSL stream says of itself, in XML after the conventions of XDF (https://github.com/sccn/xdf/wiki/Meta-Data)."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from kinegraph.devices.formats.xdf.reader import UNITS
from kinegraph.stream.chunk import StreamSpec
from kinegraph.stream.errors import DeviceError

TEXT = "string"
INTEGERS = ("int8", "int16", "int32", "int64")
"""Formats of numbers that may be markers, too: a code each."""


@dataclass(frozen=True, slots=True)
class Described:
    """A stream's description.

    format    float32, double64, int8 ... int64, or string
    rate_hz   nominal; 0: irregular
    labels    one per channel; () where they are not all there, or not all different
    units     as kinegraph spells them: one for all, or one per channel; () if unknown
    device    manufacturer, model, serial number, and what other such facts it states
    """

    name: str
    type: str
    source_id: str
    host: str
    format: str
    count: int
    rate_hz: float
    labels: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    device: tuple[tuple[str, str], ...] = ()

    @property
    def spec(self) -> StreamSpec:
        """The spec of its samples, if they are numbers."""
        return signal_spec(self.labels or self.count, self.rate_hz, self.units or ("",), self.type)


def signal_spec(channels: tuple[str, ...] | int, rate_hz: float, units: tuple[str, ...], kind: str) -> StreamSpec:
    """The spec of a stream of numbers: float64, whatever travels."""
    names = () if isinstance(channels, int) else channels
    count = channels if isinstance(channels, int) else len(channels)
    return StreamSpec((count,), rate_hz=rate_hz or None, channels=names, units=units, meta=_meta(kind))


def marker_spec(channels: tuple[str, ...] | int, width: int, kind: str) -> StreamSpec:
    """The spec of a stream of texts, as an import from XDF gives it: `onset` (ns), and a text of `width` characters per channel."""
    count = channels if isinstance(channels, int) else len(channels)
    if count == 1:
        fields: tuple[str, ...] = ("text",)
    elif isinstance(channels, int) or "onset" in channels:
        fields = tuple(f"text{i + 1}" for i in range(count))
    else:
        fields = channels
    dtype = np.dtype([("onset", "<i8"), *((name, f"<U{width}") for name in fields)])
    return StreamSpec((), dtype, units=("ns", *("" for _ in fields)), meta=_meta(kind))


def _meta(kind: str) -> dict[str, str]:
    return {"xdf_type": kind} if kind else {}


def describe(xml: str) -> Described:
    """Read a stream's XML; raises DeviceError if it is invalid."""
    try:
        info = ElementTree.fromstring(xml)
    except ElementTree.ParseError as error:
        raise DeviceError(f"an LSL stream's description is not XML: {error}") from None
    count = int(_text(info, "channel_count") or 0)
    channels = info.findall("desc/channels/channel")
    labels = tuple(_text(c, "label") for c in channels)
    units = tuple(our_unit(_text(c, "unit")) for c in channels)
    device = [
        e for e in info.findall("desc/acquisition/*") + info.findall("desc/*") if not len(e) and (e.text or "").strip()
    ]
    return Described(
        name=_text(info, "name"),
        type=_text(info, "type"),
        source_id=_text(info, "source_id"),
        host=_text(info, "hostname"),
        format=_text(info, "channel_format"),
        count=count,
        rate_hz=float(_text(info, "nominal_srate") or 0),
        labels=labels if len(labels) == count == len(set(labels)) and all(labels) else (),
        units=_units(units) if len(units) == count and any(_text(c, "unit") for c in channels) else (),
        device=tuple((e.tag, (e.text or "").strip()) for e in device),
    )


def our_unit(unit: str) -> str:
    """A unit as kinegraph spells it: "microvolts" is "uV"."""
    return UNITS.get(unit.lower(), unit)


def differences(found: Described, declared: StreamSpec) -> list[str]:
    """What of a stream is not as it was declared; what it does not say of itself is no difference."""
    texts, numbers = declared.is_event, found.format != TEXT
    if texts == numbers and not (texts and found.format in INTEGERS):
        return [f"it holds {'numbers' if numbers else 'texts'}, declared are {'texts' if texts else 'numbers'}"]
    lines = []
    names = declared.channels[1:] if texts else declared.channels
    count = len(names) if texts else declared.shape[0]
    if found.count != count:
        lines.append(f"it has {found.count} channel{'s' * (found.count != 1)}, declared are {count}")
    elif not texts and found.labels and names and found.labels != names:
        lines.append(f"its channels are {', '.join(found.labels)}; declared are {', '.join(names)}")
    rate = declared.rate_hz or 0.0
    if not texts and abs(found.rate_hz - rate) > 1e-6 * rate:
        lines.append(f"its rate is {_rate(found.rate_hz)}, declared is {_rate(rate)}")
    if not texts and found.units and any(declared.units) and found.count == count:
        its, ours = (_spread(units, count) for units in (found.units, declared.units))
        if its != ours:
            lines.append(
                f"its unit is {', '.join(map(repr, found.units))}; declared is {', '.join(map(repr, declared.units))}"
            )
    return lines


def _rate(rate_hz: float) -> str:
    return f"{rate_hz:.12g} Hz" if rate_hz else "irregular (0 Hz)"


def _units(units: tuple[str, ...]) -> tuple[str, ...]:
    return units[:1] if len(set(units)) == 1 else units


def _spread(units: tuple[str, ...], count: int) -> tuple[str, ...]:
    return units * count if len(units) == 1 else units


def _text(element: ElementTree.Element, path: str) -> str:
    return (element.findtext(path) or "").strip()
