"""A session that is asked to end while its kernels are still compiled ends then, not minutes later."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from kinegraph.stream.errors import Interrupted, Terminated
from tests.support.command_line import KINEGRAPH, Command, kinegraph

__all__ = ["kinegraph"]


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
        reported, _ = session.communicate(timeout=120)
    finally:
        session.kill()
        session.wait(30)
    assert session.returncode == (143 if sent == signal.SIGTERM else 130), reported
    assert "session of" not in reported and not (tmp_path / "run").exists(), reported
    assert "Traceback" not in reported, reported


SLOW_LINK = """
import signal, sys, time
from llvmlite.binding import ffi, linker
from kinegraph.stream.cli import main

link = ffi.lib.LLVMPY_LinkModules
def interrupted(*modules):
    # the signal comes when LLVM has freed what was linked, and before llvmlite knows it
    ffi.lib._fntab["LLVMPY_LinkModules"] = link
    failed = link(*modules)
    print("linked", flush=True)
    signal.raise_signal(number)
    for _ in range(100):
        time.sleep(0.01)
    return failed

number = int(sys.argv.pop())
ffi.lib._fntab["LLVMPY_LinkModules"] = interrupted
main.main()
"""


@pytest.mark.skipif(os.name == "nt", reason="Windows has no SIGTERM that can be heard")
@pytest.mark.parametrize("command", ["run", "dev try"])
@pytest.mark.parametrize("sent", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_in_the_midst_of_the_compilers_work_is_no_crash(
    sent: signal.Signals, command: str, tmp_path: Path
) -> None:
    graph = tmp_path / "low.yaml"
    graph.write_text(
        "nodes:\n  walk: {use: devices.people.treadmill.Treadmill}\n"
        "  low: {use: operators.filters.iir.Lowpass, from: walk.emg, cutoff_hz: 6}\n"
    )
    asked = (
        [graph, "-o", tmp_path / "run", "--view", "lines"] if command == "run" else ["operators.filters.iir.Lowpass"]
    )
    done = subprocess.run(
        [sys.executable, "-c", SLOW_LINK, *command.split(), *map(str, asked), str(int(sent))],
        env={**os.environ, "KINEGRAPH_CACHE": str(tmp_path / "cold")}, cwd=tmp_path, check=False,
        capture_output=True, text=True, timeout=200,
    )  # fmt: skip
    assert "linked" in done.stdout, done.stdout + done.stderr
    assert done.returncode == (143 if sent == signal.SIGTERM else 130), done.stdout + done.stderr
    assert "Traceback" not in done.stderr and not (tmp_path / "run").exists()


@pytest.mark.parametrize(("came", "code"), [(KeyboardInterrupt, 130), (Interrupted, 130), (Terminated, 143)])
def test_an_interruption_before_the_command_has_begun_is_no_traceback(
    kinegraph: Command, monkeypatch: pytest.MonkeyPatch, came: type[BaseException], code: int
) -> None:
    def importing(name: str) -> None:
        raise came

    monkeypatch.setattr("kinegraph.stream.cli.main.function_of", importing)
    assert kinegraph("info", "x.mcap") == (code, "", "kinegraph: stopped\n")
