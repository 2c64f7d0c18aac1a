"""Everything a calibration found, ready to be written down: stages, their errors on rows used and never used."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from aridcal.campaign import Campaign
from aridcal.effects import Effect
from aridcal.measurements import Measurements
from aridcal.residual import Sigma
from aridcal.robot import Robot
from aridcal.solver import Fit

STATISTICS = ("rms", "mean", "median", "p95", "max")


@dataclass(frozen=True)
class Stage:
    """One model and what it leaves.

    Attributes:
        name: ``nominal``, ``geometric``, the name of an accepted effect, or ``final``.
        fit: The solved model.
        residual: Measured minus predicted for every row, world axes, shape (N, 6) or (N, 3): [m], then [rad].
    """

    name: str
    fit: Fit
    residual: np.ndarray


@dataclass(frozen=True)
class Repeats:
    """Rows that repeat a configuration (ISO 9283's attained poses).

    Attributes:
        groups: Number of configurations that were measured more than once.
        rows: Rows in them.
        sigma: Scatter within them, per axis, [m] and [rad].
        repeatability: RP: mean distance to the group's centre plus three standard deviations, [m]; worst group.
    """

    groups: int
    rows: int
    sigma: Sigma
    repeatability: float


@dataclass(frozen=True)
class Precision:
    """How well the calibrated target is known, by propagating the noise, and by fitting two halves apart.

    Attributes:
        position: 1-sigma of the target in its worst direction at each row, shape (N,), [m].
        rotation: Likewise for its orientation, [rad].
        reach: The same at configurations drawn from the whole joint range, shape (M,), [m].
        halves_measured: RMS difference of two calibrations from one half of the training rows each, [m]; nan if the
            halves are too small.
        halves_expected: RMS difference that noise alone would make, [m].
    """

    position: np.ndarray
    rotation: np.ndarray
    reach: np.ndarray
    halves_measured: float
    halves_expected: float


@dataclass(frozen=True)
class Verification:
    """Another day's data, scored with the models that were identified.

    Attributes:
        file: Where it came from.
        measurements: Its rows.
        residuals: Measured minus predicted of each stage, shape (N, 6) or (N, 3).
        outlier: Rows that are off by more than 10 robust scales even with the frames fitted anew, shape (N,).
        realigned: The final stage's after fitting the two frames anew: what remounting target or tracker changed.
    """

    file: str
    measurements: Measurements
    residuals: dict[str, np.ndarray]
    outlier: np.ndarray
    realigned: np.ndarray | None


@dataclass(frozen=True)
class Curve:
    """An effect's motion over its covariate, with the rows behind it.

    Attributes:
        component: What moves.
        unit: ``m`` or ``rad``.
        covariate: What it depends on.
        at: Values of the covariate, shape (G,).
        value: The identified motion there, shape (G,).
        std: Its standard deviation, shape (G,).
        seen: Covariate of the rows, shape (N,).
        pulled: Motion that each row asks for by itself: its residual pulled back to this place, shape (N,).
    """

    component: str
    unit: str
    covariate: str
    at: np.ndarray
    value: np.ndarray
    std: np.ndarray
    seen: np.ndarray
    pulled: np.ndarray


@dataclass(frozen=True)
class NamedEffect:
    """An effect that was accepted or declared.

    Attributes:
        effect: What, where, on what it depends; all its coefficients.
        declared: True if the campaign named it.
        p_value: After correction for the number of candidates, not below 1e-300.
        before: Residuals of the test rows of the final model without it, refitted, shape (T, m).
        after: The same with it.
        confounded_with: Effects that these data cannot tell from it.
        curves: Its motions over its covariates.
    """

    effect: Effect
    declared: bool
    p_value: float
    before: np.ndarray
    after: np.ndarray
    confounded_with: tuple[Effect, ...]
    curves: tuple[Curve, ...] = ()


@dataclass(frozen=True)
class Rejected:
    """A candidate that was looked at closely and not taken."""

    effect: Effect
    p_value: float
    gain: float
    why: str


@dataclass(frozen=True)
class Diagnosis:
    """What the search for undeclared effects did.

    Attributes:
        effects: Accepted and declared effects, the largest gain first.
        rejected: The best of those that were not taken.
        barred: What could not be tested, and why: pairs of sentences.
        tested: Number of candidates.
        clues: Whether what remains is noise: (question, share of the variance, p-value).
    """

    effects: tuple[NamedEffect, ...]
    rejected: tuple[Rejected, ...]
    barred: tuple[tuple[str, str], ...]
    tested: int
    clues: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True)
class Outcome:
    """The result of one campaign.

    Attributes:
        campaign: What was asked.
        robot: The nominal chain.
        measurements: All usable rows.
        stages: nominal, geometric, one for each accepted effect, final; at least the three.
        outlier: Flagged rows, shape (N,): one set for all stages.
        stale: Rows whose measurement repeats the row before bit for bit although the joints moved, shape (N,).
        noise: Noise per axis, [m] and [rad].
        noise_source: ``declared`` or ``estimated``.
        repeats: Rows that repeat a configuration; None where there are none.
        precision: Uncertainty of the target.
        verdict: ``noise_floor``, ``structure_remains`` or ``not_enough_data``.
        unexplained_fraction: Share of the remaining variance that is repeatable beyond the noise.
        notices: Sentences that the user should read.
        seconds: Wall time.
        verification: Another day's data, if it was given.
        diagnosis: The search for undeclared effects.
    """

    campaign: Campaign
    robot: Robot
    measurements: Measurements
    stages: tuple[Stage, ...]
    outlier: np.ndarray
    stale: np.ndarray
    noise: Sigma
    noise_source: str
    repeats: Repeats | None
    precision: Precision
    verdict: str
    unexplained_fraction: float
    notices: tuple[str, ...]
    seconds: float
    verification: Verification | None = None
    diagnosis: Diagnosis | None = None

    @property
    def effects(self) -> tuple[NamedEffect, ...]:
        """Accepted and declared effects."""
        return () if self.diagnosis is None else self.diagnosis.effects

    def stage(self, name: str) -> Stage:
        """The first or last stage of that name."""
        return next(s for s in self.stages if s.name == name)

    def parts(self) -> dict[str, np.ndarray]:
        """Masks of the rows scored: ``train`` and ``test`` without outliers, ``test_all`` with them."""
        test = self.measurements.test
        return {"train": ~test & ~self.outlier, "test": test & ~self.outlier, "test_all": test}


def errors(residual: np.ndarray, mask: np.ndarray) -> dict[str, dict[str, float]]:
    """Error statistics of some rows.

    Args:
        residual: Shape (N, 6) or (N, 3), [m] and [rad].
        mask: Rows to count, shape (N,).

    Returns:
        ``position_mm`` (norm of the residual) and, for poses, ``rotation_mrad`` (angle), each with rms, mean, median,
        p95 and max; nan where no row counts.
    """
    found = {"position_mm": statistics(1e3 * np.linalg.norm(residual[mask, :3], axis=1))}
    if residual.shape[1] == 6:
        found["rotation_mrad"] = statistics(1e3 * np.linalg.norm(residual[mask, 3:], axis=1))
    return found


def statistics(values: np.ndarray) -> dict[str, float]:
    """rms, mean, median, p95 and max of absolute values, shape (N,)."""
    if len(values) == 0:
        return dict.fromkeys(STATISTICS, float("nan"))
    return {
        "rms": float(np.sqrt(np.mean(values**2))),
        "mean": float(np.mean(values)),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95)),
        "max": float(np.max(values)),
    }
