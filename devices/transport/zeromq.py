"""Messages of ZeroMQ, behind the interface of a serial port: each read gives one; extra `zmq`."""

from __future__ import annotations

from kinegraph.devices.transport.closing import ClosesAtExit
from kinegraph.stream.errors import DeviceError
from kinegraph.stream.system.extras import optional

SCHEME = "zmq+"
MAX_WAITING = 10_000
"""Messages that are kept unread; ZeroMQ drops the rest."""


class ZeroMqTransport(ClosesAtExit):
    """Subscribes to "zmq+tcp://host:port" or "zmq+ipc://path": all of it, or "...?topic=TEXT" what begins so; the publisher binds.

    Of a message of several parts, the last one is taken: those before it are topics. ZeroMQ itself connects again to a publisher that
    comes back, which nothing tells: only a counter or a time in the messages knows what was lost.
    """

    def __init__(self, address: str) -> None:
        zmq = optional("zmq", "ZeroMQ", "pip install 'kinegraph[zmq]'", DeviceError)
        self.address = address
        where, _, topic = address.removeprefix(SCHEME).partition("?topic=")
        self._zmq = zmq
        self._context = zmq.Context()
        self._socket = self._context.socket(zmq.SUB)
        self._socket.set(zmq.LINGER, 0)
        self._socket.set(zmq.RCVHWM, MAX_WAITING)
        try:
            self._socket.connect(where)
        except zmq.ZMQError as error:
            self.close()
            raise DeviceError(
                f"{address!r} cannot be subscribed to: {error}; write zmq+tcp://host:port or zmq+ipc://path"
            ) from None
        self._socket.set(zmq.SUBSCRIBE, topic.encode())

    def read(self, timeout_s: float) -> bytes:
        try:
            if not self._socket.poll(round(timeout_s * 1000)):
                return b""
            parts: list[bytes] = self._socket.recv_multipart()
        except self._zmq.ZMQError as error:
            raise DeviceError(f"{self.address} is gone: {error}") from None
        return parts[-1]

    def write(self, data: bytes) -> None:
        raise DeviceError(f"{self.address}: nothing can be sent to a publisher")

    def close(self) -> None:
        self._socket.close()
        self._context.term()
