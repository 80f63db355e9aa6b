"""`kinegraph batch`: the bits of a replay, in tables; what has not changed is kept; what fails costs only itself."""

from __future__ import annotations

import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from io import StringIO
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas
import pytest
from rich.console import Console

import kinegraph as kg
from kinegraph.stream.batch.cluster import AHEAD, spread, workers
from kinegraph.stream.batch.digests import recording_digest
from kinegraph.stream.batch.jobs import Job, jobs, read_grid
from kinegraph.stream.batch.manifest import JOBS, JobEntry, Manifest
from kinegraph.stream.batch.study import BatchState, memory_of, number_of_workers
from kinegraph.stream.batch.work import Common, do
from kinegraph.stream.cli.commands.batch import _report, _shown
from kinegraph.stream.errors import GraphError, KinegraphError
from kinegraph.stream.graph.reading.load import load_text
from kinegraph.stream.recording.format.versions import release
from kinegraph.stream.recording.series import write_recording
from kinegraph.stream.system.file_digest import sha256_of
from kinegraph.stream.system.memory_limit import ceiling
from tests.study.batch_runs import GRAPH, common, out_with
from tests.study.batch_runs import folder as folder
from tests.study.batch_runs import recordings as recordings
from tests.support.command_line import KINEGRAPH, Command, kinegraph, refused

__all__ = ["kinegraph"]
ROOT = Path(__file__).resolve().parents[2]
DEADLY = """
from __future__ import annotations

import os
from dataclasses import dataclass

from kinegraph.operators.filters.rectify import Rectify


@dataclass(frozen=True)
class Deadly(Rectify):
    dies: bool = False

    def process(self, state, chunk):
        if self.dies:
            os._exit(3)
        return super().process(state, chunk)
"""


@pytest.mark.quick
def test_a_grid_is_read_as_yaml_lists() -> None:
    assert read_grid(["smooth.cutoff_hz=4, 6,1e1", "x.place=[a, b]", "y.on=true"]) == {
        "smooth.cutoff_hz": [4, 6, 10.0],
        "x.place": [["a", "b"]],
        "y.on": [True],
    }


@pytest.mark.parametrize(
    "settings", [["smooth.cutoff_hz"], ["=4"], ["a.b="], ["a.b=4", "a.b=5"], ["a.b=4,4"], ["a.b=[4"]]
)
def test_a_grid_that_is_none_is_refused(settings: list[str]) -> None:
    with pytest.raises(KinegraphError, match="--set"):
        read_grid(settings)


def test_every_recording_with_every_combination(folder: Path) -> None:
    found = jobs([Path("s1"), Path("s2"), folder / "s1"], {"a.x": [1, 2], "b.y": ["u", "v", "w"]})
    assert len(found) == 2 * 2 * 3 and len({job.key for job in found}) == 12
    assert {job.name for job in found} == {"s1", "s2"}
    with pytest.raises(KinegraphError, match="more than"):
        jobs([Path("s1")], {"a.x": list(range(2000)), "b.y": list(range(2000))})


def test_the_bits_are_those_of_a_replay(folder: Path) -> None:
    out = out_with(common())
    for name in ("s1", "s2"):
        for cutoff in (4, 6):
            entry, now = do(out, Job(folder / name, name, {"smooth.cutoff_hz": cutoff}))
            assert now and entry.status == "done", entry
    results = kg.BatchResults(out)
    assert results.outputs == ["active.interval", "smooth"] and not results.failed
    table = results.to_pandas("smooth")
    assert set(table["subject"]) == {"S1", "S2"} and set(table["speed"]) == {1.2}
    for name in ("s1", "s2"):
        for cutoff in (4, 6):
            one = table[(table["recording"] == name) & (table["smooth.cutoff_hz"] == cutoff)]
            replayed = kg.replay(kg.load("graph.yaml", {"smooth.cutoff_hz": cutoff}), name)["smooth"]
            channels = list(replayed.spec.channels)
            assert one[channels].to_numpy().tobytes() == np.ascontiguousarray(replayed.data).tobytes()
            assert (one["time"].astype("int64").to_numpy() == replayed.time).all()
    plain = pandas.read_parquet(out / "smooth")
    assert len(plain) == len(table)


