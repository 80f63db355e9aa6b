"""A pulse on a control line of a serial port."""

from __future__ import annotations

import threading
from queue import SimpleQueue
from typing import Any, Literal

import structlog

from stream.errors import DeviceError

log = structlog.get_logger(__name__)


class SerialLine:
    """The RTS or DTR line of a serial port, at rest when idle; pulses are given by a thread of its own, one after another.

    port   "/dev/ttyUSB0", "COM3", or a URL of pyserial
    """

    def __init__(self, port: str, line: Literal["rts", "dtr"], pulse_s: float) -> None:
        """Raises DeviceError saying what to look at."""
        import serial

        self._where, self._line, self._pulse_s, self._wanted = port, line, pulse_s, SimpleQueue[bool]()
        try:
            self._port: Any = serial.serial_for_url(port, do_not_open=True)
            self._port.rts = self._port.dtr = False
            self._port.open()
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceError(f"serial port {port} cannot be opened for trigger pulses: {error}") from None
        self._thread = threading.Thread(target=self._work, name=f"trigger {port}", daemon=True)
        self._thread.start()

    def pulse(self) -> None:
        self._wanted.put(True)

    def close(self) -> None:
        """Pulses that were asked for are given first."""
        self._wanted.put(False)
        self._thread.join()

    def _work(self) -> None:
        rest = threading.Event()
        try:
            while self._wanted.get():
                self._set(True)
                rest.wait(self._pulse_s)
                self._set(False)
                rest.wait(self._pulse_s)
        except (OSError, ValueError) as error:
            log.warning("no more trigger pulses: the serial port is gone", port=self._where, error=str(error))
        finally:
            self._port.close()

    def _set(self, up: bool) -> None:
        setattr(self._port, self._line, up)
