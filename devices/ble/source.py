"""A Bluetooth LE device by name: connected, set up, read until the session ends, stopped. What all such drivers share."""

from __future__ import annotations

from contextlib import suppress
from typing import ClassVar, Protocol

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.device_clock import ClockState
from kinegraph.devices.transport.ble_link import BleLink, Notification
from kinegraph.devices.transport.ble_radio import library, missing
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.source import Feed, Source

READ_S = 0.1
DEVICE_HELP = "its address, or how its name begins; left out: the first that advertises the service"
FACTS = {"maker": "2a29", "model": "2a24", "serial": "2a25", "firmware": "2a26"}
BATTERY = "2a19"


class BleReading(Protocol):
    """Notifications to chunks, and what is remembered between two of them."""

    @property
    def clock(self) -> ClockState | None:
        """What is known of the device's clock; None: it has none."""

    def take(self, note: Notification, feed: Feed) -> None:
        """Emit what a notification has brought."""


class BleSource(Source):
    """A driver says which `services` its device advertises, how to `greet` it, and which `BleReading` takes its notifications.

    `rest` is called whatever happens once there is a connection, so that what was switched on goes off again.
    """

    __slots__ = ()
    services: ClassVar[tuple[str, ...]] = ()
    device: str
    scan_s: float

    def greet(self, link: BleLink, feed: Feed) -> BleReading:
        """Bring the device to notify what is wanted; raises DeviceError if it cannot."""
        raise NotImplementedError

    def rest(self, link: BleLink, feed: Feed) -> None:
        """Tell the device to stop. Whether it hears that does not matter."""

    def serve(self, reading: BleReading, feed: Feed) -> None:
        """Whatever has to be done between two notifications."""

    @property
    def may_appear(self) -> bool:
        return True

    def missing(self) -> str:
        return missing(self.device, self.services)

    def prepare(self) -> None:
        library()  # where it is missing, waiting for a device would be in vain
        line_below.prepare()

    def read(self, feed: Feed) -> None:
        with BleLink(feed, self.device, self.services, self.scan_s) as link:
            try:
                self._report_device(link, feed)
                reading = self.greet(link, feed)
                feed.ready()
                with ClockLog(link.name, feed, lambda: reading.clock) as clock_log:
                    while not feed.stopped:
                        for note in link.fetch(READ_S):
                            reading.take(note, feed)
                        self.serve(reading, feed)
                        clock_log.tell()
            finally:
                with suppress(DeviceError):
                    self.rest(link, feed)

    def _report_device(self, link: BleLink, feed: Feed) -> None:
        facts: dict[str, str | float] = {
            key: text for key, c in FACTS.items() if link.offers(c) and (text := link.text(c))
        }
        if link.offers(BATTERY):
            with suppress(DeviceError):
                facts["battery_percent"] = float(link.ask(BATTERY)[0])
        feed.identify(type(self).__name__, name=link.name, mtu=float(link.mtu), **facts)
