"""An outcome as a calibration that predicts and commands: the arm and its target without instruments, and the ranges of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import pinocchio as pin

from aridcal import __version__
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.corrections.labels import is_label
from aridcal.engine.corrections.sights import Sights
from aridcal.engine.fit.least_squares import LEAST_FREEDOM, Fit
from aridcal.engine.fit.noise import noise_ratio
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.tails import Tails, tails_of
from aridcal.engine.instruments.channels import columns, norms, spread
from aridcal.engine.instruments.kinds import MEASUREMENT_KINDS as INSTRUMENTS
from aridcal.engine.instruments.setup import TIP, Instruments
from aridcal.engine.model.model import ONE_FRAME, Model
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.row_facts import Labels
from aridcal.engine.trust.coverage import holes, largest
from aridcal.engine.trust.rival_predictions import Rival
from aridcal.engine.trust.wander import wanders
from aridcal.engine.trust.workspace import OpenCombination
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel


def calibration(outcome: Outcome) -> SavedModel:
    """An outcome as a self-contained calibration."""
    m, final = outcome.measurements, outcome.stage("final").fit
    tails = _tails(outcome, final)
    saved = _without_wander(outcome, tails)
    wander = wanders(final, m.select(~outcome.outlier), final.estimated, tails, saved.span)
    return replace(saved, record=saved.record | ({"wander": [asdict(process) for process in wander]} if wander else {}))


def _without_wander(outcome: Outcome, tails: Sequence[Tails | None]) -> SavedModel:
    """The calibration without the processes of joint zeros: these need all rows once more, and as much memory as all this."""
    campaign, m = outcome.campaign, outcome.measurements
    fitted = ~m.test & ~outcome.outlier
    final, target = outcome.stage("final").fit, _saved_target(m, outcome.head is not None)
    solved = _solved(final, target)
    largest_deviations = _largest_std(outcome, solved, target)
    columns = fitted_values(outcome)
    record = {
        "campaign": campaign.text,
        "data": {
            "files": [f.name for f in m.origin.files],
            "sha256": m.origin.sha256,
            "rows": len(m),
            "train": int(fitted.sum()),
        },
        "derived_columns": [name for name in m.origin.derived if name in columns],
        "versions": {"aridcal": __version__, "pinocchio": pin.__version__, "numpy": np.__version__},
    }
    scatter = _scatter(outcome, fitted, tails)
    if m.direct:
        record["scatter"] = scatter
    else:
        record["scatter_of_kinds"] = _of_kinds(m, scatter)
    if len(target.labels) > 1:
        record["frames_by"] = "both" if len(final.model.world_base) > 1 else "target"
    if m.direct:
        position, rotation = float(outcome.noise[0]), float(outcome.noise[-1])
    else:
        position, rotation = outcome.at_target.noise(spread(outcome.noise, outcome.channels))
    return SavedModel(
        _solved(outcome.stage("geometric").fit, target),
        solved,
        "pose" if target.turns else "position",
        campaign.robot.gravity,
        (position, rotation if target.turns else 1.0),
        {name: ends(v) for name, v in columns.items()},
        record,
        {name: gaps for name, v in columns.items() if (gaps := holes(v))},
        largest_deviations,
        () if outcome.certainty is None else _of_target(outcome.certainty.open_combinations, final, target),
        {name: ends(v) for name, v in recorded_values(outcome).items() if name not in columns},
        _rivals(outcome, final, target),
    )


def _largest_std(outcome: Outcome, solved: SolvedModel, target: _Target) -> tuple[float, float]:
    """Largest standard deviations of the target's place [m] and turn [rad] at the fitted rows; infinite if never measured."""
    m = outcome.measurements
    fitted = m.fitted.select(~outcome.outlier[m.train])
    if target.labels and fitted.labels.target is not None:
        fitted = fitted.select(np.isin(fitted.labels.target, target.labels))
    std = solved.std(fitted.readings, fitted.covariates, *_frame_labels(solved.model, fitted.labels))
    if not target.turns:  # a rotation that was never measured has no deviation worth a limit
        std[:, 3:] = np.inf
    if not target.moves:
        std[:, :3] = np.inf
    return largest(std)


