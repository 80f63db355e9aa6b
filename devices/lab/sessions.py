"""Sessions of a lab: each a process of its own and a folder, which says all that a restarted lab must know.

lab.json     what was asked for, and the process; remarks and the result, once there are any
lab.lock     held by the process as long as it lives; so a process id is never used of one that has ended
output.txt   what the command printed
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from kinegraph.devices.lab.jobs import COMMAND
from kinegraph.devices.lab.uses import titled
from kinegraph.stream.data.json_file import read_json, write_json
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.atomic_file import private_folder
from kinegraph.stream.text.time_text import for_names

FACTS, LOCK, OUTPUT = "lab.json", "lab.lock", "output.txt"
PAGE = re.compile(r"^page: (http\S+)", re.MULTILINE)
LEFT = re.compile(r"^[\w.-]+: (\S.*)$", re.MULTILINE)
ERROR = re.compile(r"^kinegraph: (.+)", re.MULTILINE | re.DOTALL)
ENDED = re.compile(r"^session of ([\d.]+) s ended", re.MULTILINE)
MOST_OUTPUT = 64 << 10
FILES = (
    ".html",
    ".csv",
    ".xlsx",
    ".pdf",
    ".json",
    ".edf",
    ".xdf",
    ".c3d",
    ".trc",
    ".bvh",
    ".glb",
    ".zip",
    ".parquet",
    ".mat",
)
"""Files that a session leaves for people, beside its recording."""

_children: list[subprocess.Popen[bytes]] = []


@dataclass(frozen=True, slots=True)
class LabSession:
    """One session, by its folder."""

    folder: Path

    @property
    def id(self) -> str:
        return self.folder.name

    @property
    def facts(self) -> dict[str, Any]:
        """What is known of it. Raises KinegraphError."""
        return read_json(self.folder / FACTS, "the facts of a session")

    def note(self, **facts: Any) -> None:
        """Add facts."""
        write_json(self.folder / FACTS, {**self.facts, **facts})

    @property
    def runs(self) -> bool:
        """Whether its process lives: it holds the lock from its first moment to its last."""
        import fcntl  # not on Windows, where `kinegraph lab` refuses to begin

        for child in [*_children]:
            if child.poll() is not None:
                _children.remove(child)
        try:
            with (self.folder / LOCK).open("rb") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return False

    @property
    def output(self) -> str:
        """The end of what the command printed."""
        with suppress(OSError), (self.folder / OUTPUT).open("rb") as file:
            file.seek(max(0, (self.folder / OUTPUT).stat().st_size - MOST_OUTPUT))
            return file.read().decode(errors="replace")
        return ""

    @property
    def page(self) -> str:
        """The address of its page with the token; "" where it is not served (yet, or any more)."""
        found = PAGE.findall(self.output)
        return found[-1] if found and self.runs else ""

    def stop(self) -> None:
        """End it as Ctrl-C does; once more breaks it off."""
        if self.runs:
            with suppress(ProcessLookupError):
                os.kill(int(self.facts["pid"]), signal.SIGINT)

    def files(self) -> list[Path]:
        """What it has left for people: reports first."""
        found = [
            p
            for p in self.folder.rglob("*")
            if p.suffix in FILES and p.is_file() and p.name != FACTS and not p.name.startswith(".")
        ]
        return sorted(found, key=lambda p: (p.suffix != ".html", p.stem == "comparison", p.name))

    def keep_reports(self) -> None:
        """Copy what the session wrote elsewhere in the lab's folder, where the next one would replace it."""
        home, began_s = self.folder.parent.parent.resolve(), self.facts["began_s"]
        for line in LEFT.findall(self.output):
            path = (home / line.strip()).resolve()
            if path == home or not path.is_relative_to(home) or path.is_relative_to(self.folder.resolve()):
                continue
            beside = path.rglob("*") if path.is_dir() else path.parent.glob(f"{path.stem}.*")
            for one in beside:
                if one.suffix in FILES and one.is_file() and one.stat().st_mtime >= began_s:
                    private_folder(self.folder / "reports")
                    shutil.copy(one, self.folder / "reports")

    def summary(self) -> dict[str, Any]:
        """What lists show of it."""
        facts, runs, output = self.facts, self.runs, self.output
        ended = ENDED.search(output)
        error = "" if runs else _error(output, whole=any(self.folder.glob("*.mcap")))
        size = sum(p.stat().st_size for p in self.folder.rglob("*") if p.is_file())
        return {
            "id": self.id, **{k: facts.get(k, "") for k in ("graph", "name", "subject", "kind", "remarks", "result", "devices")},
            "title": titled(str(facts.get("name", ""))),
            "began_s": facts["began_s"], "lasted_s": float(ended[1]) if ended else None, "runs": runs, "error": error, "bytes": size,
        }  # fmt: skip

    def delete(self) -> None:
        """Remove it. Raises KinegraphError while it runs."""
        if self.runs:
            raise KinegraphError("the session runs; stop it first")
        shutil.rmtree(self.folder)


