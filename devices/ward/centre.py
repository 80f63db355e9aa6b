"""The ward's centre: what beds report comes in, orders go out, nights are kept."""

from __future__ import annotations

import asyncio
import json
import re
import threading
import time
import uuid
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import structlog

from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.clock import BedClock
from kinegraph.devices.nats.messages import DAMAGE, FACTS, PREFIX, subject
from kinegraph.devices.nats.server import NAME, NatsServer
from kinegraph.devices.ward.alarms import AlarmBook, Deliveries
from kinegraph.devices.ward.beds import WardBed, attention, night_line
from kinegraph.stream.chunk import NS
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete

TURN_S = 1.0
KEPT = "beds.json"
"""What beds reported last, for a ward that is started again: who was there and is silent then is an alarm."""
KEEP_S = 10.0
FORGET_S = 7 * 86400.0
"""Beds without a report for so long are left out at the next start."""
ORDER_S = 10.0
"""How often an order is repeated to a bed that has not taken it."""
NIGHT = re.compile(r"[\w.+-]{1,64}")
NIGHT_FILES = ("night.json", "epochs.csv")
MAX_NIGHT_BYTES = 64 << 20

log = structlog.get_logger(__name__)


class Centre:
    """Receives reports on the link's thread; a thread of its own looks once a second at what has become silent."""

    def __init__(self, home: Path, server: NatsServer, *, beds: tuple[str, ...] = ()) -> None:
        """`beds` that have an account are on the page also before their first report."""
        self.home = private_folder(home)
        self.beds = {name: WardBed(name) for name in beds}
        self.book = AlarmBook(home / "alarms.sqlite")
        self.link = links.Link(server, "kinegraph ward")
        self._clocks: dict[str, BedClock] = {}
        self._orders: dict[str, tuple[dict[str, Any], float]] = {}
        self._lock = threading.RLock()
        self._stop = threading.Event()
        self._made_for = self._connection = 0
        self.listening_s = self._kept_s = 0.0
        self._load()
        for kind, take in (("status", self._status), ("agent", self._agent), ("facts.night.>", self._night)):
            self.link.subscribe(f"{PREFIX}.*.{kind}", take)
        self._thread = threading.Thread(target=self._run, name="ward", daemon=True)
        self.deliveries: Deliveries | None = None
        for bed in self.beds.values():
            bed.night = self._last_night(bed.name)

    def start(self) -> None:
        self._thread.start()
        if self.deliveries:
            self.deliveries.start()

    def stop(self) -> None:
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(5)
        if self.deliveries:
            self.deliveries.stop()
        self._save()
        self.link.close()
        self.book.close()

    def _load(self) -> None:
        """What beds reported before the ward was started, as old as it is now."""
        now, wall, given = time.monotonic(), time.time(), set(self.beds)
        with suppress(OSError, *DAMAGE, AttributeError):
            for name, kept in json.loads((self.home / KEPT).read_text(encoding="utf-8")).items():
                status_s, agent_s = now - (wall - kept["status_at"]), now - (wall - kept["agent_at"])
                if NAME.fullmatch(name) and (name in given or not given) and now - max(status_s, agent_s) < FORGET_S:
                    self.beds[name] = WardBed(name, kept["status"], status_s, kept["agent"], agent_s)

    def _save(self) -> None:
        now, wall = time.monotonic(), time.time()
        with self._lock:
            self._kept_s = now
            kept = {
                bed.name: {
                    "status": bed.status, "status_at": wall - (now - bed.status_s),
                    "agent": bed.agent, "agent_at": wall - (now - bed.agent_s),
                }
                for bed in self.beds.values()
                if bed.status or bed.agent
            }  # fmt: skip
        try:
            write_complete(self.home / KEPT, json.dumps(kept))
        except OSError as error:
            log.warning("what beds reported cannot be kept", error=error.strerror)

    # what comes in -------------------------------------------------------------------------------------------------------

    def _bed(self, message: Any) -> WardBed | None:
        name = message.subject.split(".")[1]
        if not NAME.fullmatch(name):
            return None
        if name not in self.beds:
            self.beds[name] = WardBed(name, night=self._last_night(name))
        return self.beds[name]

    async def _status(self, message: Any) -> None:
        with self._lock, suppress(*DAMAGE, AttributeError):
            facts = json.loads(message.data)
            bed = self._bed(message)
            if bed and isinstance(facts["streams"], dict) and isinstance(facts["now"], int):
                bed.status, bed.status_s = facts, time.monotonic()

    async def _agent(self, message: Any) -> None:
        with self._lock, suppress(*DAMAGE, AttributeError):
            facts = json.loads(message.data)
            bed = self._bed(message)
            if bed and isinstance(facts["order"], dict):
                bed.agent, bed.agent_s = facts, time.monotonic()
                self._reconcile(bed)

    async def _night(self, message: Any) -> None:
        with self._lock:
            self._keep_night(message.subject, message.data)

    def _keep_night(self, where: str, body: bytes) -> None:
        """A night's log from a bed, into the folder of that bed's nights."""
        try:
            _, bed, _, _, name = where.split(".", 4)
            files = json.loads(zlib.decompressobj().decompress(body, MAX_NIGHT_BYTES))
            if not (NAME.fullmatch(bed) and NIGHT.fullmatch(name) and not name.startswith(".")):
                return
            folder = private_folder(self.home / "nights" / bed / name)
            for file in NIGHT_FILES:
                write_complete(folder / file, str(files[file]))
        except (OSError, zlib.error, *DAMAGE) as error:
            log.warning("a night from a bed is left out", where=where, error=str(error))
            return
        if bed in self.beds:
            self.beds[bed].night = self._last_night(bed)

    def _last_night(self, bed: str) -> str:
        found = sorted((self.home / "nights" / bed).glob("*/night.json"))
        with suppress(OSError, *DAMAGE, IndexError):
            return night_line(json.loads(found[-1].read_text(encoding="utf-8")))
        return ""

    # what goes out -------------------------------------------------------------------------------------------------------

    def roll_out(self, beds: list[str], order: dict[str, Any]) -> str:
        """Send an order (a graph's text, a version, or `back`) to some beds; each takes it when it is there. Returns its id."""
        id = uuid.uuid4().hex[:12]
        with self._lock:
            missing = [name for name in beds if name not in self.beds]
            if missing:
                raise KinegraphError(f"there is no bed {', '.join(missing)}; there are {', '.join(sorted(self.beds))}")
            for name in beds:
                self.beds[name].order = {"id": id, "state": "sent", "text": ""}
                self._orders[name] = {**order, "id": id}, time.monotonic()
                self.link.start(self._send(name, self._orders[name][0]))
        return id

    def _reconcile(self, bed: WardBed) -> None:
        """What the agent reports of its order; one that it does not have yet is sent (again)."""
        reported, wanted = bed.agent["order"], self._orders.get(bed.name)
        if wanted is None:
            bed.order = reported if reported.get("state") else bed.order
            return
        order, sent_s = wanted
        if reported.get("id") == order["id"]:
            del self._orders[bed.name]
            bed.order = reported
        elif time.monotonic() - sent_s > ORDER_S:
            self._orders[bed.name] = order, time.monotonic()
            self.link.start(self._send(bed.name, order))

    async def _send(self, bed: str, order: dict[str, Any]) -> None:
        with suppress(OSError, asyncio.TimeoutError, self.link.error_kind):
            await self.link.client.request(subject(bed, "ask", "order"), json.dumps(order).encode(), timeout=2)

    # what is shown -------------------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """What the page shows."""
        now = time.monotonic()
        with self._lock:
            rows = attention([bed.row(now) for bed in self.beds.values()])
        return {
            "beds": rows,
            "alarms": self.book.open(),
            "server": {"there": self.link.there, "error": self.link.error},
        }

    def _run(self) -> None:
        while not self._stop.wait(TURN_S):
            self.turn()

    def turn(self) -> None:
        """Look once at all beds: clocks, alarms; and make the server's streams, once it is there."""
        if self.link.there and self._made_for != self.link.connections:  # it may have lost its disk
            with suppress(OSError):
                self.link.call(links.make_streams(self.link))
                self._fetch_nights()
                self._made_for = self.link.connections
        now, wall = time.monotonic(), time.time()
        if self.link.there and self._connection != self.link.connections:
            self._connection, self.listening_s = self.link.connections, now
        if now - self._kept_s > KEEP_S:
            self._save()
        with self._lock:
            for name, bed in list(self.beds.items()):
                bed.listening_s = self.listening_s
                clock = self._clocks.setdefault(name, BedClock(self.link, name, time.time_ns))
                if bed.status and now - bed.status_s < 10.0:
                    clock.ask()
                if clock.offset:
                    bed.offset_s, bed.uncertainty_s = clock.offset.ns / NS, clock.offset.uncertainty_ns / NS
                if self.link.there and not bed.awaited(now):
                    self.book.update(name, bed.troubles(now), wall)

    def _fetch_nights(self) -> None:
        """Nights that came while no ward ran."""
        info = self.link.call(self.link.stream.stream_info(FACTS, subjects_filter=f"{PREFIX}.*.facts.night.>"))
        for where in info.state.subjects or {}:
            _, bed, _, _, name = where.split(".", 4)
            if not (self.home / "nights" / bed / name).exists():
                body = self.link.call(links.fact(self.link, where.removeprefix(f"{PREFIX}.")))
                if body:
                    self._keep_night(where, body)
