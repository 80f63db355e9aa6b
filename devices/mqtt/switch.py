"""A switch of the home that comes into the graph: the light's button, a pause."""

from __future__ import annotations

import json
import os
import socket
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import ClassVar

import numpy as np
import structlog

from kinegraph.devices.mqtt.discovery import OFF, ON, Device, Topics, switch
from kinegraph.devices.mqtt.link import Broker, BrokerConnection
from kinegraph.stream.chunk import Chunk, Specs, StreamSpec, empty
from kinegraph.stream.params import param
from kinegraph.stream.source import Feed, Source

log = structlog.get_logger(__name__)

SWITCHED = np.dtype([("on", "?")])
MAX_SHOWN = 200
"""Characters of a message that is neither ON nor OFF, of which the log tells."""
MAX_TOLD = 20
"""How many such messages of one opening are logged; whoever sends more has been named often enough."""
HEARTBEAT_S = 0.05
"""How often it says that it was not switched: so long does an operator that reads it wait for it."""


@dataclass(frozen=True, slots=True)
class MqttSwitch(Source):
    """A switch in Home Assistant, or anything that publishes ON or OFF to base/device/name/set, as a recorded stream.

    One event (`on`) whenever it is switched, stamped with its arrival. What it was when kinegraph last ran is taken up at the start, from
    the broker's retained state; without that it is `initial`, and no event is given. Without a broker nothing is switched and the graph
    goes on.
    """

    background: ClassVar[bool] = True

    name: str = param(help="what it is called in topics: letters, digits, - and _")
    title: str = param("", help="its name in Home Assistant; left out: `name`")
    initial: bool = param(False, help="its state before it was ever switched")
    broker: Broker = param(Broker(), help="where the broker is")
    device: Device = param(Device(), help="the device in Home Assistant that it belongs to")
    base: str = param("kinegraph", help="what all topics begin with")
    discovery: str = param("homeassistant", help="the prefix of discovery messages; empty: no discovery")
    icon: str = param("", help="such as mdi:lightbulb")

    def specs(self) -> Specs:
        self.broker.check()
        self.device.check()
        Device(self.name).check()
        Topics(self.base, self.device.id, self.discovery).check()
        return {"out": StreamSpec((), SWITCHED, meta={"switch": self.name})}

    @property
    def may_appear(self) -> bool:
        return True

    def missing(self) -> str:
        return self.broker.missing()

    def read(self, feed: Feed) -> None:
        spec, hand = self.specs()["out"], _Hand(self)
        feed.ready()
        hand.link.start()
        try:
            while not feed.stopped:
                on = hand.switched(HEARTBEAT_S)
                now = feed.now()
                feed.emit(empty(spec, now) if on is None else Chunk(np.array([now]), np.array([(on,)], SWITCHED), now))
        finally:
            hand.link.stop()


class _Hand:
    """One opening of the switch. `on`: what it is; `settled`: whether somebody has set it."""

    def __init__(self, of: MqttSwitch) -> None:
        self._of, self._topics = of, Topics(of.base, of.device.id, of.discovery)
        self._on, self._settled, self._strange = of.initial, False, 0
        self._switched: SimpleQueue[bool] = SimpleQueue()
        state, command = self._topics.state(of.name), self._topics.command(of.name)
        self.link = BrokerConnection(
            of.broker, f"kinegraph-{of.device.id}-{of.name}-{socket.gethostname()}-{os.getpid()}", self._topics.availability(of.name),
            [state, command, *([self._topics.birth] if of.discovery else [])], joined=self._joined, heard=self._heard,
        )  # fmt: skip

    def switched(self, timeout_s: float) -> bool | None:
        """Wait for the switch; None after the timeout."""
        try:
            return self._switched.get(timeout=timeout_s)
        except Empty:
            return None

    def _joined(self) -> None:
        self._announce()
        if self._settled:
            self._say_state()

    def _heard(self, topic: str, text: str, retained: bool) -> None:
        if topic == self._topics.birth:
            if text == "online" and not retained:
                self._announce()
                self._say_state()
        elif text.strip().upper() in (ON, OFF):
            self._turn(text.strip().upper() == ON, topic, retained)
        elif self._strange < MAX_TOLD:
            self._strange += 1
            log.warning("MQTT message is neither ON nor OFF", topic=topic, text=text[:MAX_SHOWN])

    def _turn(self, on: bool, topic: str, retained: bool) -> None:
        """A command, or at the start what the broker remembers; an old retained command is ignored."""
        commanded = topic == self._topics.command(self._of.name)
        if commanded == retained or (not commanded and self._settled):
            return
        changed, self._on, self._settled = on != self._on, on, True
        if changed:
            self._switched.put(on)
        if commanded:
            self._say_state()

    def _say_state(self) -> None:
        self.link.say(self._topics.state(self._of.name), ON if self._on else OFF, retain=True)

    def _announce(self) -> None:
        of = self._of
        if of.discovery:
            result = switch(of.name, of.title or of.name, of.icon, of.device, self._topics)
            self.link.say(self._topics.config("switch", of.name), json.dumps(result), retain=True)
