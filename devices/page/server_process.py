"""The process that serves a page: started, started again when it ends, and heard."""

from __future__ import annotations

import json
import os
import subprocess
import threading
import time
from contextlib import suppress
from typing import Any, Protocol

import structlog

from kinegraph.devices.page.transfer.handover import Handover
from kinegraph.devices.page.transfer.pipe import ServerPipe
from kinegraph.devices.page.transfer.wire import OPTIONS
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.subprocesses import child

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
NICE = 10
"""How far the server's priority is below the session's, from its first instant: to load it costs a second of a processor."""

log = structlog.get_logger(__name__)


class Served(Protocol):
    """A page, as the process that serves it needs it."""

    def options(self) -> str:
        """What the server is started with."""

    def greeting(self) -> list[bytes]:
        """The first messages to a server that has started."""

    def answer(self, asked: dict[str, Any]) -> None:
        """Do what the server, or somebody by way of it, asks for. Raises KinegraphError for what cannot be understood."""


class ServerProcess:
    """Keeps a page served until the session is over."""

    def __init__(self, module: str, called: str, page: Served, handover: Handover, over: threading.Event) -> None:
        """`module` is what is run, `called` what people call it."""
        self._module, self._called = module, called
        self._page, self._handover, self._over = page, handover, over

    def run(self) -> None:
        """One server after another, until the session is over."""
        pause = FIRST_PAUSE_S
        while not self._over.is_set():
            began = time.monotonic()
            try:
                self._serve()
            except (OSError, ValueError) as error:
                log.debug("the page's server has ended", error=str(error))
            if self._over.is_set():
                break
            pause = FIRST_PAUSE_S if time.monotonic() - began > LONGEST_PAUSE_S else min(2 * pause, LONGEST_PAUSE_S)
            log.warning(f"the {self._called}'s server has ended; it is started again", in_s=pause)
            self._over.wait(pause)

    def _serve(self) -> None:
        """One server, from its start until it or the session ends."""
        handover = self._handover
        # unlike arguments, no other user sees the environment: the token is among the options
        given = {**os.environ, OPTIONS: self._page.options()}
        with subprocess.Popen(
            child(self._module), env=given, stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
        ) as server:
            assert server.stdin
            _yielding(server.pid)
            pipe = ServerPipe(server.stdin.fileno())
            try:
                pipe.write([[part] for part in self._page.greeting()])
                handover.channel.lead_to(pipe)
                handover.give(pipe)
                threading.Thread(target=self._hear, args=(server,), name="page answers", daemon=True).start()
                while not self._over.wait(handover.tick_s) and server.poll() is None:
                    handover.give(pipe)
                if self._over.is_set():
                    handover.give_last(pipe)
            finally:
                handover.channel.lead_to(None)
                with suppress(OSError):
                    server.stdin.close()
                _end(server)

    def _hear(self, server: subprocess.Popen[bytes]) -> None:
        """What the server asks for, line by line."""
        assert server.stdout
        for line in server.stdout:
            try:
                asked = json.loads(line)
                self._page.answer(asked)
            except KinegraphError as error:
                log.warning("not understood", asked_on_the_page=asked, error=str(error))
            except Exception as error:  # noqa: BLE001 - the session does not end because of its page
                log.warning("the page asked for something impossible", error=str(error))


def _yielding(pid: int) -> None:
    """Views wait where the machine is busy; samples do not."""
    if hasattr(os, "setpriority"):
        with suppress(OSError):
            os.setpriority(os.PRIO_PROCESS, pid, NICE)


def _end(server: subprocess.Popen[bytes]) -> None:
    try:
        server.wait(3)
    except subprocess.TimeoutExpired:
        server.kill()
