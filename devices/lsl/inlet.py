"""A stream of the Lab Streaming Layer as a source."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal, Self

import numpy as np

from kinegraph.devices.clocks.timing import timing_spec
from kinegraph.devices.formats.timing import snapped
from kinegraph.devices.lsl.connection import Connection, opened
from kinegraph.devices.lsl.find import Wanted, find, missing
from kinegraph.devices.lsl.metadata import INTEGERS, TEXT, describe, differences, marker_spec, signal_spec
from kinegraph.devices.lsl.network import ANY, Network, library
from kinegraph.devices.lsl.pull import Pull
from kinegraph.stream.chunk import Specs, StreamSpec
from kinegraph.stream.domain.claims import WRONG_BY_STAMPS
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

MEASURED_S, MAX_MEASURED_S, ENOUGH = 3.0, 10.0, 50
"""A rate is measured over this time, or at most this, and by this number of samples."""


class _Probing(Source):
    __slots__ = ("probed",)
    probed: StreamSpec
    """What was found when the graph was checked (with `probe: true`)."""


@dataclass(frozen=True, slots=True)
class LslInlet(_Probing):
    """A stream that another program offers on the Lab Streaming Layer: numbers, or texts (markers).

    out      (channels,) float64 in the stream's units, irregular where `rate_hz` is 0; of markers: events with `onset` (ns) and `text` (at
             most `text_width` characters; with several channels, a text under each channel's label)
    timing   events, one per read: the running number of its last sample, that sample's stamp on the sender's clock, arrival, mapped stamp

    The stream is found by its name, type, source_id and host: what is given of these must be unique. What it is must be declared, so that
    a graph can be checked where the stream is not; `probe: true` looks at the stream itself when the graph is loaded. A stream that is
    not what was declared is refused, with the difference.

    Stamps are the sender's, moved to this computer's clock by LSL's own measurement of the offset (every 5 s or so, within 0.2 ms on a
    cable; a new estimate is blended in, so that stamps keep their pace) and less `latency_s`. LSL counts no samples: what is lost shows
    as a leap of the stamps (see `gap_s`). LSL itself connects again when an outlet comes back with the same source_id; what was missed is
    then marked as lost, of unknown number. One that has brought nothing for `lost_after_s` is given up and searched for again, by name and
    type, so that it may come back with another source_id. A stream without a rate may be silent for ever as long as its outlet
    answers.
    """

    outputs: ClassVar[tuple[str, ...]] = ("out", "timing")
    rate_tolerance: ClassVar[float] = WRONG_BY_STAMPS

    name: str = param("", help="the stream's name")
    type: str = param("", help="its content type: EMG, EEG, Markers, ...")
    source_id: str = param("", help="its source_id: the one thing about it that is unique")
    host: str = param("", help="the computer that sends it")
    channels: tuple[str, ...] | int = param(0, least=0, help="the channels' labels, or only how many there are")
    rate_hz: float = param(0.0, least=0, help="nominal rate; 0: irregular")
    unit: tuple[str, ...] | str = param("", help="of all channels, or one for each: uV, mV, g, ...")
    markers: bool = param(False, help="the stream holds markers: texts, or whole numbers, which become texts")
    text_width: int = param(64, least=1, most=65536, help="characters that a marker may have; longer ones are cut")
    probe: bool = param(False, help="look at the stream when the graph is loaded, instead of declaring it")
    resolve_s: float = param(5.0, above=0, most=600, help="how long to search for the stream")
    lost_after_s: float = param(5.0, above=0, help="after how long without a sample it is searched for again")
    gap_s: float = param(
        0.5, above=0, help="a longer step between stamps is a gap; an even sender's gaps are seen at two periods"
    )
    latency_s: float = param(0.0, least=0, help="how long before its stamp a sample really was taken")
    rate_mismatch: Literal["warn", "fail", "measured"] = param(
        "warn",
        help="samples that come at another rate than the stream claims raise the alarm, or end the session; `measured`: what counts is the "
        "graph's `rate_hz`, or with `probe: true` the rate that is measured when the graph is loaded",
    )
    network: Network = param(ANY, help="how far LSL looks; one for the whole graph")

    def specs(self) -> Specs:
        if not (self.name or self.type or self.source_id):
            raise ParameterError("name", self.name, "given, or `type`, or `source_id`: what the stream is known by")
        if not isinstance(self.channels, int) and len(set(self.channels)) != len(self.channels):
            raise ParameterError("channels", list(self.channels), "labels of which no two are the same")
        return {"out": self._probe() if self.probe else self._declared(), "timing": timing_spec()}

    def unopened(self) -> Self:
        made = replace(self)
        if hasattr(self, "probed"):
            object.__setattr__(made, "probed", self.probed)
        return made

    @property
    def may_appear(self) -> bool:
        return True

    def missing(self) -> str:
        return missing(library(self.network), self._wanted)

    def read(self, feed: Feed) -> None:
        lsl = library(self.network)
        found = find(lsl, self._wanted, self.resolve_s, feed.wait)
        if found is None:
            return
        with opened(lsl, found, feed) as connection:
            if connection is not None:
                self._check(connection)
                Pull(connection, self._spec, feed, self.gap_s, self.latency_s, self.lost_after_s).run()

    @property
    def refuses(self) -> frozenset[str]:
        return frozenset({"rate"} if self.rate_mismatch == "fail" else ())

    @property
    def _wanted(self) -> Wanted:
        return Wanted(self.name, self.type, self.source_id, self.host)

    @property
    def _spec(self) -> StreamSpec:
        return self.probed if self.probe else self._declared()

    def _declared(self) -> StreamSpec:
        channels = self.channels or (1 if self.markers else 0)
        if not channels:
            raise ParameterError("channels", self.channels, "labels, or a number of at least 1; or say `probe: true`")
        if self.markers:
            return marker_spec(channels, self.text_width, self.type)
        count = channels if isinstance(channels, int) else len(channels)
        units = (self.unit,) if isinstance(self.unit, str) else self.unit
        if len(units) not in (1, count):
            raise ParameterError("unit", list(units), f"one unit, or one for each of the {count} channels")
        return signal_spec(channels, self.rate_hz, units, self.type)

    def _probe(self) -> StreamSpec:
        """What the stream is; looked up once, and kept."""
        if hasattr(self, "probed"):
            return self.probed
        lsl = library(self.network)
        found = find(lsl, self._wanted, self.resolve_s, _sleep)
        inlet = lsl.StreamInlet(found, recover=False)
        try:
            described = describe(inlet.info(self.resolve_s).as_xml())
        except RuntimeError as error:
            raise DeviceError(f"the LSL stream with {self._wanted} does not describe itself: {error}") from None
        if described.format == TEXT or (self.markers and described.format in INTEGERS):
            spec = marker_spec(described.labels or described.count, self.text_width, described.type)
        else:
            spec = described.spec
            if self.rate_mismatch == "measured" and spec.rate_hz:
                spec = spec.derive(rate_hz=_measured(inlet, spec.rate_hz))
        object.__setattr__(self, "probed", spec)
        return spec

    def _check(self, connection: Connection) -> None:
        """Refuse a stream that is not what the graph was checked with."""
        described = connection.described
        if self.rate_mismatch == "measured":
            described = replace(described, rate_hz=self._spec.rate_hz or 0.0)
        result = differences(described, self._spec)
        if result:
            hint = (
                "has it changed since the graph was loaded?"
                if self.probe
                else "declare what it is, or say `probe: true`"
            )
            raise DeviceError(
                f"the LSL stream with {self._wanted} is not what was declared: {'; '.join(result)}; {hint}"
            )


def _measured(inlet: Any, claimed_hz: float) -> float:
    """The rate at which samples come, by their stamps over a few seconds; the claimed one where that holds."""
    stamps: list[float] = []
    began = time.monotonic()
    while time.monotonic() < began + MAX_MEASURED_S:
        stamps += inlet.pull_chunk(0.2)[1]
        if len(stamps) > ENOUGH and stamps[-1] - stamps[0] > MEASURED_S:
            break
    steps = np.diff(stamps)
    if len(steps) < ENOUGH or not stamps[-1] > stamps[0]:
        return claimed_hz
    hz, jitter = len(steps) / (stamps[-1] - stamps[0]), 2 * float(steps.max()) / (stamps[-1] - stamps[0])
    return claimed_hz if abs(hz / claimed_hz - 1) < WRONG_BY_STAMPS + jitter else snapped(hz)


def _sleep(seconds: float) -> bool:
    time.sleep(seconds)
    return False
