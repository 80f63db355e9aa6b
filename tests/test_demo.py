"""`make demo`: a session that tells where its page is, is there to be looked at while it runs, and waits for nobody when it is over."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import urlopen

import pytest

from tests.page_session import ADDRESS, PATIENCE_S, needs_page

HOUSE = Path(__file__).resolve().parent.parent
LAST = re.compile(r"the same session in a browser: \S+/kinegraph view (recordings/treadmill_emg-\S+)\s*$")

pytestmark = [
    needs_page,
    pytest.mark.timeout(500),
    pytest.mark.skipif(shutil.which("make") is None, reason="no make here"),
]


def test_the_demo_tells_its_pages_address_which_answers_and_ends_by_itself(tmp_path: Path) -> None:
    shutil.copy(HOUSE / "Makefile", tmp_path)
    shutil.copytree(HOUSE / "configs", tmp_path / "configs")
    command = ["make", "demo", "-o", ".venv/installed", f"BIN={Path(sys.executable).parent}", "SECONDS_OF_DEMO=5"]
    alone = {name: value for name, value in os.environ.items() if not name.startswith("MAKE")}
    """It is no part of the `make` that runs the tests."""
    log = tmp_path / "said.txt"
    with (
        log.open("w") as out,
        subprocess.Popen(command, cwd=tmp_path, env=alone, stdout=out, stderr=out, stdin=subprocess.DEVNULL) as demo,
    ):
        end = time.monotonic() + PATIENCE_S
        while not (found := ADDRESS.search(log.read_text())):
            assert demo.poll() is None and time.monotonic() < end, log.read_text()
            time.sleep(0.05)
        with urlopen(found[1], timeout=60) as answer:
            assert b"kinegraph" in answer.read()
        assert demo.wait(2 * PATIENCE_S) == 0, log.read_text()
    told = LAST.search(log.read_text())
    assert told and (tmp_path / told[1]).is_dir(), log.read_text()
