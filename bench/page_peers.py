"""16 channels at 2000 Hz to a headless client: our page beside timeflux_ui and the Foxglove SDK's server, in turns."""

from __future__ import annotations

import json
import struct
import subprocess
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from bench.engines import EngineError, environment
from bench.page_session import GRAPH, HOUSE, PATIENCE_S, WARM_S
from bench.page_turns import Turn, both, cpu_s, take_turn
from bench.report import Section, short

MESSAGE = struct.Struct("<BIQ")
"""Of Foxglove's protocol: opcode, subscription, stamp (ns)."""


def beside(rounds: int, seconds: float) -> Section:
    """Who installs, in turns with our own."""
    pythons: dict[str, tuple[Path, str, Callable[..., None]]] = {}
    absent = []
    for peer, packages, module, watch in PEERS:
        try:
            pythons[peer] = (environment(module, packages), module, watch)
        except (EngineError, OSError, subprocess.SubprocessError) as error:
            absent.append(str(error))
    turns: dict[str, list[Turn]] = {"kinegraph": [], **{name: [] for name in pythons}}
    for _ in range(rounds):
        turns["kinegraph"].append(take_turn(GRAPH, "signal", 1, seconds))
        for name, (python, module, watch) in list(pythons.items()):
            try:
                turns[name].append(peer_turn(python, module, watch, seconds))
            except (RuntimeError, OSError, AssertionError) as error:
                absent.append(f"{name}: {error}")
                del pythons[name], turns[name]
    rows = [
        [name, both(np.concatenate([t.ages for t in taken])), short(float(np.median([t.updates for t in taken]))),
         short(100 * float(np.median([t.session + t.server for t in taken])))]
        for name, taken in turns.items()
    ]  # fmt: skip
    notes = [f"Left out: {'; '.join(absent)}."] if absent else []
    notes.append(
        "The age is that of the newest sample of each message when a headless client has it. Of kinegraph it is the whole session: the "
        "source, an envelope and an operator beside the page; of the others a source and the server alone. timeflux_ui's stamps are whole "
        "milliseconds, and of samples with the same one it sends the last: every other sample at 2000 Hz."
    )
    return Section(
        f"Beside others, {rounds} rounds of {seconds:g} s",
        ["", "client ms p50, p99", "messages/s", "all processes %"],
        rows,
        notes,
    )


@contextmanager
def contender(python: Path, module: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A peer at work, and its port."""
    command = [str(python), "-m", f"bench.contenders.{module}"]
    with subprocess.Popen(command, cwd=HOUSE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stdout
            line = process.stdout.readline()
            if not line.strip().isdigit():
                raise RuntimeError(f"it does not start (exit code {process.wait(10)})")
            yield process, int(line)
        finally:
            process.kill()


def peer_turn(python: Path, module: str, watch: Callable[..., None], seconds: float) -> Turn:
    """One turn of a peer with one client."""
    turn, stop = Turn(), threading.Event()
    with contender(python, module) as (process, port):
        client = threading.Thread(target=watch, args=(port, turn, stop))
        client.start()
        if not turn.begun.wait(PATIENCE_S):
            stop.set()
            raise RuntimeError("no message came")
        time.sleep(WARM_S)
        turn.ages.clear()
        before, began = cpu_s(process.pid), time.monotonic()
        time.sleep(seconds)
        lasted = time.monotonic() - began
        turn.session, turn.updates = (cpu_s(process.pid) - before) / lasted, len(turn.ages) / lasted
        stop.set()
        client.join(PATIENCE_S)
    return turn


def watch_timeflux(port: int, turn: Turn, stop: threading.Event) -> None:
    """Subscribe as timeflux's own monitor does."""
    with connected(f"ws://127.0.0.1:{port}/ws?uuid=bench") as client:
        client.send(json.dumps({"command": "subscribe", "payload": "board"}))
        while not stop.is_set():
            record = json.loads(client.recv(timeout=PATIENCE_S))
            if record["command"] == "stream" and record["payload"]["data"]:
                turn.ages.append(1000 * time.time() - max(map(int, record["payload"]["data"])))
                turn.begun.set()


def watch_foxglove(port: int, turn: Turn, stop: threading.Event) -> None:
    """Subscribe as Foxglove does."""
    with connected(f"ws://127.0.0.1:{port}", subprotocols=[Subprotocol("foxglove.sdk.v1")]) as client:
        while not stop.is_set():
            result = client.recv(timeout=PATIENCE_S)
            if isinstance(result, bytes):
                if result[0] == 1:
                    json.loads(result[MESSAGE.size :])
                    turn.ages.append((time.time_ns() - MESSAGE.unpack_from(result)[2]) / 1e6)
                    turn.begun.set()
            elif (record := json.loads(result))["op"] == "advertise":
                wanted = [{"id": 1, "channelId": record["channels"][0]["id"]}]
                client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


PEERS: list[tuple[str, list[str], str, Callable[..., None]]] = [
    ("timeflux_ui", ["timeflux", "timeflux_ui", "pandas<3"], "timeflux_page", watch_timeflux),
    ("the Foxglove SDK, a JSON message per sample", ["foxglove-sdk", "numpy"], "foxglove_page", watch_foxglove),
]
"""What they are called, what is installed, what runs, and who watches."""


@contextmanager
def connected(url: str, **options: object) -> Iterator[object]:
    """A client; how its connection ends is of no interest."""
    end = time.monotonic() + PATIENCE_S
    while True:
        try:
            client = connect(url, max_size=None, compression=None, ping_interval=None, close_timeout=0.5, **options)
            break
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.1)
    try:
        with client:
            yield client
    except (TimeoutError, ConnectionClosed):
        return
