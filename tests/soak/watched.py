"""A session as a process to which faults happen, with its device and its broker."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from kinegraph.devices.lines.indexed_simulator import Indexed
from kinegraph.devices.page.transfer.wire import decode
from kinegraph.devices.simulation.cable import line_at
from kinegraph.devices.simulation.fault_injection import FaultInjection
from kinegraph.devices.simulation.serve import Server
from tests.soak.faults import Kind
from tests.soak.uses import RATE_HZ, Use
from tests.support.mosquitto import Mosquitto

ENDING_S = 90.0
CALM_S = 6.0
SLOW_CLIENTS = 3
PAGE = re.compile(r"page: (http\S+)")
LOOSE = FaultInjection(lose=0.002, duplicate=0.001)
"""Beside everything else, single lines get lost on the way, or come twice."""
STARVED_S = 0.2
"""A session of which a thread has waited so long for a processor within a second is disturbed, as if it had been stopped."""
START_S = 20.0
"""The most that a session takes from the start of its process to its first sample, on a busy machine."""
ROOT = Path(__file__).resolve().parents[2]


@dataclass(slots=True)
class Held:
    """What a process holds at a moment. Pages of libraries' files, which the system drops and reads again as it likes, are not counted."""

    own_kb: int
    files: int
    threads: int

    @classmethod
    def by(cls, pid: int) -> Held | None:
        """None: there is no such process any more."""
        try:
            status = dict(
                line.split(":", 1) for line in Path(f"/proc/{pid}/status").read_text().splitlines() if ":" in line
            )
            files = sum(1 for _ in Path(f"/proc/{pid}/fd").iterdir())
            own_kb = sum(int(status[kind].split()[0]) for kind in ("RssAnon", "RssShmem"))
            return cls(own_kb, files, int(status["Threads"]))
        except (OSError, KeyError):
            return None


def waited(pid: int) -> dict[str, int]:
    """How long (ns) each thread of a process has waited for a processor so far; empty if the system does not say."""
    found = {}
    for path in Path(f"/proc/{pid}/task").glob("*/schedstat"):
        with suppress(OSError):
            found[path.parent.name] = int(path.read_text().split()[1])
    return found