def test_jobs_name_graph_version_and_recording_by_digest(folder: Path, kinegraph: Command) -> None:
    assert (
        kinegraph("batch", "graph.yaml", "s1", "s2", "--set", "smooth.cutoff_hz=4,6", "-o", "out", "--workers", 2)[0]
        == 0
    )
    table = pandas.read_parquet("out/jobs.parquet").set_index(["recording", "settings"])
    for (name, settings), row in table.iterrows():
        graph = load_text(GRAPH, "graph", overrides=json.loads(settings))
        assert row["graph_digest"] == hashlib.sha256(graph.text.encode()).hexdigest()
        parts = [sha256_of(part) for part in sorted((folder / name).glob("*.mcap"))]
        assert row["recording_digest"] == hashlib.sha256("".join(parts).encode()).hexdigest()
        assert row["version"] == release() and re.fullmatch(r".+:\d+", row["worker"])
    assert table["graph_digest"].nunique() == 2 and table["recording_digest"].nunique() == 2


def test_the_pages_lines_for_polars_and_duckdb_open_the_tables(folder: Path) -> None:
    polars, duckdb = (pytest.importorskip(name, reason=f"{name} is not installed") for name in ("polars", "duckdb"))
    page = (ROOT / "docs/use/batch.md").read_text()
    (line,), (query,) = re.findall(r"`(pl\.scan_parquet\(.*?\))`", page), re.findall(r"`(from '.*?')`", page)
    out, rows = out_with(common()), 0
    for name in ("s1", "s2"):
        rows += do(out, Job(folder / name, name))[0].rows["smooth"]
    out.rename("results")
    read = eval(line, {"pl": polars}).collect()
    assert len(read) == rows and set(read["recording"]) == {"s1", "s2"}
    assert duckdb.sql(f"select count(*), count(distinct recording), max(TA) {query}").fetchall() == [
        (rows, 2, read["TA"].max())
    ]


def test_units_and_gaps_are_in_the_file(folder: Path) -> None:
    import pyarrow.parquet

    out = out_with(common())
    entry, _ = do(out, Job(folder / "s1", "s1"))
    schema = pyarrow.parquet.read_schema(out / entry.tables["smooth"])
    assert schema.field("TA").metadata == {b"unit": b"uV"}
    assert json.loads(schema.metadata[b"kinegraph"])["rate_hz"] == 1000
    assert schema.names[:4] == ["subject", "speed", "time", "lost"]


def test_what_has_not_changed_is_kept(folder: Path) -> None:
    (folder / "s1").unlink()
    kg.run(
        kg.load("graph.yaml", {"board.duration_s": 40}), folder / "s1"
    )  # long enough for half of its file to hold whole chunks
    job = Job(folder / "s1", "s1")
    out = out_with(common())
    first, now = do(out, job)
    assert now
    assert do(out, job) == (first, False)
    table = out / first.tables["smooth"]
    os.utime(table, ns=(0, 0))

    (folder / "s1" / "report.html").write_text("a report made later")
    assert not do(out, job)[1]
    file = folder / "s1" / "session.0000.mcap"
    os.utime(file, ns=(0, 0))
    assert not do(out, job)[1], "the same bytes, another time"
    out_with(common(again=True))
    assert do(out, job)[1] and table.stat().st_mtime_ns
    Common(GRAPH + "# a comment\n", "graph", str(folder / "graph.yaml")).save(out)
    assert do(out, job)[1], "another graph"
    assert not do(out, job)[1]
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
    entry, now = do(out, job)
    assert now and entry.status == "incomplete" and "not closed" in entry.error
    assert entry.tables, "what there is is kept"


