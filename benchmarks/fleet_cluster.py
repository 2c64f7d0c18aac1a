"""A Dask cluster of processes of this computer over TCP, for `fleet.py`: what dies, or is killed, is started again."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PRELOAD = """
import json, os, time
import threadpoolctl
import aridcal.jobs.fleet.work as work
import aridcal.runs.result_folder as results
def log(**what):
    line = json.dumps({"pid": os.getpid(), "time": time.time(), "cpu": time.process_time()} | what) + "\\n"
    file = os.open(os.environ["FLEET_LOG"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(file, line.encode()); os.close(file)
def logged(task):
    log(what="begins", robot=task.robot)
    row = work.calibrated_itself(task)
    log(what="ends", robot=task.robot)
    return row
def written(outcome, folder, **rest):
    blas = [lib["num_threads"] for lib in threadpoolctl.threadpool_info() if lib["user_api"] == "blas"]
    log(what="writes", robot=folder.name, threads=max(blas))
    done = work.write_itself(outcome, folder, **rest)
    log(what="written", robot=folder.name)
    return done
if not hasattr(work, "calibrated_itself"):  # Dask may load this twice
    work.calibrated_itself, work.write_itself = work.calibrated, results.write_folder
    work.calibrated, results.write_folder = logged, written
    log(what="ready")
"""
"""Of a worker: it notes what it does, and nothing else changes."""

LEAN = {
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
    "DASK_DISTRIBUTED__SCHEDULER__WORKER_SATURATION": "1.0",
    "DASK_DISTRIBUTED__ADMIN__TICK__INTERVAL": "1s",
    "DASK_DISTRIBUTED__ADMIN__SYSTEM_MONITOR__INTERVAL": "10s",
}
"""Of scheduler and workers, as `docs/formats.md` advises, and as `aridcal fleet` starts its own."""

THREADS = frozenset({"OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"})
"""Of the environment, taken away from workers: what limits them is aridcal."""


class Cluster:
    """A scheduler and workers as processes of their own; what dies is started again, as systemd would do it."""

    def __init__(self, folder: Path, workers: int) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self.folder, self.address = folder, f"tcp://127.0.0.1:{self.port}"
        self.log = folder / "log.jsonl"
        self.log.unlink(missing_ok=True)
        (folder / "preload.py").write_text(PRELOAD, encoding="utf-8")
        self.scheduler = self._scheduler()
        self.workers = [self._worker() for _ in range(workers)]
        self.killed = 0

    def _start(self, *words: str) -> subprocess.Popen[bytes]:
        env = (
            {key: value for key, value in os.environ.items() if key not in THREADS}
            | {"FLEET_LOG": str(self.log)}
            | LEAN
        )
        with (self.folder / "cluster.txt").open("ab") as out:
            return subprocess.Popen(
                [sys.executable, "-m", "distributed.cli." + words[0], *words[1:]], env=env, stdout=out, stderr=out
            )

    def _scheduler(self) -> subprocess.Popen[bytes]:
        return self._start("dask_scheduler", "--host", "127.0.0.1", "--port", str(self.port), "--no-dashboard")

    def _worker(self) -> subprocess.Popen[bytes]:
        preload = str(self.folder / "preload.py")
        rest = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--death-timeout", "60", "--preload", preload)
        return self._start("dask_worker", self.address, *rest)

    def tend(self) -> None:
        """Start again what has ended."""
        if self.scheduler.poll() is not None:
            self.scheduler = self._scheduler()
        self.workers = [w if w.poll() is None else self._worker() for w in self.workers]

    def kill_worker(self) -> None:
        """Kill one, the oldest."""
        self.workers[0].send_signal(signal.SIGKILL)
        self.workers[0].wait()
        self.workers.append(self.workers.pop(0))
        self.killed += 1

    def ready(self, limit: float = 120.0) -> None:
        """Wait until all workers have loaded what they need."""
        end = time.monotonic() + limit
        while sum(line["what"] == "ready" for line in self.noted()) < len(self.workers):
            if time.monotonic() > end:
                raise SystemExit(f"no workers within {limit:.0f} s; see {self.folder / 'cluster.txt'}")
            time.sleep(0.2)

    def scheduler_cpu(self) -> float:
        """CPU seconds of the scheduler that runs now."""
        after_name = Path(f"/proc/{self.scheduler.pid}/stat").read_text("utf-8").rpartition(")")[2].split()
        return sum(map(int, after_name[11:13])) / os.sysconf("SC_CLK_TCK")

    def stop(self) -> None:
        """End all of it."""
        for process in (*self.workers, self.scheduler):
            process.kill()
        for process in (*self.workers, self.scheduler):
            process.wait()

    def noted(self) -> list[dict[str, Any]]:
        """What workers noted."""
        lines = self.log.read_text("utf-8").splitlines() if self.log.exists() else []
        return [json.loads(line) for line in lines]


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    """A cluster, until the block ends."""
    made = Cluster(folder, workers)
    try:
        yield made
    finally:
        made.stop()
