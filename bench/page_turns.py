"""Turns of a session with a page: so many clients, one that stalls, a server that is killed; what that does to ages and processor time."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from bench.page_clients import company
from bench.page_session import CHUNK, PATIENCE_S, RATE_HZ, WARM_S, looks, session
from bench.report import short
from kinegraph.devices.page.transfer.wire import decode

PROCESS_CLOCK = 2
"""CPUCLOCK_SCHED: of the clocks that Linux keeps of a process, the exact one."""


@dataclass(slots=True)
class Turn:
    """What one turn of a session came to.

    ages        ms, of every message of the first client: of its last sample, when it was there
    graph       ms, of every chunk at the graph's last operator
    begun       set when the first message is there
    session, server   share of a processor
    updates     messages per second
    """

    ages: list[float] = field(default_factory=list)
    graph: list[float] = field(default_factory=list)
    begun: threading.Event = field(default_factory=threading.Event)
    session: float = 0.0
    server: float = 0.0
    updates: float = 0.0


def cpu_s(pid: int) -> float:
    """Processor time of a process so far, children apart, to the nanosecond (Linux's clock of another process); 0 for one that is gone."""
    try:
        return time.clock_gettime(~pid << 3 | PROCESS_CLOCK)
    except OSError:
        return 0.0


def watch(url: str, turn: Turn, kind: str, stop: threading.Event) -> None:
    """Take messages, and note how old the newest sample of each is."""
    with connect(url, max_size=None, compression=None, ping_interval=None) as client:
        hello, _ = decode(client.recv(decode=False))
        client.send(json.dumps({"do": "see", "streams": {"0": 0}}))
        began = float("inf")
        while not stop.is_set():
            try:
                header, numbers = decode(client.recv(timeout=PATIENCE_S, decode=False))
            except (TimeoutError, ConnectionClosed):
                return
            if header["t"] != kind:
                continue
            if not turn.begun.is_set():
                began = time.monotonic()
                turn.begun.set()
            if time.monotonic() - began < WARM_S:
                continue
            at = header["at"] if kind == "mesh" else float(np.frombuffer(numbers, np.float64, header["n"])[-1])
            turn.ages.append(1000 * (time.time() - hello["t0_ms"] / 1000 - at))


def stall(url: str, stop: threading.Event) -> None:
    """Subscribe to everything, and read nothing."""
    with connect(url, max_size=None, max_queue=1, compression=None, ping_interval=None) as client:
        looks(client, 0)
        stop.wait()


def servers(process: subprocess.Popen[bytes]) -> list[int]:
    """The processes that a session has started."""
    output = subprocess.run(
        ["ps", "-o", "pid=", "--ppid", str(process.pid)], capture_output=True, text=True, check=False
    )
    return [*map(int, output.stdout.split())]


def kill(process: subprocess.Popen[bytes], stop: threading.Event) -> None:
    """End the page's server every second."""
    while not stop.wait(1.0):
        for pid in servers(process):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def take_turn(graph: str, kind: str, clients: int, seconds: float, *, page: bool = True, harm: str = "") -> Turn:
    """One session with so many clients; `harm`: one more "stalls", or the server is "killed" again and again."""
    turn, stop = Turn(), threading.Event()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        with session(folder, graph, page=page) as (process, url):
            stack.enter_context(company(url, clients - 1 if clients else 0))
            jobs: list[tuple[Callable[..., None], tuple[Any, ...]]]
            jobs = [(watch, (url, turn, kind, stop))] if clients else []
            jobs += (
                [(stall, (url, stop))] if harm == "stalls" else [(kill, (process, stop))] if harm == "killed" else []
            )
            threads = [threading.Thread(target=job, args=given) for job, given in jobs]
            for thread in threads:
                thread.start()
            if clients:
                turn.begun.wait(PATIENCE_S)
            time.sleep(WARM_S)
            turn.session, turn.server, lasted = shares(process, seconds)
            stop.set()
            for thread in threads:
                thread.join()
        turn.updates = len(turn.ages) / lasted
        ages = folder / "ages.json"
        turn.graph = [age / 1e6 for age in json.loads(ages.read_text())[RATE_HZ // CHUNK :]] if ages.exists() else []
    return turn


def shares(process: subprocess.Popen[bytes], seconds: float) -> tuple[float, float, float]:
    """Processor time of a session and of its servers over so many seconds, as shares of a core, and how long that was."""
    pids = [process.pid, *servers(process)]
    before, began = [cpu_s(pid) for pid in pids], time.monotonic()
    time.sleep(seconds)
    lasted = time.monotonic() - began
    own, *others = [max(0.0, cpu_s(pid) - then) / lasted for pid, then in zip(pids, before, strict=True)]
    return own, sum(others), lasted


def both(values: Any) -> str:
    """The median and the 99th percentile."""
    return f"{short(float(np.percentile(values, 50)))}, {short(float(np.percentile(values, 99)))}"
