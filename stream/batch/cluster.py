"""The workers of a batch: processes of this machine, or those of a cluster, both by Dask."""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from stream.errors import KinegraphError

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
QUEUES = {"slurm": "SLURMCluster", "pbs": "PBSCluster"}
KUBERNETES = "kubernetes"
PATIENCE_S = 10
"""Within which a scheduler that is there answers."""
LOOK_S = 1.0
"""How often it is looked how many workers there are."""
Item = TypeVar("Item")


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


def spread(client: Any, call: Callable[[Item], Any], items: Iterable[Item]) -> Iterator[tuple[Item, Any]]:
    """`call` with each of the items, on workers of a thread each: the items and their futures, in the order in which they end.

    As many are under way as there are workers: no item waits at a worker, to be lost with it, and memory does not grow with their number.
    """
    from distributed import as_completed

    waiting, at_work = iter(items), dict[str, Item]()
    finished: Any = as_completed()  # type: ignore[no-untyped-call]
    places, looked = 0, -math.inf
    while True:
        if time.monotonic() - looked > LOOK_S:
            places, looked = sum(client.nthreads().values()), time.monotonic()
        for item in islice(waiting, max(places, 1) - len(at_work)):
            future = client.submit(call, item, pure=False)
            at_work[future.key] = item
            finished.add(future)
        if not at_work:
            return
        future = next(finished)
        yield at_work.pop(future.key), future


def _cluster(distributed: Any, where: str, count: int, memory_bytes: int) -> Any:
    """The cluster that is made for this batch; None where one is there already."""
    mebibytes = max(memory_bytes >> 20, 1)
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
        queue = getattr(_imported("dask_jobqueue", "queue"), QUEUES[where])
        import dask

        configured = dask.config.get(f"jobqueue.{where}.worker-extra-args", None) or []
        unlimited = [
            *configured,
            "--memory-limit",
            "0",
        ]  # the queue ends what takes too much; Dask would let it stand still at 80 %
        return queue(cores=1, processes=1, memory=f"{mebibytes}MiB", n_workers=count, worker_extra_args=unlimited)
    if where == KUBERNETES:
        operator = _imported("dask_kubernetes.operator", "kubernetes")
        return operator.KubeCluster(
            name="kinegraph-{uuid}",  # a cluster of this batch's own: one of the same name would be joined, and closed for others
            n_workers=count,
            resources={"requests": {"memory": f"{mebibytes}Mi"}},
            worker_command=["dask", "worker", "--nthreads", "1"],
        )
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


def _imported(module: str, extra: str) -> Any:
    import importlib

    try:
        return importlib.import_module(module)
    except ModuleNotFoundError:
        missing = module.partition(".")[0].replace("_", "-")
        raise ClusterError(f"{missing} is not installed; install it: pip install 'kinegraph[{extra}]'") from None
