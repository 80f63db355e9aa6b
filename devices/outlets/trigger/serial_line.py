"""A pulse on a control line of a serial port, or as a byte that a trigger box turns into one."""

from __future__ import annotations

import threading
from queue import SimpleQueue
from typing import Any, Literal

import structlog

from kinegraph.stream.errors import DeviceError

log = structlog.get_logger(__name__)


class SerialLine:
    """The RTS or DTR line of a serial port, at rest when idle, or bytes written to it, 0 at rest; pulses are given by a thread of its own,
    one after another.

    port   "/dev/ttyUSB0", "COM3", or a URL of pyserial;  baud: of bytes
    """

    def __init__(self, port: str, line: Literal["rts", "dtr", "byte"], pulse_s: float, baud: int = 115200) -> None:
        """Raises DeviceError saying what to look at."""
        import serial

        self._where, self._line, self._pulse_s, self._wanted = port, line, pulse_s, SimpleQueue[int]()
        try:
            self._port: Any = serial.serial_for_url(port, do_not_open=True)
            self._port.baudrate, self._port.rts, self._port.dtr = baud, False, False
            self._port.open()
        except (serial.SerialException, OSError, ValueError) as error:
            raise DeviceError(f"serial port {port} cannot be opened for trigger pulses: {error}") from None
        self._asked = self._given = 0
        self._thread = threading.Thread(target=self._work, name=f"trigger {port}", daemon=True)
        self._thread.start()

    def pulse(self, code: int = 1) -> None:
        """Give a pulse; `code`, from 1 to 255, is the byte."""
        self._asked += 1
        self._wanted.put(code)

    @property
    def lost(self) -> int:
        """How many pulses were not given; to be asked after `close`."""
        return self._asked - self._given

    def close(self) -> None:
        """Pulses that were asked for are given first."""
        self._wanted.put(0)
        self._thread.join()

    def _work(self) -> None:
        rest = threading.Event()
        try:
            while code := self._wanted.get():
                self._set(code)
                rest.wait(self._pulse_s)
                self._set(0)
                self._given += 1
                rest.wait(self._pulse_s)
        except (OSError, ValueError) as error:
            log.warning("no more trigger pulses: the serial port is gone", port=self._where, error=str(error))
        finally:
            self._port.close()

    def _set(self, code: int) -> None:
        if self._line == "byte":
            self._port.write(bytes([code]))
        else:
            setattr(self._port, self._line, bool(code))