def _rivals(outcome: Outcome, final: Fit, target: _Target) -> tuple[Rival, ...]:
    """Causes that the rows could not tell from the effects, as far as they move the saved target."""
    tied = () if outcome.diagnosis is None else outcome.diagnosis.tied
    return tuple(
        Rival(tie.effect.label, tie.instead_of.label, tie.weight, change)
        for tie in tied
        for change in _of_target((tie.change,), final, target)
    )


def fitted_values(outcome: Outcome) -> dict[str, np.ndarray]:
    """Readings, and covariates that predictions depend on, of the n fitted rows, by name, shape (n,) each."""
    m = outcome.measurements
    fitted = ~m.test & ~outcome.outlier
    columns = dict(zip(outcome.robot.readings, m.readings[fitted].T, strict=True))
    return columns | {name: m.covariates[name][fitted] for name in outcome.stage("final").fit.model.needs}


def recorded_values(outcome: Outcome) -> dict[str, np.ndarray]:
    """Numeric columns of the tables at the n fitted rows, by name, shape (n,) each."""
    m = outcome.measurements
    fitted = ~m.test & ~outcome.outlier
    named = [name for name in m.covariates if name not in m.origin.derived and not is_label(name)]
    return {name: v for name in named if np.isfinite(v := m.covariates[name][fitted]).any()}


def ends(values: np.ndarray) -> tuple[float, float]:
    """Lowest and highest of some values, shape (N,)."""
    return float(np.nanmin(values)), float(np.nanmax(values))


def _tails(outcome: Outcome, fit: Fit) -> list[Tails | None]:
    """Tails of each channel's noise, outliers included: if chance made them, it will make more."""
    residual = problem(fit.model, outcome.measurements).scaled_residual(fit.theta)
    scale = np.sqrt(max(fit.freedom, LEAST_FREEDOM) / fit.numbers)
    residual /= scale  # in place: of many rows a copy counts
    squares = norms(residual, outcome.channels) ** 2
    measures = outcome.measurements.measures
    return [
        tails_of(values[measured & np.isfinite(values)], channel.size)
        for channel, values, measured in zip(outcome.channels, squares, measures.T, strict=True)
    ]


def _scatter(outcome: Outcome, fitted: np.ndarray, tails: Sequence[Tails | None]) -> dict[str, dict[str, Any]]:
    """Scatter of the fitted rows about the final model, by channel: the declared noise as long as the rows agree with it.

    Args:
        outcome: The outcome.
        fitted: Fitted rows, shape (N,) bool.
        tails: Tails of each channel, if it has any.
    """
    fit, rows = outcome.stage("final").fit, outcome.measurements
    train = rows.fitted
    surprise = noise_ratio(train, fit.estimated, fit.freedom)
    freedom_share = fit.freedom / fit.numbers
    scatter: dict[str, dict[str, Any]] = {}
    for k, (channel, part) in enumerate(zip(outcome.channels, columns(outcome.channels), strict=True)):
        declared = rows.sigma[k]
        residual = outcome.stage("final").residual[fitted][:, part]
        residual = residual[~np.isnan(residual)]
        freedom = freedom_share * residual.size
        if declared is not None and surprise[k] == 1.0:
            scatter[channel.name] = {"sigma": float(declared), "freedom": np.inf}
        elif freedom > LEAST_FREEDOM and np.any(residual != 0.0):
            scatter[channel.name] = {
                "sigma": float(np.sqrt(np.mean(residual**2) / freedom_share)),
                "freedom": float(freedom),
            }
        tail = tails[k]
        if tail is not None and channel.name in scatter:
            scatter[channel.name]["tails"] = asdict(tail)
    return scatter


