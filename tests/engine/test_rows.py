"""Operators in a row as one piece of machine code: the same samples, counts and states as one by one, whatever comes."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kinegraph.operators.filters.decimate import Decimate
from kinegraph.operators.filters.derivative import Derivative
from kinegraph.operators.filters.iir import Lowpass
from kinegraph.operators.filters.moving import MovingMean
from kinegraph.operators.filters.rectify import Rectify
from kinegraph.operators.filters.scale import straight_line
from kinegraph.stream.chunk import FOREVER, Array, Chunk, StreamSpec, empty
from kinegraph.stream.engine.flow import row
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.engine.warmup import Compilations
from kinegraph.stream.errors import GraphError
from kinegraph.stream.filter import KernelCall
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.kernel import is_kernel, kernel
from kinegraph.stream.operator import Operator

pytestmark = pytest.mark.skipif(not row.POSSIBLE, reason="this system has no rows")

GRAPH = """
nodes:
  board: {use: devices.people.treadmill.Treadmill, realtime: false}
  choose: {use: operators.filters.channels.Select, from: board.emg, channels: [2, 0, 1]}
  centre: {use: operators.filters.mean.RemoveMean, from: choose, window_s: 0.05}
  rectify: {use: operators.filters.rectify.Rectify, from: centre}
  lowpass: {use: operators.filters.iir.Lowpass, from: rectify, cutoff_hz: 20}
  thin: {use: operators.filters.decimate.Decimate, from: lowpass, every: 7}
  mean: {use: operators.filters.moving.MovingMean, from: thin, window_s: 0.05}
  scale: {use: operators.filters.scale.Scale, from: mean, gain: 0.5}
  events: {use: operators.filters.threshold.Threshold, from: scale, level: 0.2, channel: 0}
