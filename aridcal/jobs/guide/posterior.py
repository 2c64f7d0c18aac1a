r"""What all rows so far say together: the model of a plan with a prior for everything, fitted, and followed row by row.

About the fit everything is linear: with F the columns of a row in units of its noise and r its residual,

.. math:: M \leftarrow M + F^T F, \qquad g \leftarrow g + F^T r, \qquad \delta = M^{-1} g

so that each row of a batch is judged beside all before it at the price of some small matrices; then the fit is made anew, from
where it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from aridcal.engine.corrections.effect import ANGULAR, FRAME_COMPONENTS, MOUNTING_FRAMES, Coefficient
from aridcal.engine.fit.constants import constants, frame_coefficients, station_labels
from aridcal.engine.fit.least_squares import NUMBERS_THAT_TELL_NOISE, fit
from aridcal.engine.fit.normal_equations import Prior
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.stages import REACH_ANGLE, REACH_LENGTH
from aridcal.engine.inverse.reachable import draw_readings
from aridcal.engine.model.model import Model
from aridcal.engine.model.predictions import merged_instruments
from aridcal.engine.robot.chain import Robot
from aridcal.engine.robot.collisions import Bodies
from aridcal.engine.rows.dataset import Dataset, with_sigma
from aridcal.engine.search.loop import fit_constants
from aridcal.engine.trust.workspace import UNTOLD_SIGMA
from aridcal.files.campaign import Campaign
from aridcal.jobs.plan.configurations import Candidates, draw_candidates, ends
from aridcal.jobs.plan.information import TOGETHER_RANK, CandidateInformation, columns_of, expected_rows, target_columns
from aridcal.jobs.plan.prior_knowledge import PlanSetup, from_fit, patterns_of
from aridcal.jobs.plan.usual_effects import with_stated_effects, with_usual_effects
from aridcal.system.errors import AridcalError, NotOfThisRobot

POOL, SMALL_POOL = 600, 90
"""Configurations to choose from: the best of as many is within some per cent of the best of all; and the same where each must be
sought, as the target must come to a point, so that a row is answered within a second."""

SHOWN_BY, UNTOLD_SHARE = 60, 0.03
"""Poses of which not one tells anything of a combination of unknowns: all of them move it by less than this share of a sigma, so
that a thousand times as many would. Where the arm stands is such a one, if nobody knows where any thing is."""

HELD = 1e3
"""Sigmas of what is expected by which such a combination is held where it is: it is a choice of axes, no error."""

USUAL_SHARE = 0.1
"""Of :data:`REACH_ANGLE` and :data:`REACH_LENGTH`, which are ten times what robots are usually wrong by."""

PRIOR_WEIGHT = 4.0
"""Coefficients for which the usual size of a group counts beside its own: the size is then known to a third before any row."""

NOISE_WEIGHT = 4.0
"""Numbers for which the noise of a good instrument counts where none is declared."""

FEWEST_TO_BEGIN = 3
"""Configurations from which frames can be found in closed form: two poses leave a turn open."""

SPARE = 6
"""Numbers beyond the unknowns of the frames that must be measured to begin: as many as one pose has. With fewer, other frames
explain three places as well."""


@dataclass(frozen=True)
class Posterior:
    """The unknowns of a plan as the rows so far tell them: D of them, those of things first.

    Attributes:
        setup: Model, values and noise at the last fit; its prior in the sizes that the rows suggest.
        base: The prior before any row, shape (K,).
        information: M, shape (D, D).
        pull: g, shape (D,): zero at the fit.
        freedom: Numbers measured beyond those that unknowns took up.
        poses: Some that can be measured, which show what no row tells; None where rows tell the target's whole pose.
    """

    setup: PlanSetup
    base: np.ndarray
    information: np.ndarray
    pull: np.ndarray
    freedom: float
    poses: Candidates | None = None

    @cached_property
    def covariance(self) -> np.ndarray:
        """Of the unknowns, shape (D, D)."""
        return inverse(self.information)

    @cached_property
    def step(self) -> np.ndarray:
        """Where the unknowns are beside the last fit, shape (D,)."""
        return np.asarray(self.covariance @ self.pull)

    @property
    def things(self) -> int:
        """Number of unknowns of things."""
        return len(self.information) - len(self.setup.theta)

    def columns(self, rows: Dataset, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns (n, m, D) and residuals (n, m) of measurements at the last fit, in sigmas.

        Args:
            rows: M of them.
            of: Measurement that each belongs to, ascending from 0, shape (M,); several: see :func:`together`.
        """
        F, r = columns_of(self.setup, rows)
        return (F, r) if len(of) == of[-1] + 1 else together(F, r, of)

    def with_rows(self, F: np.ndarray, r: np.ndarray, sign: float = 1.0) -> Posterior:
        """The posterior with more rows, columns (n, m, D) and residuals (n, m); or without them (sign -1)."""
        flat = F.reshape(-1, F.shape[-1])
        return replace(
            self,
            information=self.information + sign * flat.T @ flat,
            pull=self.pull + sign * flat.T @ r.ravel(),
        )


