"""Streams of a graph as entities of a home, over MQTT."""

from __future__ import annotations

import json
import os
import socket
import time
import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import structlog

from devices.mqtt.link import Broker, BrokerConnection
from devices.outlets.claim import check_path
from devices.outlets.mqtt.discovery import OFF, ON, UNKNOWN, Device, Entity, Topics, announcement
from devices.outlets.mqtt.outbox import Outbox, OutboxState
from devices.outlets.mqtt.report_news import NAME, ReportNews, ReportWatch, report_announcement
from stream.chunk import FOREVER, NEVER, NS, Array, Chunk, Specs, StreamSpec, utc
from stream.complete import private_folder
from stream.errors import InputError, ParameterError, nearest
from stream.operator import Outlet
from stream.params import param
from stream.state import pack

if TYPE_CHECKING:
    from stream.clock import SessionClock

REFRESH = 0.4
"""A state that has not changed is said again after this share of its `expire_after_s`."""
FAREWELL_S, KNOCK_S, LAST_TRY_S = 2.0, 5.0, 20.0
"""At the end: how long the last states are given to arrive; how long a broker to answer, if letters wait; how long these to arrive."""

log = structlog.get_logger(__name__)


@dataclass(frozen=True, slots=True)
class SentEvents:
    """Events of a stream that are sent one by one, each once and in order, as JSON with all their fields.

    of      the stream
    where   only events whose fields have these values ({final: true})
    key     an integer field that grows from event to event; by it what was sent already is known again
    log     the folder of a `devices.outlets.night.NightLog`, where these are final epochs: after a crash, what stands there and was not
            sent is sent as it stands, so that the two always agree (put the log before this outlet in the graph)
    sleeper whose nights of that folder, where there are several
    """

    of: str
    where: dict[str, str | float | bool] | None = None
    key: str = "onset"
    log: str = ""
    sleeper: str = ""


class MqttRuntime:
    """What belongs to a running outlet but not to its state."""

    def __init__(self, specs: Specs) -> None:
        self.specs = specs
        self.link: BrokerConnection | None = None
        self.outbox: Outbox | None = None
        self.live_from = NEVER
        """What a resumed session works through a second time lies before this."""
        self.told: dict[str, tuple[str, float, int]] = {}
        """Per entity: the state told last, when (monotonic s), and the sample's time."""
        self.newest: dict[str, int] = {}
        """Per stream, the newest sample's stamp."""
        self.mark = ""
        self.reports: ReportWatch | None = None


