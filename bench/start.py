"""`python -m bench.start`: from the command to the first sample, of every shipped graph; and of `--help`, the import and the demo.

Cold: with an empty folder of compiled kernels (KINEGRAPH_CACHE). Warm: again with what the cold start left. Graphs of devices run on
simulated ones. Processor time is that of all processes that take part, simulated devices included. Two idle processors take no longer than
the session's own processor time and that of its busiest child, one after the other: that is held against the goals, for it means the same
on a busy machine, where the clock does not. `--write`: into docs/lab/first-minutes.md.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import psutil

from bench.report import Goal, Section, marks, publish, short, whole
from kinegraph.stream.compiler.cache import SUFFIX
from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.graph.reading.load import load
from kinegraph.stream.graph.shipped import shipped
from kinegraph.stream.source import Source

ROOT = Path(__file__).resolve().parent.parent
GRAPH = "treadmill_emg"
FIRST = """nodes:
  bench_first_sample:
    use: bench.first_sample.FirstSample
    from: {output}
    path: {path}
"""
CYCLES = "leg.cycles.cycles"
"""The output of `treadmill_emg` that holds one event for each cycle."""
GOALS_S = {"treadmill_emg": 12.0, "bedside_simulated": 6.0}
"""How long a cold start may take on two idle processors; no other graph's may be over `GOAL_S`."""
GOAL_S = 30.0
PATIENCE_S = 900.0
PEAK = """
import atexit, sys
atexit.register(lambda: print(*(line for line in open("/proc/self/status") if line.startswith("VmHWM")), file=sys.stderr))
"""
ABOUT = "By `python -m bench.start`."
PAGE = "lab/first-minutes.md"


@dataclass(frozen=True, slots=True)
class Start:
    """What a start took.

    cpu_s, wall_s   from the command to the first sample in an operator
    idle_s          of which the session and its busiest child took: the clock of two idle processors shows no more
    kernels         pieces of machine code that were compiled
    cache_mb        what the cache holds then
    """

    cpu_s: float
    wall_s: float
    idle_s: float
    kernels: int
    cache_mb: float


def start(rounds: int) -> Section:
    """`rounds` starts of one graph after one that fills the cache, for `make bench`."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = [started(GRAPH, Path(folder) / str(i)).wall_s for i in range(rounds + 1)][1:]
    section = Section(f"Start: `kinegraph run {GRAPH}` until its first sample is in an operator, warm cache")
    section.notes = [
        f"median {short(median(seconds))} s, slowest of {rounds} {short(max(seconds))} s.",
        "Modules imported by then, slowest first (own time with what only they import): " + _imports(),
    ]
    section.goals = [Goal("start to first sample", median(seconds), 2.5, "s")]
    return section


def graphs(names: list[str], rounds: int) -> Section:
    """Every graph cold once, and warm `rounds` times (median)."""
    section = Section(
        "From the command to the first sample",
        ["graph", "cold: idle, s", "processor, s", "wall, s", "kernels", "cache, MB", "warm: idle, s", "wall, s"],
    )
    for name in names:
        print(f"{name} ...", file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            try:
                cache = Path(folder) / "cache"
                cold = started(name, Path(folder) / "cold", cache)
                warm = [started(name, Path(folder) / f"warm{i}", cache) for i in range(rounds)]
            except (KinegraphError, RuntimeError) as error:
                section.notes.append(f"{name}: left out ({error})")
                continue
        warm_idle_s, warm_wall_s = median(one.idle_s for one in warm), median(one.wall_s for one in warm)
        numbers = (cold.idle_s, cold.cpu_s, cold.wall_s, cold.kernels, cold.cache_mb, warm_idle_s, warm_wall_s)
        section.rows.append([name, *map(short, numbers)])
        section.goals.append(Goal(f"{name}, cold, two idle processors", cold.idle_s, GOALS_S.get(name, GOAL_S), "s"))
        if name == GRAPH:
            section.goals.append(Goal(f"{name}, warm, two idle processors", warm_idle_s, 1.5, "s"))
    section.goals.sort(key=lambda goal: goal.met)
    return section


def commands(rounds: int) -> Section:
    """What everybody waits for first: help, the import, and the demo's first cycle (with an empty cache and with a full one)."""
    section = Section("Commands", ["", "processor, s", "wall, s", "memory, MB"])
    shown = {
        "`kinegraph --help`": "from kinegraph.stream.cli.main import main; main()",
        "`import kinegraph`": "import kinegraph",
        "Python itself": "",
    }
    for name, code in shown.items():
        taken = [_run_to_end(code) for _ in range(rounds + 1)][1:]
        cpu_s, wall_s, memory_mb = (median(column) for column in zip(*taken, strict=True))
        section.rows.append([name, short(cpu_s), short(wall_s), short(memory_mb)])
        if name != "Python itself":
            section.goals.append(Goal(f"{name}, processor time", cpu_s, 0.3, "s"))
    with tempfile.TemporaryDirectory() as folder:
        for state in ("cold", "warm"):
            first = started(GRAPH, Path(folder) / state, Path(folder) / "cache", output=CYCLES, options=("--page",))
            row = f"the demo's graph with its page until the first cycle, {state}"
            section.rows.append([row, short(first.cpu_s), short(first.wall_s), ""])
    section.goals.append(Goal("first cycle on the page, warm, wall", first.wall_s, 5.0, "s"))
    return section