@dataclass
class Watched:
    """One use's session, from its start through every kill to its end; everything of it lies in `folder`.

    ends   the exit code of every process of it; -9 where it was killed
    disturbed  when something was last wrong, or will have started; or the machine last had no processor for it
    filled whether the disk was full during the life of the newest process
    lives  what each process held, as often as it was looked at
    kills  the device's next index at each kill, and whether nothing had been wrong for `CALM_S` then
    """

    use: Use
    folder: Path
    options: tuple[str, ...] = ()
    ends: list[int] = field(default_factory=list)
    lives: list[list[Held]] = field(default_factory=list)
    kills: list[tuple[int, bool]] = field(default_factory=list)
    wrong: set[Kind] = field(default_factory=set)
    disturbed: float = 0.0
    filled: bool = False

    def __post_init__(self) -> None:
        self.folder.mkdir(parents=True)
        self.switches = self.folder / "switches"
        self.switches.mkdir()
        self.broker = Mosquitto(self.folder).start()
        self._since = time.monotonic()
        self.device = Server(Indexed(rate_hz=RATE_HZ).brain(), line_at("", Indexed.port_name), LOOSE)
        self.graph = self.use.write(self.folder, self.device.address, self.broker.port)
        self.log = (self.folder / "log.txt").open("ab")
        self._process: subprocess.Popen[bytes] | None = None
        self._clients = ExitStack()
        self._waited: dict[str, int] = {}

    @property
    def session(self) -> Path:
        return self.folder / "session"

    @property
    def going(self) -> bool:
        """Whether anything has been recorded, so that a killed session can go on."""
        return self._begun > 0

    @property
    def _begun(self) -> int:
        """How many files there are that hold something: each process begins one of its own."""
        return sum(path.stat().st_size > 0 for path in self.session.glob("session.*.mcap"))

    @property
    def offered(self) -> int:
        """How many samples the device has made so far."""
        return int((time.monotonic() - self._since) * RATE_HZ)

    def start(self) -> None:
        """Begin the session, or go on with it where it was killed."""
        resume = ["--resume"] if self.going else []
        settings = [word for one in (*self.use.live, *self.options) for word in ("--set", one)]
        call = [sys.executable, "-m", "tests.soak.process", str(self.switches), "run", str(self.graph), *settings]
        self._said, self._former = self.log.tell(), self._begun
        self._process = subprocess.Popen(
            [*call, "-o", str(self.session), *resume, "--view", "none", "--page-at", ":0", "--no-token"],
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=self.log,
            stderr=self.log,
            env={**os.environ, "PYTHONPATH": str(ROOT)},
        )
        self.disturbed = time.monotonic() + START_S
        self.filled = "full disk" in self.wrong
        self.lives.append([])

    def happens(self, kind: Kind) -> None:
        self.wrong.add(kind)
        self.filled |= kind == "full disk"

    def is_over(self, kind: Kind) -> None:
        self.wrong.discard(kind)
        self.disturbed = time.monotonic()

    @property
    def alive(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def look(self) -> None:
        """Note what the process holds."""
        if self._process and self.alive and (held := Held.by(self._process.pid)):
            self.lives[-1].append(held)
            before, self._waited = self._waited, waited(self._process.pid)
            if self._begun <= self._former or any(
                ns - before.get(thread, ns) > STARVED_S * 1e9 for thread, ns in self._waited.items()
            ):
                self.disturbed = max(self.disturbed, time.monotonic())

    def send(self, number: signal.Signals) -> None:
        if self._process and self.alive:
            self._process.send_signal(number)

    def look_slowly(self) -> bool:
        """Open the page in clients that ask for every stream and then read nothing; whether it was there."""
        with (self.folder / "log.txt").open("rb") as log:
            log.seek(self._said)
            found = PAGE.findall(log.read().decode(errors="replace"))
        if not self.alive or not found:
            return False
        try:
            for _ in range(SLOW_CLIENTS):
                looking = connect(
                    found[-1].replace("http", "ws", 1) + "socket",
                    max_size=None, compression=None, ping_interval=None, close_timeout=0.1, max_queue=1,
                )  # fmt: skip
                client = self._clients.enter_context(looking)
                hello, _ = decode(client.recv(timeout=ENDING_S))
                streams = {str(i): 0 for i in range(len(hello["streams"]))}
                client.send(json.dumps({"do": "see", "streams": streams}))
        except (OSError, WebSocketException, TimeoutError, EOFError):
            self.look_away()
            return False
        return True

    def look_away(self) -> None:
        """End all clients."""
        self._clients.close()
        self._clients = ExitStack()

    def kill(self) -> None:
        self.kills.append((self.offered, not self.wrong and time.monotonic() - self.disturbed > CALM_S))
        self.send(signal.SIGKILL)
        self._wait()

    def end(self) -> None:
        """As a person would, with everything in order; the device goes on for as long as the session takes to end.

        One that was just started records first: asked to end while kernels are compiled, it would leave things as they were.
        """
        self.send(signal.SIGCONT)
        deadline = time.monotonic() + ENDING_S
        while self.alive and self._begun <= self._former and time.monotonic() < deadline:
            time.sleep(0.05)
        self.send(signal.SIGTERM)
        self._wait()

    def _wait(self) -> None:
        if self._process:
            try:
                self.ends.append(self._process.wait(ENDING_S))
            except subprocess.TimeoutExpired:
                self._process.kill()
                self.ends.append(self._process.wait())
                self.log.write(b"soak: the session did not end within a minute and a half, and was killed\n")
            self._process = None

    def close(self) -> None:
        self.look_away()
        if self._process:
            self.kill()
        self.device.close()
        self.broker.stop()
        self.log.close()
