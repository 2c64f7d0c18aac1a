"""What Doty (1992) claims of measurements and constants, as figures: a page with tables and pictures, every number computed here.

Example:
    PYTHONPATH=.:tests/support python benchmarks/doty1992_claims.py -o docs/claims-of-1992.md

Pictures go to ``images/claims-of-1992`` beside the page. Poses are random within the report's joint limits unless they are those
of ``identification/arid-strip``. The report gives no link lengths: 0.3, 1.98 and 1.98 m, as in ``urdf/arid.urdf``.
"""

from __future__ import annotations

import argparse
import csv
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from doty_arm import LENGTHS as OTHER_LENGTHS
from doty_arm import angles, arid, conditions, printed_E, random_q, ranks
from matplotlib.figure import Figure

from aridcal.jobs.head1992.doty1992 import E, pose, solve_psi

TOP = Path(__file__).resolve().parents[1]
FOLDER = "images/claims-of-1992"
"""Of the pictures, beside the page."""

LENGTHS = np.array([0.3, 1.98, 1.98])
"""a_1, a_2, a_3 of ``urdf/arid.urdf``, [m]."""

SETS = 1000
"""Random sets of poses of each size: medians are then known to some 5 %."""

POSES = (3, 4, 5, 6, 10, 13, 20, 28, 45, 70)
"""Sizes of sets of which condition numbers are given."""

SQUARES = 28
"""Of a strip across the bay door (Doty, section 5.1)."""

NOISE = np.array([5e-4, 5e-4, 2.5e-4])
"""Of e_1 and e_2, 0.5 mrad, and of e_5, 0.25 mm: a good camera head."""

SIZE = 1e-3
"""True psi, 1-sigma [rad]."""

BLUE, RED, GREY = "#2c6eb3", "#b3452c", "#888888"


@dataclass(frozen=True)
class Claims:
    """Every figure of the page.

    Attributes:
        ranks: Of E's rows 1 to 4 and of rows 1 to 5, by the number of poses 1 to 4: the same for every set.
        values: Singular values of the 8 x 8 system of two poses, shape (SETS, 8), correct and as printed.
        printed_condition: Median condition number of the printed system.
        printed_error: Error of psi from it as a share of psi, shape (SETS,), the measurements being exact.
        filled_error: The same where the blank cell is filled in.
        three: RMS error of psi from three poses by exact kinematics, as a share of psi, median.
        condition: 10, 50 and 90 % of the condition numbers of rows 1, 2, 3, 4 and 5 by the number of poses, shape (sizes, 3).
        other_lengths: Its median with 28 poses and the lengths of :data:`OTHER_LENGTHS`.
        strips: Condition number of the 28 squares of each strip.
        all_strips: That of all strips together.
        with_rail: The same where the rail's zero is unknown, too.
        sigma: 1-sigma of the worst and the best angle of psi [mrad] at :data:`NOISE`, by sets: random ones by size, then a strip.
    """

    ranks: dict[int, tuple[int, int]]
    values: tuple[np.ndarray, np.ndarray]
    printed_condition: float
    printed_error: np.ndarray
    filled_error: np.ndarray
    three: float
    condition: np.ndarray
    other_lengths: float
    strips: tuple[float, ...]
    all_strips: float
    with_rail: tuple[float, ...]
    sigma: dict[str, tuple[float, float]]


def claims() -> Claims:
    """Compute all of it."""
    rng = np.random.default_rng(1992)
    found = {n: _ranks(rng, n) for n in (1, 2, 3, 4)}
    theta = angles(random_q(rng, SETS, 2))
    correct = E(theta, LENGTHS)[:, :, :4]
    psi = SIZE * rng.normal(size=(SETS, 8))
    e = np.einsum("snij,sj->sni", correct, psi).reshape(SETS, 8)
    printed = printed_E(theta)
    filled = printed.copy()
    filled[..., 2, 0] = -np.cos(theta[..., 1:].sum(axis=-1))
    systems = [each.reshape(SETS, 8, 8) for each in (correct, printed, filled)]
    errors = [_share(np.linalg.solve(each, e[..., None])[..., 0], psi) for each in systems[1:]]
    spread = [np.quantile(conditions(_system(random_q(rng, SETS, n))), (0.1, 0.5, 0.9)) for n in POSES]
    strips = strip_readings()
    return Claims(
        ranks=found,
        values=(np.linalg.svd(systems[0], compute_uv=False), np.linalg.svd(systems[1], compute_uv=False)),
        printed_condition=float(np.median(conditions(systems[1]))),
        printed_error=errors[0],
        filled_error=errors[1],
        three=_three(rng),
        condition=np.array(spread),
        other_lengths=float(np.median(conditions(_system(random_q(rng, SETS, SQUARES), OTHER_LENGTHS)))),
        all_strips=float(conditions(_system(np.concatenate(strips)))),
        strips=tuple(float(conditions(_system(q))) for q in strips),
        with_rail=tuple(float(conditions(_with_rail(q))) for q in strips),
        sigma={f"{n} anywhere": _sigma(random_q(rng, SETS, n)) for n in (3, 5, 10, 28)}
        | {"28 of a strip": _sigma(np.stack(strips))},
    )


