"""A simulated Delsys Trigno: a server with a command port and four data ports, and sixteen sensors on a walker's leg."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from kinegraph.devices.people.treadmill.signal import BURSTS, Signal, Walker
from kinegraph.devices.people.walking_limb import GRAVITY, Limb
from kinegraph.devices.simulation.cable import TcpLine
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection
from kinegraph.devices.simulation.serve import Server, Simulator
from kinegraph.devices.trigno import protocol as protocol
from kinegraph.devices.trigno.protocol import AUX_HZ, FRAME_S, SENSORS, Layout
from kinegraph.stream.chunk import Samples, Times
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.trigno.source import Trigno

EMG_HZ = 2000.0
EMG_FRAME, AUX_FRAME = 27, 2
"""Samples in 13.5 ms."""
MAX_BEHIND = 740
"""Frames (10 s) that are sent at once at most."""
MAX_WAITING = 1 << 22
"""Bytes that wait for a slow reader; then it is cut off."""
TRIES = 20


@dataclass(frozen=True, slots=True)
class SimulatedTrigno(Simulator):
    """A Trigno base station with sixteen sensors on a walking person."""

    paired: int = param(SENSORS, least=0, most=SENSORS, help="how many sensors are paired, from the first on")
    duos: int = param(0, least=0, most=8, help="how many sensors, from the first on, are Duos: two EMG channels each")
    seed: int = param(0, least=0, help="another seed, another walk")

    @property
    def cannot(self) -> dict[str, str]:
        return {"reset_every_s": "its samples have no counter"}

    def brain(self) -> TrignoModel:
        return TrignoModel(self.paired, self.seed, self.duos)

    @contextmanager
    def serving(self, faults: FaultInjection = GOOD, address: str = "") -> Iterator[str]:
        with Station(self.brain(), StationLine(address or "tcp://127.0.0.1:0"), faults) as station:
            yield station.address


class TrignoModel:
    """The base station without its sockets. `emg` and `aux` give sample i since START of all sensors."""

    def __init__(self, paired: int = SENSORS, seed: int = 0, duos: int = 0) -> None:
        self._paired, self._duos = paired, duos
        muscles = tuple(list(BURSTS) + list(BURSTS)[: SENSORS - len(BURSTS)])
        self._signal = Signal(Walker(muscles, rate_hz=EMG_HZ, seed=seed))
        self._limb = Limb("shank", AUX_HZ, seed=seed)
        self._heard = b""
        self.running = False
        self._began: float | None = None
        self._said = 0

    def receive(self, data: bytes) -> bytes:
        commands, self._heard = protocol.answers(self._heard + data)
        return b"".join(protocol.command(self._obey(one.upper())) for one in commands)

    def say(self, seconds: float) -> list[bytes]:
        if not self.running:
            return []
        if self._began is None:
            self._began = seconds
        due = int((seconds - self._began) / FRAME_S)
        first, self._said = max(self._said, due - MAX_BEHIND), max(self._said, due)
        return self.frames(first, self._said)

    def restart(self) -> None: ...

    def frames(self, first: int, last: int) -> list[bytes]:
        """What is sent every 13.5 ms: EMG, auxiliary channels as of old, and as of today; made at once, however many are due."""
        if first >= last:
            return []
        emg = self.emg(np.arange(first * EMG_FRAME, last * EMG_FRAME))
        aux = self.aux(np.arange(first * AUX_FRAME, last * AUX_FRAME), "current")
        legacy = aux.reshape(len(aux), SENSORS, 9)[:, :, :3].reshape(len(aux), SENSORS * 3)
        sent: list[bytes] = []
        for i in range(last - first):
            now = slice(i * AUX_FRAME, (i + 1) * AUX_FRAME)
            sent += [protocol.rows(emg[i * EMG_FRAME : (i + 1) * EMG_FRAME])]
            sent += [protocol.rows(legacy[now]), protocol.rows(aux[now])]
        return sent

    def emg(self, index: Times) -> Samples:
        """V (n, 16) at consecutive samples."""
        return np.asarray(self._signal.read(int(index[0]), int(index[-1]) + 1)[0] * 1e-6)

    def aux(self, index: Times, layout: Layout) -> Samples:
        """(n, 48) or (n, 144) at consecutive samples: all sensors sit on the shank, sensor k turned by k degrees."""
        measured = self._limb.measure(index)
        kinds = [
            measured["acceleration"] / GRAVITY,
            np.degrees(measured["angular_velocity"]),
            measured["magnetic_field"],
        ]
        parts = []
        for sensor in range(SENSORS):
            c, s = np.cos(np.radians(sensor)), np.sin(np.radians(sensor))
            turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
            parts += [kind @ turn for kind in kinds[: 1 if layout == "legacy" else 3]]
        return np.hstack(parts)

    def _obey(self, command: str) -> str:
        """One command; returns the answer."""
        words = command.split()
        match words:
            case ["START"]:
                self.running, self._began, self._said = True, None, 0
            case ["STOP"]:
                self.running = False
            case ["SENSOR", number, "CHANNEL", _, "RATE?"] if number.isdigit():
                return f"{EMG_HZ:g}"
            case ["SENSOR", number, what] if number.isdigit() and 1 <= int(number) <= SENSORS:
                return self._answer(int(number), what)
            case ["ENDIAN", "LITTLE"] | ["TRIGGER", _, _] | ["UPSAMPLE", _] | ["BACKWARDS", "COMPATIBILITY", _]:
                pass
            case _:
                return "INVALID COMMAND"
        return "OK"

    def _answer(self, sensor: int, what: str) -> str:
        known = {
            "PAIRED?": "YES" if sensor <= self._paired else "NO",
            "SERIAL?": f"SP-W02A-{1000 + sensor}",
            "FIRMWARE?": "3.6.0",
            "STARTINDEX?": str(sensor + min(self._duos, sensor - 1)),
            "EMGCHANNELCOUNT?": "2" if sensor <= self._duos else "1",
            "AUXCHANNELCOUNT?": "3",
        }
        return known.get(what, "INVALID COMMAND")


class DataLine(TcpLine):
    """A data port: nothing that was sent is lost, as by TCP; a reader who stays away for long is cut off."""

    _waiting = b""

    def write(self, data: bytes) -> None:
        if self._client is None:
            return
        self._waiting += data
        try:
            sent = self._client.send(self._waiting)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._hang_up()
            return
        self._waiting = self._waiting[sent:]
        if len(self._waiting) > MAX_WAITING:
            self._hang_up()

    def _hang_up(self) -> None:
        self._waiting = b""
        super()._hang_up()


class StationLine(TcpLine):
    """The command port, with a greeting for whoever connects, and the four data ports behind it."""

    def __init__(self, address: str) -> None:
        host, _, port = address.removeprefix("tcp://").rpartition(":")
        if not address.startswith("tcp://") or not host or not port.isdigit():
            raise DeviceError(f"{address!r} is not an address to serve; write tcp://host:port")
        self.data: list[DataLine] = []
        super().__init__(host.strip("[]"), int(port) or _free(host.strip("[]")))
        self.data = [DataLine(self._host, self._port + i) for i in (1, 2, 3, 4)]

    def plug(self) -> None:
        super().plug()
        for line in self.data:
            line.plug()

    def unplug(self) -> None:
        super().unplug()
        for line in self.data:
            line.unplug()

    def read(self, timeout_s: float) -> bytes:
        for line in self.data:  # before commands: who says START has connected
            line.read(0)
            line.write(b"")
        heard = super().read(timeout_s)
        for line in self.data if heard else ():
            line.read(0)
        return heard

    def _accept(self) -> None:
        before = self._client
        super()._accept()
        if self._client is not None and self._client is not before:
            self.write(protocol.command(protocol.BANNER.decode() + " 3.6.0"))


class Station(Server):
    """The base station at work: frames go out by the ports that they belong to, which their length tells."""

    def _send(self, packets: list[bytes]) -> None:
        assert isinstance(self.line, StationLine)
        legacy_emg, legacy_aux, emg, aux = self.line.data
        for packet in packets:
            match len(packet):
                case size if size == 4 * EMG_FRAME * SENSORS:
                    legacy_emg.write(packet)
                    emg.write(packet)
                case size if size == 4 * AUX_FRAME * SENSORS * 3:
                    legacy_aux.write(packet)
                case size if size == 4 * AUX_FRAME * SENSORS * 9:
                    aux.write(packet)
                case _:
                    legacy_emg.write(packet)  # what is left when the cable is pulled out
                    emg.write(packet)


def _free(host: str) -> int:
    """A port behind which four more are free."""
    for _ in range(TRIES):
        with socket.create_server((host, 0)) as probe:
            port = int(probe.getsockname()[1])
        with suppress(OSError, OverflowError):
            for i in range(1, 5):
                socket.create_server((host, port + i)).close()
            return port
    raise DeviceError("no five ports in a row are free")


@contextmanager
def simulated(source: Trigno) -> Iterator[Trigno]:
    """What `--simulate` puts in its place."""
    with SimulatedTrigno().serving() as address:
        yield replace(source, port=address, emg_hz=2000.0)