"""
NAMES = ("choose", "centre", "rectify", "lowpass", "thin", "mean", "scale")
START = 10**18


def pipeline(monkeypatch: pytest.MonkeyPatch, *, rows: bool, tapped: str = "") -> Pipeline:
    monkeypatch.setattr(row, "POSSIBLE", rows)
    made = Pipeline(load_text(GRAPH))
    if tapped:
        made.edges[tapped].observers.append(lambda chunk: None)
    made.compile()
    return made


def rows_in(made: Pipeline) -> list[list[str]]:
    spans = [span for segment in made.segments for span in segment.spans if span.row]
    return [[port.node for port in span.ports] for span in spans]


def delivery(seed: int, width: int) -> list[Chunk]:
    """Chunks of all sizes, with gaps that are held and gaps that reset, bad samples, and pauses."""
    random = np.random.default_rng(seed)
    now, made = START, []
    for _ in range(60):
        n = int(random.choice([0, 1, 3, 10, 40, 200]))
        lost = int(random.choice([0] * 8 + [5, 500]))
        now += lost * 10**6
        time = now + np.arange(n) * 10**6
        now += n * 10**6
        data = random.normal(size=(n, width))
        if n and random.random() < 0.2:
            data[random.integers(n), random.integers(width)] = random.choice([np.nan, np.inf])
        made.append(Chunk(time, data, now - 10**6, lost if n else 0))
    return [*made, Chunk(np.empty(0, np.int64), np.empty((0, width)), FOREVER)]


def fed(made: Pipeline, chunks: list[Chunk]) -> list[tuple[Array, Array, int, int]]:
    """Feed copies of these, and what came out behind the last of them, in order."""
    out: list[tuple[Array, Array, int, int]] = []
    edge = made.edges["scale"]
    edge.observers.append(lambda c: out.append((c.time.copy(), c.data.copy(), c.until, c.lost)))
    made.compile()
    for c in chunks:
        made.feed("board.emg", Chunk(c.time.copy(), c.data.copy(), c.until, c.lost))
    edge.observers.pop()
    return out


def alike(one: list[tuple[Array, Array, int, int]], other: list[tuple[Array, Array, int, int]]) -> bool:
    return [(t.tobytes(), d.tobytes(), u, k) for t, d, u, k in one] == [
        (t.tobytes(), d.tobytes(), u, k) for t, d, u, k in other
    ]


def states(made: Pipeline) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in made.snapshot().items()}


@pytest.mark.parametrize("seed", range(6))
def test_a_row_gives_what_its_operators_give(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, joined = (pipeline(monkeypatch, rows=rows) for rows in (False, True))
    assert rows_in(plain) == [] and rows_in(joined) == [[*NAMES]]
    chunks = delivery(seed, plain.entries["board.emg"].spec.shape[0])
    monkeypatch.setattr(row, "POSSIBLE", False)
    one = fed(plain, chunks)
    monkeypatch.setattr(row, "POSSIBLE", True)
    other = fed(joined, chunks)
    assert len(one) > 20 and alike(one, other)
    assert states(plain) == states(joined)  # and with them what passed every wire, gaps and losses


def test_whoever_listens_in_between_cuts_the_row(monkeypatch: pytest.MonkeyPatch) -> None:
    made = pipeline(monkeypatch, rows=True, tapped="rectify")
    assert rows_in(made) == [[*NAMES[:3]], [*NAMES[3:]]]


def test_each_operator_of_a_row_is_timed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A first call that has to load its code may take as long as hundreds of others, which go untimed then."""
    made, fed = pipeline(monkeypatch, rows=True), 0
    timings = {name: made.stages[name].timing for name in NAMES}
    while timings["thin"].calls == timings["mean"].calls and fed < 1_000_000:
        fed += 400
        _feed(made, range(fed - 400, fed))
        made.fold(least=1)
    read = {name: timing.read() for name, timing in timings.items()}
    assert read["thin"]["calls"] > read["mean"]["calls"] > 0, "some chunks end where samples are left out"
    assert all(0.0 < row["p50_us"] < 1000.0 for row in read.values())
    assert made.stages["thin"].edges["out"].samples == -(-3 * fed // 7)


def test_what_comes_after_a_loss_is_timed_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    made = pipeline(monkeypatch, rows=True)
    _feed(made, range(400), lost=1)
    made.fold(least=1)
    assert all(0.0 < made.stages[name].timing.read()["p50_us"] < 1000.0 for name in NAMES)


def _feed(made: Pipeline, chunks: range, lost: int = 0) -> None:
    """Chunks of three samples, with so many missing before each."""
    for i in chunks:
        stamps = START + (i * (3 + lost) + np.arange(3)) * 10**6
        data = np.ones((3, made.entries["board.emg"].spec.shape[0]))
        made.feed("board.emg", Chunk(stamps, data, int(stamps[-1]), lost if i else 0))


def test_a_restored_row_goes_on_where_the_other_was(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, first, second = (pipeline(monkeypatch, rows=True) for _ in range(3))
    chunks = delivery(9, whole.entries["board.emg"].spec.shape[0])
    expected = fed(whole, chunks)
    got = fed(first, chunks[:25])
    second.restore(first.snapshot())
    got += fed(second, chunks[25:])
    assert alike(expected, got)


def test_nothing_compiles_once_a_pipeline_is_fastened(monkeypatch: pytest.MonkeyPatch) -> None:
    made = pipeline(monkeypatch, rows=True)
    before, compilations = written(), Compilations()
    try:
        for chunk in delivery(
            3, made.entries["board.emg"].spec.shape[0]
        ):  # with gaps, which are worked through one by one
            made.feed("board.emg", chunk)
    finally:
        compilations.stop()
    assert compilations.names == [] and written() == before


def written() -> set[str]:
    """The rows that this process has."""
    return {name for name in sys.modules if name.startswith("kinegraph_row_")}


def test_a_first_session_compiles_nothing_while_it_runs(tmp_path: Path) -> None:
    (tmp_path / "g.yaml").write_text(GRAPH.replace("realtime: false", "duration_s: 1.5"))
    command = [sys.executable, "-m", "kinegraph", "run", "g.yaml", "--no-record", "--view", "lines"]
    environment = {**os.environ, "KINEGRAPH_CACHE": str(tmp_path / "cache")}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0 and "compiled while running" not in done.stderr, done.stderr


def test_what_has_no_place_in_a_row(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = load_text(GRAPH).nodes["board"].specs["emg"]

    def opened(operator: Operator[Any], spec: StreamSpec = spec) -> KernelCall | None:
        return row.step_of(operator, spec, operator.open({"in": spec})["out"])

    assert opened(Rectify()) and opened(Decimate(2)) and opened(MovingMean(0.1))
    assert opened(Lowpass(20.0, start="first")) and opened(Derivative()) is None, (
        "which would not tell that time passes"
    )
    assert opened(Rectify(), spec.derive(dtype=np.dtype(np.float32))) is None, "samples must be converted first"
    assert not is_kernel(opened) and not is_kernel(_nested()) and not is_kernel(letting_go)


@dataclass(frozen=True, slots=True)
class Slip(Rectify):
    """Names a kernel that wants more than the state has."""

    kernel = straight_line


@dataclass(frozen=True, slots=True)
class Stampless(Rectify):
    """Thins out without stamps."""

    def rows(self, n: int) -> int:
        return n // 2


@pytest.mark.parametrize(
    ("part", "told"),
    [
        ("Slip", "the kernel of Slip is to be given 'line', which is neither a field of its state nor a parameter"),
        ("Stampless", "Stampless leaves samples out .`rows`., so its kernel must be given `stamps`"),
    ],
)
def test_a_slip_in_a_declaration_names_the_node(part: str, told: str) -> None:
    text = GRAPH.replace("operators.filters.rectify.Rectify", f"tests.engine.test_rows.{part}")
    with pytest.raises(GraphError, match=f"node 'rectify': {told}"):
        load_text(text)


@kernel(nogil=True)
def letting_go(x: Array, out: Array) -> None:
    """Gives up the interpreter, which a kernel in a row must not."""
    out[:] = x


def _nested() -> Callable[..., None]:
    @kernel
    def inner(x: Array, out: Array) -> None:
        out[:] = x

    return inner


KEPT = """
import sys
import tests.engine.test_rows as rows
from kinegraph.stream.engine.pipeline import Pipeline
from kinegraph.stream.graph.reading.load import load_text
made = Pipeline(load_text(rows.GRAPH))
made.compile()
run = next(module.run for name, module in sys.modules.items() if name.startswith("kinegraph_row_"))
print(sum(run.stats.cache_hits.values()), sum(run.stats.cache_misses.values()))
"""


def test_rows_are_kept_for_the_next_start(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    environment = {**os.environ, "KINEGRAPH_CACHE": str(tmp_path), "PYTHONPATH": f"{root}{os.pathsep}{root / 'tests'}"}
    told = [subprocess.check_output([sys.executable, "-c", KEPT], env=environment, text=True) for _ in range(2)]
    assert [text.split() for text in told] == [["0", "1"], ["1", "0"]]


@pytest.mark.parametrize("how", ["apart", "read-only"])
def test_arrays_that_no_kernel_takes_are_made_normal_first(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    plain, joined = (pipeline(monkeypatch, rows=rows) for rows in (False, True))
    width = plain.entries["board.emg"].spec.shape[0]
    time, data = START + np.arange(80) * 10**6, np.random.default_rng(2).normal(size=(80, width))
    if how == "apart":
        time, data = time[::2], data[::2]
    else:
        time.flags.writeable = data.flags.writeable = False
    for made in (plain, joined):
        made.feed("board.emg", Chunk(time, data, int(time[-1])))
    assert states(plain) == states(joined)


def test_time_alone_passes_a_row_step_by_step(monkeypatch: pytest.MonkeyPatch) -> None:
    made = pipeline(monkeypatch, rows=True)
    got = fed(made, [empty(made.entries["board.emg"].spec, START)])
    assert [u < START for _, _, u, _ in got] == [True]
