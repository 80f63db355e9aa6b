"""Any USB device that sends its measurements as transfers of an endpoint (HID reports, vendor's packets), declared in the graph."""

from __future__ import annotations

from dataclasses import dataclass

from kinegraph.devices.frames.layout import FrameLayout
from kinegraph.devices.frames.packet_decoder import PacketDecoder
from kinegraph.devices.frames.reading import FrameReading
from kinegraph.devices.frames.source import Binary
from kinegraph.devices.transport.serial_source import READ_S
from kinegraph.devices.transport.transport import Transport
from kinegraph.devices.transport.usb_bus import UsbAddress
from kinegraph.devices.transport.usb_pipe import Pipe
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed


@dataclass(frozen=True, slots=True)
class Endpoint(Binary):
    """A USB device with reports that the graph declares, as `devices.frames.Binary` does frames: each transfer is one.

    NAME     (channels,) float64: the data fields of the report of that name, in their units; an output for each report with data
    timing   an event per report: its counter, the device's time, arrival, stamp

    `port` is usb://VENDOR:PRODUCT; `sync` is what a report begins with (its id; left empty, every transfer that is long enough
    is a report), and what is behind the last field is passed over. The
    system's own driver is detached while the source reads. `start` and `stop` are written to the interface's other endpoint. A device that
    sends a stream of bytes over USB, cut into transfers anywhere, is read by `devices.frames.Binary` with the same `port`.
    """

    interface: int | None = param(
        None, least=0, most=255, help="the interface's number; left out: the first with an endpoint to read"
    )
    endpoint: int | None = param(
        None,
        least=0x81,
        most=0x8F,
        help="the endpoint's address (0x81 to 0x8F); left out: the interface's first to read",
    )

    def layouts(self) -> list[FrameLayout]:
        try:
            UsbAddress.parse(self.port)
        except DeviceError as error:
            raise ParameterError("port", self.port, str(error).partition("; write ")[2]) from None
        if self.framing != "none":
            raise ParameterError("framing", self.framing, "none: each transfer is a report")
        return super(Endpoint, self).layouts()

    @property
    def _alone(self) -> bool:
        return True

    def connect(self) -> Transport:
        return Pipe(self.port, self.interface, self.endpoint)

    def greet(self, link: Transport, feed: Feed) -> FrameReading:
        assert isinstance(link, Pipe)
        feed.identify("USB device", **link.identity)
        self._send(link, feed, self._commands()[0])
        return FrameReading(self, PacketDecoder(self.layouts()))

    def fetch(self, link: Transport, heard: float) -> bytes:
        return link.read(READ_S)
