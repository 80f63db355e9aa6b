"""A simulated Qualisys Track Manager on loopback: two markers, a rigid body, a skeleton and an analog device for who asks."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from kinegraph.devices.qualisys import protocol as protocol
from kinegraph.devices.qualisys.protocol import AnalogSamples, QualisysDecoder, QualisysFrame
from kinegraph.devices.transport.closing import ClosesAtExit

if TYPE_CHECKING:
    from kinegraph.devices.qualisys.source import Qualisys


class QualisysServer(ClosesAtExit):
    """One client at a time, which gets everything. Every 20th frame misses the first marker; every `lose`-th frame is lost."""

    def __init__(
        self, markers: tuple[str, ...] = ("knee", "ankle"), bodies: tuple[str, ...] = ("shank",), rate_hz: float = 100.0, lose: int = 0,
        segments: tuple[str, ...] = ("Fred:Hips", "Fred:Spine"), analog: tuple[str, ...] = ("EMG 1", "EMG 2"), analog_hz: float = 1000.0,
        unit: str = "V",
    ) -> None:  # fmt: skip
        self._markers, self._bodies, self._rate, self._lose = markers, bodies, rate_hz, lose
        self._segments, self._analog, self._analog_hz, self._unit = segments, analog, analog_hz, unit
        self._server = socket.create_server(("127.0.0.1", 0))
        self._server.settimeout(0.05)
        self.port = int(self._server.getsockname()[1])
        self.heard: list[str] = []
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._work, name="simulated QTM", daemon=True)
        self._thread.start()

    def frame(self, number: int) -> QualisysFrame:
        """What frame `number` holds."""
        markers = np.array([[number + 0.5, 100.0 * k, 1000.0] for k in range(len(self._markers))], np.float32)
        if number % 20 == 19 and len(markers):
            markers[0] = np.nan
        bodies = np.array(
            [[number, 5.0, 6.0 + k, 1, 0, 0, 0, 1, 0, 0, 0, 1] for k in range(len(self._bodies))], np.float32
        )
        skeletons: dict[str, dict[int, np.ndarray]] = {}
        for k, name in enumerate(self._segments):
            row = np.array([number, 10.0 * k, 900.0, 0, 0, 0, 1], np.float32)
            skeletons.setdefault(name.partition(":")[0], {})[k + 1] = row
        first, last = (round((number + i) * self._analog_hz / self._rate) for i in (0, 1))
        at = np.arange(first, last)
        volts = (at[:, None] % 1000 + 0.25 * np.arange(len(self._analog))).astype(np.float32)
        return QualisysFrame(
            number, 1_000_000 + round(number * 1e6 / self._rate), markers.reshape(-1, 3), bodies.reshape(-1, 12),
            [*skeletons.values()], [AnalogSamples(1, first, volts)] if self._analog else [],
        )  # fmt: skip

    @property
    def parameters(self) -> str:
        labels = "".join(f"<Label><Name>{name}</Name></Label>" for name in self._markers)
        bodies = "".join(f"<Body><Name>{name}</Name></Body>" for name in self._bodies)
        skeletons: dict[str, str] = {}
        for k, name in enumerate(self._segments):
            skeleton, _, segment = name.partition(":")
            skeletons[skeleton] = skeletons.get(skeleton, "") + f'<Segment Name="{segment}" ID="{k + 1}"/>'
        solved = "".join(
            f'<Skeleton Name="{name}"><Segments>{text}</Segments></Skeleton>' for name, text in skeletons.items()
        )
        channels = "".join(
            f"<Channel><Label>{name}</Label><Unit>{self._unit}</Unit></Channel>" for name in self._analog
        )
        device = f"<Device_ID>1</Device_ID><Device_Name>EMG</Device_Name><Frequency>{self._analog_hz:g}</Frequency>"
        more = f"<Skeletons>{solved}</Skeletons><Analog><Device>{device}{channels}</Device></Analog>"
        rate = f"<General><Frequency>{self._rate:g}</Frequency></General>"
        places = f"<The_3D><AxisUpwards>+Z</AxisUpwards>{labels}</The_3D>"
        return f"<QTM_Parameters_Ver_1.25>{rate}{places}<The_6D>{bodies}</The_6D>{more}</QTM_Parameters_Ver_1.25>"

    def _work(self) -> None:
        while not self._stop.is_set():
            with suppress(OSError):
                client, _ = self._server.accept()
                with client:
                    self._serve(client)

    def _serve(self, client: socket.socket) -> None:
        client.settimeout(0.004)
        client.sendall(protocol.command("QTM RT Interface connected"))
        decoder, began, result = QualisysDecoder(), 0.0, 0
        while not self._stop.is_set():
            try:
                data = client.recv(4096)
                if not data:
                    return
            except TimeoutError:
                data = b""
            for _, payload in decoder.feed(data):
                text = protocol.text_of(payload)
                self.heard.append(text)
                if text.lower().startswith("streamframes"):
                    began, result = (0.0 if "stop" in text else time.monotonic()), 0
                else:
                    client.sendall(self.answer(text.lower()))
            due = int((time.monotonic() - began) * self._rate) if began else 0
            for number in range(result, due):
                if not self._lose or number % self._lose:
                    client.sendall(protocol.packet(protocol.DATA, protocol.build_data(self.frame(number))))
            result = max(result, due)

    def answer(self, text: str) -> bytes:
        if text.startswith("version"):
            return protocol.command(f"Version set to {text.split()[-1]}")
        if text.startswith("getparameters"):
            return protocol.packet(protocol.XML, self.parameters.encode() + b"\0")
        return protocol.packet(protocol.ERROR, b"Parse error\0")

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._server.close()


@contextmanager
def simulated(source: Qualisys) -> Iterator[Qualisys]:
    """What `--simulate` puts in its place."""
    with QualisysServer(
        source.markers, source.bodies, source.rate_hz, segments=source.segments,
        analog=tuple(name.rpartition(":")[2] for name in source.analog), analog_hz=source.analog_hz, unit=source.analog_unit,
    ) as server:  # fmt: skip
        yield replace(source, server="127.0.0.1", port=server.port)