def test_a_model_that_changed_is_noticed(folder: Path) -> None:
    own = "from dataclasses import dataclass\nfrom pathlib import Path\nfrom kinegraph.operators.filters.rectify import Rectify\n\n\n"
    own += "@dataclass(frozen=True)\nclass Modelled(Rectify):\n    model: str = 'model.npz'\n"
    Path("modelled_part.py").write_text(own)
    Path("model.npz").write_bytes(b"1")
    text = GRAPH.replace("operators.filters.iir.Lowpass", "modelled_part.Modelled").replace(", cutoff_hz: 6", "")
    kept = Common(text, "graph", str(folder / "graph.yaml"))
    out, job = out_with(kept), Job(folder / "s1", "s1")
    assert do(out, job)[0].status == "done" and not do(out, job)[1]
    Path("model.npz").write_bytes(b"2")
    assert do(out, job)[1]
    assert not do(out, job)[1]
    Path("modelled_part.py").write_text(own + "\n\n# changed\n")
    assert do(out, job)[1]


def test_what_fails_is_an_entry_and_leaves_no_table(folder: Path) -> None:
    out = out_with(common())
    done, _ = do(out, Job(folder / "s1", "s1"))
    (folder / "broken.mcap").write_bytes(b"no recording at all")
    for job in (
        Job(folder / "broken.mcap", "broken"),
        Job(folder / "none", "none"),
        Job(folder / "s2", "s2", {"x.y": 1}),
    ):
        since = time.monotonic()
        entry, now = do(out, job)
        assert entry.failed and entry.error and now and not entry.tables
        assert 0 <= entry.took_s <= time.monotonic() - since
        assert do(out, job)[1], "what failed is tried again"
    results = kg.BatchResults(out)
    assert {entry.name for entry in results.failed} == {"broken", "none", "s2"}
    assert len(list(out.glob("smooth/*/*"))) == 1
    with pytest.raises(KinegraphError, match="smooth"):
        results.to_arrow("smoth")
    assert (out / done.tables["smooth"]).stat().st_mode & 0o077 == 0


