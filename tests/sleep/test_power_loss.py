"""Power that goes at any moment, on a disk: what was flushed is there, of what was not any part may be; the night is read, and goes on.

ext4 on a loop device over a file that keeps every write in order (tests/sleep/logged_disk.py). Part of `make nights`; needs root, loop
devices and FUSE (`pip install mfusepy`).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from kinegraph.devices.reports.night import archive
from kinegraph.stream.chunk import NS
from tests.sleep.hard_night import GRAPH, HardNight, Lived, _logged, _started
from tests.sleep.logged_disk import after_power_loss, events
from tests.sleep.test_hard_nights import check_report

SEED = 29
MOMENTS, RESUMED = 30, 3
EPOCHS = 60
"""How many epochs of the night are on the disk when the last moment comes."""

pytestmark = [
    pytest.mark.skipif("KINEGRAPH_NIGHTS" not in os.environ, reason="part of `make nights`"),
    pytest.mark.skipif(os.geteuid() != 0 or not Path("/dev/loop-control").exists(), reason="no loop devices, or no right to them"),
    pytest.mark.skipif(find_spec("mfusepy") is None or not Path("/dev/fuse").exists(), reason="no FUSE"),
]  # fmt: skip


def run(*command: str | Path) -> str:
    return subprocess.run([str(word) for word in command], check=True, capture_output=True, text=True).stdout.strip()


@contextmanager
def mounted(image: Path, folder: Path) -> Iterator[Path]:
    """The image's file system at `folder`; its journal is replayed, as after a power loss."""
    folder.mkdir(exist_ok=True)
    loop = run("losetup", "--find", "--show", image)
    try:
        run("mount", loop, folder)
        try:
            yield folder
        finally:
            run("umount", "--lazy", folder)
    finally:
        run("losetup", "--detach", loop)


def a_night_on(disk: Path) -> np.ndarray:
    """The night's first hours, written there; killed in the middle. Its log's rows."""
    night = HardNight.of(SEED)
    config = disk / "night.yaml"
    text = GRAPH.replace("SEED", str(SEED)).replace("BEGUN", str(night.begun)).replace("ZONE", night.zone)
    config.write_text(text.replace("FPS", "1.0").replace("path: nights", f"path: {disk / 'nights'}"))
    os.sync()  # who sets a monitor up does it long before the power goes
    process = _started(config, night.begun)
    _logged(disk, process, EPOCHS)
    process.kill()
    process.wait(60)
    (folder,) = (path.parent for path in disk.glob(f"nights/*/{archive.EPOCHS}"))
    return np.asarray(archive.read_epochs(folder).end)


@pytest.mark.timeout(1800)
def test_the_night_is_read_and_goes_on_after_a_power_loss_at_any_moment(tmp_path: Path) -> None:
    image, shown, log = tmp_path / "disk.img", tmp_path / "shown", tmp_path / "writes"
    with image.open("wb") as file:
        file.truncate(48 << 20)
    run("mkfs.ext4", "-q", image)
    before = tmp_path / "before.img"
    shutil.copy(image, before)
    shown.mkdir()
    script = Path(__file__).with_name("logged_disk.py")
    server = subprocess.Popen([sys.executable, str(script), str(image), str(shown), str(log)])
    try:
        while not (shown / "disk.img").exists():
            assert server.poll() is None
            time.sleep(0.05)
        with mounted(shown / "disk.img", tmp_path / "disk") as disk:
            ends = a_night_on(disk)
    finally:
        run("umount", "--lazy", shown)
        server.wait(60)

    rng = np.random.default_rng(SEED)
    asked = sum(1 for _ in events(log))
    kept, loose = [], 0
    lost = tmp_path / "lost.img"
    for moment in np.sort(rng.integers(asked // 4, asked, MOMENTS)).tolist():
        loose += after_power_loss(before, log, moment, rng, lost)
        with mounted(lost, tmp_path / "after") as after:
            found = [path for path, _ in archive.nights(after / "nights")] if (after / "nights").exists() else []
            rows = np.asarray(archive.read_epochs(found[0]).end) if found else np.empty(0, np.int64)
            assert len(found) <= 1 and np.array_equal(rows, ends[: len(rows)]), "what is read is what was written"
            kept.append(len(rows))
    assert loose > MOMENTS and max(kept) > EPOCHS // 2, "the power went while something was on its way"
    assert kept == sorted(kept), "what once was on the disk stays there"
    print(f"{MOMENTS} moments of {asked} writes and flushes, {loose} writes on their way; epochs kept: {kept}")

    for moment in rng.integers(asked // 2, asked, RESUMED).tolist():
        after_power_loss(before, log, moment, rng, lost)
        with mounted(lost, tmp_path / "disk") as disk:
            goes_on(disk, ends)


def goes_on(disk: Path, ends: np.ndarray) -> None:
    """The broken-off session of the disk goes on to the morning, and the report follows from the log."""
    night = HardNight.of(SEED)
    back = int(ends[-1]) + 90 * NS
    process = _started(disk / "night.yaml", back, *(["--resume"] if any((disk / "session").glob("*.mcap")) else []))
    assert process.wait(900) == 0, (disk / "log.txt").read_text()[-3000:]
    ((found, _),) = archive.nights(disk / "nights")
    check_report(Lived(night, found, ((int(ends[0]), back),)))
