"""A simulated sender on the Lab Streaming Layer: the EMG of someone walking, a footswitch, and markers at every footfall."""

from __future__ import annotations

import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from kinegraph.devices.lsl.network import ANY, MACHINE, Network, library, unsettled
from kinegraph.devices.lsl.samples import write_channels
from kinegraph.devices.people.treadmill.signal import BURSTS, Signal, Walker
from kinegraph.devices.simulation.fault_injection import GOOD, FaultInjection, FaultInjector
from kinegraph.devices.simulation.sample_schedule import due
from kinegraph.devices.simulation.serve import TICK_S, Simulator
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.params import param

if TYPE_CHECKING:
    from kinegraph.devices.lsl.inlet import LslInlet

GAIT_HZ = 1000.0
"""How finely the footfalls of a stream without a rate are timed."""
UNITS = {"mV": 1e-3, "V": 1e-6}


@dataclass(frozen=True, slots=True)
class Lsl(Simulator):
    """An LSL stream of a walker's EMG (float32), and, if wanted, a second one (NAME markers) with "touchdown" and "liftoff".

    Sample k is stamped k / `rate_hz` on LSL's clock and is a function of k alone, so streams of one seed are in step, whoever sends
    them, and one that was restarted goes on with the same walk. When the cable is pulled out the outlet is gone; it comes back with the
    same source_id.
    """

    name: str = param("simulated EMG", help="what the stream is called")
    type: str = param("EMG", help="its content type")
    source_id: str = param("kinegraph.simulated", help="it stays the same when the outlet is restarted")
    channels: tuple[str, ...] | int = param(("TA", "GM", "SO", "RF", "BF", "VM"), least=1, help="labels, or how many")
    rate_hz: float = param(1000.0, least=0, most=20000, help="0: one sample at each touch-down")
    unit: str = param("uV", help="of every channel")
    markers: bool = param(False, help="the stream itself holds markers, not EMG")
    with_markers: bool = param(False, help="a second stream holds markers")
    chunk_ms: float = param(10.0, above=0, most=1000, help="how much is sent at a time")
    seed: int = param(0, least=0, help="another seed, another walk")
    network: Network = param(ANY, help="how far it is seen")

    @property
    def cannot(self) -> dict[str, str]:
        return {
            "reset_every_s": "a stream of LSL has no counter",
            "corrupt": "LSL goes over TCP, which lets no changed byte pass",
        }

    @contextmanager
    def serving(self, faults: FaultInjection = GOOD, address: str = "") -> Iterator[str]:
        with self.sending(faults, address):
            yield f"LSL stream {self.name!r} with source_id {self.source_id!r}"

    @contextmanager
    def sending(self, faults: FaultInjection = GOOD, address: str = "") -> Iterator[Sender]:
        """As `serving`, with the sender in hand."""
        if address:
            raise DeviceError(f"an LSL stream has no address such as {address!r}; it is found by its name or source_id")
        with ExitStack() as senders:
            if self.with_markers:
                more = replace(
                    self,
                    name=f"{self.name} markers",
                    type="Markers",
                    source_id=f"{self.source_id}.markers",
                    channels=1,
                    markers=True,
                )
                senders.enter_context(Sender(more, faults))
            yield senders.enter_context(Sender(self, faults))

    def signal(self) -> Signal:
        """What is simulated; sample k is stamped k / rate."""
        names = range(self.channels) if isinstance(self.channels, int) else self.channels
        known = list(BURSTS)
        muscles = tuple(str(n) if n in BURSTS else known[i % len(known)] for i, n in enumerate(names))
        return Signal(Walker(muscles, rate_hz=self.rate_hz or GAIT_HZ, seed=self.seed))

    def values(self, signal: Signal, start: int, stop: int) -> NDArray[np.float64]:
        """Samples start..stop-1 (n, channels), in `unit`; of a type with "switch" in its name 1 while the foot is on the ground."""
        if "switch" in self.type.lower():
            count = self.channels if isinstance(self.channels, int) else len(self.channels)
            return np.repeat(signal.on_ground(np.arange(start, stop))[:, None], count, axis=1).astype(np.float64)
        return np.asarray(signal.read(start, stop)[0] * UNITS.get(self.unit, 1.0))


