"""A session that is asked to end while its kernels are still compiled ends then, not minutes later."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests.support.command_line import KINEGRAPH


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGTERM that can be heard")
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_the_first_signal_ends_a_warm_up(sent: signal.Signals, tmp_path: Path) -> None:
    session = subprocess.Popen(
        [KINEGRAPH, "run", "avatar_markers", "-o", tmp_path / "run", "--view", "lines"],
        env={**os.environ, "KINEGRAPH_CACHE": str(tmp_path / "cold")}, cwd=tmp_path,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip
    try:
        assert session.stdout is not None and "getting ready" in session.stdout.readline()
        session.send_signal(sent)
        said, _ = session.communicate(timeout=120)
    finally:
        session.kill()
        session.wait(30)
    assert session.returncode not in (0, -signal.SIGKILL), said
    assert "session of" not in said and not (tmp_path / "run").exists(), said
    assert "Traceback" not in said, said
