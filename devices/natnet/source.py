"""OptiTrack Motive, live by NatNet: rigid bodies, bones, labelled markers, analog channels; multicast and unicast."""

from __future__ import annotations

import socket
import struct
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from kinegraph.devices.clocks import line_below
from kinegraph.devices.clocks.clock_log import ClockLog
from kinegraph.devices.clocks.rate_check import POLICY_HELP, Policy, RateCheck
from kinegraph.devices.clocks.stamps import Stamps
from kinegraph.devices.clocks.timing import timing_of_one, timing_spec
from kinegraph.devices.natnet import numbers as natnet_numbers
from kinegraph.devices.natnet import protocol as protocol
from kinegraph.devices.natnet.names import NatNetNames
from kinegraph.devices.natnet.numbers import HEAD
from kinegraph.devices.natnet.protocol import COMMAND_PORT, NatNetError, ServerInfo
from kinegraph.stream.chunk import NS, Chunk, Specs, StreamSpec
from kinegraph.stream.domain.axes import Axes
from kinegraph.stream.errors import DeviceError, ParameterError
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source, outputs_by_parameters

ANSWER_S, ASK_S = 3.0, 0.5
KEEP_ALIVE_S = 1.0
SILENT_S = 3.0
READ_S = 0.1
MAX = 65536
LATEST_NS = 1 << 62
"""A server's time beyond is garbled; such are left out before they are counted with."""


@dataclass(frozen=True, slots=True)
class NatNet(Source):
    """OptiTrack Motive (or another NatNet server, versions 3.0 to 4.2) in the local network.

    bodies      (b, 3) float64 at `rate_hz`: positions of the named rigid bodies and bones in m; NaN: not tracked
    rotations   (b, 4) float64: theirs, as quaternions w, x, y, z
    markers     (m, 3) float64: labelled markers in m; NaN: occluded
    analog      (c,) float64 at `rate_hz` times `analog_samples`: channels of force plates and devices, in the unit of Motive's calibration
    timing      an event per frame: its number, the server's time (middle of the exposure), arrival, stamp

    Bodies are named as in Motive, bones as "Skeleton:Bone", markers as "Body:1" (or "Body:Name" from NatNet 4.0), analog channels as
    "plate 1:Fx" or "device 2:1". The server's axes are kept; `up` declares which of them points up. Stamps follow the server's clock,
    and missing frames are known from their number. Where the server says so it is heard by multicast, else by unicast.
    """

    server: str = param("127.0.0.1", help="the computer on which Motive runs")
    bodies: tuple[str, ...] = param((), help="rigid bodies and bones, as Motive names them")
    markers: tuple[str, ...] = param((), help="labelled markers: Body:1, Body:2, ...")
    analog: tuple[str, ...] = param((), help='analog channels: "plate 1:Fx", "device 2:1"')
    analog_samples: int = param(1, least=1, most=1000, help="how many samples of them a frame holds")
    rate_hz: float = param(120.0, above=0, most=2000, help="frames per second, as set in Motive")
    up: Literal["y", "z"] = param("y", help="the axis that points up, as set in Motive (Streaming, Up Axis)")
    local: str = param("0.0.0.0", help="the address of this computer's network card that listens; 0.0.0.0: any")
    port: int = param(COMMAND_PORT, least=1, most=65535, help="the server's command port")
    rate_mismatch: Policy = param("fail", help=POLICY_HELP)
    latency_s: float = param(
        0.0, least=0, most=1, help="the constant delay from the exposure to the arrival, if you know it"
    )

    @outputs_by_parameters("bodies", "rotations", "timing")
    def outputs(self) -> tuple[str, ...]:
        return (
            *(("bodies", "rotations") if self.bodies else ()),
            *(("markers",) if self.markers else ()),
            *(("analog",) if self.analog else ()),
            "timing",
        )

    @property
    def chunk_s(self) -> float:
        return 1 / self.rate_hz

    def specs(self) -> Specs:
        for name in ("bodies", "markers", "analog"):
            given = getattr(self, name)
            if len(set(given)) != len(given):
                raise ParameterError(name, list(given), "different names")
        if not (self.bodies or self.markers or self.analog):
            raise ParameterError(
                "bodies", [], "at least one of bodies, markers, analog; `kinegraph devices natnet` lists what there is"
            )
        for name in (*self.markers, *self.analog):
            if ":" not in name:
                raise ParameterError("markers" if name in self.markers else "analog", name, "Body:1, or plate 1:Fx")
        specs: Specs = {"timing": timing_spec()}
        device = {"device": "NatNet"}
        meta = {**device, "axes": Axes(self.up).facts()}
        if self.bodies:
            specs["bodies"] = StreamSpec(
                (len(self.bodies), 3), rate_hz=self.rate_hz, channels=self.bodies, units=("m",), meta=meta
            )
            specs["rotations"] = StreamSpec(
                (len(self.bodies), 4), rate_hz=self.rate_hz, channels=self.bodies, meta={**meta, "rotation": "wxyz"}
            )
        if self.markers:
            specs["markers"] = StreamSpec(
                (len(self.markers), 3), rate_hz=self.rate_hz, channels=self.markers, units=("m",), meta=meta
            )
        if self.analog:
            rate = self.rate_hz * self.analog_samples
            specs["analog"] = StreamSpec((len(self.analog),), rate_hz=rate, channels=self.analog, meta=device)
        return specs

    def missing(self) -> str:
        from kinegraph.devices.natnet.discovery import missing

        return missing(self.server, self.port)

    def prepare(self) -> None:
        line_below.prepare()
        natnet_numbers.prepare()

    def read(self, feed: Feed) -> None:
        with ExitStack() as stack:
            link = NatNetLink(self.server, self.port, self.local)
            stack.callback(link.close)
            info = link.connect(feed)
            feed.identify(
                "NatNet server", application=info.application, version=".".join(map(str, info.version)),
                natnet=".".join(map(str, info.natnet)), server=self.server,
            )  # fmt: skip
            reading = NatNetReading(self, info, link)
            feed.ready()
            with ClockLog(f"NatNet {self.server}", feed, lambda: reading.stamps.state) as clock_log:
                while not feed.stopped:
                    for kind, payload, arrival in link.fetch(feed):
                        reading.take(kind, payload, arrival, feed)
                    link.keep_alive()
                    clock_log.tell()


