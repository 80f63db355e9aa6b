"""The shipped unit under systemd itself, in a container: it starts as its user, shut in; killed it goes on; stopped it ends in order.

Part of `make nights`; needs root and systemd-nspawn (Debian: systemd-container). The camera is simulated.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

HOUSE = Path(__file__).resolve().parents[2]
CAMERA = """  camera:
    use: devices.people.bedside.Bedside
    width: 320
    height: 200
    fps: 10
    speed: 1
    evening_min: 2

"""
PROGRAM = """#!/bin/sh
export PYTHONPATH=/house:/site LD_LIBRARY_PATH=/python/lib PYTHONDONTWRITEBYTECODE=1
exec /python/bin/python3 -c 'from kinegraph.stream.cli.main import main; main()' "$@"
"""
USER = 990
UNIT = "kinegraph-bedside"

pytestmark = [
    pytest.mark.skipif("KINEGRAPH_NIGHTS" not in os.environ, reason="part of `make nights`"),
    pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("systemd-nspawn"), reason="no containers, or no right to them"),
]  # fmt: skip


def root_of(folder: Path) -> Path:
    """A root with this machine's /usr and /etc, the unit enabled as the docs say, and kinegraph where the unit looks for it."""
    for name in (
        "usr/lib",
        "var/lib",
        "var/cache",
        "var/log",
        "var/tmp",
        "tmp",
        "run",
        "proc",
        "sys",
        "dev",
        "root",
        "home",
    ):
        (folder / name).mkdir(parents=True)
    for name in ("house", "site", "python"):
        (folder / name).mkdir()
    for name in ("bin", "sbin", "lib", "lib64"):
        (folder / name).symlink_to(f"usr/{name}")
    shutil.copy("/usr/lib/os-release", folder / "usr/lib/os-release")
    shutil.copytree("/etc", folder / "etc", symlinks=True)
    for name, line in (
        ("passwd", f"kinegraph:x:{USER}:{USER}::/nonexistent:/usr/sbin/nologin"),
        ("group", f"kinegraph:x:{USER}:"),
    ):
        with (folder / "etc" / name).open("a") as file:
            file.write(f"{line}\n")
    (folder / "etc/machine-id").write_text("")
    program = folder / "opt/kinegraph/bin/kinegraph"
    program.parent.mkdir(parents=True)
    program.write_text(PROGRAM)
    program.chmod(0o755)
    units = folder / "etc/systemd/system"
    shutil.copy(HOUSE / "configs" / f"{UNIT}.service", units)
    (units / "multi-user.target.wants").mkdir(exist_ok=True)
    (units / f"multi-user.target.wants/{UNIT}.service").symlink_to(f"/etc/systemd/system/{UNIT}.service")
    home = folder / "var/lib/kinegraph"
    home.mkdir(mode=0o700)
    text, count = re.subn(r"  camera:\n(?:    .*\n)+\n", CAMERA, (HOUSE / "configs" / "bedside_sleep.yaml").read_text())
    assert count == 1
    (home / "bedside.yaml").write_text(text.replace("checkpoint_s: 300", "checkpoint_s: 2"))
    for path in (home, home / "bedside.yaml"):
        os.chown(path, USER, USER)
    return folder


@contextmanager
def booted(root: Path) -> Iterator[Callable[..., str]]:
    """systemd as the first process of a container; gives how to run a command in it."""
    shared = {"/usr": "/usr", HOUSE: "/house", sysconfig.get_path("purelib"): "/site", sys.base_prefix: "/python"}
    command = ["systemd-nspawn", "--directory", root, "--boot", "--register=no", "--keep-unit", "--private-network"]
    command += [f"--bind-ro={of}:{at}" for of, at in shared.items()]
    with (root.parent / "console.txt").open("w") as console:
        container = subprocess.Popen(list(map(str, command)), stdin=subprocess.DEVNULL, stdout=console, stderr=console)
    try:
        first = ""
        while not first:
            assert container.poll() is None, (root.parent / "console.txt").read_text()[-2000:]
            time.sleep(0.1)
            children = Path(f"/proc/{container.pid}/task/{container.pid}/children").read_text().split()
            first = next((pid for pid in children if b"systemd" in Path(f"/proc/{pid}/cmdline").read_bytes()[:40]), "")

        def inside(*words: str) -> str:
            enter = ["nsenter", "-t", first, "-m", "-u", "-i", "-n", "-p", "--", *words]
            return subprocess.run(enter, capture_output=True, text=True, timeout=60).stdout

        yield inside
    finally:
        container.terminate()
        container.wait(60)


def journal(inside: Callable[..., str], *, until: str, times: int = 1, within_s: float = 300) -> str:
    """The unit's log, once it contains `until` so many times."""
    deadline = time.monotonic() + within_s
    while True:
        log = inside("journalctl", "-u", UNIT, "--no-pager", "-o", "cat")
        if log.count(until) >= times:
            return log
        assert time.monotonic() < deadline, log[-3000:]
        time.sleep(0.5)


@pytest.mark.timeout(900)
def test_the_unit_under_systemd_starts_goes_on_after_a_kill_and_ends_in_order(tmp_path: Path) -> None:
    root = root_of(tmp_path / "root")
    home = root / "var/lib/kinegraph"
    with booted(root) as inside:
        journal(inside, until="camera.depth 10/s")
        assert inside("systemctl", "show", UNIT, "-p", "User", "--value").strip() == "kinegraph"
        open_to_others = [p for p in home.rglob("*") if p.name != "bedside.yaml" and p.stat().st_mode & 0o077]
        assert not open_to_others and all(p.stat().st_uid == USER for p in home.rglob("*"))
        assert any((root / "var/cache/kinegraph").rglob("*")), "kernels are kept though the user has no home"

        inside("systemctl", "kill", "-s", "KILL", UNIT)
        log = journal(inside, until="session resumed")
        assert "resuming an interrupted session" in log
        journal(inside, until="camera.depth 10/s", times=log.count("camera.depth 10/s") + 1)

        inside("systemctl", "stop", UNIT)
        log = journal(inside, until="Deactivated successfully")
        assert (
            "Traceback" not in log and inside("systemctl", "show", UNIT, "-p", "Result", "--value").strip() == "success"
        )

        inside("systemctl", "start", UNIT)
        again = journal(inside, until="camera.depth 10/s", times=log.count("camera.depth 10/s") + 1)
        assert again.count("session resumed") == 1, "what was ended in order is not gone on with"

        inside("systemctl", "stop", UNIT)
        log = journal(inside, until="Deactivated successfully", times=2)
        assert (
            "Traceback" not in log and inside("systemctl", "show", UNIT, "-p", "Result", "--value").strip() == "success"
        )