def together(F: np.ndarray, r: np.ndarray, of: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the same image as one measurement, by as many numbers as its marks move by together: those of a body.

    What the marks scatter by about that is noise of single marks, and says nothing of the shot.

    Args:
        F: Columns, shape (M, m, D).
        r: Residuals, shape (M, m).
        of: Measurement that each belongs to, ascending from 0, shape (M,).

    Returns:
        Columns (n, p, D) and residuals (n, p), zero where a measurement has fewer numbers.
    """
    D = F.shape[2]
    parts = []
    for number in range(int(of[-1]) + 1):
        flat, error = F[of == number].reshape(-1, D), r[of == number].ravel()
        U, s, Vt = np.linalg.svd(flat, full_matrices=False)
        rank = int((s > TOGETHER_RANK * s[0]).sum())
        parts.append((s[:rank, None] * Vt[:rank], U[:, :rank].T @ error))
    wide = max(len(error) for _, error in parts)
    columns, residuals = np.zeros((len(parts), wide, D)), np.zeros((len(parts), wide))
    for number, (part, error) in enumerate(parts):
        columns[number, : len(error)], residuals[number, : len(error)] = part, error
    return columns, residuals


def inverse(information: np.ndarray) -> np.ndarray:
    """Inverse of information, shape (D, D), unknowns scaled alike: lengths, turns and pixels differ by orders."""
    scale = 1.0 / np.sqrt(np.diag(information))
    return np.asarray(np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale))


def expected(setup: PlanSetup) -> np.ndarray:
    """Standard deviation that is expected of each coefficient before any row, shape (K,).

    Frames and instruments may be anywhere within :data:`UNTOLD_SIGMA` of where closed forms have them; constants are off by
    what is usual.
    """
    sizes, at_things = setup.model.sizes, setup.model.at_things
    usual = [
        UNTOLD_SIGMA if of_thing else _usual(c)
        for c, of_thing in zip(setup.model.coefficients, at_things.tolist(), strict=True)
    ]
    usual = np.array(usual) * sizes
    return np.where(np.isfinite(setup.prior), setup.prior, usual)


def _usual(c: Coefficient) -> float:
    """Usual size of a constant of the arm; :data:`UNTOLD_SIGMA` of all else."""
    if c.where in MOUNTING_FRAMES or not c.basis.constant or c.component not in _COMPONENTS:
        return UNTOLD_SIGMA
    return USUAL_SHARE * (REACH_ANGLE if c.component in ANGULAR else REACH_LENGTH)


_COMPONENTS = ANGULAR | {"x", "y", "z", "a", "d"}


def configurations(setup: PlanSetup, rng: np.random.Generator, count: int | None = None) -> Candidates:
    """Configurations that can be measured, to choose from; none of a point to which the arm does not come."""
    traits = setup.campaign.measurements.traits
    return draw_candidates(setup, count or (SMALL_POOL if traits.condition or traits.images else POOL), 0, rng)


def before_rows(setup: PlanSetup) -> Posterior:
    """What is known before any row."""
    base = expected(setup)
    setup = replace(setup, prior=base)
    flat = expected_rows(setup)
    D = flat.shape[1]
    loose = np.diag(1.0 / UNTOLD_SIGMA**2 * np.r_[np.ones(D - len(base)), np.zeros(len(base))])
    traits = setup.campaign.measurements.traits
    poses = None if traits.tracked else draw_candidates(setup, SHOWN_BY, 0, np.random.default_rng(0))
    information = flat.T @ flat + loose
    return Posterior(setup, base, information + held(setup, poses, information), np.zeros(D), 0.0, poses)


def region_columns(setup: PlanSetup, things: int, region: np.ndarray) -> np.ndarray:
    """How each target moves and turns with the unknowns at places of the region, shape (R, 6, D)."""
    every = tuple(range(len(setup.theta)))
    unknowns = CandidateInformation(np.zeros(0), np.zeros(0), np.zeros(0), things, every, np.zeros(0))
    return np.concatenate([target_columns(setup, unknowns, region, k, turns=True) for k in ends(setup)])


def held(setup: PlanSetup, poses: Candidates | None, beforehand: np.ndarray) -> np.ndarray:
    """Information that holds the axes of the base and of a tip, where no row tells them and nothing defines them, shape (D, D).

    Without it such combinations count as errors of the target, as large as what is expected of the constants in them. What no
    row tells and moves the target otherwise, as the size of an arm where no length is known, is an error and stays one.

    Args:
        setup: K coefficients.
        poses: Some that can be measured; None: nothing is held.
        beforehand: Information before any row, shape (D, D).
    """
    if poses is None:
        return np.zeros_like(beforehand)
    rows = columns_of(setup, poses.rows(setup))[0].reshape(-1, len(beforehand))
    std = 1.0 / np.sqrt(np.diag(beforehand))
    things = len(std) - len(setup.theta)
    # A point to which no pose comes is told by touches that the user finds, and what stepped at a slip by the rows before it.
    elsewhere = np.flatnonzero(~np.any(rows[:, :things] != 0.0, axis=0))
    stepped = [things + k for k, c in enumerate(setup.model.coefficients) if c.basis.form == "step"]
    lasting = np.setdiff1d(np.arange(len(std)), [*elsewhere.tolist(), *stepped])
    stated = expected_rows(setup)  # known lengths and places
    of_things = np.any(stated[:, :things] != 0.0, axis=1) & ~np.any(stated[:, elsewhere] != 0.0, axis=1)
    rows = np.concatenate([rows, stated[of_things]])
    triangle = np.linalg.qr(rows[:, lasting] * std[lasting], mode="r")  # has their singular values
    _, s, Vt = np.linalg.svd(triangle, full_matrices=True)
    untold = Vt[np.flatnonzero(np.pad(s, (0, len(lasting) - len(s))) < UNTOLD_SHARE)]
    untold = _as_one_body(setup, untold, std, lasting) / std[lasting]
    information = np.zeros_like(beforehand)
    information[np.ix_(lasting, lasting)] = HELD**2 * untold.T @ untold
    return information


def _as_one_body(setup: PlanSetup, untold: np.ndarray, std: np.ndarray, lasting: np.ndarray) -> np.ndarray:
    """Combinations of unknowns, each by what is expected of it, that leave the target or move all its places as one body.

    Args:
        setup: K coefficients.
        untold: Orthonormal, shape (k, n).
        std: What is expected of each unknown, shape (D,).
        lasting: The n unknowns that they are made of.

    Returns:
        Shape (j, n).
    """
    model = setup.model
    places = draw_readings(model.robot, SHOWN_BY, np.random.default_rng(0))
    moves = region_columns(setup, len(std) - len(setup.theta), places)[:, :3] * std
    moves = moves[:, :, lasting].reshape(-1, len(lasting)) @ untold.T
    # Images tell neither where the base nor where the tip is: camera and board are somewhere about them.
    ends_of_arm = ("world_base", "tip_target") if setup.campaign.measurements.traits.images else ("world_base",)
    body = tuple(Coefficient(where, component) for where in ends_of_arm for component in FRAME_COMPONENTS)
    as_one = replace(setup, model=model.with_coefficients(body), theta=np.zeros(len(body)))
    B = region_columns(as_one, 0, places)[:, :3].reshape(-1, len(body))
    bent = moves - B @ np.linalg.lstsq(B, moves, rcond=None)[0]
    _, s, Vt = np.linalg.svd(bent)
    return np.asarray(Vt[np.pad(s, (0, len(Vt) - len(s))) < UNTOLD_SHARE * np.linalg.norm(moves)] @ untold)


def begun(campaign: Campaign, robot: Robot, around: Bodies, prior: PlanSetup | None, rows: Dataset) -> PlanSetup | None:
    """The setup with its frames, and what the rows refer to, where closed forms have them; None where rows are too few.

    Args:
        campaign: Says which frames are unknown.
        robot: The nominal chain.
        around: Shapes that can touch.
        prior: Before any row; None where nobody says where all is that rows refer to.
        rows: N of them.

    Raises:
        NotOfThisRobot: the rows cannot be of this robot.
    """
    # Rows of one image are configurations each, as they refer to different things; two at one place are one.
    poses = min(len(np.unique(rows.repeats.configuration)), len(np.unique(rows.readings, axis=0)))
    if poses < FEWEST_TO_BEGIN:
        return None
    question = replace(campaign.question, constants="none", effects=(), sought=())
    labels = station_labels(question, rows)
    many = [things for things in rows.instruments.things.values() if things.role.many]
    unknown = sum(int((things.free & ~np.isfinite(things.std)).sum()) for things in many)
    unknown += len(frame_coefficients(question, labels, rows)) - len(rows.instruments.ties)
    sizes = np.array([channel.size for channel in rows.channels])
    if float((rows.measures @ sizes).sum()) < unknown + SPARE:
        return None
    try:
        fitted_frames = fit_constants(question, robot, rows, labels).geometric
    except NotOfThisRobot:
        raise
    except (AridcalError, np.linalg.LinAlgError):  # these rows leave something open: more will not
        return None
    if prior is None:
        setup = from_fit(campaign, robot, around, fitted_frames, constants(robot, campaign.question.constants), rows)
        return with_suspects(replace(setup, patterns=_now(setup.patterns)), np.random.default_rng(0))
    return _with_frames(prior, fitted_frames.model, rows)


def with_suspects(setup: PlanSetup, rng: np.random.Generator) -> PlanSetup:
    """The setup with the effects that the campaign declares; where it declares none, with those that such arms usually have."""
    candidates = configurations(setup, rng)
    setup = with_stated_effects(setup, candidates)
    return setup if setup.campaign.effects else with_usual_effects(setup, candidates)


def _with_frames(prior: PlanSetup, known: Model, rows: Dataset) -> PlanSetup:
    """What was known before any row, with frames and things where rows have them."""
    others = [k for k, c in enumerate(prior.model.coefficients) if c.name not in set(known.names)]
    # Of frames what these rows do not tell of them stays open, as a slip may be along just that.
    labels = {
        "world_base": {name for name, _ in known.world_base},
        "tip_target": {name for name, _ in known.tip_target},
    }
    of_frames = [prior.model.coefficients[k] for k in others]
    others = [k for k, c in zip(others, of_frames, strict=True) if c.station in labels.get(c.where, {c.station})]
    coefficients = (*known.coefficients, *(prior.model.coefficients[k] for k in others))
    around = replace(prior.model.around, sights=known.around.sights)
    instruments, _ = merged_instruments(known.instruments, prior.model.instruments)
    states = {
        role: np.vstack([state, instruments.things[role].start[len(state) :]]) for role, state in known.states.items()
    }
    model = replace(known.with_coefficients(coefficients), around=around, instruments=instruments, states=states)
    return replace(
        prior,
        model=model,
        theta=np.zeros(len(coefficients)),
        prior=np.r_[np.full(len(known.coefficients), np.inf), prior.prior[others]],
        patterns=_now(_patterns(prior.patterns, rows)),
    )


def _patterns(before: Dataset, rows: Dataset) -> Dataset:
    """What rows may refer to: all that the campaign says, and what it does not say as soon as a row refers to it."""
    if rows.blocks[0].traits.tracked:
        return patterns_of(rows)
    stated = {tuple(labels) for labels in before.labels.refers.tolist()}
    return before if {tuple(labels) for labels in rows.labels.refers.tolist()} <= stated else patterns_of(rows)


def _now(patterns: Dataset) -> Dataset:
    """Patterns of rows to come: after every step."""
    return patterns.with_origin(order=np.full(len(patterns), np.inf))


def fitted(before: Posterior, rows: Dataset) -> Posterior:
    """The posterior of all rows in use, fitted anew from where it was.

    Args:
        before: Its model and values begin; its noise and sizes are improved by one step.
        rows: N of them.
    """
    setup = before.setup
    K = len(setup.theta)
    in_noise = with_sigma(rows, setup.sigma.tolist())
    things = before.things
    start = setup.theta + before.step[things:]
    prior = Prior(np.zeros(K), np.diag(setup.prior**-2.0))
    made = fit(problem(setup.model, in_noise), start, np.ones(len(rows)), prior)
    sizes = _sizes(before.base, setup, made.theta, np.diag(made.covariance))
    setup = replace(
        setup,
        model=made.model,
        theta=made.theta,
        prior=sizes,
        sigma=_noise(setup.sigma, rows, made.estimated, made.freedom),
        rows=rows,
        weight=np.ones(len(rows)),
    )
    F, r = columns_of(setup, rows)
    flat = F.reshape(-1, F.shape[2])
    beforehand = expected_rows(setup)
    stated = beforehand.T @ beforehand
    things = len(stated) - K
    stated[:things, :things] += np.eye(things) / UNTOLD_SIGMA**2
    M = flat.T @ flat + stated + held(setup, before.poses, stated)
    pull = flat.T @ r.ravel()
    pull[things:] -= made.theta / sizes**2
    return Posterior(setup, before.base, M, pull, max(made.freedom, 0.0), before.poses)


def _sizes(base: np.ndarray, setup: PlanSetup, theta: np.ndarray, variance: np.ndarray) -> np.ndarray:
    r"""Standard deviation expected of each coefficient, in sizes that the rows suggest, shape (K,).

    .. math:: s_g^2 = (\nu + \sum_k (\theta_k^2 + \Sigma_{kk}) / \sigma_k^2) / (\nu + n_g)

    One step of the EM algorithm (Laird and Ware 1982) with the usual size for :data:`PRIOR_WEIGHT` coefficients. Frames keep
    theirs.
    """
    sizes = base.copy()
    for some in members(setup.model):
        squares = float(np.sum((theta[some] ** 2 + np.maximum(variance[some], 0.0)) / base[some] ** 2))
        sizes[some] *= np.sqrt((PRIOR_WEIGHT + squares) / (PRIOR_WEIGHT + len(some)))
    return sizes


def members(model: Model) -> list[np.ndarray]:
    """Numbers of the coefficients of each group that shares a size; none of frames, of what is at things, and of what moved."""
    keys = [
        "" if of_thing else _group(c) for c, of_thing in zip(model.coefficients, model.at_things.tolist(), strict=True)
    ]
    return [np.array([k for k, other in enumerate(keys) if other == key]) for key in dict.fromkeys(keys) if key]


def _group(c: Coefficient) -> str:
    """What a coefficient shares its size with; nothing of frames, things and what moved."""
    if c.where in MOUNTING_FRAMES or c.component not in _COMPONENTS | {"axis", "t1", "t2", "r1", "r2"}:
        return ""
    if c.basis.constant:
        return "turns" if c.component in ANGULAR else "lengths"
    of = c.basis.of[0] if c.basis.of else ""
    return "sides" if of.endswith("_direction") else "waves" if c.basis.form in ("sin", "cos") else c.basis.form


def _noise(before: np.ndarray, rows: Dataset, estimated: np.ndarray, freedom: float) -> np.ndarray:
    """Noise of each channel, shape (C,): as declared, else between a good instrument's and what the rows scatter by."""
    undeclared = np.array([sigma is None for sigma in rows.sigma])
    nu = max(freedom - NUMBERS_THAT_TELL_NOISE, 0.0)
    mixed = np.sqrt((NOISE_WEIGHT * before**2 + nu * estimated**2) / (NOISE_WEIGHT + nu))
    return np.where(undeclared, mixed, before)


def moved_by(posterior: Posterior, more: Sequence[Coefficient], std: float) -> Posterior:
    """The posterior with coefficients of something that moved, before any row tells them.

    Args:
        posterior: Without them.
        more: The coefficients.
        std: What is expected of each.
    """
    setup = posterior.setup.with_coefficients(tuple(more), np.full(len(more), std))
    n = len(posterior.information) + len(more)
    M = np.eye(n) / std**2
    M[: n - len(more), : n - len(more)] = posterior.information
    return Posterior(
        setup,
        np.r_[posterior.base, np.full(len(more), std)],
        M,
        np.r_[posterior.pull, np.zeros(len(more))],
        posterior.freedom,
        posterior.poses,
    )
