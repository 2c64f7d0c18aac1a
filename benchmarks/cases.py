"""Cases of a benchmark run in worker processes, each shown when it is one to look at."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Sequence
from typing import Protocol, TypeVar


class Shown(Protocol):
    """How one case went."""

    @property
    def good(self) -> bool:
        """True if there is nothing to look at."""

    def line(self) -> str:
        """The case in one line."""


S = TypeVar("S", bound=Shown)
T = TypeVar("T")


def run_cases(run: Callable[[T], S | str], todo: Sequence[T], jobs: int, verbose: bool) -> tuple[list[S], list[str]]:
    """Run every case, and print those to look at.

    Args:
        run: Of a module, so that workers can import it; what it returns is a score, or why the case failed.
        todo: What makes each case.
        jobs: Worker processes.
        verbose: Print every case.

    Returns:
        The scores, and what failed.
    """
    os.environ["OMP_NUM_THREADS"] = "1"  # for the workers: the arrays are too small to gain from more
    scores: list[S] = []
    failed: list[str] = []
    with multiprocessing.get_context("spawn").Pool(min(jobs, len(todo))) as pool:
        for result in pool.imap_unordered(run, todo):
            if isinstance(result, str):
                failed.append(result)
                print(result, flush=True)
                continue
            scores.append(result)
            if verbose or not result.good:
                print(result.line(), flush=True)
    return scores, failed