def started(
    name: str, folder: Path, cache: Path | None = None, *, output: str = "", options: tuple[str, ...] = ()
) -> Start:
    """Start a shipped graph in a new `folder`, until a sample of `output` (by default of a source) is in an operator.

    Raises RuntimeError where it ends before, or waits too long.
    """
    folder.mkdir(parents=True)
    noted, config = folder / "first", folder / f"{name}.yaml"
    first = FIRST.format(output=output or _first_output(name), path=noted)
    config.write_text(re.sub(r"^nodes:\n", first, shipped()[name].read_text(encoding="utf-8"), flags=re.M))
    command = [sys.executable, "-m", "kinegraph", "run", str(config), "--simulate", "--view", "none"]
    command += ["--out", str(folder / "session"), *options]
    before = _kept(cache) if cache else (0, 0.0)
    began = time.monotonic_ns()
    with _process(command, folder, cache) as process:
        taken: dict[int, float] = {}
        while not (noted.exists() and noted.stat().st_size):
            if process.poll() is not None:
                assert process.stderr
                raise RuntimeError(process.stderr.read().decode().strip().replace(str(folder), "").splitlines()[-1])
            if time.monotonic_ns() - began > PATIENCE_S * 1e9:
                raise RuntimeError(f"no sample in {PATIENCE_S:g} s")
            time.sleep(0.05)
            taken |= _processor_s(psutil.Process(process.pid))
        kept = _kept(cache) if cache else before
    own_s = taken.pop(process.pid, 0.0)
    idle_s = own_s + max(taken.values(), default=0.0)
    wall_s = (int(noted.read_text()) - began) / 1e9
    return Start(own_s + sum(taken.values()), wall_s, idle_s, kept[0] - before[0], kept[1])


@contextmanager
def _process(command: list[str], folder: Path, cache: Path | None) -> Iterator[subprocess.Popen[bytes]]:
    """A command at work; ended with the block."""
    nowhere = subprocess.DEVNULL
    env = _env() | ({"KINEGRAPH_CACHE": str(cache)} if cache else {})
    process = subprocess.Popen(command, cwd=folder, env=env, stdin=nowhere, stdout=nowhere, stderr=subprocess.PIPE)
    with process:
        try:
            yield process
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.communicate(timeout=10)
            process.kill()


def _first_output(name: str) -> str:
    """The first output of a graph's first source that is not what people type."""
    graph = load(shipped()[name])
    for node in graph.nodes.values():
        if isinstance(node.part, Source) and not node.use.startswith("stream."):
            return f"{node.name}.{next(iter(node.part.specs()))}"
    raise RuntimeError("it has no source")


def _processor_s(process: psutil.Process) -> dict[int, float]:
    """Processor time so far (s) of a process and of those that it has started, by number."""
    found: dict[int, float] = {}
    with suppress(psutil.NoSuchProcess):
        for one in (process, *process.children(recursive=True)):
            with suppress(psutil.NoSuchProcess):
                times = one.cpu_times()
                found[one.pid] = times.user + times.system
    return found


def _kept(cache: Path) -> tuple[int, float]:
    """How many pieces of machine code a cache holds, and how many MB."""
    files = [path for path in cache.rglob("*") if path.is_file()]
    return sum(path.suffix == SUFFIX for path in files), sum(path.stat().st_size for path in files) / 1e6


def _run_to_end(code: str) -> tuple[float, float, float]:
    """Processor time and wall time (s) and peak memory (MB) of Python that runs this code with the argument --help."""
    began = time.monotonic()
    command = [sys.executable, "-c", PEAK + code, "--help"]
    process = subprocess.Popen(
        command, cwd=ROOT, env=_env(), stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True
    )
    assert process.stderr
    peak_kb = process.stderr.read().split()[-2]
    _, _, usage = os.wait4(process.pid, 0)
    process.returncode = 0
    return usage.ru_utime + usage.ru_stime, time.monotonic() - began, int(peak_kb) / 1024


def _env() -> dict[str, str]:
    """With Python's own cache of compiled modules, as any installation has it."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return kept | {"PYTHONPATH": str(ROOT)}


def _imports() -> str:
    """What `python -X importtime` reports of the packages that weigh most, in ms."""
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


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m bench.start", description=__doc__)
    parser.add_argument("graphs", nargs="*", help="shipped graphs; default: all")
    parser.add_argument("--rounds", type=int, default=3, help="warm starts of each")
    parser.add_argument("--write", action="store_true", help=f"write into docs/{PAGE}")
    given = parser.parse_args()
    load = os.getloadavg()[0]
    sections = [commands(given.rounds), graphs(given.graphs or list(shipped()), given.rounds)]
    busy = f" The load average was {load:.1f} at the start: wall times are of a busy machine." if load > 1 else ""
    print(whole(sections, ABOUT + busy))
    if given.write:
        begin, end = marks("bench.start")
        publish(sections, ABOUT + busy, PAGE, begin, end)


if __name__ == "__main__":
    main()
