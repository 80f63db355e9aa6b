"""Streams of a graph as entities of a home, over MQTT."""

from __future__ import annotations

import json
import os
import socket
import time
import uuid
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from kinegraph.devices.mqtt.discovery import Device, Entity, Topics, announcement
from kinegraph.devices.mqtt.entity_states import EntityStates
from kinegraph.devices.mqtt.fields import check_field, check_where, stream_of
from kinegraph.devices.mqtt.link import Broker, BrokerConnection
from kinegraph.devices.mqtt.message_queue import MessageQueue, MessageQueueState
from kinegraph.devices.mqtt.newest_report import NAME, ReportNews, ReportWatch, report_announcement
from kinegraph.devices.mqtt.sent_events import SentEvents
from kinegraph.devices.outlets.output_lock import check_path
from kinegraph.stream.chunk import NEVER, Array, Chunk, Specs
from kinegraph.stream.data.state import pack
from kinegraph.stream.errors import ParameterError
from kinegraph.stream.operator import ANY, Input
from kinegraph.stream.outlet import Outlet
from kinegraph.stream.params import param
from kinegraph.stream.system.atomic_file import private_folder

if TYPE_CHECKING:
    from kinegraph.stream.system.clock import SessionClock

FAREWELL_S, KNOCK_S, LAST_TRY_S = 2.0, 5.0, 20.0
"""At the end: how long the last states are given to arrive; how long a broker to answer, if messages wait; how long these to arrive."""


class MqttRuntime:
    """What belongs to a running outlet but not to its state."""

    def __init__(self, specs: Specs, entities: Mapping[str, Entity]) -> None:
        self.specs = specs
        self.states = EntityStates(entities, specs)
        self.link: BrokerConnection | None = None
        self.messages: MessageQueue | None = None
        self.live_from = NEVER
        """What a resumed session works through a second time lies before this."""
        self.mark = ""
        self.reports: ReportWatch | None = None


