"""A simulated device at the end of its cable, at work in a thread: it listens, speaks as time passes, and with injected faults."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import ClassVar, TypeVar

from kinegraph.devices.simulation.cable import Line, line_at
from kinegraph.devices.simulation.device_model import Clocked, DeviceModel
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection, FaultInjector
from kinegraph.devices.simulation.shared_walk import WALK
from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.source import Source

S = TypeVar("S", bound=Source)

TICK_S = 0.002
"""How finely time passes for a simulated device."""


class Server(ClosesAtExit):
    """Runs a brain on a line until closed."""

    def __init__(self, brain: DeviceModel, line: Line, faults: FaultInjection = GOOD) -> None:
        self.brain, self.line, self.injector = brain, line, FaultInjector(faults)
        self._stop = threading.Event()
        self._cut = threading.Event()
        self._cut_by = 0.0
        self._out = False
        self._resets = 0
        self._kept: list[bytes] = []
        self._thread = threading.Thread(target=self._work, name=f"simulator {line.address}", daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """What the host opens."""
        return self.line.address

    def unplug(self) -> None:
        """Pull the cable out in the middle of the next packet (or 0.2 s from now), and return when it is out."""
        self._cut_by = time.monotonic() + 0.2
        self._cut.set()
        while self._cut.is_set() and self._thread.is_alive():
            time.sleep(TICK_S / 4)

    def plug(self) -> None:
        """Put the cable in again after `unplug`."""
        self.line.plug()
        self._out = False

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self.line.close()

    def _work(self) -> None:
        began = time.monotonic()
        while not self._stop.is_set():
            if self._out:
                time.sleep(TICK_S)
            elif heard := self.line.read(TICK_S):
                self.line.write(self.brain.receive(heard))
            self._pass(time.monotonic() - began)

    def _pass(self, seconds: float) -> None:
        """What the device does by itself until this second."""
        if self.injector.resets(seconds) > self._resets:
            self._resets += 1
            self.brain.restart()
        if isinstance(self.brain, Clocked):
            self.brain.ahead_s = self.injector.jumped_s(seconds)
        packets = self.injector.spoil(self.brain.say(seconds), seconds)
        if self._out:
            self._kept = []
            self._cut.clear()  # pulled out once more: it is out
        elif self._cut.is_set() and (packets or time.monotonic() > self._cut_by):
            self._pull_out(packets)
            self._out = True
            self._cut.clear()
        elif self.injector.unplugged(seconds):
            self._pull_out(packets)
        elif self.injector.stalled(seconds):
            self._kept += packets
        else:
            self.line.plug()
            self._send([*self._kept, *packets])
            self._kept = []

    def _send(self, packets: list[bytes]) -> None:
        self.line.write(b"".join(packets))

    def _pull_out(self, packets: list[bytes]) -> None:
        """The last thing to pass is half a packet."""
        if packets:
            self._send([*packets[:-1], packets[-1][: len(packets[-1]) // 2]])
        self.line.unplug()
        self._kept = []


class Simulator:
    """A kind of simulated device. Subclasses are frozen dataclasses of parameters, in a file of `devices.simulators`, and give a `brain`.

    What is not served on a pseudo-terminal or by TCP replaces `serving`.
    """

    __slots__ = ()
    port_name: ClassVar[str] = "ttySIM"
    """The end of the pseudo-terminal's address."""

    @property
    def cannot(self) -> dict[str, str]:
        """By misbehaviour that means nothing to this device: why."""
        return {}

    def check(self, faults: FaultInjection) -> None:
        """Raise ParameterError for a misbehaviour that this device cannot show."""
        for name, why in self.cannot.items():
            if value := getattr(faults, name):
                raise ParameterError(name, int(value) if value == int(value) else value, f"0, as {why}")
        if faults.jump_every_s and not isinstance(self.brain(), Clocked):
            raise ParameterError("jump_every_s", faults.jump_every_s, "0, as its packets bring no time")

    def brain(self) -> DeviceModel:
        """The device, just switched on."""
        raise NotImplementedError

    @contextmanager
    def serving(self, faults: FaultInjection = GOOD, address: str = "") -> Iterator[str]:
        """While the context lasts, the device can be reached; gives what the host opens.

        `address`: where to serve, "tcp://host:port" (port 0: any); left out: a pseudo-terminal.
        """
        with Server(self.brain(), line_at(address, self.port_name), faults) as server:
            yield server.address


@contextmanager
def in_place(source: S, device: Simulator) -> Iterator[S]:
    """The source as it reads a simulated device, which is there for as long as the context lasts."""
    with WALK.watched(), Server(device.brain(), line_at(name=device.port_name, patient=True)) as server:
        yield replace(source, port=server.address)  # type: ignore[type-var]
