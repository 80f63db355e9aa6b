"""Trigger pulses for other devices: by a serial port's control line or bytes, as an LSL marker, as an OSC message."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import structlog

from kinegraph.devices.lsl.clock import zero_ns
from kinegraph.devices.lsl.network import ANY, Network, library
from kinegraph.devices.lsl.outlet import LINGER_S
from kinegraph.devices.osc.sender import OscSender
from kinegraph.devices.osc.writer import bundles, floats
from kinegraph.devices.outlets.trigger.serial_line import SerialLine
from kinegraph.stream.chunk import NS, Chunk, Specs
from kinegraph.stream.errors import DeviceError, InputError, ParameterError
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.stream.system.clock import SessionClock

log = structlog.get_logger(__name__)


@dataclass(slots=True)
class TriggerState:
    """begun: whether a sample has come;  last: the newest stamp;  pulses: how many were given."""

    begun: bool
    last: int
    pulses: int


class TriggerRuntime:
    """What belongs to a running outlet: the clock of a live session, and the ways out that are in use; at the end, the pulses not given."""

    def __init__(self) -> None:
        self.clock: SessionClock | None = None
        self.serial: SerialLine | None = None
        self.osc: OscSender | None = None
        self.lsl: Any = None
        self.lost = 0
        self.zero: int | None = None


@dataclass(frozen=True, slots=True)
class TriggerOutlet(Outlet[TriggerState, TriggerRuntime]):
    """Starts and stops other devices: a pulse when the first sample comes and one when the session ends, or one per event.

    serial_port   the RTS or DTR line of a serial port is up for `pulse_ms`: many systems take it as TTL through an adapter. With
                  `line: byte` a byte is written in its place, and 0 after `pulse_ms`: trigger boxes set their TTL lines by it. `codes` are
                  the bytes at the start (and of each event) and at the end
    lsl           a marker stream of this name: "start", "stop", or "pulse" for an event, at the stamp of the sample
    osc           a UDP receiver HOST:PORT that is sent the message `osc_address` with 1 (start), 0 (stop), or 1 for an event

    Connect it to a stream behind `operators.timing.gate.Gate`, and the pulse at the first sample is that of the gate's opening. It is given
    when the outlet hears of the sample; a serial line or a network promises no time: take the pulse that the other device recorded, and
    this outlet's own in the recording, to align the two (`kinegraph files compare-clocks`). In replay the outlet is silent.
    """

    when: Literal["session", "events"] = param("session", help="a pulse at start and end, or one per event")
    serial_port: str = param("", help="/dev/ttyUSB0, COM3 or a URL of pyserial; empty: off")
    line: Literal["rts", "dtr", "byte"] = param(
        "rts", help="the line that gives the pulse, or a byte for a trigger box"
    )
    codes: tuple[int, int] = param(
        (1, 2), least=1, most=255, help="with `byte`: at the start or per event, and at the end"
    )
    baud: int = param(115200, least=50, help="with `byte`: bits per second of the serial port")
    pulse_ms: float = param(
        10.0, least=1.0, most=1000.0, help="how long the line is up, and at least down before the next"
    )
    lsl: str = param("", help="the marker stream's name; empty: off")
    network: Network = param(ANY, help="how far the marker stream is seen; one for the whole graph")
    osc: str = param("", help="HOST:PORT of the OSC receiver; empty: off")
    osc_address: str = param("/kinegraph/trigger", help="the message's address")

    def open(self, specs: Specs) -> Specs:
        if self.when == "events" and not specs["in"].is_event:
            raise InputError("in", specs["in"].describe(), "events, where `when` is events")
        if not (self.serial_port or self.lsl or self.osc):
            raise ParameterError("serial_port", "", "given, or `lsl`, or `osc`: a pulse needs a way out")
        host, _, port = self.osc.rpartition(":")
        if self.osc and not (host and port.isdigit() and 0 < int(port) < 65536):
            raise ParameterError("osc", self.osc, "HOST:PORT, such as 127.0.0.1:9000")
        if not self.osc_address.startswith("/") or not self.osc_address.isascii():
            raise ParameterError("osc_address", self.osc_address, "an OSC address such as /kinegraph/trigger")
        self.set_state(TriggerState(False, 0, 0), TriggerRuntime())
        return {}

    @property
    def undelivered(self) -> str:
        lost = self.runtime.lost
        return f"{lost} trigger pulses were not given: the serial port {self.serial_port} is gone" if lost else ""

    def keep_time(self, clock: SessionClock) -> None:
        self.runtime.clock = clock

    def begin(self) -> None:
        runtime = self.runtime
        if self.serial_port:
            runtime.serial = SerialLine(self.serial_port, self.line, self.pulse_ms / 1000, self.baud)
        if self.osc:
            host, _, port = self.osc.rpartition(":")
            runtime.osc = OscSender("trigger pulses", host, int(port))
        if self.lsl:
            runtime.lsl = self._marker_stream()

    def process(self, port: str, chunk: Chunk) -> None:
        state = self.state
        if not len(chunk):
            return
        if self.when == "events":
            for stamp in chunk.time.tolist():
                self._give("pulse", 1.0, stamp)
        elif not state.begun:
            self._give("start", 1.0, int(chunk.time[0]))
        state.begun, state.last = True, int(chunk.time[-1])

    def close(self) -> None:
        runtime = self.runtime
        if self.when == "session" and self.state.begun:
            self._give("stop", 0.0, self.state.last)
        if runtime.serial is not None:
            runtime.serial.close()
            runtime.lost = runtime.serial.lost
        if runtime.osc is not None:
            runtime.osc.close()
        if runtime.lsl is not None and runtime.lsl.have_consumers():
            time.sleep(LINGER_S)
        runtime.serial = runtime.osc = runtime.lsl = None

    def _marker_stream(self) -> Any:
        runtime, lsl = self.runtime, library(self.network)
        source_id = f"kinegraph.{socket.gethostname()}.{self.lsl}"
        try:
            outlet = lsl.StreamOutlet(lsl.StreamInfo(self.lsl, "Markers", 1, 0.0, "string", source_id))
        except RuntimeError as error:
            raise DeviceError(f"the LSL outlet {self.lsl!r} cannot be opened: {error}") from None
        runtime.zero = zero_ns(lsl, runtime.clock.now) if runtime.clock else None
        return outlet

    def _give(self, what: str, value: float, stamp: int) -> None:
        runtime = self.runtime
        self.state.pulses += 1
        if runtime.serial is not None:
            runtime.serial.pulse(self.codes[what == "stop"])
        if runtime.osc is not None:
            runtime.osc.send(bundles([floats(self.osc_address, [value])]))
        if runtime.lsl is not None:
            if runtime.zero is None:
                runtime.zero = stamp - round(library(self.network).local_clock() * NS)
            runtime.lsl.push_sample([what], (stamp - runtime.zero) / NS)
        log.info("trigger pulse", what=what)
