"""A nats-server of this machine: its configuration, with the rights of each account, and its process."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from kinegraph.devices.nats.messages import PREFIX
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder, write_complete

STARTED_S = 20.0
PID = "nats.pid"
CENTRE = "centre"
"""The account of the centre, which may do everything."""


@dataclass(frozen=True, slots=True)
class Account:
    """Who may connect: a bed, or the centre. With a password, or with the public part of an NKey."""

    name: str
    password: str = ""
    nkey: str = ""

    @property
    def lines(self) -> str:
        who = (
            f"nkey: {self.nkey}"
            if self.nkey
            else f"user: {json.dumps(self.name)}, password: {json.dumps(self.password)}"
        )
        return f"    {{{who}{'' if self.name == CENTRE else ', ' + permissions(self.name)}}}"


def permissions(bed: str) -> str:
    """A bed writes its own subjects and reads what is asked of it, and nothing else."""
    own = f"{PREFIX}.{bed}"
    writes = json.dumps([f"{own}.data.>", f"{own}.facts.>", f"{own}.status", f"{own}.agent"])
    reads = json.dumps([f"{own}.ask.>", f"_INBOX_{bed}.>"])
    return f"permissions: {{publish: {{allow: {writes}}}, subscribe: {{allow: {reads}}}, allow_responses: true}}"


def configuration(
    port: int,
    store: Path,
    accounts: Sequence[Account],
    *,
    host: str = "127.0.0.1",
    tls: tuple[Path, Path] | None = None,
    disk_mb: int = 20_000,
) -> str:
    """What nats-server reads. Without accounts everybody may do everything, which is for tests on one machine."""
    lines = [
        f"listen: {json.dumps(f'{host}:{port}')}",
        f"jetstream {{store_dir: {json.dumps(str(store))}, max_file_store: {disk_mb}MB}}",
        "max_payload: 1MB",
    ]
    if accounts:
        lines += ["authorization {", "  users = [", *(one.lines for one in accounts), "  ]", "}"]
    if tls:
        lines.append(f"tls {{cert_file: {json.dumps(str(tls[0]))}, key_file: {json.dumps(str(tls[1]))}}}")
    return "\n".join(lines) + "\n"


def program() -> str:
    """The server's program. Raises KinegraphError where there is none."""
    found = shutil.which("nats-server") or shutil.which("nats-server", path="/usr/sbin:/usr/local/sbin:/usr/local/bin")
    if not found:
        raise KinegraphError(
            "there is no nats-server; install it (Debian: apt install nats-server), or name a server with --server"
        )
    return found


class LocalServer:
    """A nats-server process with its configuration and its store in a folder of ours."""

    def __init__(
        self,
        folder: Path,
        port: int,
        accounts: Sequence[Account] = (),
        *,
        host: str = "127.0.0.1",
        tls: tuple[Path, Path] | None = None,
        disk_mb: int = 20_000,
    ) -> None:
        self.folder, self.port, self._host, self._tls, self._disk_mb = folder, port, host, tls, disk_mb
        self.store = folder / "store"
        self._process: subprocess.Popen[bytes] | None = None
        self.configure(accounts)

    @property
    def url(self) -> str:
        return f"{'tls' if self._tls else 'nats'}://127.0.0.1:{self.port}"

    def configure(self, accounts: Sequence[Account]) -> None:
        """Write the configuration; a server that runs takes it over."""
        private_folder(self.folder)
        text = configuration(self.port, self.store, accounts, host=self._host, tls=self._tls, disk_mb=self._disk_mb)
        write_complete(self.folder / "nats.conf", text)
        if self.runs and self._process:
            self._process.send_signal(signal.SIGHUP)

    @property
    def runs(self) -> bool:
        return self._process is not None and self._process.poll() is None

    def start(self) -> LocalServer:
        """Start it, and wait until it answers. Raises KinegraphError."""
        self._end_orphan()
        with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            raise KinegraphError(f"another program listens at port {self.port}; end it, or choose another --port")
        with (self.folder / "nats.log").open("ab") as log:
            self._process = subprocess.Popen(
                [program(), "-c", str(self.folder / "nats.conf")], stdout=log, stderr=log, start_new_session=True
            )
        write_complete(self.folder / PID, str(self._process.pid))
        until = time.monotonic() + STARTED_S
        while time.monotonic() < until and self._process.poll() is None:
            with suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1) as there:
                if there.recv(4).startswith(b"INFO"):
                    return self
            time.sleep(0.01)
        self.stop()
        raise KinegraphError(f"nats-server does not start; {self.folder / 'nats.log'} holds why")

    def _end_orphan(self) -> None:
        """End the server of a process of ours that was killed; what it has stored stays."""
        with suppress(OSError, ValueError):
            number = int((self.folder / PID).read_text(encoding="utf-8"))
            if str(self.folder / "nats.conf").encode() in Path(f"/proc/{number}/cmdline").read_bytes():
                os.kill(number, signal.SIGTERM)
                until = time.monotonic() + STARTED_S
                while Path(f"/proc/{number}/cmdline").read_bytes() and time.monotonic() < until:
                    time.sleep(0.02)

    def kill(self) -> None:
        """As a power cut does."""
        self._end(signal.SIGKILL)

    def stop(self) -> None:
        self._end(signal.SIGTERM)

    def pause(self) -> None:
        """It answers no more, but its connections stay: as a network that is gone."""
        if self._process:
            self._process.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        if self._process:
            self._process.send_signal(signal.SIGCONT)

    def lose_disk(self) -> None:
        """Remove what the server has stored; it must not run."""
        shutil.rmtree(self.store, ignore_errors=True)

    def _end(self, number: signal.Signals) -> None:
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(OSError):
            process.send_signal(number)
            process.send_signal(signal.SIGCONT)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