class NatNetLink:
    """The sockets of a connection. What is no message of NatNet is counted, never more."""

    def __init__(self, server: str, port: int, local: str = "0.0.0.0") -> None:
        self._at, self._local = (server, port), local
        self._command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._data: socket.socket | None = None
        try:
            self._command.bind((local, 0))
        except OSError as error:
            self._command.close()
            raise DeviceError(f"{local} is not an address of this computer: {error.strerror}") from None
        self._sent = 0.0
        self.heard = time.monotonic()

    def send(self, kind: int, payload: bytes = b"") -> None:
        with suppress(OSError):
            self._command.sendto(protocol.message(kind, payload), self._at)

    def connect(self, feed: Feed) -> ServerInfo:
        """Ask until the server answers; raises DeviceError."""
        deadline, asked = time.monotonic() + ANSWER_S, 0.0
        while time.monotonic() < deadline and not feed.stopped:
            if time.monotonic() - asked > ASK_S:
                with suppress(OSError):
                    self._command.sendto(protocol.connect(), self._at)
                asked = time.monotonic()
            for kind, payload, _ in self.fetch(feed):
                if kind == protocol.SERVER_INFO:
                    return self._listen(protocol.server_info(payload))
        raise DeviceError(
            f"no NatNet server answers at {self._at[0]}:{self._at[1]}; does Motive stream (Settings, Streaming, Enable), on that network "
            "card, and does no firewall block it?"
        )

    def _listen(self, info: ServerInfo) -> ServerInfo:
        if not info.natnet >= protocol.OLDEST:
            raise DeviceError(
                f"{self._at[0]} speaks NatNet {info.natnet[0]}.{info.natnet[1]}; 3.0 or newer is needed (Motive 2.0)"
            )
        if info.multicast is not False:
            self._data = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            self._data.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                self._data.bind(("", info.data_port))
                group = socket.inet_aton(info.group) + socket.inet_aton(self._local)
                self._data.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
            except OSError as error:
                raise DeviceError(
                    f"multicast of {info.group}:{info.data_port} cannot be heard: {error.strerror}"
                ) from None
        return info

    def keep_alive(self) -> None:
        """A unicast server forgets who says nothing; one that has restarted is asked again."""
        now = time.monotonic()
        if now - self._sent > KEEP_ALIVE_S:
            self._sent = now
            if now - self.heard > SILENT_S:
                with suppress(OSError):
                    self._command.sendto(protocol.connect(), self._at)
            elif self._data is None:
                self.send(protocol.KEEP_ALIVE)

    def fetch(self, feed: Feed) -> list[tuple[int, bytes, int]]:
        """What has come: kind, payload, arrival."""
        import select

        ports = [p for p in (self._command, self._data) if p is not None]
        found: list[tuple[int, bytes, int]] = []
        for port in select.select(ports, [], [], READ_S)[0]:
            try:
                kind, payload = protocol.opened(port.recv(MAX))
            except NatNetError:
                feed.problem("no NatNet message")
                continue
            except OSError:
                continue  # an earlier message found no receiver
            found.append((kind, payload, feed.now()))
            if kind == protocol.FRAME:
                self.heard = time.monotonic()
        return found

    def close(self) -> None:
        self._command.close()
        if self._data is not None:
            self._data.close()