@dataclass(frozen=True, slots=True)
class MqttOutlet(Outlet[MessageQueueState, MqttRuntime]):
    """Fields of events, and channels of signals, as sensors in Home Assistant or for any MQTT client.

    `entities` says by name what is reported; states are retained, unknown ones are "None". Home Assistant learns of the entities by its
    discovery messages (retained, and once more when it has started); they become unavailable when kinegraph vanishes (last will), and each
    by itself when nothing comes for `expire_after_s`. Topics: base/device/entity/state, base/device/availability.

    `history` sends events one by one as JSON to base/device/history/stream, each once and in order, also over a broker that was away, a
    killed process and `--resume`: the checkpoint, the file `ledger` and the broker's own retained message say what has arrived. With no
    broker up to 6000 events wait; older ones are dropped, counted and logged. When the session ends, the broker is tried once more, and
    given 20 s to take what waits; the rest is dropped and counted.

    `report` names the folder of a night's log: the newest report is summed up in one line, with its address beside it.

    It never waits for the network: without a broker at start, or when it goes, everything else goes on. With
    `broker: {host: ""}` it is off.
    """

    inputs = {ANY: Input()}
    durable: ClassVar[bool] = True
    closes_last: ClassVar[bool] = True
    in_order: ClassVar[bool] = False

    entities: dict[str, Entity] = param(help="what is reported, by name")
    broker: Broker = param(Broker(), help="where the broker is")
    device: Device = param(Device(), help="the device in Home Assistant that all entities belong to")
    history: tuple[SentEvents, ...] = param((), help="events that are sent one by one")
    base: str = param("kinegraph", help="what all topics begin with")
    discovery: str = param("homeassistant", help="the prefix of discovery messages; empty: no discovery")
    report: ReportNews | None = param(None, help="announce when a night's report is ready, and its address")
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
            spec = stream_of(specs, entity.of, f"entities.{name}.of")
            if not entity.alive_s:
                check_field(spec, entity.field, f"entities.{name}.field")
            check_where(spec, entity.where, f"entities.{name}.where")
        for i, history in enumerate(self.history):
            history.check(specs, f"history[{i}]")
        self.set_state(MessageQueueState(""), MqttRuntime(specs, self.entities))
        return {}

    def missing(self) -> str:
        return self.broker.missing()

    @property
    def undelivered(self) -> str:
        messages = self.runtime.messages
        count = messages.waiting + messages.dropped if messages else 0
        if not count:
            return ""
        kept = " (the log has those of the night)" if any(history.log for history in self.history) else ""
        return f"the MQTT broker {self.broker.host}:{self.broker.port} did not get {count} events of the history{kept}"

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
        runtime.messages = MessageQueue(self.state, self._say, ledger)
        for history in self.history:
            if history.log:
                topic = self._topics.history(history.of)
                for key, text in history.logged_after(runtime.messages.newest(topic), self.state.session):
                    runtime.messages.post(topic, key, text)
        runtime.reports = ReportWatch(self.report, self._topics) if self.report else None
        topics, histories = self._topics, [self._topics.history(h.of) for h in self.history]
        heard = [*([topics.birth] if self.discovery else []), *([topics.mark(), *histories] if histories else [])]
        runtime.link = BrokerConnection(
            self.broker, f"kinegraph-{self.device.id}-{socket.gethostname()}-{os.getpid()}", topics.availability(), heard,
            joined=self._joined, heard=self._heard, delivered=runtime.messages.delivered, left=runtime.messages.shut,
        )  # fmt: skip
        runtime.link.start()

    def process(self, port: str, chunk: Chunk) -> None:
        runtime = self.runtime
        if runtime.messages is None:
            return
        for name, text in runtime.states.changed(port, chunk):
            runtime.messages.state(self._topics.state(name), text)
        for history in self.history:
            if history.of == port and len(chunk):
                for key, text in history.chosen(chunk, runtime.specs[port], self.state.session):
                    runtime.messages.post(self._topics.history(port), key, text)
        self._publish_report()
        if chunk.until >= runtime.live_from:
            runtime.messages.flush()

    def close(self) -> None:
        runtime = self.runtime
        link = runtime.link
        if link is None or runtime.messages is None:
            return
        self._publish_report(now=True)
        runtime.messages.flush()
        self._wait_for_the_last(link, runtime.messages)
        runtime.link = None
        link.stop()

    def _wait_for_the_last(self, link: BrokerConnection, queue: MessageQueue) -> None:
        """Messages are given a bounded time as long as the broker takes them; one that is away is tried once more, at once."""
        began, failures = time.monotonic(), link.failures
        if queue.waiting:
            link.hasten()
        while not queue.empty:
            waiting, passed = queue.waiting, time.monotonic() - began
            reachable = link.there or (waiting and link.failures == failures)
            limit_s = FAREWELL_S if not waiting else LAST_TRY_S if link.there else KNOCK_S
            if not reachable or passed > limit_s:
                return
            time.sleep(0.01)

    def snapshot(self) -> dict[str, Array]:
        return pack(self.runtime.messages.keep() if self.runtime.messages else self.state)

    def _publish_report(self, *, now: bool = False) -> None:
        """Announce a new report."""
        runtime = self.runtime
        for topic, text in runtime.reports.look(now=now) if runtime.reports else ():
            assert runtime.messages
            runtime.messages.state(topic, text)

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
        elif self.runtime.messages:
            self.runtime.messages.open()

    def _heard(self, topic: str, text: str, retained: bool) -> None:
        messages = self.runtime.messages
        assert messages
        if topic == self._topics.mark():
            if text == self.runtime.mark:
                messages.open()
        elif topic == self._topics.birth:
            if text == "online" and not retained:
                self._announce()
                messages.repeat()
        else:
            messages.remembered(topic, text)

    def _announce(self) -> None:
        if self.discovery:
            for name, entity in self.entities.items():
                result = announcement(name, entity, self.device, self._topics)
                self._say(self._topics.config(entity.component, name), json.dumps(result), True)
            if self.report:
                result = report_announcement(self.device, self._topics)
                self._say(self._topics.config("sensor", NAME), json.dumps(result), True)
