"""Tasks on a Dask cluster: processes of this computer, or any cluster by the address of its scheduler.

Dask hands tasks to workers, gives those of a worker that dies to another one, up to its `allowed-failures` (3 unless the
cluster's owner says otherwise), and finds a scheduler that was started again; what this one has not answered is asked again.
A task that Dask gives up is tried once more when all others are done: deaths are seldom a task's fault.
"""

from __future__ import annotations

import logging
import os
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING, Any, TypeVar

from aridcal.jobs.fleet.local_engine import Engine, EngineGone, WorkFailure, in_words
from aridcal.system.errors import AridcalError
from aridcal.system.progress import Progress

if TYPE_CHECKING:
    from distributed import Client

T = TypeVar("T")
R = TypeVar("R")

PATIENCE = 120.0
"""[s] that a scheduler may be away before the rest is given up: what restarts it, systemd or a cloud's own, takes less."""

ANSWER = 10.0
"""[s] within which the computer of a scheduler answers."""

LEAN: dict[str, bool | float | str | None] = {
    "distributed.scheduler.worker-saturation": 1.0,
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
"""Of Dask, in processes of this computer: a worker holds no task that it does not work on, so that its death speaks of none
other; nobody looks at its profile, a sample every 10 ms, nor at its monitors, 50 a second; and what it asks of glibc, to give
memory back at once, has every larger array cleared anew."""

MISSING = 'fleets need Dask, which is not installed: pip install "aridcal[fleet]"'


@contextmanager
def dask_engine(address: str | None, progress: Progress, patience: float = PATIENCE) -> Iterator[Engine]:
    """Have work done by Dask until the block ends.

    Args:
        address: Of a scheduler, ``tcp://10.0.0.1:8786`` for instance; None: processes of this computer, one for each core.
        progress: Told of troubles.
        patience: How long a scheduler may be away, [s].

    Raises:
        AridcalError: Dask is not installed, or no scheduler answers there.
    """
    try:
        import distributed
    except ImportError:
        raise AridcalError(MISSING) from None
    _silence()
    with ExitStack() as ends:
        if address is None:
            ends.enter_context(_main_unseen())
            place = ends.enter_context(_processes(distributed))
        else:
            place = _answering(address, distributed)
        try:
            client = ends.enter_context(distributed.Client(place, timeout=patience, set_as_default=False))
            if not client.nthreads():
                progress.note("no worker is there; waiting for one")
        except OSError as problem:
            raise AridcalError(f"{address}: what answers there is no scheduler of Dask: {problem}") from None
        yield _engine(client, progress)


def _silence() -> None:
    """What matters of Dask's own messages is said by us, without tracebacks."""
    for name in [*logging.root.manager.loggerDict, "distributed.client", "asyncio"]:
        if name.partition(".")[0] in ("distributed", "asyncio", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)


def dask_setup(worker: object) -> None:
    """Called by Dask in each worker that loads this module as its `preload`: Ctrl-C at a terminal is for the command alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)


@contextmanager
def _main_unseen() -> Iterator[None]:
    """Keep new processes from running the user's script again, all of it: multiprocessing finds it by these two names.

    A script that asks for a fleet outside of ``if __name__ == "__main__":`` would ask for one in each worker. No task needs it.
    """
    main = sys.modules["__main__"]
    kept = {name: getattr(main, name, None) for name in ("__spec__", "__file__")}
    vars(main).update(dict.fromkeys(kept))
    try:
        yield
    finally:
        vars(main).update(kept)


@contextmanager
def _processes(distributed: Any) -> Iterator[Any]:
    """Processes of this computer, of one thread each."""
    import dask

    with (
        dask.config.set(LEAN),
        distributed.LocalCluster(
            n_workers=len(os.sched_getaffinity(0)),
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=logging.CRITICAL,
            preload=[__name__],
        ) as local,
    ):
        yield local


def _answering(address: str, distributed: Any) -> str:
    """The address of a scheduler, if somebody listens there."""
    try:
        place = distributed.comm.get_address_host_port(address, strict=True)
    except ValueError as problem:
        raise AridcalError(f"{address}: is no address of a scheduler: {problem}; write tcp://HOST:8786") from None
    try:
        socket.create_connection(place, timeout=ANSWER).close()
    except OSError:
        raise AridcalError(
            f"{address}: no scheduler answers there. Start one with `dask scheduler`, and workers with "
            "`dask worker ADDRESS --nthreads 1`, in an environment that has aridcal"
        ) from None
    return address


def _engine(client: Client, progress: Progress) -> Engine:
    """The engine of a connection."""
    from distributed import KilledWorker, as_completed

    def engine(work: Callable[[T], R], tasks: Mapping[str, T]) -> Iterator[tuple[str, R | WorkFailure]]:
        waiting = dict(tasks)
        again: set[str] = set()
        while waiting:
            if client.status in ("closing", "closed"):
                raise EngineGone("the scheduler is gone, and did not come back")
            names = {f"{name}-again" if name in again else name: name for name in waiting}
            # No future stays once it is answered: Dask would compute it again if the worker that did it dies.
            answers = as_completed(
                client.map(work, list(waiting.values()), key=list(names), pure=False),
                loop=client.loop,
                with_results=True,
                raise_errors=False,
            )
            for future, answer in answers:
                name, status = names[future.key], future.status
                del future
                if status == "error" and isinstance(answer[1], KilledWorker) and name not in again:
                    again.add(name)
                    progress.note(f"workers died at one task; it is tried once more at the end: {name}")
                elif status in ("finished", "error"):
                    del waiting[name]
                    yield name, answer if status == "finished" else _broken(answer[1])
            if waiting.keys() - again:
                progress.note("the connection to the scheduler broke; what it has not answered is asked again")

    return engine


def _broken(problem: BaseException) -> WorkFailure:
    """What is said of a task that Dask gave up."""
    from distributed import KilledWorker

    if isinstance(problem, KilledWorker):
        times = problem.allowed_failures + 1
        return WorkFailure(f"{times} workers died at it, the last one on {problem.last_worker.address}")
    return WorkFailure(in_words(problem))