class NatNetReading:
    """Messages to chunks."""

    def __init__(self, of: NatNet, info: ServerInfo, link: NatNetLink) -> None:
        self._of, self._info, self._link = of, info, link
        self.stamps = Stamps(of.rate_hz, counter_bits=32, has_time=True, latency_s=of.latency_s)
        self._rate = RateCheck(f"NatNet {of.server}", of.rate_hz, of.rate_mismatch, counted=True)
        self._names: NatNetNames | None = None
        self._head = np.zeros(1, HEAD)
        self._asked = 0.0
        self._last = 0

    def take(self, kind: int, payload: bytes, arrival: int, feed: Feed) -> None:
        try:
            if kind == protocol.SERVER_INFO:
                self._info, self._names = protocol.server_info(payload), None  # it has started again
            elif kind == protocol.MODELS:
                self._names = NatNetNames(self._of, protocol.models(payload, self._info.natnet))
            elif kind == protocol.FRAME:
                self._frame(payload, arrival, feed)
        except (NatNetError, struct.error):
            feed.problem("cut message")

    def _frame(self, payload: bytes, arrival: int, feed: Feed) -> None:
        if self._names is None:
            self._ask_for_models()
            feed.problem("frame before the models were known")
            return
        rows = self._names.rows(payload, self._info.natnet >= protocol.SIZED, self._head)
        if rows is None:
            feed.problem("cut message")
            return
        number, time_ns, ticks, flags = self._head[0].item()
        if flags & protocol.MODELS_CHANGED:
            self._ask_for_models()
        ns = round(ticks * NS / self._info.tick_hz) if ticks and self._info.tick_hz else time_ns
        if not 0 <= ns < LATEST_NS:
            feed.problem("repeated frame or wrong time")
            return
        made = self.stamps.take_one(ns, number, arrival)
        if made is None:
            feed.problem("repeated frame or wrong time")
            return
        lost, stamp = made.lost, made.stamp
        if lost:
            feed.problem("lost frame" if lost > 0 else "device restarted", max(lost, 1))
        self._rate.see(1, max(lost, 0), arrival, feed, np.array([ns]))
        timing = timing_of_one(made.number, made.device, arrival, stamp)
        for output, samples in rows:
            if output == "analog":
                feed.emit(self._spread(timing.time, lost, samples), output)
            else:
                feed.emit(Chunk(timing.time, samples, stamp, lost), output)
        feed.emit(timing, "timing")
        self._last = stamp

    def _spread(self, stamp: np.ndarray, lost: int, rows: np.ndarray) -> Chunk:
        """A frame's analog samples, evenly back to the frame before; the last one has the frame's stamp."""
        n, end = len(rows), int(stamp[0])
        period = NS / self._of.rate_hz / n
        step = (end - self._last) / n if self._last and not lost else period
        times = end - np.round(step * np.arange(n - 1, -1, -1)).astype(np.int64)
        return Chunk(np.maximum(times, self._last), rows, end, lost * n if lost > 0 else lost)

    def _ask_for_models(self) -> None:
        if time.monotonic() - self._asked > ASK_S:
            self._asked = time.monotonic()
            self._link.send(protocol.REQUEST_MODELS)
