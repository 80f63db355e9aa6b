"""A stream or event of a graph on the Lab Streaming Layer, for LabRecorder and any other program."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import structlog

from kinegraph.devices.lsl.clock import zero_ns
from kinegraph.devices.lsl.network import ANY, Network, library
from kinegraph.devices.lsl.samples import Form, NumberRows, form_of
from kinegraph.stream.chunk import NS, Chunk, Specs
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.stream.system.clock import SessionClock

LINGER_S = 0.2
"""How long the last samples are given to reach those who listen."""
BUFFER_S = 60
"""What is kept for a listener that is slow."""

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class Nothing:
    """An outlet to a network has no state."""


class LslRuntime:
    """What belongs to a running outlet. `zero`: session time (ns) at which LSL's clock stood at 0; None: not known yet."""

    def __init__(self, form: Form) -> None:
        self.form = form
        self.zero: int | None = None
        self.clock: SessionClock | None = None
        self.lsl: Any = None
        self.outlet: Any = None


@dataclass(frozen=True, slots=True)
class LslOutlet(Outlet[Nothing, LslRuntime]):
    """Offers a stream of the graph on the Lab Streaming Layer, with labels, units, type and the full spec in its description.

    Signals, markers and small frames go out as they are, one LSL channel for each number of a sample (LANK.x, LANK.y, ...), in the
    narrowest of LSL's types that holds all values. Events go out in one of three ways:

    json       one text per event: {"onset": ..., "cause": ...}; fields in ns are whole numbers of session time (UTC)
    field      one text per event: the field named in `fields`
    numbers    a float64 channel for each of `fields` (default: all); fields in ns become seconds after the event's stamp

    Stamps are those of the samples, on LSL's clock: a delay inside the graph is taken off already, so that listeners need not know of it.
    A gap is a leap of the stamps. In replay the outlet is silent; asked to speak, its first sample is stamped with the present, and
    the others keep their distance. Without a name it is off.
    It keeps nothing for those who were not there, and 60 s for those who are slow.
    """

    name: str = param(help="what others find the stream by; left empty: nothing is offered")
    type: str = param("", help="content type; left out: Markers for texts, else what the stream was called, or Signal")
    source_id: str = param("", help="by which listeners find it again after a restart; left out: made of host and name")
    events: Literal["json", "field", "numbers"] = param("json", help="how events are sent")
    fields: tuple[str, ...] = param((), help="the fields of an event that are sent")
    network: Network = param(ANY, help="how far the stream is seen; one for the whole graph")

    def open(self, specs: Specs) -> Specs:
        self.set_state(Nothing(), LslRuntime(form_of(specs["in"], self.events, self.fields)))
        return {}

    def keep_time(self, clock: SessionClock) -> None:
        self.runtime.clock = clock

    def begin(self) -> None:
        runtime = self.runtime
        if not self.name:
            return
        lsl = runtime.lsl = library(self.network)
        form = runtime.form
        source_id = self.source_id or f"kinegraph.{socket.gethostname()}.{self.name}"
        kind = self.type or form.type
        info = lsl.StreamInfo(self.name, kind, len(form.labels), form.rate_hz, form.format, source_id)
        form.describe(info.desc(), kind)
        try:
            runtime.outlet = lsl.StreamOutlet(info, max_buffered=BUFFER_S)
        except RuntimeError as error:
            raise DeviceError(f"the LSL outlet {self.name!r} cannot be opened: {error}") from None
        if runtime.clock:
            runtime.zero = zero_ns(lsl, runtime.clock.now)
        log.info(
            "LSL outlet", name=self.name, type=kind, source_id=source_id, channels=len(form.labels), format=form.format
        )

    def process(self, port: str, chunk: Chunk) -> None:
        runtime = self.runtime
        if not len(chunk) or runtime.outlet is None:
            return
        if runtime.zero is None:
            runtime.zero = int(chunk.time[-1]) - round(runtime.lsl.local_clock() * NS)
        stamps = ((chunk.time - runtime.zero) / NS).tolist()
        if isinstance(runtime.form, NumberRows):
            runtime.outlet.push_chunk(runtime.form.rows(chunk), stamps)
        else:
            for text, stamp in zip(runtime.form.rows(chunk), stamps, strict=True):
                runtime.outlet.push_sample([text], stamp)

    def close(self) -> None:
        runtime = self.runtime
        if runtime.outlet is not None:
            if runtime.outlet.have_consumers():
                time.sleep(LINGER_S)
            runtime.outlet = None