def _error(output: str, *, whole: bool) -> str:
    """What the command complained of last; without a word of it, and where nothing was recorded, all that it printed."""
    found = [text for text in ERROR.findall(output) if text.strip() != "stopped"]
    if found:
        return str(found[-1]).strip()
    return "" if whole or ENDED.search(output) or "kinegraph: stopped" in output else output.strip()[-500:]


class Sessions:
    """All sessions in a lab's folder."""

    def __init__(self, home: Path) -> None:
        self.home, self._folder = home, home / "sessions"

    def all(self) -> list[LabSession]:
        """The newest first."""
        if not self._folder.is_dir():
            return []
        found = [LabSession(path) for path in self._folder.iterdir() if (path / FACTS).is_file()]
        return sorted(found, key=lambda one: one.folder.name.rpartition("-")[2], reverse=True)

    def of(self, id: str) -> LabSession:
        """A session by its id, which never leads out of the folder. Raises KinegraphError."""
        if not re.fullmatch(r"[\w.-]+", id) or id.startswith(".") or not (self._folder / id / FACTS).is_file():
            raise KinegraphError("there is no such session")
        return LabSession(self._folder / id)

    def new(self, name: str) -> Path:
        """A folder for a new session."""
        name = re.sub(r"[^\w.-]+", "_", name).strip("._") or "session"
        stamp, more = for_names(), 1
        while (folder := self._folder / f"{name}-{f'{more}-' if more > 1 else ''}{stamp}").exists():
            more += 1
        private_folder(folder)
        return folder

    def begin(self, folder: Path, arguments: Sequence[str], facts: Mapping[str, Any]) -> LabSession:
        """Start `kinegraph` with these arguments, detached: neither the end of the lab nor of the browser reaches it."""
        import fcntl

        write_json(folder / FACTS, {"began_s": time.time(), "pid": 0, **facts})
        with (folder / LOCK).open("wb") as lock, (folder / OUTPUT).open("wb") as output:
            fcntl.flock(lock, fcntl.LOCK_EX)  # which the process inherits, and keeps
            child = subprocess.Popen(
                [*COMMAND, *arguments],
                cwd=self.home, stdin=subprocess.DEVNULL, stdout=output, stderr=output,
                start_new_session=True, pass_fds=[lock.fileno()],
            )  # fmt: skip
        _children.append(child)
        session = LabSession(folder)
        session.note(pid=child.pid)
        return session

    def run(
        self, graph: str, name: str, values: Mapping[str, Any], *, simulate: bool, kind: str = "session"
    ) -> LabSession:
        """Run a graph, as `kinegraph run` does; the `kind` mvc is a session of strongest contractions."""
        folder = self.new(name)
        more = ["--simulate"] if simulate else []
        settings = [part for key, value in values.items() for part in ("--set", f"{key}={json.dumps(value)}")]
        arguments = ["run", graph, *settings, "-o", str(folder), "--view", "none", "--page-at", "127.0.0.1:0", *more]
        facts = {
            "kind": kind, "graph": graph, "name": name, "values": dict(values), "subject": str(values.get("session.subject", "")),
            "devices": "simulated devices" if simulate else "",
        }  # fmt: skip
        return self.begin(folder, arguments, facts)
