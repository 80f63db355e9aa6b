"""What the README promises somebody who has never seen the project, done as it says, in a real browser: watch the demo's cycles, open its
recording, find the gap, mark that moment, see the mark in the replay. The demo itself waits for nobody when it is over."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.support.browser import needs_browser
from tests.support.live_browser import LiveBrowser, live_browser
from tests.support.page_session import PATIENCE_S, needs_page

HOUSE = Path(__file__).resolve().parents[2]
README = (HOUSE / "README.md").read_text(encoding="utf-8")
PROGRAMS = Path(sys.executable).parent
SECONDS, LOST_S = 14, 6.0
ADDRESS = re.compile(r"page: (http://[\d.]+:\d+/\S*)")
VIEW = re.compile(r"its recording in a browser: +(\S+/kinegraph view (recordings/treadmill_emg-\S+))$", re.MULTILINE)
REPLAY = re.compile(
    r"the session again, with your marks: +(\S+/kinegraph replay \S+ recordings/treadmill_emg-\S+ --page)\s*$"
)

pytestmark = [
    pytest.mark.nightly,
    needs_page,
    needs_browser,
    pytest.mark.timeout(500),
    pytest.mark.skipif(shutil.which("make") is None, reason="no make here"),
]


@contextmanager
def typed(command: list[str], folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], Path]]:
    """What somebody types in a terminal, and what it has said so far."""
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    """It is no part of the `make` that runs the tests."""
    alone["PATH"] = f"{PROGRAMS}{os.pathsep}{alone['PATH']}"
    log = folder / f"{len(list(folder.iterdir()))}.txt"
    with (
        log.open("w") as out,
        subprocess.Popen(command, cwd=folder, env=alone, stdout=out, stderr=out, stdin=subprocess.DEVNULL) as process,
    ):
        try:
            yield process, log
        finally:
            if process.poll() is None:
                process.terminate()


def address(process: subprocess.Popen[bytes], log: Path) -> str:
    end = time.monotonic() + PATIENCE_S
    while not (found := ADDRESS.search(log.read_text())):
        assert process.poll() is None and time.monotonic() < end, log.read_text()
        time.sleep(0.05)
    return found[1]


def told(pattern: str) -> str:
    """What the README says; the test does as it says."""
    found = re.search(pattern, " ".join(README.split()))
    assert found, f"the README no longer says {pattern}"
    return found[1]


def test_somebody_with_only_the_readme_watches_cycles_finds_the_gap_marks_it_and_sees_the_mark_again(
    tmp_path: Path,
) -> None:
    shutil.copy(HOUSE / "Makefile", tmp_path)
    shutil.copytree(HOUSE / "configs", tmp_path / "configs")
    demo = [*shlex.split(told(r"In a checkout, `([^`]+)` creates")), "-o", ".venv/installed", f"BIN={PROGRAMS}"]
    with live_browser(tmp_path) as browser:
        with typed([*demo, f"SECONDS_OF_DEMO={SECONDS}"], tmp_path) as (process, log):
            browser.open(address(process, log))
            browser.wait("document.querySelector('.cycles')?.dataset.cycles > 2")
            assert browser.colours(".cycles canvas") > 5
            assert browser.complaints == []
            assert process.wait(2 * PATIENCE_S) == 0, log.read_text()
            told("(printing two commands. The first opens .* The second replays)")
            first, second = VIEW.search(log.read_text()), REPLAY.search(log.read_text())
            assert first and second and (tmp_path / first[2]).is_dir(), log.read_text()
        with typed(shlex.split(first[1]), tmp_path) as (process, log):
            browser.open(address(process, log))
            at = find_and_mark(
                browser, told(r"browser, where `(.)` jumps to the gap"), told(r"gap, and `(.)`, a text and Enter mark")
            )
        with typed([*shlex.split(second[1]), "-q"], tmp_path) as (process, log):
            browser.open(address(process, log))
            chosen = "[...s.options].find(o => o.textContent === 'marks')"
            browser.wait(
                f"(s => s && {chosen} && (s.value = {chosen}.value))(document.querySelector('select[aria-label=stream]'))"
            )
            browser.wait("document.querySelector('.table table').textContent.includes('lost here')")
            browser.wait(f"+document.body.dataset.replayed > {at}")
            assert browser.complaints == []


def find_and_mark(browser: LiveBrowser, gap: str, mark: str) -> float:
    """Go to the gap by its key and mark it by the other; where that is (s)."""
    browser.wait("document.getElementById('line').dataset.gaps > 0 && document.body.dataset.looked >= 0")
    browser.type(gap)
    cursor = "+document.querySelector('#line canvas').getAttribute('aria-valuenow')"
    at = float(browser.wait(f"(t => Math.abs(t - {LOST_S}) < .5 && t)({cursor})"))
    browser.wait("[...document.querySelectorAll('.signal')].some(panel => panel.dataset.gaps > 0)")
    browser.type(mark)
    browser.wait("document.activeElement.getAttribute('aria-label') === 'annotation'")
    browser.type("lost here\r")
    browser.wait("document.getElementById('line').dataset.marks === '1'")
    assert browser.complaints == []
    return at
