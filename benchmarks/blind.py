"""Blind benchmark: random robots with undeclared effects; what is named, missed, invented, and at what error.

Example:
    python benchmarks/blind.py --cases 300 --clean 500 --seed 1 --jobs 2
    python benchmarks/blind.py --replay 1000042 --verbose

Every case is made from its own seed (see ``machines.py``): a robot, geometric errors, unknown frames, columns that
matter and columns that do not, and none, one, two or three effects, or one that no catalogue has. An effect's size is the
RMS per component, in sigma, of what it moves on the training rows after projection off all constants and frames.

- A single effect is named right if the kind and the place agree, or if it is listed as what cannot be told from the one
  named, or if the columns of the one named hold all of its contribution but for what the data could not tell: a
  chi-square below :data:`TELLABLE`. (What is smooth holds nearly anything, so it counts only for what is smooth.)
- An effect of a combination is found if that holds for one of those named, or for all of them together.
- The oracle knows the true form of every effect and fits it to the same noisy rows with the same solver.
- Errors are those on configurations never measured, without noise: RMS per component in sigma.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from cases import run_cases
from machines import ADDED, NAMED, Case, basis_of, contribution, draw_case

from aridcal.engine.corrections.effect import Effect
from aridcal.engine.fit.identifiable import identifiable
from aridcal.engine.fit.least_squares import Fit, fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.residual import triangle
from aridcal.engine.instruments.channels import spread
from aridcal.engine.search.loop import CalibratedArm, calibrated_arm, fit_constants
from aridcal.jobs.calibrate.pipeline import judge_arm
from aridcal.system.progress import SILENT

TELLABLE = 12.0
COVERED = 0.5  # share of the error of an effect without a name that must be gone
PATIENCE = 120  # for one case, [s]
OFF = 0.7  # error in sigma at which nobody may say that only noise is left


@dataclass(frozen=True)
class Score:
    """How one case went.

    Attributes:
        seed: Makes the case again.
        what: ``clean``, ``single``, ``combination`` or ``off``.
        kind: Which of the kinds of ``machines.py`` was asked for.
        family: Of the robot.
        truth: What is wrong, in words.
        kinds: Kind of each true effect.
        right: Of each, whether it was named (see the module's docstring).
        invented: Named effects that are no true one's.
        said: What was named, in words.
        verdict: The campaign's.
        geometric: Error of constants alone, [sigma].
        final: Error of the final model, [sigma].
        oracle: Error of the oracle, [sigma].
        seconds: Wall time of fit and search.
        rows: Of the table.
    """

    seed: int
    what: str
    kind: str | None
    family: str
    truth: str
    kinds: tuple[str, ...]
    right: tuple[bool, ...]
    invented: int
    said: str
    verdict: str
    geometric: float
    final: float
    oracle: float
    seconds: float
    rows: int

    @property
    def ratio(self) -> float:
        """Error over the oracle's."""
        return self.final / self.oracle

    @property
    def good(self) -> bool:
        """True if nothing is to be looked at."""
        if self.what == "clean":
            return not self.invented
        if self.what == "off":
            covered = self.final < COVERED * self.geometric or "structure" in self.verdict
            return covered and not (self.verdict == "noise_floor" and self.final > OFF)
        return all(self.right) and not self.invented and self.ratio < 1.5

    def line(self) -> str:
        """The case in one line."""
        missed = [k for k, right in zip(self.kinds, self.right, strict=True) if not right and self.what != "off"]
        marks = [f"MISSED {k}" for k in missed] + ([f"INVENTED {self.invented}"] if self.invented else [])
        marks = marks if self.what != "off" else []
        return (
            f"{' '.join(marks) or 'ok'}: {self.seed} {self.what} {self.family} n={self.rows} {self.truth} "
            f"-> {self.said} | {self.verdict} | error {self.geometric:.2f} -> {self.final:.3f}, "
            f"oracle {self.oracle:.3f} ({self.ratio:.2f}) | {self.seconds:.1f} s"
        )


def analyse(case: Case) -> tuple[CalibratedArm, str]:
    """Do with a case what ``aridcal identify`` does: constants, search, verdict."""
    rows = case.rows
    robot, geometry = case.truth.robot, fit_constants(case.campaign.question, case.truth.robot, rows, ())
    arm = calibrated_arm(case.campaign.question, robot, rows, (), geometry, SILENT)
    return arm, judge_arm(arm).verdict.word


def judge(case: Case) -> Score:
    """Analyse a case and compare with its truth."""
    started = time.perf_counter()
    arm, said = analyse(case)
    seconds = time.perf_counter() - started
    geometric, found = arm.geometry.geometric, arm.diagnosed
    named: dict[tuple[object, ...], list[Effect]] = defaultdict(list)
    twins: dict[tuple[object, ...], set[tuple[str, str]]] = defaultdict(set)
    for active, others in zip(found.stepwise.state.active, found.confounded, strict=True):
        e = active.effect
        key = (e.kind, e.where, e.with_, e.by)
        named[key].append(e)
        twins[key] |= {(t.kind, t.where) for t in others}
    right, used = _matches(case, named, twins)
    words = [f"{e[0].label} {'/'.join(m)} of {','.join(e[0].covariates[:2])}"
             for e in named.values() for m in [dict.fromkeys(c for x in e for c in x.motion)]]  # fmt: skip
    return Score(
        case.seed, case.what, case.kind, case.family, case.names, tuple(c.effect.kind for c in case.causes), right,
        len(named) - len(used), " + ".join(words) or "nothing", said, error(geometric, case), error(found.fit, case),
        error(oracle(case, geometric), case), seconds, len(case.rows),
    )  # fmt: skip


def oracle(case: Case, geometric: Fit) -> Fit:
    """The true form fitted to the same rows with the same solver; smooth curves with their true stiffness."""
    train, truth = case.train, case.truth
    first = len(case.theta) - sum(len(c.values) for c in case.causes)
    R = triangle(problem(truth, train), case.theta, np.ones(len(train)), case.sigma)
    # What is well known stays ahead of what the effect makes barely separable.
    order = sorted(range(first), key=lambda k: truth.names[k] not in geometric.model.names)
    columns = first
    shifts = any(cause.effect.kind == "shift" for cause in case.causes)
    if shifts or all(shape is None for shape in case.shapes):
        # What an effect and the constants do alike is no direction of its own: the constants leave it to the effect.
        columns, order = len(case.theta), [*range(first, len(case.theta)), *order]
    kept = [k for k in sorted(identifiable(R[:, :columns], order).independent) if k < first] + [
        *range(first, len(case.theta))
    ]
    model, theta = truth.with_coefficients([truth.coefficients[k] for k in kept]), case.theta[kept]
    precision = np.zeros((len(kept), len(kept)))
    at = len(kept) - (len(case.theta) - first)
    for cause, shape in zip(case.causes, case.shapes, strict=True):
        d = len(cause.values)
        if shape is not None:
            precision[at : at + d, at : at + d] = np.linalg.inv(shape)
        at += d
    return fit(problem(model, train), theta, prior=Prior(np.zeros_like(theta), precision))


def error(found: Fit, case: Case) -> float:
    """RMS per component, in sigma, on configurations never measured."""
    off = problem(found.model, case.query).residual(found.theta) / spread(case.sigma, case.query.channels)
    return float(np.sqrt(np.mean(off**2)))


def _matches(
    case: Case, named: dict[tuple[object, ...], list[Effect]], twins: dict[tuple[object, ...], set[tuple[str, str]]]
) -> tuple[tuple[bool, ...], set[tuple[object, ...]]]:
    """Which true effects were named, and which of those named are true ones."""
    if not case.causes or not named:
        return (False,) * len(case.causes), set()
    extra = [c for group in named.values() for e in group for c in e.coefficients]
    model = case.truth.with_coefficients((*case.truth.coefficients, *extra))
    theta = np.concatenate([case.theta, np.zeros(len(extra))])
    J = contribution(model, theta, case.train, case.sigma)
    true = len(case.truth.coefficients)
    first = true - sum(len(c.values) for c in case.causes)
    U = basis_of(J[:, :first])
    J = J - U @ (U.T @ J)
    parts, at = {}, true
    for key, group in named.items():
        width = sum(len(e.coefficients) for e in group)
        parts[key] = J[:, at : at + width]
        at += width

    def holds(columns: np.ndarray, moved: np.ndarray) -> bool:
        seen = np.linalg.norm(columns, axis=0)
        if not np.any(seen > 1e-6):
            return False
        Q = basis_of(columns[:, seen > 1e-6])
        rest = moved - Q @ (Q.T @ moved)
        return float(rest @ rest) < TELLABLE

    right, used, at = [], set(), first
    for cause in case.causes:
        e, d = cause.effect, len(cause.values)
        moved = J[:, at : at + d] @ cause.values
        at += d
        same = {key for key in named if key[:2] == (e.kind, e.where)}
        listed = {key for key, others in twins.items() if (e.kind, e.where) in others}
        fair = {key for key, group in named.items() if e.smooth or not any(x.smooth for x in group)}
        held = {key for key in fair if holds(parts[key], moved)}
        mine = same | listed | held
        if not mine and fair and len(case.causes) > 1 and holds(np.hstack([parts[k] for k in fair]), moved):
            mine = fair
        right.append(bool(mine))
        used |= mine
    return tuple(right), used


def _run(job: tuple[int, str, str | None, float]) -> Score | str:
    seed = job[0]
    signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(PATIENCE)
    try:
        return judge(draw_case(*job))
    except Exception as problem:  # a crash is a result, and must not end the others
        return f"{seed} {job[1]} {job[2] or ''} failed: {type(problem).__name__}: {problem}"


def _too_long(*_: object) -> None:
    raise TimeoutError(f"more than {PATIENCE} s")


def jobs(cases: int, clean: int, seed: int, only: str | None, share: float) -> list[tuple[int, str, str | None, float]]:
    """What to run: 6 of 10 cases with effects have one, 2 have two or three, 2 one without a name.

    One in five more is of a kind of :data:`ADDED`: of four of these, three have one effect and one has two or three.
    """
    found: list[tuple[int, str, str | None, float]] = []
    for k in range(cases):
        number = seed * 100_000 + k
        if only in ADDED:
            found.append((number + FROM, "single", only, share))
            continue
        what = only if only in ("single", "combination", "off") else "single" if only else PLAN[k % 10]
        kind = only if only in NAMED else NAMED[k % len(NAMED)] if what == "single" else None
        found.append((number, what, kind, share))
    for k in range(cases // 5 if only is None else 0):
        what = "combination" if k % 4 == 3 else "single"
        found.append((seed * 100_000 + FROM + k, what, ADDED[k % len(ADDED)], share))
    found += [(seed * 100_000 + 50_000 + k, "clean", None, share) for k in range(clean)]
    return found


FROM = 40_000  # number of the first case of an added kind
PLAN = ("single", "single", "combination", "single", "off", "single", "single", "combination", "single", "off")


def report(scores: Sequence[Score], failed: Sequence[str], seconds: float) -> None:
    """Print the figures."""
    by = {what: [s for s in scores if s.what == what] for what in ("single", "combination", "off", "clean")}
    print()
    for kind in (*NAMED, *ADDED):
        rows = [s for s in by["single"] if s.kind == kind]
        if rows:
            good = sum(s.right[0] for s in rows)
            print(f"  {kind:20} {good:3}/{len(rows):<3} named right, {sum(s.invented for s in rows)} invented beside")
    if by["single"]:
        good = sum(s.right[0] for s in by["single"])
        print(
            f"single effects named right: {good}/{len(by['single'])} = {100 * good / len(by['single']):.1f} % (>= 97)"
        )
    if by["combination"]:
        right = [r for s in by["combination"] for r in s.right]
        print(f"effects of combinations found: {sum(right)}/{len(right)} = {100 * np.mean(right):.1f} % (>= 90)")
    ratios = np.array([s.ratio for s in by["single"] + by["combination"]])
    if len(ratios):
        p = np.percentile(ratios, [50, 95, 99, 100])
        print(f"error over the oracle's: median {p[0]:.3f} (<= 1.05), 95 % {p[1]:.2f} (<= 1.5), 99 % {p[2]:.2f} (<= 2), "
              f"worst {p[3]:.2f}")  # fmt: skip
        known = by["single"] + by["combination"]
        middle = [float(np.median([getattr(s, name) for s in known])) for name in ("geometric", "final", "oracle")]
        print(f"median error [sigma]: constants alone {middle[0]:.3f}, final {middle[1]:.3f}, oracle {middle[2]:.3f}")
        print(f"invented beside true effects: {sum(s.invented for s in by['single'] + by['combination'])}")
        wrong = sum(s.verdict == "noise_floor" and s.final > OFF for s in by["single"] + by["combination"])
        print(f"noise_floor said of models off by more than {OFF} sigma: {wrong}")
    if by["off"]:
        covered = np.mean([s.final < COVERED * s.geometric or s.verdict == "structure_remains" for s in by["off"]])
        wrong = sum(s.verdict == "noise_floor" and s.final > OFF for s in by["off"])
        print(f"off the catalogue, covered or said to remain: {100 * covered:.1f} % (>= 95); noise_floor said of models "
              f"off by more than {OFF} sigma: {wrong} (0)")  # fmt: skip
    if by["clean"]:
        false = [s for s in by["clean"] if s.invented]
        doubted = sum(s.verdict == "structure_remains" for s in by["clean"])
        print(f"clean campaigns with an effect: {len(false)} of {len(by['clean'])} (<= 5 of 500); "
              f"structure_remains said of {doubted}")  # fmt: skip
    if scores:
        times = np.array([s.seconds for s in scores])
        print(f"seconds a case: median {np.median(times):.2f}, worst {times.max():.1f}; in all {seconds:.0f} s")
    for line in failed:
        print(line)


def main(argv: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", type=int, default=300, help="with effects")
    parser.add_argument("--clean", type=int, default=500, help="without")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument(
        "--only", choices=("single", "combination", "off", *NAMED, *ADDED), help="cases with effects to run"
    )
    parser.add_argument("--outliers", type=float, default=0.0, help="share of the rows grossly wrong")
    parser.add_argument("--replay", type=int, metavar="SEED", help="one case (with the same --only)")
    parser.add_argument("--verbose", action="store_true", help="a line for every case, not only for those to look at")
    arguments = parser.parse_args(argv)
    todo = jobs(arguments.cases, arguments.clean, arguments.seed, arguments.only, arguments.outliers)
    if arguments.replay is not None:
        base, k = divmod(arguments.replay, 100_000)
        every = jobs(FROM, 50_000, base, arguments.only, arguments.outliers)
        todo, arguments.verbose = [job for job in every if job[0] == arguments.replay], True
        if not todo:
            parser.error(f"--replay: no case has the number {k} with the base {base}")
    started = time.perf_counter()
    scores, failed = run_cases(_run, todo, arguments.jobs, arguments.verbose)
    report(scores, failed, time.perf_counter() - started)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
