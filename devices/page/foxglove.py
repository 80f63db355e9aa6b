"""`--foxglove`: the same streams for Foxglove and Lichtblick, through the Foxglove SDK's WebSocket server, in a process of its own.

Signals, events, markers and poses are JSON messages, one per sample, as `kinegraph files export --format foxglove` writes them; depth
frames are `foxglove.RawImage`. A stream is asked for while somebody subscribes to it. The protocol knows no token, and the SDK looks at no
Origin; so it is served to this machine alone, and cannot control the session.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from typing import Any

import msgspec
import numpy as np

from kinegraph.devices.formats.table.foxglove_writer import JsonMessages
from kinegraph.devices.page.server import say
from kinegraph.devices.page.transfer.catalogue import kind_of
from kinegraph.devices.page.transfer.wire import LENGTH, MAX_BYTES, OPTIONS, decode
from kinegraph.stream.chunk import NS, Chunk, StreamSpec

BACKLOG = 4096
"""Messages that wait for a client that is slow; then the oldest are dropped."""
MAX_COLUMNS = 256
"""A sample of more numbers is no JSON message."""


class Bridge:
    """Streams on their way to the SDK's channels; `wanted` are those that somebody subscribes to."""

    def __init__(self, header: dict[str, Any], host: str, port: int) -> None:
        import foxglove

        self.specs = [StreamSpec.from_json(spec) for spec in header["specs"]]
        self.context = foxglove.Context()
        names = [stream["name"] for stream in header["streams"]]
        self.messages = {i: JsonMessages(names[i], spec) for i, spec in enumerate(self.specs) if is_json(spec)}
        self.channels: dict[int, Any] = {}
        for i, spec in enumerate(self.specs):
            if i in self.messages:
                schema = foxglove.Schema(name=names[i], encoding="jsonschema", data=self.messages[i].schema)
                self.channels[i] = foxglove.Channel(
                    names[i], schema=schema, message_encoding="json", context=self.context
                )
            elif kind_of(spec) == "frame" and spec.dtype == np.uint16:
                self.channels[i] = foxglove.channels.RawImageChannel(names[i], context=self.context)
        self._numbers = {names[i]: i for i in self.channels}
        self._lock, self._subscribers = threading.Lock(), dict.fromkeys(self.channels, 0)
        self.server = foxglove.start_server(
            name=header["name"], host=host, port=port, context=self.context, server_listener=listener(self),
            message_backlog_size=BACKLOG,
        )  # fmt: skip

    def note(self, topic: str, change: int) -> None:
        with self._lock:
            self._subscribers[self._numbers[topic]] += change
            wanted = [i for i, n in self._subscribers.items() if n > 0]
            say({"do": "want", "streams": wanted, "seen": bool(wanted)})

    def give(self, number: int, chunk: Chunk) -> None:
        """Samples, as messages."""
        if number not in self.channels:
            return
        if number in self.messages:
            for stamp, data in self.messages[number].of(chunk):
                self.channels[number].log(data, log_time=stamp)
            return
        from foxglove.messages import RawImage, Timestamp

        for stamp, frame in zip(chunk.time.tolist(), chunk.data, strict=True):
            height, width = frame.shape
            image = RawImage(
                timestamp=Timestamp(stamp // NS, stamp % NS), width=width, height=height, encoding="16UC1", step=2 * width,
                data=np.ascontiguousarray(frame, "<u2").tobytes(),
            )  # fmt: skip
            self.channels[number].log(image, log_time=stamp)


def listener(bridge: Bridge) -> Any:
    """Tells the bridge of subscriptions."""
    from foxglove.websocket import ServerListener

    class Subscriptions(ServerListener):
        def on_subscribe(self, client: Any, channel: Any) -> None:
            bridge.note(channel.topic, 1)

        def on_unsubscribe(self, client: Any, channel: Any) -> None:
            bridge.note(channel.topic, -1)

    return Subscriptions()


def is_json(spec: StreamSpec) -> bool:
    """Whether a stream's samples are JSON messages."""
    size = 1 if spec.is_event else int(np.prod(spec.shape))
    return kind_of(spec) in ("signal", "events", "points", "pose") and size <= MAX_COLUMNS


def main(options: dict[str, Any]) -> None:
    """Serve until the session ends."""
    bridge: Bridge | None = None
    heard = sys.stdin.buffer
    while len(head := heard.read(LENGTH.size)) == LENGTH.size:
        (length,) = LENGTH.unpack(head)
        if length > MAX_BYTES or len(message := heard.read(length)) < length:
            break
        header, numbers = decode(message)
        if header["t"] == "hello":
            bridge = Bridge(header, options["host"], options["port"])
            say({"do": "listen", "port": bridge.server.port})
        elif header["t"] == "chunk" and bridge:
            spec, n = bridge.specs[header["s"]], header["n"]
            time = np.frombuffer(numbers, np.int64, n)
            data = np.frombuffer(numbers, spec.dtype, offset=8 * n).reshape(n, *spec.shape)
            bridge.give(header["s"], Chunk(time, data, header["until"], header["lost"]))
    if bridge:
        bridge.server.stop()


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C ends the session, which then ends us
    main(msgspec.json.decode(os.environ.pop(OPTIONS)))
