"""The work on several processes, by Dask: on this machine, or on a cluster that is there already.

Only names, numbers and keys go over the wire. A loop that kills its worker is tried once more and then given up; the
others are not touched by it, since no worker holds more than the one that it works on.
"""

from __future__ import annotations

import itertools
import logging
import tempfile
import uuid
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from trueplant.errors import UsageError
from trueplant.fleet import levels
from trueplant.fleet.site import Cluster, Site
from trueplant.fleet.worker import Task, audit_loop
from trueplant.threads import VARIABLES
from trueplant.version import __version__

_MEMORY = {"MALLOC_MMAP_THRESHOLD_": 1 << 25, "MALLOC_TRIM_THRESHOLD_": 1 << 26}
"""What the allocator of Linux ends with by itself. Dask would have all memory given back at once (64 kB), and asking
for it again takes longer than an estimate does."""
_LOGGING = dict.fromkeys(
    ("distributed", "distributed.client", "distributed.gc", "tornado", "tornado.application", "asyncio"), "critical"
)
"""What happens to a worker is told by the row of its loop. Those named have levels of their own with Dask, or speak of
the connections that its event loops lose."""
_SETTINGS: dict[str, Any] = {
    "logging": _LOGGING,
    # a worker takes its levels as it imports Dask, before our settings reach it
    "distributed.nanny.pre-spawn-environ.DASK_LOGGING": repr(_LOGGING),
    "distributed.scheduler.allowed-failures": levels.ALLOWED_DEATHS,
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.daemon": True,
    "distributed.worker.profile.enabled": False,  # its samples of the last hour would take a GB or two
    "distributed.admin.tick.limit": "1h",  # a loop keeps its worker busy, and that is nothing to warn of
    **{
        f"distributed.nanny.pre-spawn-environ.{name}": value
        for name, value in (dict.fromkeys((*VARIABLES, "POLARS_MAX_THREADS"), 1) | _MEMORY).items()
    },
}


class OnDask:
    """Hands tasks to the workers of a client of Dask, a few ahead of what they do."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def run(self, tasks: Iterable[Task]) -> Iterator[tuple[Task, str | None]]:
        """Each task with the key of its row, as it is done; None where its worker died, and the next one too.

        The first loop of each host goes alone: it compiles what the others then find compiled.
        """
        from distributed import as_completed

        left, waiting = iter(tasks), {}

        def submit(task: Task, **where: Any) -> Any:
            name = f"{task.name}-{uuid.uuid4().hex}"
            future = self._client.submit(audit_loop, task, may_end=True, key=name, pure=False, **where)
            waiting[future] = task
            return future

        workers = self._workers()
        hosts = {worker["host"]: address for address, worker in workers.items()}
        first = [
            submit(task, workers=[address], allow_other_workers=True)
            for address, task in zip(hosts.values(), itertools.islice(left, len(hosts)), strict=False)
        ]
        first = first or [submit(task) for task in itertools.islice(left, 1)]  # a worker may be on its way
        done: Any = as_completed(first)
        alone = len(first)
        for future in done:
            task = waiting.pop(future)
            yield task, _key(future)
            alone = max(alone - 1, 0)
            room = levels.AHEAD * max(len(workers), 1) - len(waiting)
            for more in itertools.islice(left, 0 if alone else max(room, 0)):
                done.add(submit(more))

    def _workers(self) -> dict[str, Any]:
        return dict(self._client.scheduler_info(n_workers=-1)["workers"])


def _key(future: Any) -> str | None:
    from distributed import CancelledError, KilledWorker

    try:
        error = future.exception()
        key = None if error is not None else str(future.result())  # the scheduler may go between the two
    except (CancelledError, OSError):
        error = CancelledError()
    if isinstance(error, KilledWorker):
        return None
    if isinstance(error, CancelledError):
        raise UsageError(
            "the scheduler of the cluster is gone: start the audit again when it is back; loops that are done are kept"
        ) from None
    if error is not None:
        raise error
    return key


@contextmanager
def on_this_machine(workers: int) -> Iterator[OnDask]:
    """Workers of our own, which nobody beyond this machine can speak to. Raises UsageError without Dask."""
    with _settings() as distributed, tempfile.TemporaryDirectory(prefix="trueplant-") as scratch:
        cluster = distributed.LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            host="127.0.0.1",
            dashboard_address="127.0.0.1:0",
            scheduler_kwargs={"dashboard": False},
            local_directory=scratch,
            silence_logs=logging.CRITICAL,
        )
        with cluster, distributed.Client(cluster) as client:
            yield OnDask(client)


@contextmanager
def on_cluster(site: Site, given: str | None) -> Iterator[OnDask]:
    """The workers of a cluster that is there already; `given` takes the place of the address in the site file.

    Raises UsageError where it does not answer, has no workers, or has another version of trueplant.
    """
    table = _table(site, given)
    with _settings() as distributed:
        files = {
            "tls_ca_file": table.ca,
            "tls_client_cert": table.certificate,
            "tls_client_key": table.key,
        }
        named = {key: str(site.folder / name) for key, name in files.items() if name is not None}
        secure = table.address.startswith("tls://")
        try:
            security = distributed.Security(require_encryption=secure, **named)
            client = distributed.Client(table.address, security=security, timeout=levels.CONNECT)
        except (OSError, ValueError, RuntimeError) as error:
            raise UsageError(
                f"no scheduler answers at {table.address} ({_line(error)}): check the address, the network and the "
                "certificates of [cluster]"
            ) from None
        with client:
            _check_workers(client, table.address)
            yield OnDask(client)


def _table(site: Site, given: str | None) -> Cluster:
    table = site.cluster
    if given is None:
        assert table is not None
        return table
    rest = {} if table is None else table.model_dump(exclude={"address"}, exclude_none=True)
    from pydantic import ValidationError

    from trueplant.project.messages import message

    try:
        return Cluster(address=given, **rest)
    except ValidationError as error:
        raise UsageError(message(error, Cluster, f"--dask, with [cluster] of {site.source}")) from None


def _check_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=levels.CONNECT)
        versions = client.run(_version)
    except (OSError, TimeoutError) as error:
        raise UsageError(f"{address} has no workers ({_line(error)}): start dask worker there") from None
    except Exception as error:  # a worker without trueplant says so in its own way
        text = f"the workers of {address} cannot run trueplant ({_line(error)}): install trueplant {__version__} there"
        raise UsageError(text) from None
    other = sorted({version for version in versions.values() if version != __version__})
    if other:
        raise UsageError(
            f"workers of {address} have trueplant {', '.join(other)}, and this is {__version__}: install the same there"
        )


def _version() -> str:
    return __version__


def _line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), "") or type(error).__name__


@contextmanager
def _settings() -> Iterator[Any]:
    """Dask's package `distributed` under our settings."""
    try:
        import dask
        import distributed
    except ImportError:
        raise UsageError(
            "several workers need dask, which is not installed: pip install 'trueplant[fleet]', or --workers 0"
        ) from None
    # some of its loggers have levels of their own
    names = (*_LOGGING, *(name for name in logging.root.manager.loggerDict if name.startswith("distributed.")))
    before = {name: logging.getLogger(name).level for name in names}
    for name in names:
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        with dask.config.set(_SETTINGS):
            yield distributed
    finally:
        for name, level in before.items():
            logging.getLogger(name).setLevel(level)
