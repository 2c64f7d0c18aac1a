"""Tasks on a Dask cluster: processes of this computer, or any cluster by the address of its scheduler.

A worker gets one task for each of its threads and no more, so that a worker's death speaks of those alone that it worked on.
Dask gives them to other workers at once, up to its `allowed-failures` (3 unless the cluster's owner says otherwise). A task that
Dask gives up is tried once more when all others are done: deaths are seldom a task's fault, memory runs out, a node is taken
away, and one after another they meet the same task, which goes from each worker to the next.
"""

from __future__ import annotations

import logging
import os
import queue
import signal
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from aridcal.jobs.fleet.local_engine import Engine, EngineGone, WorkFailure, in_words
from aridcal.system.errors import AridcalError
from aridcal.system.progress import Progress

if TYPE_CHECKING:
    from distributed import Client, Future

T = TypeVar("T")
R = TypeVar("R")

PATIENCE = 120.0
"""[s] that a scheduler may be away before the rest is given up: what restarts it, systemd or a cloud's own, takes less."""

ANSWER = 10.0
"""[s] within which a scheduler that is there answers."""

LEAN: dict[str, bool | str | None] = {
    "distributed.worker.profile.enabled": False,
    "distributed.scheduler.work-stealing": False,
    "distributed.admin.tick.interval": "1s",
    "distributed.admin.system-monitor.interval": "10s",
    "distributed.nanny.pre-spawn-environ.MALLOC_TRIM_THRESHOLD_": None,
}
"""Of Dask, in processes of this computer: nobody looks at its profile, a sample every 10 ms, nor at its monitors, 50 a second;
no task waits to be stolen; and what it asks of glibc, to give memory back at once, has every larger array cleared anew."""

LOOK = 1.0
"""[s] between two looks at the cluster while no answer comes."""

TELL_IDLE = 30.0
"""[s] between two notices that nobody works."""

MISSING = 'fleets need Dask, which is not installed: pip install "aridcal[fleet]"'


class WorkerDeaths(WorkFailure):
    """Workers died at it, one after another."""


class _Lost(Exception):
    """The connection to the scheduler broke, and with it whatever was asked and not answered."""


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
    if address is None:
        with (
            _main_unseen(),
            _quiet_cluster(distributed) as local,
            distributed.Client(local, set_as_default=False) as client,
        ):
            yield _engine(lambda: client, progress, 0.0)
        return
    try:
        distributed.comm.get_address_host_port(address, strict=True)
    except ValueError as problem:
        raise AridcalError(f"{address}: is no address of a scheduler: {problem}; write tcp://HOST:8786") from None
    client = _connected(address, ANSWER)
    if client is None:
        raise AridcalError(
            f"{address}: no scheduler answers there. Start one with `dask scheduler`, and workers with "
            "`dask worker ADDRESS --nthreads 1`, in an environment that has aridcal"
        )
    clients = [client]

    def current() -> Client:
        """The connection, made anew where it broke."""
        if clients[-1].status != "running":
            _close(clients[-1])
            progress.note(f"{address} is gone; waiting up to {patience:.0f} s for it to come back")
            again = _connected(address, patience)
            if again is None:
                raise EngineGone(f"the scheduler at {address} is gone, and did not come back within {patience:.0f} s")
            progress.note(f"{address} is back")
            clients.append(again)
        return clients[-1]

    try:
        yield _engine(current, progress, patience)
    finally:
        _close(clients[-1])


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
def _quiet_cluster(distributed: Any) -> Iterator[Any]:
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


def _connected(address: str, patience: float) -> Client | None:
    """A connection to a scheduler; None if none answers for so long, [s]."""
    from distributed import Client

    end = time.monotonic() + patience
    while True:
        try:
            client: Client = Client(address, timeout=ANSWER, set_as_default=False)
            return client
        except (OSError, TimeoutError):
            if time.monotonic() > end:
                return None
            time.sleep(LOOK)


def _close(client: Client) -> None:
    """End a connection that may be broken."""
    with suppress(Exception):
        client.close(timeout=ANSWER)


