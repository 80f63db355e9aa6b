"""The workers of a batch: processes of this machine, or those of a cluster, both by Dask."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any

from stream.errors import KinegraphError

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
QUEUES = {"slurm": "SLURMCluster", "pbs": "PBSCluster"}
KUBERNETES = "kubernetes"
PATIENCE_S = 10
"""Within which a scheduler that is there answers."""


class ClusterError(KinegraphError):
    """There are no workers."""


@contextmanager
def workers(where: str, count: int, memory_bytes: int, retries: int) -> Iterator[Client]:
    """Within: workers, each of which does one job at a time.

    where         "local"; "slurm", "pbs" (dask-jobqueue) or "kubernetes" (dask-kubernetes); or the address of a Dask scheduler
    memory_bytes  what a job may need; a queue is asked for as much for each worker
    retries       how often a job whose worker died is given to another
    """
    dask, distributed = _dask()
    settings = {
        "distributed.scheduler.allowed-failures": retries,
        "distributed.worker.daemon": False,
        "distributed.admin.tick.limit": "1h",
    }
    with dask.config.set(settings), ExitStack() as stack:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        made = _cluster(distributed, where, count, memory_bytes)
        cluster = stack.enter_context(made) if made is not None else None
        try:
            client = distributed.Client(cluster if cluster is not None else where, timeout=PATIENCE_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise ClusterError(f"--cluster {where}: no Dask scheduler answers there ({error})") from None
        yield stack.enter_context(client)


def _cluster(distributed: Any, where: str, count: int, memory_bytes: int) -> Any:
    """The cluster that is made for this batch; None where one is there already."""
    memory = f"{max(memory_bytes >> 20, 1)}MiB"
    if where == LOCAL:
        return distributed.LocalCluster(
            n_workers=count,
            threads_per_worker=1,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            memory_limit=None,
            silence_logs=logging.CRITICAL,
            security=_private(distributed),
        )
    if where in QUEUES:
        queue = getattr(_imported("dask_jobqueue", "dask-jobqueue"), QUEUES[where])
        return queue(cores=1, processes=1, memory=memory, n_workers=count)
    if where == KUBERNETES:
        operator = _imported("dask_kubernetes.operator", "dask-kubernetes")
        return operator.KubeCluster(name="kinegraph", n_workers=count, resources={"requests": {"memory": memory}})
    return None


def _private(distributed: Any) -> Any:
    """Certificates made for this batch: what listens on the loopback takes jobs from nobody else."""
    try:
        return distributed.security.Security.temporary()
    except ImportError:
        raise ClusterError("cryptography is not installed; install it: pip install 'kinegraph[batch]'") from None


def _dask() -> tuple[Any, Any]:
    try:
        import dask
        import distributed
    except ModuleNotFoundError:
        raise ClusterError("Dask is not installed; install it: pip install 'kinegraph[batch]'") from None
    return dask, distributed


def _imported(module: str, package: str) -> Any:
    import importlib

    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        raise ClusterError(f"{package} is not installed; install it: pip install {package}") from None
