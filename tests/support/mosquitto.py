"""A real Mosquitto broker for tests, and a client that writes down everything it hears."""

from __future__ import annotations

import contextlib
import random
import shutil
import signal
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion

PATIENCE_S = 60.0


def program() -> str:
    """The broker's program; the test is skipped where it is not installed."""
    found = shutil.which("mosquitto") or shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin")
    if not found:
        pytest.skip("no Mosquitto broker here (Debian: apt install mosquitto)")
    return found


def free_port() -> int:
    """A port below those that the system gives to connections: while a server is down, one of these may take a port of theirs."""
    for port in random.SystemRandom().sample(range(20_000, 32_000), 100):
        with contextlib.suppress(OSError), socket.socket() as place:
            place.bind(("127.0.0.1", port))
            return port
    raise OSError("no port is free")


class Mosquitto:
    """A broker on a port of this computer, which may be stopped and started; it remembers retained messages over that."""

    def __init__(self, folder: Path, port: int = 0, password: str = "") -> None:
        """`password`: that of the only user who may connect, `me`; empty: everybody may."""
        self.port = port or free_port()
        self._config = folder / "mosquitto.conf"
        kept = folder / "broker"
        kept.mkdir(exist_ok=True)
        kept.chmod(0o777)
        self._config.write_text(
            f"listener {self.port} 127.0.0.1\nallow_anonymous {str(not password).lower()}\n"
            f"persistence true\npersistence_location {kept}/\nuser root\n"
        )
        if password:
            users = folder / "users"
            subprocess.run(["mosquitto_passwd", "-c", "-b", users, "me", password], check=True, capture_output=True)
            with self._config.open("a") as file:
                file.write(f"password_file {users}\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> Mosquitto:
        self._process = subprocess.Popen(
            [program(), "-c", str(self._config)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        eventually(self._answers)
        return self

    def stop(self) -> None:
        if self._process:
            self._process.terminate()
            self._process.wait(PATIENCE_S)
            self._process = None

    def send(self, number: signal.Signals) -> None:
        if self._process:
            self._process.send_signal(number)

    def _answers(self) -> bool:
        assert self._process and self._process.poll() is None, "the broker does not start"
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False


@contextmanager
def broker(folder: Path) -> Iterator[Mosquitto]:
    made = Mosquitto(folder).start()
    try:
        yield made
    finally:
        made.stop()


class Listener:
    """A plain MQTT client: `messages` is every (topic, text, retained) in the order of arrival."""

    def __init__(self, port: int) -> None:
        self.messages: list[tuple[str, str, bool]] = []
        self._news = threading.Condition()
        self._ready = threading.Event()
        self.client = Client(CallbackAPIVersion.VERSION2, clean_session=True)
        self.client.reconnect_delay_set(1, 1)
        self.client.on_connect = lambda client, *_: client.subscribe("#", 1)
        self.client.on_subscribe = lambda *_: self._ready.set()
        self.client.on_message = lambda _c, _d, m: self._hear(m.topic, m.payload.decode(), bool(m.retain))
        self.client.connect("127.0.0.1", port)
        self.client.loop_start()
        assert self._ready.wait(PATIENCE_S)

    def _hear(self, topic: str, text: str, retained: bool) -> None:
        with self._news:
            self.messages.append((topic, text, retained))
            self._news.notify_all()

    def texts(self, topic: str) -> list[str]:
        """Live messages of a topic."""
        with self._news:
            return [text for name, text, _ in self.messages if name == topic]

    def wait(self, holds: Callable[[], bool]) -> None:
        """Until what is asked for holds; fails after a minute."""
        with self._news:
            assert self._news.wait_for(holds, PATIENCE_S), self.messages[-20:]

    def wait_for(self, topic: str, text: str | None = None) -> str:
        """Wait for a message (or `text`) of a topic; returns the last one."""
        self.wait(lambda: any(name == topic and text in (None, reported) for name, reported, _ in self.messages))
        return self.texts(topic)[-1]

    def say(self, topic: str, text: str, *, retain: bool = False) -> None:
        self.client.publish(topic, text, qos=1, retain=retain).wait_for_publish(PATIENCE_S)

    def close(self) -> None:
        self.client.disconnect()
        self.client.loop_stop()


@contextmanager
def listening(port: int) -> Iterator[Listener]:
    made = Listener(port)
    try:
        yield made
    finally:
        made.close()


def eventually(holds: Callable[[], bool]) -> None:
    """Wait until something holds; fails after a minute."""
    pause = threading.Event()
    for _ in range(round(PATIENCE_S / 0.02)):
        if holds():
            return
        pause.wait(0.02)
    raise AssertionError("it never came to be")
