"""From the command to the first sample: `kinegraph run`, with everything compiled before; and where that time goes."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

from bench.report import Goal, Section, short

ROOT = Path(__file__).resolve().parent.parent
CONFIG = ROOT / "configs" / "treadmill_emg.yaml"
FIRST = """
  first_sample:
    use: bench.parts.FirstSample
    from: treadmill.emg
    path: {path}
"""
SLOW = ("numba", "scipy", "numpy", "matplotlib", "pandas", "pydantic", "ruamel", "typer", "rich", "mcap", "llvmlite")


def start(rounds: int) -> Section:
    """`rounds` starts after one that fills the cache."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = [_start(Path(folder), i) for i in range(rounds + 1)][1:]
    section = Section(f"Start: `kinegraph run {CONFIG.name}` until its first sample is in an operator, warm cache")
    section.notes = [
        f"median {short(median(seconds))} s, slowest of {rounds} {short(max(seconds))} s.",
        "Modules imported by then, slowest first (own time with what only they import): " + _imports(),
    ]
    section.goals = [Goal("start to first sample", median(seconds), 2.5, "s")]
    return section


def _start(folder: Path, i: int) -> float:
    noted = folder / f"first{i}"
    config = folder / f"{CONFIG.stem}_{i}.yaml"
    config.write_text(CONFIG.read_text(encoding="utf-8") + FIRST.format(path=noted), encoding="utf-8")
    command = [
        sys.executable,
        "-m",
        "kinegraph",
        "run",
        str(config),
        "--out",
        str(folder / f"session{i}"),
        "--view",
        "none",
    ]
    began = time.monotonic_ns()
    process = subprocess.Popen(
        command, cwd=folder, env=_env(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    try:
        while not (noted.exists() and noted.stat().st_size):
            if process.poll() is not None:
                raise RuntimeError(
                    f"kinegraph run ended before its first sample:\n{process.stderr and process.stderr.read()}"
                )
            time.sleep(0.01)
    finally:
        process.terminate()
        process.wait()
    return (int(noted.read_text()) - began) / 1e9


def _env() -> dict[str, str]:
    """With Python's own cache of compiled modules, as any installation has it."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPATH": str(ROOT)}


def _imports() -> str:
    """What `python -X importtime` says of the packages that weigh most, in ms."""
    modules = (
        "cli.main",
        "cli.commands.run",
        "engine.session",
        "graph.reading.load",
        "graph.plan",
        "cli.commands.console",
    )
    code = "import " + ", ".join(f"kinegraph.stream.{module}" for module in modules)
    done = subprocess.run(
        [sys.executable, "-X", "importtime", "-c", code],
        cwd=ROOT,
        env=_env(),
        capture_output=True,
        text=True,
        check=True,
    )
    own: dict[str, float] = {}
    for line in done.stderr.splitlines():
        parts = line.removeprefix("import time:").split("|")
        if len(parts) == 3 and parts[0].strip().isdigit():
            package = parts[2].strip().split(".")[0]
            own[package] = own.get(package, 0.0) + int(parts[0]) / 1000
    rows = sorted(own.items(), key=lambda row: -row[1])[:8]
    return ", ".join(f"{name} {ms:.0f} ms" for name, ms in rows) + f"; all {sum(own.values()):.0f} ms"
