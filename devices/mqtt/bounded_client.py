"""An MQTT client that never holds a long message: a broker, or whoever publishes there, may send up to 256 MB, and paho keeps it all."""

from __future__ import annotations

from typing import Any

from paho.mqtt.client import Client
from paho.mqtt.enums import MQTTErrorCode

MAX_BYTES = 256 << 10
"""A longer message is not for us: it is read, confirmed and dropped."""
HEAD_BYTES = 70_000
"""What is kept of it: its topic and its number stand there."""
PIECE_BYTES = 64 << 10
PUBLISH = 0x30


class _Head(bytearray):
    """The first bytes of what is added to it."""

    def __iadd__(self, data: Any) -> _Head:  # type: ignore[misc]
        if len(self) < HEAD_BYTES:
            self.extend(data[: HEAD_BYTES - len(self)])
        return self


class BoundedClient(Client):
    """`dropped`: messages that were too long."""

    dropped = 0

    def _sock_recv(self, bufsize: int) -> bytes:
        packet = self._in_packet
        if (
            packet["have_remaining"]
            and packet["remaining_length"] > MAX_BYTES
            and not isinstance(packet["packet"], _Head)
        ):
            packet["packet"] = _Head(packet["packet"])
        return super()._sock_recv(min(bufsize, PIECE_BYTES))

    def _packet_handle(self) -> MQTTErrorCode:
        if not isinstance(self._in_packet["packet"], _Head):
            return super()._packet_handle()
        self.dropped += 1
        command, head = self._in_packet["command"], bytes(self._in_packet["packet"])
        qos, at = (command >> 1) & 3, 2 + int.from_bytes(head[:2], "big")
        if command & 0xF0 == PUBLISH and qos == 1:
            return self._send_puback(int.from_bytes(head[at : at + 2], "big"))
        return MQTTErrorCode.MQTT_ERR_SUCCESS if command & 0xF0 == PUBLISH else MQTTErrorCode.MQTT_ERR_PROTOCOL