@dataclass(frozen=True, slots=True)
class MqttOutlet(Outlet[OutboxState, MqttRuntime]):
    """Fields of events, and channels of signals, as sensors in Home Assistant or for any MQTT client.

    `entities` says by name what is reported; states are retained, unknown ones are "None". Home Assistant learns of the entities by its
    discovery messages (retained, and once more when it has started); they become unavailable when kinegraph vanishes (last will), and each
    by itself when nothing comes for `expire_after_s`. Topics: base/device/entity/state, base/device/availability.

    `history` sends events one by one as JSON to base/device/history/stream, each once and in order, also over a broker that was away, a
    killed process and `--resume`: the checkpoint, the file `ledger` and the broker's own retained message say what has arrived. With no
    broker up to 6000 events wait; older ones are dropped, counted and logged. When the session ends, the broker is tried once more, and
    given 20 s to take what waits; what it does not take is forgotten, and its number told.

    `report` names the folder of a night's log: the newest report is summed up in one line, with its address beside it.

    It never waits for the network: without a broker at start, or when it goes, everything else goes on. With
    `broker: {host: ""}` it is off.
    """

    variadic: ClassVar[bool] = True
    inputs: ClassVar[tuple[str, ...]] = ()
    durable: ClassVar[bool] = True
    in_order: ClassVar[bool] = False

    entities: dict[str, Entity] = param(help="what is reported, by name")
    broker: Broker = param(Broker(), help="where the broker is")
    device: Device = param(Device(), help="the device in Home Assistant that all entities belong to")
    history: tuple[SentEvents, ...] = param((), help="events that are sent one by one")
    base: str = param("kinegraph", help="what all topics begin with")
    discovery: str = param("homeassistant", help="the prefix of discovery messages; left empty: none are sent")
    report: ReportNews | None = param(None, help="tell when a night's report is ready, and where it stands")
    ledger: str = param("", help="a file that remembers over a power cut which events were sent")

    def open(self, specs: Specs) -> Specs:
        if self.broker.host:
            self.broker.check()
        self.device.check()
        self._topics.check()
        if self.ledger and (wrong := check_path(Path(self.ledger))):
            raise ParameterError("ledger", self.ledger, wrong)
        if self.report and NAME in self.entities:
            raise ParameterError("entities", NAME, "another name: this one is the report's")
        for name, entity in self.entities.items():
            entity.check(name)
            spec = _stream(specs, entity.of, f"entities.{name}.of")
            if not entity.alive_s:
                _check_field(spec, entity.field, f"entities.{name}.field")
            _check_where(spec, entity.where, f"entities.{name}.where")
        for i, history in enumerate(self.history):
            spec = _stream(specs, history.of, f"history[{i}].of")
            if not spec.is_event or history.key not in spec.channels or spec.dtype[history.key].kind not in "iu":
                raise InputError(history.of, spec.describe(), f"events with a whole number {history.key!r}")
            _check_where(spec, history.where, f"history[{i}].where")
        self.hold(OutboxState(""), MqttRuntime(specs))
        return {}

    def keep_time(self, clock: SessionClock) -> None:
        self.runtime.live_from = clock.utc_ns

    def begin(self) -> None:
        runtime = self.runtime
        if not self.broker.host:
            return
        self.state.session = self.state.session or uuid.uuid4().hex
        ledger = Path(self.ledger).absolute() if self.ledger else None
        if ledger:
            private_folder(ledger.parent)
        runtime.outbox = Outbox(self.state, self._say, ledger)
        for history in self.history:
            if history.log:
                self._post_logged(history)
        runtime.reports = ReportWatch(self.report, self._topics) if self.report else None
        topics, histories = self._topics, [self._topics.history(h.of) for h in self.history]
        heard = [*([topics.birth] if self.discovery else []), *([topics.mark(), *histories] if histories else [])]
        runtime.link = BrokerConnection(
            self.broker, f"kinegraph-{self.device.id}-{socket.gethostname()}-{os.getpid()}", topics.availability(), heard,
            joined=self._joined, heard=self._heard, delivered=runtime.outbox.delivered, left=runtime.outbox.shut,
        )  # fmt: skip
        runtime.link.start()

    def process(self, port: str, chunk: Chunk) -> None:
        runtime = self.runtime
        if runtime.outbox is None:
            return
        if len(chunk):
            runtime.newest[port] = int(chunk.time[-1])
        for name, entity in self.entities.items():
            if entity.of == port:
                self._tell(name, entity, chunk)
        for history in self.history:
            if history.of == port and len(chunk):
                self._post(history, chunk)
        self._tell_report()
        if chunk.until >= runtime.live_from:
            runtime.outbox.flush()

    def close(self) -> None:
        runtime = self.runtime
        link = runtime.link
        if link is None or runtime.outbox is None:
            return
        self._tell_report(now=True)
        runtime.outbox.flush()
        self._wait_for_the_last(link, runtime.outbox)
        runtime.link = None
        link.stop()
        if undelivered := runtime.outbox.waiting + runtime.outbox.dropped:
            broker = f"{self.broker.host}:{self.broker.port}"
            kept = " (the log has those of the night)" if any(h.log for h in self.history) else ""
            log.warning(
                f"the MQTT broker did not get these events, and will not{kept}", events=undelivered, broker=broker
            )

    def _wait_for_the_last(self, link: BrokerConnection, outbox: Outbox) -> None:
        """Letters are given a bounded time as long as the broker takes them; one that is away is tried once more, at once."""
        began, failures = time.monotonic(), link.failures
        if outbox.waiting:
            link.hasten()
        while not outbox.empty:
            letters, passed = outbox.waiting, time.monotonic() - began
            reachable = link.there or (letters and link.failures == failures)
            limit_s = FAREWELL_S if not letters else LAST_TRY_S if link.there else KNOCK_S
            if not reachable or passed > limit_s:
                return
            time.sleep(0.01)

    def snapshot(self) -> dict[str, Array]:
        return pack(self.runtime.outbox.keep() if self.runtime.outbox else self.state)

    # what is reported --------------------------------------------------------------------------------------------------------

    def _tell(self, name: str, entity: Entity, chunk: Chunk) -> None:
        """Tell an entity's state where it has changed, or is about to be forgotten."""
        runtime = self.runtime
        assert runtime.outbox
        before, when, stamp = runtime.told.get(name, ("", 0.0, NEVER))
        text, at = self._state(entity, chunk, before, stamp)
        now = time.monotonic()
        stale = entity.expire_after_s > 0 and now - when >= REFRESH * entity.expire_after_s
        if text and (text != before or stale):
            runtime.told[name] = (text, now, at)
            runtime.outbox.state(self._topics.state(name), text)

    def _tell_report(self, *, now: bool = False) -> None:
        """Announce a new report."""
        runtime = self.runtime
        for topic, text in runtime.reports.look(now=now) if runtime.reports else ():
            assert runtime.outbox
            runtime.outbox.state(topic, text)

    def _state(self, entity: Entity, chunk: Chunk, before: str, told: int) -> tuple[str, int]:
        """What is to be reported after a chunk, and of which sample; "": nothing is known yet."""
        if entity.alive_s:
            newest = self.runtime.newest.get(entity.of, NEVER)
            alive = newest != NEVER and chunk.until < FOREVER and chunk.until - newest <= entity.alive_s * NS
            return (ON if alive else OFF), newest
        spec = self.runtime.specs[entity.of]
        rows = chunk.data[_chosen(chunk.data, entity.where)] if spec.is_event else chunk.data
        if not len(rows) or (not spec.is_event and told != NEVER and chunk.time[-1] - told < entity.every_s * NS):
            return before, told
        row = rows[-1]
        value = row[entity.field or spec.channels[0]] if spec.is_event else row.reshape(-1)[_place(spec, entity.field)]
        return _text(value, entity), int(chunk.time[-1])

    def _post(self, history: SentEvents, chunk: Chunk) -> None:
        runtime = self.runtime
        assert runtime.outbox
        spec = runtime.specs[history.of]
        for row in chunk.data[_chosen(chunk.data, history.where)]:
            told: dict[str, Any] = {"session": self.state.session, "key": int(row[history.key])}
            told |= {field: _plain(row[field], spec.unit_of(field)) for field in spec.channels}
            runtime.outbox.post(self._topics.history(history.of), told["key"], json.dumps(told))

    def _post_logged(self, history: SentEvents) -> None:
        """What a night's log has, and this session has not sent: it was killed in between."""
        from devices.outlets.night import archive

        outbox, topic = self.runtime.outbox, self._topics.history(history.of)
        assert outbox
        newest = outbox.newest(topic)
        nights = archive.nights(Path(history.log)) if newest >= 0 else []
        nights = [night for night in nights if night[1].sleeper == history.sleeper]
        nights.sort(key=lambda night: (night[0] / archive.EPOCHS).stat().st_mtime_ns)  # the one that was written last
        for folder, _ in nights[-1:]:
            epochs = archive.read_epochs(folder)
            for k in np.flatnonzero(epochs.onset > newest).tolist():
                told = {"session": self.state.session, "key": int(epochs.onset[k])}
                told |= {name: utc(int(column[k])) for name, column in (("onset", epochs.onset), ("end", epochs.end))}
                told |= {
                    "state": str(epochs.texts["state"][k]),
                    "final": True,
                    "rescored": bool(epochs.numbers["rescored"][k]),
                }
                told |= {name: _plain(epochs.numbers[name][k], "") for name in ("score", "activity")}
                outbox.post(topic, int(epochs.onset[k]), json.dumps(told))

    # the link's thread ---------------------------------------------------------------------------------------------------

    @property
    def _topics(self) -> Topics:
        return Topics(self.base, self.device.id, self.discovery)

    def _say(self, topic: str, text: str, retain: bool) -> int | None:
        link = self.runtime.link
        return link.say(topic, text, retain=retain) if link else None

    def _joined(self) -> None:
        """The broker is there. What it remembers of our history comes before our own mark does."""
        self._announce()
        if self.history:
            self.runtime.mark = uuid.uuid4().hex
            if self.runtime.link:
                self.runtime.link.say(self._topics.mark(), self.runtime.mark)
        elif self.runtime.outbox:
            self.runtime.outbox.open()

    def _heard(self, topic: str, text: str, retained: bool) -> None:
        outbox = self.runtime.outbox
        assert outbox
        if topic == self._topics.mark():
            if text == self.runtime.mark:
                outbox.open()
        elif topic == self._topics.birth:
            if text == "online" and not retained:
                self._announce()
                outbox.repeat()
        else:
            outbox.remembered(topic, text)

    def _announce(self) -> None:
        if self.discovery:
            for name, entity in self.entities.items():
                told = announcement(name, entity, self.device, self._topics)
                self._say(self._topics.config(entity.component, name), json.dumps(told), True)
            if self.report:
                told = report_announcement(self.device, self._topics)
                self._say(self._topics.config("sensor", NAME), json.dumps(told), True)


