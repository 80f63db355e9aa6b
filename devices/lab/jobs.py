"""What is done with sessions afterwards: other commands of kinegraph, each a process that ends."""

from __future__ import annotations

import asyncio
import shutil
import sys
import tempfile
from collections.abc import AsyncGenerator
from contextlib import suppress
from pathlib import Path
from typing import Any

from kinegraph.stream.errors import KinegraphError

COMMAND = (sys.executable, "-P", "-c", "from kinegraph.stream.cli.main import main; main()")
MAX_PRINTED = 20_000
CHROMIUM = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


_starting: set[asyncio.Future[None]] = set()
"""One for each process that is being started now."""


async def _started(*command: str | Path, **given: Any) -> asyncio.subprocess.Process:
    done: asyncio.Future[None] = asyncio.get_running_loop().create_future()
    _starting.add(done)
    try:
        return await asyncio.create_subprocess_exec(*command, **given)
    finally:
        _starting.discard(done)
        done.cancel()


async def settled() -> None:
    """Wait until no process is being started: asyncio never ends a start that is cancelled half-way, and the lab would hang."""
    while _starting:
        await asyncio.wait([*_starting])


async def kinegraph(home: Path, *arguments: str) -> tuple[int, str]:
    """Call a command in the lab's folder: its exit code, and what it printed."""
    return await _called(home, *COMMAND, *arguments)


async def printed(home: Path, *arguments: str) -> AsyncGenerator[bytes, None]:
    """What a command writes, as it comes. It ends with whoever reads this. Raises KinegraphError where it writes nothing."""
    count = 0
    with tempfile.TemporaryFile() as complaints:
        process = await _started(
            *COMMAND, *arguments, cwd=home, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=complaints
        )  # fmt: skip
        assert process.stdout
        try:
            while piece := await process.stdout.read(1 << 16):
                count += len(piece)
                yield piece
        finally:
            if process.returncode is None:
                with suppress(ProcessLookupError):
                    process.terminate()
        if not count:
            complaints.seek(0)
            text = complaints.read().decode(errors="replace").strip()
            raise KinegraphError(text.rpartition("kinegraph: ")[2][-600:] or "nothing came")


class Check:
    """A check under way: a command that says what is to be done on its standard error, and what it found as JSON."""

    def __init__(self) -> None:
        self.printed, self.found, self.code = "", "", -1

    async def run(self, home: Path, *arguments: str) -> None:
        """Call the command until it ends."""
        process = await _started(
            *COMMAND, *arguments, cwd=home, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.PIPE
        )  # fmt: skip
        assert process.stdout and process.stderr
        try:
            reading = asyncio.create_task(process.stdout.read())
            async for line in process.stderr:
                self.printed = (self.printed + line.decode(errors="replace"))[-MAX_PRINTED:]
            self.found = (await reading).decode(errors="replace")
            self.code = await process.wait()
        finally:
            if process.returncode is None:
                process.terminate()


async def pdf(page: Path, into: Path) -> str:
    """Print a report; why it could not be, else ""."""
    program = next((found for name in CHROMIUM if (found := shutil.which(name))), None)
    if program is None:
        return "a PDF needs Chromium on this machine; or open the report, and print it to a file"
    sandbox = ["--no-sandbox"] if _is_root() else []
    code, out = await _called(
        into.parent, program, "--headless", *sandbox, "--disable-gpu", "--no-pdf-header-footer", f"--print-to-pdf={into}", page.as_uri()
    )  # fmt: skip
    return "" if not code and into.is_file() else f"Chromium could not print it: {out[-300:]}"


def _is_root() -> bool:
    import os

    return hasattr(os, "geteuid") and os.geteuid() == 0


async def _called(folder: Path, *command: str) -> tuple[int, str]:
    process = await _started(
        *command, cwd=folder, stdin=asyncio.subprocess.DEVNULL, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
    )  # fmt: skip
    out, _ = await process.communicate()
    return process.returncode or 0, out.decode(errors="replace").strip()