def test_a_full_disk_fails_the_job(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import kinegraph.stream.batch.parquet as parquet

    def full(self: object) -> None:
        raise OSError(28, "No space left on device")

    out = out_with(common())
    monkeypatch.setattr(parquet.ParquetTable, "_flush", full)
    entry, _ = do(out, Job(folder / "s1", "s1"))
    assert entry.failed and "No space left" in entry.error
    assert not [path for path in out.rglob("*.parquet*") if path.is_file()]


def test_images_stay_out_of_tables(folder: Path) -> None:
    spec = kg.StreamSpec(shape=(96, 128), dtype=np.dtype(np.uint16), rate_hz=10.0, units=("mm",))
    frames = kg.Series("bed.depth", spec, np.arange(30) * 10**8, np.full((30, 96, 128), 2000, np.uint16))
    write_recording(folder / "bed.mcap", [frames], {"graph": "", "session": {}})
    text = "nodes:\n  bed: {use: devices.people.bedside.Bedside}\n"
    text += "  scaled: {use: operators.filters.scale.Scale, from: bed.depth, gain: 0.001}\nrecord: [scaled]\n"
    entry, _ = do(out_with(Common(text, "bed", str(folder / "bed.yaml"))), Job(folder / "bed.mcap", "bed"))
    assert entry.status == "done" and "do not fit into a table" in entry.left_out["scaled"], entry


def test_memory_bounds_how_many_work_at_once(folder: Path) -> None:
    needed = memory_of(common(), jobs([Path("none"), Path("s1")], {"smooth.cutoff_hz": [4, 6]}))
    assert needed > 100e6
    assert number_of_workers("local", 8, 100, needed) <= 8
    assert number_of_workers("local", 8, 3, 1) == 3
    assert number_of_workers("local", 8, 100, ceiling(0) // 2) == 2
    with pytest.raises(KinegraphError, match="MB"):
        number_of_workers("local", 8, 100, 2 * ceiling(0))
    with pytest.raises(GraphError, match="cutoff"):
        memory_of(common(), jobs([Path("s1")], {"smooth.cutoff": [4]}))
    with pytest.raises(KinegraphError, match="no recording can be read"):
        memory_of(common(), jobs([Path("none")], {}))


def test_only_a_changed_recording_is_read_again(folder: Path) -> None:
    known = recording_digest(folder / "s1", {})
    assert recording_digest(folder / "s1", known | {"sha256": "kept"})["sha256"] == "kept"
    assert recording_digest(folder / "s1", known | {"files": {}}) == known
    assert recording_digest(folder / "s2", known)["sha256"] != known["sha256"]


def test_on_the_command_line(folder: Path, kinegraph: Command) -> None:
    (folder / "bad.mcap").write_bytes((folder / "s1" / "session.0000.mcap").read_bytes()[:200])
    call = ("batch", "graph.yaml", "s1", "s2", "bad.mcap", "--set", "smooth.cutoff_hz=4,6", "-o", "out", "--workers", 2)
    code, shown, complaint = kinegraph(*call)
    assert (
        code == 1 and "4 jobs done, 0 unchanged, 2 failed" in shown and "bad.mcap with smooth.cutoff_hz=4" in complaint
    )
    failed = pandas.read_parquet("out/failed.parquet")
    assert list(failed["recording"]) == ["bad.mcap"] * 2 and failed["error"].str.len().min() > 0
    assert len(pandas.read_parquet("out/jobs.parquet")) == 6
    code, shown, _ = kinegraph("batch", "graph.yaml", "s1", "s2", "--set", "smooth.cutoff_hz=6,8", "-o", "out")
    assert code == 0 and "2 jobs done, 2 unchanged, 0 failed" in shown
    refused(kinegraph("batch", "graph.yaml", "s1", "--set", "smooth.cutof_hz=6", "-o", "o2"), "cutof_hz", "cutoff_hz")
    refused(kinegraph("batch", "grap.yaml", "s1", "-o", "o2"), "grap.yaml")
    refused(kinegraph("batch", "graph.yaml", "s1", "-o", "o2", "--cluster", "tcp://127.0.0.1:9"), "127.0.0.1:9")


def test_a_terminal_shows_the_jobs_done_the_failures_and_the_time_left(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = StringIO()
    monkeypatch.setattr(
        "kinegraph.stream.text.screen.Screen", lambda **_: Console(file=drawn, force_terminal=True, width=120)
    )
    tally = BatchState(40)
    with _shown(40, quiet=False) as progress:
        for k in range(8):
            tally.add(JobEntry(f"{k}", "s1", {}, "failed" if k == 3 else "done", "", worker=f"pc:{k % 2}"), now=k != 2)
            progress(tally)
            time.sleep(0.1)  # the bar is drawn ten times a second
    shown = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", drawn.getvalue())
    assert re.search(r"batch[\s,][^\n]*[1-3]/40 jobs", shown) and re.search(
        r"batch, 1 failed, by worker 3 4[^\n]*/40 jobs 0:00:\d\d", shown
    ), shown
    assert tally.finished == 8 and tally.kept == 1 and tally.made["done"] == 6


def test_what_is_printed_to_a_pipe_is_the_summary_alone(capsys: pytest.CaptureFixture[str]) -> None:
    tally = BatchState(13)
    for k in range(13):
        tally.add(
            JobEntry(f"{k}", f"s{k}", {"a.b": 1}, "failed" if k < 12 else "done", "", error="why", seconds=9.0), True
        )
    with _shown(13, quiet=False) as progress:
        progress(tally)
    _report(tally, Path("out"))
    output = capsys.readouterr()
    assert output.out == "1 jobs done, 0 unchanged, 12 failed; 117 s replayed; results in out\n"
    assert output.err.splitlines()[0] == "  s0 with a.b=1: why" and "and 2 more, in out/failed.parquet" in output.err


class Workers:
    """A Dask client of so many places; what it was given at a time, and what has ended."""

    def __init__(self, places: int) -> None:
        self.places = places
        self.given: list[int] = []

    def nthreads(self) -> dict[str, int]:
        return {f"tcp://{k}": 1 for k in range(self.places)}

    def map(self, call: Callable[[int], int], items: Sequence[int], **_: object) -> list[SimpleNamespace]:
        self.given.append(len(items))
        ended: dict[int, Any] = {k: call(k) for k in items}
        return [SimpleNamespace(key=f"job-{k}", status="finished", value=value) for k, value in ended.items()]

    def gather(self, futures: dict[str, SimpleNamespace]) -> dict[str, int]:
        return {key: future.value for key, future in futures.items()}


class Ended:
    """What `as_completed` is, of futures that have ended: a few at a time."""

    def __init__(self) -> None:
        self.waiting: list[SimpleNamespace] = []

    def update(self, futures: list[SimpleNamespace]) -> None:
        self.waiting += futures

    def next_batch(self, block: bool = True) -> list[SimpleNamespace]:
        taken, self.waiting = self.waiting[:7], self.waiting[7:]
        return taken


@pytest.mark.parametrize(("places", "jobs"), [(1, 1), (1, 2), (4, 9), (16, 20), (16, 40), (2, 1000), (200, 500)])
def test_jobs_wait_at_the_scheduler_not_at_workers(places: int, jobs: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Up to two for each worker, Dask hands jobs to workers at once; so no more are given out than there are workers, until more follow."""
    monkeypatch.setattr("distributed.as_completed", Ended)
    client = Workers(places)
    came = dict(spread(client, lambda k: -k, range(jobs)))
    assert came == {k: -k for k in range(jobs)}
    first = client.given[0]
    assert first <= places or first > 2 * places
    assert max(client.given) <= places + AHEAD and len(client.given) <= max(jobs, 7)


def test_a_worker_that_dies_costs_its_own_job(folder: Path, kinegraph: Command) -> None:
    Path("deadly_part.py").write_text(DEADLY)
    text = GRAPH.replace("operators.filters.iir.Lowpass", "deadly_part.Deadly").replace(", cutoff_hz: 6", "")
    Path("deadly.yaml").write_text(text)
    options = ("--set", "smooth.dies=true,false", "-o", "out", "--workers", 1, "--retries", 0)
    code, shown, complaint = kinegraph("batch", "deadly.yaml", "s1", *options)
    assert code == 1 and "1 jobs done, 0 unchanged, 1 failed" in shown, complaint
    assert "s1 with smooth.dies=True: its worker died" in complaint
    assert [entry.settings["smooth.dies"] for entry in Manifest(Path("out")) if not entry.failed] == [False]


def test_a_killed_batch_goes_on_where_it_was(folder: Path) -> None:
    command = [KINEGRAPH, "batch", "graph.yaml", "s1", "s2", "-o", "out", "--workers", "1"]
    command += ["--set", "smooth.cutoff_hz=" + ",".join(map(str, range(2, 12)))]
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    waited = time.monotonic()
    while len(list(Path("out", JOBS).glob("*.json"))) < 3:
        assert process.poll() is None and time.monotonic() - waited < 120
        time.sleep(0.02)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    done = sum(1 for _ in Manifest(Path("out")))
    assert 3 <= done < 20
    after = subprocess.run(command, capture_output=True, text=True, check=True)
    assert f"{20 - done} jobs done, {done} unchanged, 0 failed" in after.stdout, after.stdout
    assert not list(Path("out").rglob("*.draft"))


@pytest.fixture
def scheduler() -> Iterator[str]:
    """A Dask scheduler with a worker, of another process, as an administrator starts them."""
    script = "import time, distributed\nif __name__ == '__main__':\n"
    script += "    c = distributed.LocalCluster(n_workers=1, threads_per_worker=1, host='127.0.0.1', dashboard_address=None)\n"
    script += "    print(c.scheduler_address, flush=True)\n    input()\n"
    process = subprocess.Popen([sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.stdin and process.stdout
    yield process.stdout.readline().strip()
    process.communicate("\n", timeout=60)


def test_on_a_scheduler_that_is_there(folder: Path, kinegraph: Command, scheduler: str) -> None:
    code, shown, complaint = kinegraph("batch", "graph.yaml", "s1", "-o", "out", "--cluster", scheduler)
    assert code == 0 and "1 jobs done" in shown, complaint


def test_the_workers_are_reached_with_the_batchs_certificate_only() -> None:
    with workers("local", 1, 1 << 30, 1) as client:
        assert client.scheduler_info()["address"].startswith("tls://127.0.0.1:")