def _of_kinds(m: Dataset, scatter: dict[str, dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """Scatter by kind of block, then by the channel's name in every campaign; of two blocks of a kind the larger one."""
    by_kind: dict[str, dict[str, dict[str, Any]]] = {}
    for block in m.blocks:
        of_kind = by_kind.setdefault(block.kind, {})
        for channel, of_block in zip(INSTRUMENTS[block.kind].channels, block.channels, strict=False):
            if of_block.name in scatter:
                scatters = [scatter[of_block.name], *([of_kind[channel.name]] if channel.name in of_kind else [])]
                of_kind[channel.name] = max(scatters, key=lambda part: part["sigma"])
    return {kind: channels for kind, channels in by_kind.items() if channels}


@dataclass(frozen=True)
class _Target:
    """The target that a saved calibration predicts.

    Attributes:
        labels: Labels of the frames on the tip that are kept; empty where all rows share one.
        turns: False where the target is a point, whose rotation nothing measured.
        moves: False where nothing measured its place.
        tip: True where the target is the tip itself: the mounting of a measuring head is left out.
    """

    labels: tuple[str, ...]
    turns: bool
    moves: bool
    tip: bool


def _saved_target(m: Dataset, head: bool) -> _Target:
    """The targets that instruments measured; the tip itself where cameras are all there is."""
    if m.direct:
        return _Target((), m.sees_turns, True, head)
    all_labels = () if m.labels.target is None else tuple(sorted(set(m.labels.target.tolist())))

    def kinds(labels: tuple[str, ...]) -> set[str]:
        some = np.ones(len(m), dtype=bool) if m.labels.target is None else np.isin(np.asarray(m.labels.target), labels)
        return {m.blocks[b].kind for b in np.unique(m.labels.block[some])}

    def level_alone(measured: set[str]) -> bool:
        return all(INSTRUMENTS[kind].level for kind in measured)

    # what instruments reach for comes before the tip that cameras see, and a place before an attitude
    placed = tuple(label for label in all_labels if label != TIP and not level_alone(kinds((label,))))
    labels = placed or tuple(label for label in all_labels if label == TIP) or all_labels
    measured = kinds(labels)
    return _Target(
        labels,
        any(INSTRUMENTS[kind].turns for kind in measured),
        not level_alone(measured),
        head,
    )


def _frame_labels(model: Model, labels: Labels) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Labels by which a saved model selects frames: those of stations, and of targets where there are several."""
    return labels.station, labels.target if len(model.tip_target) > 1 and labels.target is not None else None


def _solved(fit: Fit, target: _Target) -> SolvedModel:
    """A stage's model of the arm and its target: without the instruments, and without frames that hold no target.

    After a measuring head, also without the head's mounting: the target is then the tip.
    """
    model = fit.model
    dropped = model.at_things | np.array(
        [target.tip and c.where == "tip_target" for c in model.coefficients], dtype=bool
    )
    frames = model.tip_target
    if target.tip:
        frames = ONE_FRAME
    elif target.labels:
        frames = tuple((label, frame) for label, frame in frames if label in target.labels)
        dropped |= np.array(
            [c.where == "tip_target" and c.station not in target.labels for c in model.coefficients], dtype=bool
        )
    keep = np.flatnonzero(~dropped)
    coefficients = [model.coefficients[k] for k in keep]
    if len(target.labels) == 1:
        frames = ((None, frames[0][1]),)
        coefficients = [_of_one(c) for c in coefficients]
    labels = [label for label, _ in model.tip_target]
    sights = [0] if target.tip else [labels.index(label) for label in target.labels or labels]
    around = replace(model.around, sights=Sights(model.around.sights.targets[sights]))
    arm = replace(
        model, coefficients=tuple(coefficients), tip_target=frames, instruments=Instruments(), states={}, around=around
    )
    return SolvedModel(arm, fit.theta[keep], fit.covariance[np.ix_(keep, keep)])


def _of_one(c: Coefficient) -> Coefficient:
    """A coefficient, without a label where it is of the only target."""
    return replace(c, station=None) if c.where == "tip_target" else c


def _of_target(unobservable: Sequence[OpenCombination], fit: Fit, target: _Target) -> tuple[OpenCombination, ...]:
    """Combinations that no reading tells, without their terms on instruments and on frames that hold no saved target."""
    things = fit.model.instruments.names
    combinations = []
    for part in unobservable:
        terms = [(c, value) for c, value in part if c.where not in things]
        terms = [(c, v) for c, v in terms if c.where != "tip_target" or not target.tip]
        terms = [(c, v) for c, v in terms if c.where != "tip_target" or not target.labels or c.station in target.labels]
        combinations.append(tuple((_of_one(c) if len(target.labels) == 1 else c, v) for c, v in terms))
    return tuple(part for part in combinations if part)
