"""Batches on a cluster: queues, schedulers, certificates."""

from __future__ import annotations

import contextlib
import http.client
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import dask
import pytest
from filelock import FileLock

import kinegraph as kg
from kinegraph.stream.batch.cluster import ClusterError, workers
from kinegraph.stream.batch.jobs import Job
from kinegraph.stream.batch.work import Common, do
from tests.study.batch_runs import GRAPH, common, out_with
from tests.study.batch_runs import folder as folder
from tests.study.batch_runs import recordings as recordings
from tests.support.command_line import KINEGRAPH, Command, refused
from tests.support.tiers import rest_nightly

SUBMIT = """#!/bin/sh
for script do :; done
kept=$(mktemp "$QUEUE/job.XXXXXX")
cp "$script" "$kept"
setsid bash "$kept" > /dev/null 2>&1 &
echo $! >> "$QUEUE/pids"
echo "%s$!%s"
"""
CANCEL = """#!/bin/bash
for job do kill -- "-${job%.*}"; done
"""
QUEUES = {"slurm": ("sbatch", "scancel", "Submitted batch job ", ""), "pbs": ("qsub", "qdel", "", ".head")}
ASKED = {
    "slurm": ("#SBATCH -n 1", "#SBATCH --cpus-per-task=1", "#SBATCH --mem="),
    "pbs": ("#PBS -l select=1:ncpus=1:mem=",),
}


@pytest.fixture
def queue(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The commands of Slurm and PBS, which run what is submitted on this machine at once; the folder that keeps each script."""
    place = tmp_path / "queue"
    (place / "bin").mkdir(parents=True)
    (place / "pids").touch()
    for submit, cancel, before, after in QUEUES.values():
        for name, text in ((submit, SUBMIT % (before, after)), (cancel, CANCEL)):
            (place / "bin" / name).write_text(text)
            (place / "bin" / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{place / 'bin'}:{os.environ['PATH']}")
    monkeypatch.setenv("QUEUE", str(place))
    yield place
    for pid in (place / "pids").read_text().split():
        with contextlib.suppress(ProcessLookupError):
            os.killpg(int(pid), signal.SIGKILL)


@pytest.mark.parametrize("where", rest_nightly(*sorted(QUEUES)))
def test_through_a_queue(folder: Path, queue: Path, where: str) -> None:
    pytest.importorskip("dask_jobqueue")
    settings = {f"DASK_JOBQUEUE__{where.upper()}__INTERFACE": "lo"}
    command = [KINEGRAPH, "batch", "graph.yaml", "s1", "s2", "-o", "out", "--cluster", where, "--workers", "2"]
    done = subprocess.run(command, env=os.environ | settings, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0 and "2 jobs done, 0 unchanged, 0 failed" in done.stdout, done.stdout + done.stderr
    scripts = [path.read_text() for path in queue.glob("job.*")]
    assert len(scripts) == 2 and all("--nthreads 1 " in text for text in scripts), scripts
    assert all(asked in text for text in scripts for asked in ASKED[where]), scripts
    assert set(kg.BatchResults("out").to_pandas("smooth")["recording"]) == {"s1", "s2"}


def has_slurm() -> bool:
    """Whether a Slurm controller answers."""
    scontrol = shutil.which("scontrol")
    return bool(scontrol) and subprocess.run([scontrol or "", "ping"], capture_output=True, timeout=60).returncode == 0


@pytest.mark.skipif(not has_slurm(), reason="no Slurm controller answers `scontrol ping`")
@pytest.mark.timeout(600)
def test_through_slurm_itself(folder: Path) -> None:
    pytest.importorskip("dask_jobqueue")
    settings = {"DASK_JOBQUEUE__SLURM__INTERFACE": "lo"} | dict(os.environ)
    command = [KINEGRAPH, "batch", "graph.yaml", "s1", "s2", "-o", "out", "--cluster", "slurm", "--workers", "2"]
    done = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=580)
    assert done.returncode == 0 and "2 jobs done, 0 unchanged, 0 failed" in done.stdout, done.stdout + done.stderr
    assert set(kg.BatchResults("out").to_pandas("smooth")["recording"]) == {"s1", "s2"}


def test_kubernetes_is_refused_as_its_scheduler_takes_jobs_from_anybody() -> None:
    with pytest.raises(ClusterError, match="tls://HOST:PORT"), workers("kubernetes", 1, 1 << 30, 1):
        pass


@pytest.mark.parametrize("where", ["slurm", "pbs"])
def test_the_scheduler_of_a_queue_takes_jobs_with_the_batchs_certificate_only(
    where: str, tmp_path: Path, queue: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("dask_jobqueue")
    monkeypatch.setenv(f"DASK_JOBQUEUE__{where.upper()}__INTERFACE", "lo")
    dask.config.refresh()
    out = tmp_path / "out"
    out.mkdir(mode=0o700)
    with workers(where, 0, 1 << 30, 1, out) as client:
        address = client.scheduler_info()["address"]
        script = client.cluster.job_script()
        certificates = [path for path in out.iterdir() if path.is_file()]
    assert address.startswith("tls://")
    assert "--protocol tls://" in script and f"--tls-key {out}" in script and "WORKER__HTTP__ROUTES='[]'" in script
    assert certificates and not any(path.stat().st_mode & 0o077 for path in certificates)


def test_dasks_web_pages_are_off() -> None:
    with workers("local", 0, 1 << 30, 1) as client:
        port = client.cluster.scheduler.http_server.port
        with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=100)) as connection:
            connection.request("GET", "/health")
            with connection.getresponse() as answer:
                assert answer.status == 404


def test_a_second_batch_in_the_same_folder_is_refused(folder: Path, kinegraph: Command) -> None:
    (folder / "out").mkdir()
    with FileLock(folder / "out" / ".lock"):
        refused(kinegraph("batch", "graph.yaml", "s1", "-o", "out"), "out: another batch is at work there")
    assert not (folder / "out" / ".graph.json").exists()


def test_a_job_of_another_batch_writes_nothing(folder: Path) -> None:
    mine, other = common(), Common(GRAPH + "# another\n", "graph", str(folder / "graph.yaml"))
    out = out_with(other)
    entry, now = do(out, Job(folder / "s1", "s1"), digest=mine.digest)
    assert entry.failed and now and "another batch" in entry.error
    assert [path.name for path in out.iterdir()] == [".graph.json"]


@pytest.mark.parametrize("where", ["slurm", "pbs"])
def test_a_cluster_without_its_library_is_refused(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "dask_jobqueue", None)
    with pytest.raises(ClusterError, match=r"pip install 'kinegraph\[queue\]'"), workers(where, 1, 1 << 30, 1):
        pass
