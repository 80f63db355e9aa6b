"""Any USB device that sends its measurements as transfers of an endpoint (HID reports, vendor's packets), declared in the graph."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from devices.binary import Binary
from devices.protocols.declared import FoundFrames, FrameDecoder, FrameLayout
from devices.transport.transport import Transport
from devices.usb.bus import Address
from devices.usb.pipe import Pipe
from stream.errors import DeviceError, ParameterError
from stream.params import param
from stream.source import Feed, Source


@dataclass(frozen=True, slots=True)
class Endpoint(Binary):
    """A USB device whose reports the graph declares, as `devices.binary.Binary` does frames: each transfer is one.

    NAME     (channels,) float64: the data fields of the report of that name, in their units; an output for each report with data
    timing   an event per report: its counter, the device's time, arrival, stamp

    `port` is usb://VENDOR:PRODUCT; `sync` is what a report begins with (its id), and what is behind the last field is passed over. The
    system's own driver is detached while the source reads. `start` and `stop` are written to the interface's other endpoint. A device that
    sends a stream of bytes over USB, cut into transfers anywhere, is read by `devices.binary.Binary` with the same `port`.
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
            Address.parse(self.port)
        except DeviceError as error:
            raise ParameterError("port", self.port, str(error).partition("; write ")[2]) from None
        return super(Endpoint, self).layouts()

    @contextmanager
    def simulated(self) -> Iterator[Source]:
        from devices.simulators.usb_reports import serving

        with serving(self) as address:
            yield replace(self, port=address)

    def _connect(self) -> Transport:
        return Pipe(self.port, self.interface, self.endpoint)

    def _identify(self, link: Transport, feed: Feed) -> None:
        assert isinstance(link, Pipe)
        feed.identify("USB device", **link.identity)

    def _decoder(self, layouts: list[FrameLayout]) -> FrameDecoder:
        return Transfers(layouts)

    def _taken(self, link: Transport, timeout_s: float) -> bytes:
        return link.read(timeout_s)


class Transfers(FrameDecoder):
    """Transfers to reports: each is a report as a whole, or nothing."""

    def feed(self, data: bytes) -> FoundFrames:
        """`data`: one transfer."""
        found = FoundFrames()
        if not data:
            return found
        for kind in self._order:
            layout = self._layouts[kind]
            report = data[: layout.size]
            if len(report) == layout.size and report.startswith(layout.sync) and report.endswith(layout.footer):
                if layout.sound(report):
                    found.kinds.append(kind)
                    found.frames[kind] = bytearray(report)
                else:
                    found.bad += 1
                return found
        found.dropped += len(data)
        return found
