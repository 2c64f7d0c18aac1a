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
        name: ``nominal``, ``geometric`` or ``final``.
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
        repeatability: RP: mean distance to the group's centre plus three standard deviations, over all groups, [m].
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
        places: Targets of those configurations in the base frame, shape (M, 3), [m].
        halves_measured: RMS difference of two calibrations from one half of the training rows each, [m]; nan if the
            halves are too small.
        halves_expected: RMS difference that noise alone would make, [m].
    """

    position: np.ndarray
    rotation: np.ndarray
    reach: np.ndarray
    places: np.ndarray
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
        before: Residuals of the test rows of the final model without it, the rest refitted, shape (T, m).
        after: The same with it.
        reached: Residuals of all rows of the model with this effect and those listed before it, refitted, shape (N, m).
        confounded_with: Effects that these data cannot tell from it.
        curves: Its motions over its covariates.
    """

    effect: Effect
    declared: bool
    p_value: float
    before: np.ndarray
    after: np.ndarray
    reached: np.ndarray
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
class Trace:
    """Residuals, as a motion that each row asks for by itself, over something that they may depend on.

    Attributes:
        motion: A joint, for its own axis, or an axis of the world: ``x y z rx ry rz``.
        unit: ``m`` or ``rad``.
        covariate: A joint, a measured column, or a load.
        seen: Covariate of the rows that say something of this motion, in order, shape (n,).
        before: What they ask for without effects, shape (n,).
        after: What they ask for with the final model, shape (n,).
        centre: Covariate of slices of these rows, shape (B,).
        mean_before: Mean of each slice without effects, shape (B,).
        mean_after: The same with the final model.
        std: Standard deviation that noise gives these means, shape (B,).
        at: Where two smooth curves through the means were evaluated, shape (G,).
        smooth_before: The one without effects, shape (G,).
        smooth_after: The one of the final model, shape (G,).
        size_before: RMS of the means beyond their noise, without effects, [m] or [rad].
        size_after: The same with the final model.
        p_before: That slices of noise would differ from zero as much as those without effects do.
        p_value: The same for those of the final model.
    """

    motion: str
    unit: str
    covariate: str
    seen: np.ndarray
    before: np.ndarray
    after: np.ndarray
    centre: np.ndarray
    mean_before: np.ndarray
    mean_after: np.ndarray
    std: np.ndarray
    at: np.ndarray
    smooth_before: np.ndarray
    smooth_after: np.ndarray
    size_before: float
    size_after: float
    p_before: float
    p_value: float


@dataclass(frozen=True)
class Order:
    """The final model's residuals one after the other.

    Attributes:
        timed: True if the order is that of a column ``time``, False if it is that of the table.
        order: The rows in use in that order, shape (n,).
        lags: Rows apart, shape (L,).
        correlation: Of residuals so many rows apart, mean of the axes, shape (L,).
        bound: What 95 % of such correlations stay within if all is noise.
        changes: Changes of sign from one row to the next, all axes together.
        expected: As many as noise makes.
        spread: Standard deviation of that number.
        p_value: That noise makes so few.
    """

    timed: bool
    order: np.ndarray
    lags: np.ndarray
    correlation: np.ndarray
    bound: float
    changes: int
    expected: float
    spread: float
    p_value: float


@dataclass(frozen=True)
class Traces:
    """What remains, asked on what it depends.

    Attributes:
        joints: Each joint's own motion over its own position.
        strongest: For each joint, load and column: the motion that depends on it most clearly.
        asked: Number of pairs of a motion and a covariate that these were chosen from.
        order: In the order of time.
    """

    joints: tuple[Trace, ...]
    strongest: tuple[Trace, ...]
    asked: int
    order: Order


@dataclass(frozen=True)
class HeadNumber:
    """One number of the measuring head.

    Attributes:
        name: ``camera.k1``, ``sonar_2.bias`` for instance.
        unit: ``px``, ``m`` or ``1``.
        declared: As head.yaml has it.
        value: As identified.
        std: 1-sigma; None if it was not identified.
        status: ``identified``, ``fixed`` or ``redundant``.
        redundant_with: Names of those that it cannot be told from.
    """

    name: str
    unit: str
    declared: float
    value: float
    std: float | None
    status: str
    redundant_with: tuple[str, ...] = ()


@dataclass(frozen=True)
class ClosedForm:
    """The closed-form answer of the report of 1992, beside the full one.

    Attributes:
        nominal: ``d theta beta a alpha`` of each link, shape (4, 5), [m] and [rad].
        links: Likewise, from the closed form.
        full: Likewise, of the geometric stage.
        residual: What the closed form leaves of all rows, shape (N, 6), [m] and [rad].
    """

    nominal: np.ndarray
    links: np.ndarray
    full: np.ndarray
    residual: np.ndarray


@dataclass(frozen=True)
class MeasuringHead:
    """What was found of the measuring head.

    Attributes:
        numbers: All of them.
        coefficients: Those of its effects: change from what was declared.
        misfit: RMS of what shots have beyond their poses, in sigmas: with the head as declared and as identified.
        ranges: RMS of what each sonar reads beyond the poses, likewise, shape (2, S), [m].
        fiducials: Columns of the cache of what was found in the images.
        mount: T_tip_camera as declared and as identified, shape (2, 4, 4).
        closed_form: The report's own answer on the same poses; None for an arm that is not the ARID's like.
    """

    numbers: tuple[HeadNumber, ...]
    coefficients: tuple[HeadNumber, ...]
    misfit: tuple[float, float]
    ranges: np.ndarray
    fiducials: dict[str, np.ndarray]
    mount: np.ndarray
    closed_form: ClosedForm | None = None


@dataclass(frozen=True)
class Outcome:
    """The result of one campaign.

    Attributes:
        campaign: What was asked.
        robot: The nominal chain.
        measurements: All usable rows.
        stages: nominal, geometric, final.
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
        traces: On what the residual depends.
        head: The measuring head, for ``kind: camera_sonar``.
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
    traces: Traces
    verification: Verification | None = None
    diagnosis: Diagnosis | None = None
    head: MeasuringHead | None = None

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
