"""The workers of a batch: processes of this machine, or those of a cluster, both by Dask."""

from __future__ import annotations

import logging
import math
import os
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from kinegraph.stream.errors import KinegraphError
from kinegraph.stream.system.extras import optional

if TYPE_CHECKING:
    from distributed import Client

LOCAL = "local"
QUEUES = {"slurm": "SLURMCluster", "pbs": "PBSCluster"}
KUBERNETES = "kubernetes"
PATIENCE_S = 10
"""Within which a scheduler that is there answers."""
LOOK_S = 1.0
"""How often it is looked how many workers there are."""
AHEAD = 256
"""Items that wait at the scheduler."""
GATHER_S = 0.05
"""What came of the items that end within it is fetched at once: asked for one by one it takes longer than to give them out."""
Item = TypeVar("Item")


class ClusterError(KinegraphError):
    """There are no workers."""


@dataclass(frozen=True, slots=True)
class Lost:
    """An item without a result: its worker died, or its call raised."""

    error: BaseException


@contextmanager
def workers(where: str, count: int, memory_bytes: int, retries: int, folder: Path = Path()) -> Iterator[Client]:
    """Within: workers, each of which does one job at a time.

    where         "local"; "slurm", "pbs" (dask-jobqueue); or the address of a Dask scheduler
    memory_bytes  what a job may need; a queue is asked for as much for each worker
    retries       how often a job is given to another worker after its worker died
    folder        where all workers find the certificates of a queue's batch; its owner's alone
    """
    dask, distributed = _dask()
    settings = {
        "distributed.scheduler.allowed-failures": retries,
        "distributed.scheduler.worker-saturation": 1.0,  # one job at each worker; the others wait at the scheduler
        "distributed.scheduler.work-stealing": False,
        "distributed.scheduler.active-memory-manager.start": False,
        "distributed.deploy.lost-worker-timeout": "1h",  # a worker that died is started again; on a busy machine not within 15 s
        "distributed.worker.daemon": False,
        "distributed.worker.profile.enabled": False,  # which looks at every worker's stack a hundred times a second
        "distributed.admin.tick.limit": "1h",
        "distributed.scheduler.http.routes": [],  # which answer any host name, and so any web page
        "distributed.worker.http.routes": [],
    }
    with dask.config.set(settings), ExitStack() as stack:
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        made = _cluster(distributed, where, count, memory_bytes, folder)
        cluster = stack.enter_context(made) if made is not None else None
        try:
            client = distributed.Client(cluster if cluster is not None else where, timeout=PATIENCE_S)
        except (OSError, TimeoutError, ValueError) as error:
            raise ClusterError(f"--cluster {where}: no Dask scheduler answers there ({error})") from None
        yield stack.enter_context(client)


def spread(client: Any, call: Callable[[Item], Any], items: Sequence[Item]) -> Iterator[tuple[Item, Any]]:
    """`call` with each of the items, on workers of a thread each: the items and what came of them, in the order in which they end.

    The result of an item is what its call returned, or a `Lost`. AHEAD items wait at the scheduler and not at a worker,
    to be lost with it; no worker waits for this process; and memory does not grow with the number of items.
    """
    from distributed import as_completed

    at_work = dict[str, Item]()
    finished: Any = as_completed()  # type: ignore[no-untyped-call]
    places, looked, given = 1, -math.inf, 0
    while given < len(items) or at_work:
        if time.monotonic() - looked > LOOK_S:
            places, looked = max(sum(client.nthreads().values()), 1), time.monotonic()
        if (room := _room(places, len(at_work), given, len(items))) > 0:
            chosen = items[given : given + room]
            futures = client.map(call, chosen, key="job", pure=False)
            at_work |= {future.key: item for future, item in zip(futures, chosen, strict=True)}
            given += len(chosen)
            finished.update(futures)
        ended = finished.next_batch()
        time.sleep(GATHER_S)
        ended += finished.next_batch(block=False)
        returned = client.gather({future.key: future for future in ended if future.status == "finished"})
        for future in ended:
            came = returned[future.key] if future.key in returned else Lost(future.exception())
            yield at_work.pop(future.key), came


def _room(places: int, at_work: int, given: int, total: int) -> int:
    """How many more items to submit: 0, or at least half of what may be under way, since each submission has a cost.

    The scheduler keeps items back once there were more than two for each place; fewer it would hand to the workers at once.
    """
    window = places + AHEAD
    if min(given + window - at_work, total) <= 2 * places:
        return places - at_work
    return window - at_work if at_work <= window // 2 else 0


def _cluster(distributed: Any, where: str, count: int, memory_bytes: int, folder: Path) -> Any:
    """The cluster that is made for this batch; None where one already exists."""
    mebibytes = max(memory_bytes >> 20, 1)
    if where == LOCAL:
        os.environ.setdefault("PYTHONSAFEPATH", "1")  # workers do not import what lies in the current folder
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
        queue = getattr(
            optional("dask_jobqueue", f"--cluster {where}", "pip install 'kinegraph[queue]'", ClusterError),
            QUEUES[where],
        )
        import dask

        configured = dask.config.get(f"jobqueue.{where}.worker-extra-args", None) or []
        unlimited = [
            *configured,
            "--memory-limit",
            "0",
        ]  # the queue ends what takes too much; Dask would let it stand still at 80 %
        prologue = dask.config.get(f"jobqueue.{where}.job-script-prologue", None) or []
        return queue(
            cores=1,
            processes=1,
            memory=f"{mebibytes}MiB",
            n_workers=count,
            worker_extra_args=unlimited,
            job_script_prologue=[*prologue, "export DASK_DISTRIBUTED__WORKER__HTTP__ROUTES='[]'"],
            protocol="tls://",
            security=_private(distributed),
            shared_temp_directory=str(folder.absolute()),
            scheduler_options={"dashboard_address": "127.0.0.1:0"},
        )
    if where == KUBERNETES:
        raise ClusterError(
            "--cluster kubernetes: dask-kubernetes starts a scheduler that takes jobs from every pod that reaches it; "
            "start one with TLS yourself, and give its address: --cluster tls://HOST:PORT"
        )
    return None


def _private(distributed: Any) -> Any:
    """Certificates made for this batch: listeners accept jobs only from it."""
    try:
        return distributed.security.Security.temporary()
    except ImportError:
        raise ClusterError("cryptography is not installed; install it: pip install 'kinegraph[batch]'") from None


def _dask() -> tuple[Any, Any]:
    return tuple(
        optional(name, "a batch", "pip install 'kinegraph[batch]'", ClusterError) for name in ("dask", "distributed")
    )