def _ranks(rng: np.random.Generator, n: int) -> tuple[int, int]:
    """Rank of rows 1 to 4, and of all rows, of sets of n poses; the same for all, or this fails."""
    matrices = E(angles(random_q(rng, SETS, n)), LENGTHS)
    (four,), (five,) = (set(ranks(part.reshape(SETS, -1, 8))) for part in (matrices[:, :, :4], matrices))
    return int(four), int(five)


def _system(q: np.ndarray, lengths: np.ndarray = LENGTHS) -> np.ndarray:
    """All rows of E of sets of poses (..., n, 4) as one matrix, shape (..., 5 n, 8)."""
    return E(angles(q), lengths).reshape(*q.shape[:-2], -1, 8)


def _with_rail(q: np.ndarray) -> np.ndarray:
    """The same with the rail's zero as another unknown, which e_5 alone sees."""
    return np.column_stack([_system(q), np.tile([0.0, 0.0, 0.0, 0.0, 1.0], len(q))])


def _share(found: np.ndarray, psi: np.ndarray) -> np.ndarray:
    """Error of psi as a share of it, shape (sets,)."""
    return np.asarray(np.linalg.norm(found - psi, axis=1) / np.linalg.norm(psi, axis=1))


def _three(rng: np.random.Generator) -> float:
    """Median error of psi from three poses of the exact kinematics, as a share."""
    errors = []
    for _ in range(SETS // 10):
        q, psi = random_q(rng, 3), SIZE * rng.normal(size=8)
        found, _ = solve_psi(pose(arid(psi, LENGTHS), q), angles(q), q[:, 0], LENGTHS)
        errors.append(float(np.linalg.norm(found - psi) / np.linalg.norm(psi)))
    return float(np.median(errors))


def _sigma(q: np.ndarray) -> tuple[float, float]:
    """Median 1-sigma of the worst and of the best known angle of psi, [mrad], from rows 1, 2 and 5 of sets (..., n, 4)."""
    weighed = E(angles(q), LENGTHS)[:, :, [0, 1, 4]] / NOISE[:, None]
    inverse = np.linalg.inv(np.einsum("snij,snik->sjk", weighed, weighed))
    std = 1e3 * np.sqrt(np.einsum("skk->sk", inverse))
    return float(np.median(std.max(axis=1))), float(np.median(std.min(axis=1)))


def strip_readings() -> list[np.ndarray]:
    """Readings at the 28 squares of each strip of ``identification/arid-strip``, shape (28, 4) each."""
    with (TOP / "identification" / "arid-strip" / "shots.csv").open(newline="") as file:
        q = np.array([[float(row[f"joint_{k}"]) for k in (1, 2, 3, 4)] for row in csv.DictReader(file)])
    return list(q.reshape(-1, SQUARES, 4))


def page(c: Claims) -> str:
    """The page as Markdown."""
    rank_lines = "\n".join(f"| {n} | {four} of 8 | {five} of 8 |" for n, (four, five) in c.ranks.items())
    condition_lines = "\n".join(
        f"| {n} | {low:.0f} | {middle:.0f} | {high:.0f} |"
        for n, (low, middle, high) in zip(POSES, c.condition, strict=True)
    )
    sigma_lines = "\n".join(f"| {name} | {best:.2f} | {worst:.2f} |" for name, (worst, best) in c.sigma.items())
    wrong, filled = np.median(c.printed_error), np.median(c.filled_error)
    best = c.printed_error.min()
    at_28 = c.condition[POSES.index(SQUARES), 1]
    return f"""# Claims of 1992, as figures

K. L. Doty's report on the ARID (NASA/ASEE Summer Faculty Fellowship, 1992) says how many measurements a calibration
needs, and prints the matrix E to do it with. Every number here is computed by

    PYTHONPATH=.:tests/support python benchmarks/doty1992_claims.py \\
      -o docs/claims-of-1992.md

from the corrected E ([conventions](conventions.md)), for {SETS:,} random sets of poses within the report's joint limits. The
unknowns are the eight angles psi, a pitch beta and a twist alpha of each link.

## "A minimum of two measurements": no, three

A pose gives four direction cosines and a height (3-11). The report takes the cosines of two poses: eight equations for
eight unknowns. But the third and the fourth repeat the first two: the 8 × 8 system has rank {c.ranks[2][0]}, whatever the poses.

| poses | rank of the cosines (rows 1 to 4) | rank with the height (rows 1 to 5) |
|---|---|---|
{rank_lines}

With the height, three poses are enough; without it, four. From three, `solve_psi` returns psi to {c.three:.0e} of
itself (median; psi of 1 mrad, exact kinematics).

![Singular values of two poses: as it is, four of eight are zero; as printed, none is]({FOLDER}/two-poses.svg)

## The matrix as printed inverts without complaint

18 of 40 printed cells are wrong, mostly columns of two rows in reverse. The printed 8 × 8 matrix has full rank and a
condition number of {c.printed_condition:.0f} in the median: nothing warns. From exact measurements its psi is wrong by
{wrong:.1f} times psi itself in the median ({filled:.1f} with the blank cell filled in), and by {best:.2f} in the luckiest of
{SETS:,} sets. A robot that is left alone has an error of 1.

![Error of psi from exact measurements, by the printed matrix; left alone it is 1]({FOLDER}/printed-matrix.svg)

A condition number shows how errors grow, not that a matrix is right. So E is tested against derivatives of the exact
kinematics.

## How many poses, and where

Condition number of E, which says how much noise grows:

| poses, anywhere | 10 % of sets below | median | 90 % below |
|---|---|---|---|
{condition_lines}

With {SQUARES} poses anywhere it is {at_28:.0f} ({c.other_lengths:.0f} with lengths of 0.5, 1.2 and 0.9 m). The report
plans {SQUARES} squares on one strip across the bay door, where the joints move together. For the three strips of
`identification/arid-strip` it is {_listed(c.strips)}, and {_listed(c.with_rail)} where the rail's zero is unknown, too.
All three together have {c.all_strips:.0f}.

![Condition number against the number of poses, with the strips]({FOLDER}/condition.svg)

With a good camera head (0.5 mrad, 0.25 mm), 1σ of psi:

| poses | best angle [mrad] | worst angle [mrad] |
|---|---|---|
{sigma_lines}

So 28 squares of a strip tell the worst angle about as well as five poses anywhere. `aridcal design` chooses poses that
tell more.
"""


def _listed(values: tuple[float, ...]) -> str:
    """Condition numbers in words: ``45, 45 and 51``."""
    *first, last = [f"{value:.0f}" for value in sorted(values)]
    return f"{', '.join(first)} and {last}"


def pictures(c: Claims) -> dict[str, Figure]:
    """The page's pictures by name."""
    return {"two-poses": _two_poses(c), "printed-matrix": _printed(c), "condition": _condition(c)}


def _axes(title: str, x: str, y: str) -> Figure:
    figure = Figure(figsize=(6.4, 3.2), layout="constrained")
    axes = figure.add_subplot()
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(color="#dddddd", linewidth=0.6)
    return figure


def _two_poses(c: Claims) -> Figure:
    figure = _axes("Singular values of the 8 × 8 system of two poses, median of all sets", "number", "singular value")
    (axes,) = figure.axes
    place = np.arange(1, 9)
    for values, name, colour, mark in ((c.values[1], "as printed", RED, "x"), (c.values[0], "as it is", BLUE, "o")):
        axes.semilogy(place, np.maximum(np.median(values, axis=0), 1e-17), mark, color=colour, label=name)
    axes.axhspan(1e-17, 1e-14, color=GREY, alpha=0.2)
    axes.text(1.0, 2e-16, "rounding", color=GREY)
    axes.legend(frameon=False)
    return figure


def _printed(c: Claims) -> Figure:
    figure = _axes("Error of psi from exact measurements of two poses", "error over psi", "sets")
    (axes,) = figure.axes
    edges = np.geomspace(0.1, 1000.0, 41).tolist()
    axes.hist(np.clip(c.printed_error, 0.1, 1000.0), edges, color=RED, alpha=0.7, label="by the printed matrix")
    axes.axvline(1.0, color=BLUE, linewidth=2, label="left alone")
    axes.set_xscale("log")
    axes.legend(frameon=False)
    return figure


def _condition(c: Claims) -> Figure:
    figure = _axes("Condition number of E", "poses", "condition number")
    (axes,) = figure.axes
    low, middle, high = c.condition.T
    axes.fill_between(POSES, low, high, color=BLUE, alpha=0.2, label="80 % of random sets")
    axes.plot(POSES, middle, color=BLUE, label="median")
    axes.plot([SQUARES] * len(c.strips), c.strips, "o", color=RED, label="28 squares of a strip")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xticks(POSES, [str(n) for n in POSES])
    axes.minorticks_off()
    axes.set_yticks((10, 20, 50, 100, 200), ("10", "20", "50", "100", "200"))
    axes.legend(frameon=False)
    return figure


def main() -> None:
    """Write the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", dest="out", type=Path, default=TOP / "docs" / "claims-of-1992.md")
    out = parser.parse_args().out
    found = claims()
    images = out.parent / FOLDER
    images.mkdir(parents=True, exist_ok=True)
    with mpl.rc_context({"svg.hashsalt": "claims of 1992", "font.size": 9}):
        for name, figure in pictures(found).items():
            figure.savefig(images / f"{name}.svg", metadata={"Date": None})
    out.write_text(page(found), encoding="utf-8")


if __name__ == "__main__":
    main()
