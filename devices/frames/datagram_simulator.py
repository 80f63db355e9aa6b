"""A simulated device that sends its packets as UDP datagrams to an address of this computer."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from kinegraph.devices.simulation.device_model import DeviceModel
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server


class UdpLine:
    """A network cable on which each write is a datagram. It hears nothing."""

    def __init__(self, port: int) -> None:
        self.address = f"udp://127.0.0.1:{port}"
        self._to, self._plugged = ("127.0.0.1", port), True
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def read(self, timeout_s: float) -> bytes:
        time.sleep(timeout_s)
        return b""

    def write(self, data: bytes) -> None:
        if data and self._plugged:
            self._socket.sendto(data, self._to)

    def unplug(self) -> None:
        self._plugged = False

    def plug(self) -> None:
        self._plugged = True

    def close(self) -> None:
        self._socket.close()


class DatagramServer(Server):
    """Runs a device that sends each packet as a datagram."""

    def _send(self, packets: list[bytes]) -> None:
        for one in packets:
            self.line.write(one)


@contextmanager
def sending(brain: DeviceModel, faults: FaultInjection = GOOD) -> Iterator[str]:
    """The address at which to listen for what a device sends."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    with DatagramServer(brain, UdpLine(port), faults) as server:
        yield server.address
