"""Where the time of a search goes, against what this machine can do: operations, time and rate of each kernel.

Example:
    OMP_NUM_THREADS=1 python benchmarks/search.py ceilings
    OMP_NUM_THREADS=1 python benchmarks/search.py identification/ur10-laser-tracker/campaign-b.yaml

Operations are those of the textbook (a Cholesky factor P^3/3, an inverse from it 2 P^3/3, a symmetric eigenproblem 9 d^3, a
tridiagonal form 4 d^3/3), bytes are not counted: a kernel that stays below its ceiling waits for memory, or is too small. CPU
time of one thread.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotri

from aridcal.engine.fit import normal_equations
from aridcal.engine.search import (
    candidates,
    diagnose,
    evidence,
    exact,
    grids,
    loop,
    products,
    ranking,
    rival_models,
    scoring,
    screening,
    state,
    steps,
    stepwise,
)
from aridcal.jobs.calibrate import pipeline

REPEATS = 20


class Kernel:
    """Calls, operations and CPU seconds of one function, in place of it wherever it is looked up."""

    def __init__(self, name: str, places: list[object], operations: Callable[..., float] | None) -> None:
        """Put it in place."""
        self.name, self.calls, self.flop, self.seconds = name, 0, 0.0, 0.0
        inner = getattr(places[0], name)

        def counted(*arguments: object, **named: object) -> object:
            self.calls += 1
            self.flop += operations(*arguments, **named) if operations else 0.0
            started = time.process_time()
            try:
                return inner(*arguments, **named)
            finally:
                self.seconds += time.process_time() - started

        for place in places:
            setattr(place, name, counted)

    def line(self) -> str:
        """One row of a table."""
        rate = f"{self.flop / self.seconds / 1e9:.1f}" if self.flop and self.seconds else ""
        return f"| `{self.name}` | {self.calls:,} | {self.flop / 1e9:.1f} | {self.seconds:.2f} | {rate} |"


def across(made: products.Products, chunk: products.Chunk, members: list[products.Member]) -> float:
    """Operations of products that are not kept yet."""
    rows, w = sum(len(r) for r in made.r), len(chunk.pull[0])
    new = [e for e, _ in members if e not in chunk.across]
    if chunk.grid is None:
        return sum(2.0 * rows * w * made.columns(e)[0].shape[1] for e in new)
    return sum(of_grid(made, chunk.grid, e) for e in new)


def of_grid(made: products.Products, grid: grids.Grid, member: products.Effect | None) -> float:
    """The same of a grid with one member: k k' sums a row for each slot and channel, or k of each of the member's columns."""
    channels, (rows, size, slots), k = len(grid.slots), grid.slots[0].shape, grid.functions.values.shape[1]
    taken = None if member is None else made._source.apart(member)
    other = None if taken is None else made._functions(taken[1])
    if other is not None:
        return 2.0 * rows * slots * channels * (size + k * other.values.shape[1])
    return 2.0 * rows * slots * channels * made.columns(member)[0].shape[1] * (size + k)


def cubed(factor: float) -> Callable[..., float]:
    """Operations of a factorisation of the first argument."""
    return lambda H, *_, **__: factor * len(H) ** 3


def smooth(M: np.ndarray, *arguments: object, **_: object) -> float:
    """Operations of the tridiagonal forms of some smooth candidates, 4 d^3 / 3 each."""
    return 4.0 / 3.0 * len(M) * M.shape[1] ** 3 * len(arguments[3] if len(arguments) > 3 else ())  # type: ignore[arg-type]


def rate(flop: float, work: Callable[[], object], many: int) -> float:
    """GFLOP/s of some work, the best of several tries; many runs are timed together, as the clock's tick is long."""
    found = []
    for _ in range(REPEATS):
        started = time.process_time()
        for _ in range(many):
            work()
        found.append(time.process_time() - started)
    return many * flop / min(found) / 1e9


def ceilings() -> None:
    """What one thread of this machine does at the most."""
    rng = np.random.default_rng(0)
    for P, many in ((100, 300), (250, 50), (500, 10)):
        X = rng.standard_normal((P + 50, P))
        H = np.asfortranarray(X.T @ X)
        L = dpotrf(H, lower=1)[0]
        product = rate(2.0 * P**3, partial(np.matmul, H, H), many)
        factor = rate(P**3 / 3, partial(dpotrf, H, lower=1, clean=0), many)
        inverse = rate(2 * P**3 / 3, partial(dpotri, L, lower=1), many)
        print(f"P = {P}: product {product:.0f}, factor {factor:.0f}, inverse from it {inverse:.0f} GFLOP/s")
    small = rng.standard_normal((1000, 15, 15))
    print(f"eigenproblems of 15: {rate(9e3 * 15**3, partial(np.linalg.eigh, small), 1):.1f} GFLOP/s")
    a, b = np.zeros(30_000_000), np.ones(30_000_000)
    print(f"memory, read and written: {rate(2.0 * a.nbytes, partial(np.copyto, a, b), 1):.0f} GB/s")


def measure(campaign: Path) -> None:
    """Identify, and say what each kernel and each stage did."""
    kernels = [
        Kernel("across", [products.Products], across),
        Kernel("inverse", [normal_equations, evidence, scoring, screening], cubed(1.0)),
        Kernel("solve", [normal_equations], cubed(1 / 3)),
        Kernel("solve_equations", [evidence], cubed(1 / 3)),
        Kernel("nested_solutions", [scoring], cubed(1 / 3)),
        Kernel("_smooth", [evidence], smooth),
    ]
    stages = [
        Kernel("score_all", [screening, ranking, scoring], None),
        Kernel("score_without", [steps, rival_models], None),
        Kernel("refine", [scoring, ranking, steps], None),
        Kernel("judge", [steps, stepwise], None),
        Kernel("solve_state", [state, steps, diagnose], None),
        Kernel("best_steps", [ranking], None),
        Kernel("hinted", [candidates, ranking, steps], None),
        Kernel("regrown", [stepwise], None),
        Kernel("missed", [diagnose], None),
        Kernel("refit", [exact, diagnose], None),
        Kernel("diagnose", [loop], None),
        Kernel("noise_causes", [loop], None),
        Kernel("told_apart", [loop], None),
        Kernel("calibrated_arm", [pipeline], None),
        Kernel("identify", [pipeline], None),
    ]
    pipeline.identify(campaign)
    print("| kernel | calls | GFLOP | s | GFLOP/s |\n|---|---|---|---|---|")
    print("\n".join(kernel.line() for kernel in kernels))
    print("| stage | calls | | s | |\n|---|---|---|---|---|")
    print("\n".join(stage.line() for stage in stages))


if __name__ == "__main__":
    if sys.argv[1] == "ceilings":
        ceilings()
    else:
        measure(Path(sys.argv[1]))
