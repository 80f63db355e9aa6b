"""The agent at a bed: keeps `kinegraph run` going, reports whether it runs, takes a new graph, and goes back where that does not work.

Everything it needs is in its folder, so that a bed goes on without the centre, and after a power cut:

agent.json      which graph runs, what was before the last order (a graph, or a version), the last order
graph-*.yaml    graphs, by digest
session*        recordings
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as installed_version
from pathlib import Path
from typing import Any

import structlog

from kinegraph.devices.nats import link as links
from kinegraph.devices.nats.messages import digest_of, subject
from kinegraph.devices.nats.server import NatsServer
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.recording.format.checkpoint import NAME as CHECKPOINT
from kinegraph.stream.recording.format.paths import parts_of
from kinegraph.stream.system.atomic_file import private_folder, write_complete
from kinegraph.stream.text.time_text import for_names

COMMAND = (sys.executable, "-P", "-c", "from kinegraph.stream.cli.main import main; main()")

REPORT_S = 5.0
WATCH_S = 60.0
"""A new graph that ends within this time is not kept."""
PAUSE_S = 5.0
"""Between two starts."""
STOP_S = 60.0
KEPT = "agent.json"

log = structlog.get_logger(__name__)


def installed() -> str:
    """The version of kinegraph that the next start runs; not that of this process, which may have had another installed.

    "" where a failed installation has left no version: the bed is still watched and reported.
    """
    try:
        return installed_version("kinegraph")
    except PackageNotFoundError:
        return ""


class Agent:
    """One bed's agent. `turn` does what is due and returns; `serve` repeats it."""

    def __init__(
        self,
        bed: str,
        home: Path,
        server: NatsServer,
        *,
        command: Sequence[str] = COMMAND,
        install: Sequence[str] = (),
        watch_s: float = WATCH_S,
    ) -> None:
        """`install` installs a version; its number is appended. Without it versions are refused."""
        self.bed, self.home, self._command, self._install, self._watch_s = bed, home, command, install, watch_s
        private_folder(home)
        self.kept: dict[str, Any] = {"graph": "", "before": "", "version_before": "", "order": {}}
        with suppress(OSError, ValueError):
            self.kept |= json.loads((home / KEPT).read_text(encoding="utf-8"))
        self._child: subprocess.Popen[bytes] | None = None
        self._started_s = self._reported_s = -1e9
        self._failed = self._changed = False
        self.restarts = 0
        self._orders: list[dict[str, Any]] = []
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._link = links.Link(server, f"kinegraph agent {bed}", f"_INBOX_{bed}")
        self._link.subscribe(subject(bed, "ask", "order"), self._ordered)

    def use(self, graph: Path) -> None:
        """The graph to begin with. Raises KinegraphError where there is none."""
        try:
            text = graph.read_text(encoding="utf-8")
        except OSError as error:
            raise KinegraphError(f"{graph}: {error.strerror or error}") from None
        if not self.kept["graph"]:
            self._keep(graph=self._stored(text))

    def adopt(self, account: Path) -> None:
        """Copy the account beside the graphs: `account: server.yaml` in them is this bed's, whichever bed they are rolled out to."""
        for name in ("server.yaml", "password", "ca.pem"):
            there = account.with_name(name) if name != "server.yaml" else account
            if there.exists() and there.absolute() != self.home / name:
                write_complete(self.home / name, there.read_bytes())

    def serve(self) -> None:
        """Until `stop`."""
        try:
            while not self._stop.wait(0.2):
                self.turn()
        finally:
            self._end_child()
            self._report()
            self._link.close()

    def stop(self) -> None:
        self._stop.set()

    def turn(self) -> None:
        """Start what should run, take orders, watch a new graph, report."""
        now = time.monotonic()
        with self._lock:
            orders, self._orders = self._orders, []
        for order in orders:
            self._take(order)
        ended = self._child is not None and self._child.poll() is not None
        if ended and self._child:
            self._failed, self._changed = self._child.returncode not in (0, -signal.SIGINT), True
            self._child = None
        order = self.kept["order"]
        if order.get("state") == "watched":
            if ended and self._failed:
                self._back(f"it ended within {now - self._started_s:.0f} s")
            elif now - self._started_s > self._watch_s:
                self._keep(order={**order, "state": "done"})
        if self._child is None and self.kept["graph"] and now - self._started_s > PAUSE_S:
            self._start()
        if self._changed or time.monotonic() - self._reported_s > REPORT_S:
            self._report()

    @property
    def running(self) -> bool:
        return self._child is not None and self._child.poll() is None

    # the process ---------------------------------------------------------------------------------------------------------

    def _start(self) -> None:
        folder = self.home / "session"
        resume = []
        if parts_of(folder):
            if (folder / CHECKPOINT).exists():
                resume = ["--resume"]
            else:
                folder.rename(self.home / f"session-{for_names()}")
        self._started_s, self._changed = time.monotonic(), True
        self.restarts += 1
        with (self.home / "output.txt").open("ab") as output:
            self._child = subprocess.Popen(
                [*self._command, "run", str(self.home / self.kept["graph"]), "-o", str(folder), *resume, "--view", "none"],
                cwd=self.home, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True,
            )  # fmt: skip

    def _end_child(self) -> None:
        child, self._child = self._child, None
        if child is None or child.poll() is not None:
            return
        child.send_signal(signal.SIGINT)
        try:
            child.wait(STOP_S)
        except subprocess.TimeoutExpired:
            child.kill()
            child.wait()

    # orders --------------------------------------------------------------------------------------------------------------

    async def _ordered(self, request: Any) -> None:
        """An order from the centre: it is taken at the next turn, and the answer is what is known of it now."""
        try:
            order = json.loads(request.data)
            known = self.kept["order"].get("id") == order["id"]
        except (ValueError, KeyError, TypeError):
            return
        if not known:
            with self._lock:
                self._orders.append(order)
        await request.respond(json.dumps({"taken": not known}).encode())

    def _take(self, order: dict[str, Any]) -> None:
        """A graph or a version to change to, or the way back."""
        id, self._changed = str(order.get("id", "")), True
        if id == self.kept["order"].get("id"):
            return
        if order.get("back"):
            self._keep(order={"id": id, "state": "watched", "text": ""})
            self._back("asked for")
        elif "version" in order:
            self._take_version(id, str(order["version"]))
        else:
            text = str(order.get("graph", ""))
            name = self._stored(text)
            wrong = self._checked(name)
            if wrong:
                self._keep(order={"id": id, "state": "refused", "text": wrong})
                return
            self._change(name, {"id": id, "state": "watched", "text": ""})

    def _take_version(self, id: str, version: str) -> None:
        if not self._install or not version or set(version) - set("0123456789.abrcdevpost+"):
            self._keep(order={"id": id, "state": "refused", "text": "this bed installs no versions"})
            return
        before = installed()
        done = subprocess.run([*self._install, version], capture_output=True, text=True, check=False)
        if done.returncode:
            self._keep(order={"id": id, "state": "refused", "text": done.stderr.strip()[-200:]})
            return
        self._keep(version_before=before, order={"id": id, "state": "watched", "text": "", "version": version})
        self._again()

    def _checked(self, name: str) -> str:
        """Why a graph cannot be run; "" where it can. Only what is installed is run: an order brings no code."""
        done = subprocess.run(
            [*self._command, "check", "--trusted-only", str(self.home / name)],
            cwd=self.home, capture_output=True, text=True, check=False,
        )  # fmt: skip
        return (
            "" if not done.returncode else (done.stderr or done.stdout).strip()[-300:] or "it does not pass the check"
        )

    def _change(self, name: str, order: dict[str, Any]) -> None:
        self._end_child()
        if parts_of(self.home / "session"):
            (self.home / "session").rename(self.home / f"session-{for_names()}-{order['id'][:6]}")
        self._keep(graph=name, before=self.kept["graph"], version_before="", order=order)
        self._start()

    def _again(self) -> None:
        """The same graph, as what is installed now runs it."""
        self._end_child()
        self._start()

    def _back(self, why: str) -> None:
        """To what was before the last order: a version, where that was one, or a graph."""
        order, before, version = self.kept["order"], self.kept["before"], self.kept["version_before"]
        if version:
            done = subprocess.run([*self._install, version], capture_output=True, text=True, check=False)
            text = f"{why}; {version} cannot be installed: {done.stderr.strip()[-200:]}" if done.returncode else why
            self._keep(version_before="", order={**order, "state": "rolled back", "text": text})
            self._again()
        elif before:
            self._change(before, {**order, "state": "rolled back", "text": why})
        else:
            self._keep(order={**order, "state": "rolled back", "text": f"{why}; there is no graph before"})

    def _stored(self, text: str) -> str:
        name = f"graph-{digest_of(text)}.yaml"
        write_complete(self.home / name, text)
        return name

    def _keep(self, **facts: Any) -> None:
        self.kept |= facts
        self._changed = True
        write_complete(self.home / KEPT, json.dumps(self.kept))

    def _report(self) -> None:
        self._reported_s, self._changed = time.monotonic(), False
        facts = {
            "bed": self.bed,
            "running": self.running,
            "failed": self._failed,
            "restarts": self.restarts,
            "version": installed(),
            "digest": self.kept["graph"].removeprefix("graph-").removesuffix(".yaml"),
            "free_bytes": shutil.disk_usage(self.home).free,
            "order": self.kept["order"],
        }
        self._link.publish(subject(self.bed, "agent"), json.dumps(facts).encode())
