"""How bytes come and go: a serial port (pyserial), a TCP connection (a plain socket) or USB (pyusb), behind one small interface.

Reading waits until something is there and then takes all of it: 0.07 ms from the wire to the caller over a pseudo-terminal, where a
fixed-size read with a time-out takes 10 ms.
"""

from __future__ import annotations

import os
import select
import socket
import time
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol, Self

from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.stream.errors import DeviceError, nearest

MAX = 65536
"""Bytes taken in one read."""
PROBE_S = 1.5
"""So long a server may take to accept a connection, before a session."""
GOODBYE_S = 0.2
"""So long the other end of a TCP connection may take to close it too."""


class Transport(Protocol):
    """An open connection to a device."""

    def read(self, timeout_s: float) -> bytes:
        """What has come, or b"" if nothing comes in time. Raises DeviceError when the connection is gone."""

    def write(self, data: bytes) -> None:
        """Send all of it; raises DeviceError."""

    def close(self) -> None:
        """Let go of it; never raises."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *_: object) -> None: ...


def connect(address: str, baud: int = 115200) -> Transport:
    """Open "/dev/ttyUSB0", "COM3", "tcp://host:port", "udp://host:port", "usb://VENDOR:PRODUCT", "ble://DEVICE/NOTIFY" or
    "zmq+tcp://host:port".

    Raises DeviceError saying what to look at.
    """
    if address.startswith("tcp://"):
        return TcpTransport(address)
    if address.startswith("udp://"):
        from kinegraph.devices.transport.datagrams import UdpTransport

        return UdpTransport(address)
    if address.startswith("ble://"):
        from kinegraph.devices.transport.bluetooth import BleTransport

        return BleTransport(address)
    if address.startswith("zmq+"):
        from kinegraph.devices.transport.zeromq import ZeroMqTransport

        return ZeroMqTransport(address)
    if address.startswith("usb://"):
        from kinegraph.devices.transport.usb_pipe import Pipe

        return Pipe(address)
    return SerialTransport(address, baud)


def present(address: str) -> bool | None:
    """Whether a serial port is there; None for what has no path: an address, or a port of Windows."""
    return Path(address).exists() if address.startswith("/") else None


def missing(address: str) -> str:
    """What to report of a serial port or a USB device that is not there, with the nearest that is; "" where only opening it can show.

    A server in the network is not asked: some serial bridges take one connection, and the next only after a while.
    """
    if address.startswith("usb://"):
        from kinegraph.devices.transport.usb_bus import UsbAddress, find

        try:
            find(UsbAddress.parse(address))
        except DeviceError as error:
            return str(error)
        return ""
    if address.startswith("udp://"):
        return unreachable(address)
    if address.startswith("ble://"):
        from kinegraph.devices.transport.ble_radio import missing as missing_peripheral

        return missing_peripheral(address.removeprefix("ble://").partition("/")[0])
    if present(address) is not False:
        return ""
    there = [port.device for port in connected_ports()]
    hint = nearest(address, there) if there else "there is no serial port at all"
    return f"serial port {address} does not exist; {hint}"


def unreachable(address: str) -> str:
    """Why "tcp://host:port" cannot be connected to, or "udp://host:port" cannot be listened at; "" where it can. Closed again at once."""
    try:
        with TcpTransport(address, PROBE_S) if address.startswith("tcp://") else connect(address):
            return ""
    except DeviceError as error:
        return str(error)


def connected_ports() -> list[Any]:
    """Every serial port (pyserial's ListPortInfo) that is a real one or says what it is."""
    from serial.tools.list_ports import comports

    return [
        port
        for port in sorted(comports())
        if port.device.startswith("/dev/rfcomm")
        or port.vid is not None
        or port.description not in (None, "", "n/a", port.name)
    ]


class SerialTransport(ClosesAtExit):
    """A serial port, for this process alone. Where the driver can, FTDI's 16 ms latency timer is set to 1 ms."""

    def __init__(self, port: str, baud: int) -> None:
        import serial

        self.address = port
        try:
            self._port = serial.Serial(port, baud, timeout=0, exclusive=True)
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceError(f"serial port {port} cannot be opened: {_hint(error)}") from None
        # FTDI chips hold bytes back for 16 ms by default, which would be the jitter of every packet; other drivers refuse
        with suppress(OSError, ValueError, AttributeError, NotImplementedError):
            self._port.set_low_latency_mode(True)
        self._by_descriptor = _has_descriptor(self._port)

    def read(self, timeout_s: float) -> bytes:
        if not self._by_descriptor:
            return self._read_by_pyserial(timeout_s)
        try:
            port = self._port.fileno()
            if not select.select([port], [], [], timeout_s)[0]:
                return b""
            # by the descriptor: pyserial's read waits for all bytes asked for, or calls the system twice
            data = os.read(port, MAX)
        except (OSError, ValueError, TypeError) as error:
            raise DeviceError(
                f"serial port {self.address} is gone: the cable was pulled, or the device restarted ({error})"
            ) from None
        if not data:
            raise DeviceError(f"serial port {self.address} is gone: the cable was pulled, or the device restarted")
        return data

    def _read_by_pyserial(self, timeout_s: float) -> bytes:
        """Where a port has no file descriptor (Windows): wait for a byte as pyserial does, then take all that is there."""
        try:
            if self._port.timeout != timeout_s:
                self._port.timeout = timeout_s
            first: bytes = self._port.read(1)
            return first + self._port.read(self._port.in_waiting) if first else b""
        except (OSError, ValueError, TypeError) as error:
            raise DeviceError(
                f"serial port {self.address} is gone: the cable was pulled, or the device restarted ({error})"
            ) from None

    def write(self, data: bytes) -> None:
        try:
            self._port.write(data)
            self._port.flush()
        except (OSError, ValueError) as error:
            raise DeviceError(f"serial port {self.address} cannot be written: {error}") from None

    def close(self) -> None:
        with suppress(OSError, ValueError):
            self._port.close()


class TcpTransport(ClosesAtExit):
    """A TCP connection, "tcp://host:port"."""

    def __init__(self, address: str, timeout_s: float = 3.0) -> None:
        self.address = address
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        if not host or not port.isdigit():
            raise DeviceError(f"{address!r} is not a TCP address; write tcp://host:port")
        try:
            self._socket = socket.create_connection((host.strip("[]"), int(port)), timeout_s)
        except OSError as error:
            raise DeviceError(
                f"{address} cannot be reached: {error.strerror or error}; is the device's server running?"
            ) from None
        # commands are few bytes; Nagle's algorithm would hold them back until the device answers
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def read(self, timeout_s: float) -> bytes:
        try:
            if not select.select([self._socket], [], [], timeout_s)[0]:
                return b""
            data = self._socket.recv(MAX)
        except (OSError, ValueError) as error:
            raise DeviceError(f"{self.address} is gone: {error}") from None
        if not data:
            raise DeviceError(f"{self.address} has closed the connection")
        return data

    def write(self, data: bytes) -> None:
        try:
            self._socket.sendall(data)
        except OSError as error:
            raise DeviceError(f"{self.address} cannot be written: {error}") from None

    def close(self) -> None:
        """What was written last is not taken back: closing a connection with unread bytes would reset it."""
        with suppress(OSError, ValueError):
            self._socket.shutdown(socket.SHUT_WR)
            deadline = time.monotonic() + GOODBYE_S
            while (left := deadline - time.monotonic()) > 0 and select.select([self._socket], [], [], left)[0]:
                if not self._socket.recv(MAX):
                    break
        with suppress(OSError):
            self._socket.close()


def _has_descriptor(port: object) -> bool:
    """Whether the system can wait for a port by its number."""
    try:
        return isinstance(port.fileno(), int)  # type: ignore[attr-defined]
    except (AttributeError, OSError, ValueError):
        return False


def _hint(error: Exception) -> str:
    """The error, with what a person can do about it."""
    text = str(error)
    number = getattr(error, "errno", None)
    if number == 13 or "Permission" in text:
        return "permission denied; add yourself to the group that owns it (on Debian: sudo usermod -aG dialout $USER, then log in again)"
    if number in (11, 16) or "exclusively lock" in text:
        return "another program has it open; close that one first"
    if number == 2 or "No such file" in text:
        return "it does not exist; is the device plugged in? `kinegraph devices` lists what is there"
    return text