def _engine(current: Callable[[], Client], progress: Progress, patience: float) -> Engine:
    """The engine of a connection.

    Args:
        current: Gives it, made anew where it broke; raises :class:`EngineGone` if it cannot be.
        progress: Told of troubles.
        patience: 0 where a broken connection is the end.
    """

    def engine(work: Callable[[T], R], tasks: Mapping[str, T]) -> Iterator[tuple[str, R | WorkFailure]]:
        waiting = dict(tasks)
        again: set[str] = set()
        while waiting:
            try:
                for name, answer in _asked(current(), work, waiting, again, progress):
                    del waiting[name]
                    yield name, answer
            except _Lost:
                if not patience:
                    raise EngineGone("the processes that did the work are gone") from None
                progress.note("the connection to the scheduler broke; what it has not answered is asked again")

    return engine


def _asked(
    client: Client, work: Callable[[T], R], tasks: Mapping[str, T], again: set[str], progress: Progress
) -> Iterator[tuple[str, R | WorkFailure]]:
    """Have tasks done on one connection; those given are let go if the block around ends early.

    Args:
        client: The connection.
        work: To be done.
        tasks: By their names.
        again: Names of those that Dask gave up once; added to.
        progress: Told of troubles.
    """
    answers: queue.SimpleQueue[str] = queue.SimpleQueue()
    flying: dict[str, Future] = {}
    left = list(tasks)[::-1]
    idle_since = time.monotonic()
    try:
        while left or flying:
            slots = _slots(client)
            if slots:
                idle_since = time.monotonic()
            elif time.monotonic() - idle_since > TELL_IDLE:
                idle_since = time.monotonic()
                progress.note("no worker is there; waiting for one")
            for name in islice(iter(lambda: left.pop() if left else None, None), max(slots - len(flying), 0)):
                flying[name] = _given(client, work, tasks[name], name, name in again, answers)
            try:
                name = answers.get(timeout=LOOK)
            except queue.Empty:
                continue
            done = flying.pop(name)
            # The worker is there and idle: what it did can be looked at meanwhile.
            if left and done.status == "finished":
                following = left.pop()
                flying[following] = _given(client, work, tasks[following], following, following in again, answers)
            answer = _answer(done)
            if isinstance(answer, WorkerDeaths) and name not in again:
                again.add(name)
                left.insert(0, name)
                progress.note(f"of one task {answer.why}; it is tried once more at the end")
                continue
            yield name, answer
    finally:
        with suppress(Exception):
            client.cancel(list(flying.values()), force=True)


def _slots(client: Client) -> int:
    """Threads of all workers.

    Raises:
        _Lost: nobody can be asked.
    """
    if client.status != "running":
        raise _Lost
    try:
        return sum(client.nthreads().values())
    except (OSError, TimeoutError, ValueError, RuntimeError):
        raise _Lost from None


def _given(
    client: Client, work: Callable[[T], R], task: T, name: str, again: bool, answers: queue.SimpleQueue[str]
) -> Future:
    """Give a task away; its name is told once it is answered, whatever the answer."""
    try:  # under the name that it had, Dask would answer as it did
        future: Future = client.submit(work, task, key=f"{name}-again" if again else name, pure=False)
    except (OSError, TimeoutError, RuntimeError):
        raise _Lost from None
    future.add_done_callback(lambda _: answers.put(name))
    return future


def _answer(future: Future) -> Any:
    """A task's answer.

    Raises:
        _Lost: it was asked of a scheduler that is gone.
    """
    from distributed import KilledWorker

    if future.status in ("cancelled", "lost"):
        raise _Lost
    try:
        if future.status == "finished":
            return future.result(timeout=ANSWER)
        problem = future.exception(timeout=ANSWER)
    except KilledWorker as died:
        problem = died
    except (OSError, TimeoutError):
        raise _Lost from None
    if isinstance(problem, KilledWorker):
        times = problem.allowed_failures + 1
        return WorkerDeaths(f"{times} workers died at it, the last one on {problem.last_worker.address}")
    return WorkFailure(in_words(problem) if problem is not None else "nothing was said of it")