def _stream(specs: Specs, of: str, parameter: str) -> StreamSpec:
    if of not in specs:
        raise ParameterError(parameter, of, f"a stream that this outlet reads; {nearest(of, list(specs))}")
    return specs[of]


def _check_field(spec: StreamSpec, field: str, parameter: str) -> None:
    if field and field not in spec.channels:
        raise ParameterError(parameter, field, f"a field of the stream; {nearest(field, list(spec.channels))}")
    if not spec.is_event and len(spec.shape) != 1:
        raise ParameterError(parameter, field, f"a channel of a signal or a field of events, not of {spec.describe()}")


def _check_where(spec: StreamSpec, where: dict[str, Any] | None, parameter: str) -> None:
    for field in where or {}:
        if not spec.is_event:
            raise ParameterError(parameter, field, "left out of a signal")
        _check_field(spec, field, parameter)


def _chosen(rows: Array, where: dict[str, Any] | None) -> Array:
    """Which events are meant (n,) bool."""
    chosen = np.ones(len(rows), np.bool_)
    for field, value in (where or {}).items():
        chosen &= rows[field] == value
    return chosen


def _place(spec: StreamSpec, field: str) -> int:
    return spec.channels.index(field) if field else 0


def _text(value: Any, entity: Entity) -> str:
    """A value as Home Assistant takes it; what is not known is "None"."""
    if entity.device_class == "timestamp":
        return utc(int(value)) if value > 0 else UNKNOWN
    if entity.values is not None:
        return entity.values.get(str(value).lower() if isinstance(value, bool | np.bool_) else str(value), UNKNOWN)
    if isinstance(value, np.floating | float):
        return f"{value:.{entity.decimals}f}" if np.isfinite(value) else UNKNOWN
    return str(value)


def _plain(value: Any, unit: str) -> Any:
    """A field for JSON: times as ISO 8601, what is not known as null."""
    if unit == "ns":
        return utc(int(value)) if value > 0 else None
    plain = value.item() if isinstance(value, np.generic) else value.tolist()
    return None if isinstance(plain, float) and not np.isfinite(plain) else plain