class WalkPackets:
    """The packets to send as time passes, each a row of bytes, by the number of samples since LSL's clock stood at 0."""

    def __init__(self, of: Lsl) -> None:
        self._of, self._signal = of, of.signal()
        self.rate_hz = of.rate_hz or GAIT_HZ
        count = of.channels if isinstance(of.channels, int) else len(of.channels)
        self.count = count
        self.row = np.dtype([("stamp", "<f8"), ("values", "<f4", (count,))])

    def say(self, start: int, stop: int) -> list[bytes]:
        """The packets of samples start..stop-1, without empty ones."""
        if stop <= start:
            return []
        if self._of.markers:
            return self._markers(start, stop)
        if not self._of.rate_hz:
            return [self._rows(at, np.full((1, self.count), at / self.rate_hz)) for at in self._touchdowns(start, stop)]
        return [self._rows(np.arange(start, stop), self._of.values(self._signal, start, stop))]

    def _touchdowns(self, start: int, stop: int) -> Sequence[int]:
        return [int(at) for at in self._signal.gait.touchdowns(start, stop)]

    def _rows(self, index: NDArray[np.int64] | int, values: NDArray[np.float64]) -> bytes:
        rows = np.empty(len(values), self.row)
        rows["stamp"], rows["values"] = np.asarray(index) / self.rate_hz, values
        return rows.tobytes()

    def _markers(self, start: int, stop: int) -> list[bytes]:
        gait = self._signal.gait
        events = [(int(at), "touchdown") for at in gait.touchdowns(start, stop)]
        events += [(int(at), "liftoff") for at in gait.liftoffs(start, stop)]
        return [np.float64(at / self.rate_hz).tobytes() + text.encode() for at, text in sorted(events)]


class Sender:
    """An outlet at work in a thread, with injected faults."""

    def __init__(self, of: Lsl, faults: FaultInjection) -> None:
        self._of, self._walk, self.injector = of, WalkPackets(of), FaultInjector(faults)
        self._lsl = library(of.network)
        self._stop, self._lock = threading.Event(), threading.Lock()
        self._out = False
        self._outlet: Any = None
        self._plug()
        self._thread = threading.Thread(target=self._work, name=f"simulator {of.name}", daemon=True)

    def unplug(self) -> None:
        """The outlet is gone, until `plug`."""
        with self._lock:
            self._out, self._outlet = True, None

    def plug(self) -> None:
        """It is back, with the same source_id."""
        with self._lock:
            self._out = False
            self._plug()

    def __enter__(self) -> Sender:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._outlet = None

    def _work(self) -> None:
        began, rate = self._lsl.local_clock(), self._walk.rate_hz
        chunk = max(TICK_S, self._of.chunk_ms / 1000)
        result, number, kept = int(began * rate), 0, list[bytes]()
        while not self._stop.is_set():
            number += 1
            self._stop.wait(max(0.0, began + number * chunk - self._lsl.local_clock()))
            now = self._lsl.local_clock()
            first, result = due(result, now, rate)
            packets = self.injector.spoil(self._walk.say(first, result), now - began)
            with self._lock:
                kept = self._pass(kept + packets, now - began)

    def _pass(self, packets: list[bytes], seconds: float) -> list[bytes]:
        """Send what may be sent at this second; returns what is kept."""
        if self._out or self.injector.unplugged(seconds):
            self._outlet = None
            return []
        if self.injector.stalled(seconds):
            return packets
        self._plug()
        for packet in packets:
            self._send(packet)
        return []

    def _send(self, packet: bytes) -> None:
        if self._of.markers:
            self._outlet.push_sample([packet[8:]], float(np.frombuffer(packet[:8], "<f8")[0]))
        else:
            rows = np.frombuffer(packet, self._walk.row)
            self._outlet.push_chunk(np.ascontiguousarray(rows["values"]), rows["stamp"].tolist())

    def _plug(self) -> None:
        if self._outlet is not None:
            return
        of, lsl = self._of, self._lsl
        rate = 0.0 if of.markers else of.rate_hz
        kind = "string" if of.markers else "float32"
        info = lsl.StreamInfo(of.name, of.type, self._walk.count, rate, kind, of.source_id)
        names = range(1, of.channels + 1) if isinstance(of.channels, int) else of.channels
        write_channels(info.desc(), [(str(name), "" if of.markers else of.unit) for name in names], of.type)
        self._outlet = lsl.StreamOutlet(info)


@contextmanager
def simulated(source: LslInlet) -> Iterator[LslInlet]:
    """What `--simulate` puts in its place."""
    network = MACHINE if source.network == ANY and unsettled() else source.network
    source_id = source.source_id or f"kinegraph.simulated.{uuid.uuid4().hex[:12]}"
    device = Lsl(
        name=source.name or "simulated",
        type=source.type or ("Markers" if source.markers else "EMG"),
        source_id=source_id,
        channels=source.channels or 1,
        rate_hz=source.rate_hz,
        unit=source.unit if isinstance(source.unit, str) else (source.unit[0] if source.unit else ""),
        markers=source.markers,
        network=network,
    )
    with device.serving():
        yield replace(source, source_id=source_id, host="", network=network)
