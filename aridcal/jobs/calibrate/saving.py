"""An outcome as a calibration that predicts and commands: the arm and its target without the instruments, and what was seen."""

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
from aridcal.engine.fit.noise import contradicted
from aridcal.engine.fit.problem import problem
from aridcal.engine.fit.tails import Tails, tails_of
from aridcal.engine.instruments.channels import columns, norms, spread
from aridcal.engine.instruments.kinds import KINDS as INSTRUMENTS
from aridcal.engine.instruments.setup import TIP, Instruments
from aridcal.engine.model.model import ONE_FRAME, Model
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.rows.row_facts import Labels
from aridcal.engine.trust.coverage import holes, largest
from aridcal.engine.trust.rival_predictions import Rival
from aridcal.engine.trust.wander import wanders
from aridcal.engine.trust.workspace import Untold
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.saved_model import SavedModel, SolvedModel


def calibration(outcome: Outcome) -> SavedModel:
    """The whole model, self-contained."""
    m, final = outcome.measurements, outcome.stage("final").fit
    tails = _tails(outcome, final)
    saved = _without_wander(outcome, tails)
    wander = wanders(final, m.select(~outcome.outlier), final.estimated, tails, saved.span)
    return replace(saved, record=saved.record | ({"wander": [asdict(process) for process in wander]} if wander else {}))


def _without_wander(outcome: Outcome, tails: Sequence[Tails | None]) -> SavedModel:
    """The same, but for what it asks of all rows once more, which takes as much memory as all this."""
    campaign, m = outcome.campaign, outcome.measurements
    used = ~m.test & ~outcome.outlier
    final, target = outcome.stage("final").fit, _saved_target(m, outcome.head is not None)
    solved = _solved(final, target)
    most = _largest_std(outcome, solved, target)
    seen = seen_in(outcome)
    record = {
        "campaign": campaign.text,
        "data": {
            "files": [f.name for f in m.origin.files],
            "sha256": m.origin.sha256,
            "rows": len(m),
            "train": int(used.sum()),
        },
        "derived_columns": [name for name in m.origin.derived if name in seen],
        "versions": {"aridcal": __version__, "pinocchio": pin.__version__, "numpy": np.__version__},
    }
    scatter = _scatter(outcome, used, tails)
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
        {name: ends(v) for name, v in seen.items()},
        record,
        {name: found for name, v in seen.items() if (found := holes(v))},
        most,
        () if outcome.certainty is None else _of_target(outcome.certainty.untold, final, target),
        {name: ends(v) for name, v in recorded_in(outcome).items() if name not in seen},
        _rivals(outcome, final, target),
    )


def _largest_std(outcome: Outcome, solved: SolvedModel, target: _Target) -> tuple[float, float]:
    """Largest standard deviations of the target's place [m] and turn [rad] at the fitted rows; infinite of what none measured."""
    m = outcome.measurements
    fitted = m.fitted.select(~outcome.outlier[m.train])
    if target.labels and fitted.labels.target is not None:
        fitted = fitted.select(np.isin(fitted.labels.target, target.labels))
    std = solved.std(fitted.readings, fitted.covariates, *_asked_by(solved.model, fitted.labels))
    if not target.turns:  # that of a target whose rotation was never measured says nothing
        std[:, 3:] = np.inf
    if not target.moves:
        std[:, :3] = np.inf
    return largest(std)


def _rivals(outcome: Outcome, final: Fit, target: _Target) -> tuple[Rival, ...]:
    """What the rows could not tell from the effects, as far as it moves the saved target."""
    tied = () if outcome.diagnosis is None else outcome.diagnosis.tied
    return tuple(
        Rival(one.effect.label, one.instead_of.label, one.weight, change)
        for one in tied
        for change in _of_target((one.change,), final, target)
    )


def seen_in(outcome: Outcome) -> dict[str, np.ndarray]:
    """What predictions depend on, as the fitted rows have it: readings and covariates by name, shape (n,) each."""
    m = outcome.measurements
    used = ~m.test & ~outcome.outlier
    seen = dict(zip(outcome.robot.readings, m.readings[used].T, strict=True))
    return seen | {name: m.covariates[name][used] for name in outcome.stage("final").fit.model.needs}


def recorded_in(outcome: Outcome) -> dict[str, np.ndarray]:
    """Numeric columns of the tables, as the fitted rows have them, by name, shape (n,) each."""
    m = outcome.measurements
    used = ~m.test & ~outcome.outlier
    named = [name for name in m.covariates if name not in m.origin.derived and not is_label(name)]
    return {name: v for name in named if np.isfinite(v := m.covariates[name][used]).any()}


def ends(values: np.ndarray) -> tuple[float, float]:
    """Lowest and highest of some values, shape (N,)."""
    return float(np.nanmin(values)), float(np.nanmax(values))


def _tails(outcome: Outcome, fit: Fit) -> list[Tails | None]:
    """Tails of each channel's noise, outliers among them: chance makes more of what it has made."""
    residual = problem(fit.model, outcome.measurements).scaled_residual(fit.theta)
    left = np.sqrt(max(fit.freedom, LEAST_FREEDOM) / fit.numbers)
    residual /= left  # in place: of many rows a copy counts
    squares = norms(residual, outcome.channels) ** 2
    there = outcome.measurements.measures
    return [
        tails_of(own[seen & np.isfinite(own)], channel.size)
        for channel, own, seen in zip(outcome.channels, squares, there.T, strict=True)
    ]


def _scatter(outcome: Outcome, used: np.ndarray, tails: Sequence[Tails | None]) -> dict[str, dict[str, Any]]:
    """What the fitted rows scatter by about the final model, by channel: the declared noise as long as they agree with it.

    Args:
        outcome: What was found.
        used: Fitted rows, shape (N,) bool.
        tails: Of each channel, if it has any.
    """
    fit, rows = outcome.stage("final").fit, outcome.measurements
    train = rows.fitted
    surprise = contradicted(train, fit.estimated, fit.freedom)
    left = fit.freedom / fit.numbers
    found: dict[str, dict[str, Any]] = {}
    for k, (channel, part) in enumerate(zip(outcome.channels, columns(outcome.channels), strict=True)):
        stated = rows.sigma[k]
        residual = outcome.stage("final").residual[used][:, part]
        residual = residual[~np.isnan(residual)]
        freedom = left * residual.size
        if stated is not None and surprise[k] == 1.0:
            found[channel.name] = {"sigma": float(stated), "freedom": np.inf}
        elif freedom > LEAST_FREEDOM and np.any(residual != 0.0):
            found[channel.name] = {"sigma": float(np.sqrt(np.mean(residual**2) / left)), "freedom": float(freedom)}
        tail = tails[k]
        if tail is not None and channel.name in found:
            found[channel.name]["tails"] = asdict(tail)
    return found


def _of_kinds(m: Dataset, scatter: dict[str, dict[str, Any]]) -> dict[str, dict[str, dict[str, Any]]]:
    """The same by the kinds of blocks, with the names that their channels have in every campaign; of two blocks the coarser."""
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for block in m.blocks:
        of_kind = found.setdefault(block.kind, {})
        for channel, own in zip(INSTRUMENTS[block.kind].channels, block.channels, strict=False):
            if own.name in scatter:
                both = [scatter[own.name], *([of_kind[channel.name]] if channel.name in of_kind else [])]
                of_kind[channel.name] = max(both, key=lambda part: part["sigma"])
    return {kind: channels for kind, channels in found.items() if channels}


@dataclass(frozen=True)
class _Target:
    """What a saved calibration predicts.

    Attributes:
        labels: Of the frames on the tip that it keeps; empty where there is one for all rows.
        turns: False where it is a point, whose own rotation nothing measured.
        moves: False where nothing measured its place.
        tip: True where it is the tip itself: a measuring head's mounting is left out.
    """

    labels: tuple[str, ...]
    turns: bool
    moves: bool
    tip: bool


def _saved_target(m: Dataset, head: bool) -> _Target:
    """The targets that instruments measured; the tip itself where cameras are all there is."""
    if m.direct:
        return _Target((), m.sees_turns, True, head)
    every = () if m.labels.target is None else tuple(sorted(set(m.labels.target.tolist())))

    def kinds(labels: tuple[str, ...]) -> set[str]:
        own = np.ones(len(m), dtype=bool) if m.labels.target is None else np.isin(np.asarray(m.labels.target), labels)
        return {m.blocks[b].kind for b in np.unique(m.labels.block[own])}

    def level_alone(measured: set[str]) -> bool:
        return all(INSTRUMENTS[kind].level for kind in measured)

    # what instruments reach for comes before the tip that cameras see, and a place before an attitude
    placed = tuple(label for label in every if label != TIP and not level_alone(kinds((label,))))
    labels = placed or tuple(label for label in every if label == TIP) or every
    measured = kinds(labels)
    return _Target(
        labels,
        any(INSTRUMENTS[kind].turns for kind in measured),
        not level_alone(measured),
        head,
    )


def _asked_by(model: Model, labels: Labels) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Labels by which a saved model tells its frames apart: of stations, and of several targets."""
    return labels.station, labels.target if len(model.tip_target) > 1 and labels.target is not None else None


def _solved(fit: Fit, target: _Target) -> SolvedModel:
    """A stage's model of the arm and its target: without the instruments, and without frames that hold no target.

    Of one that was measured by a head on the tip without the head's mounting, too: its target is the tip.
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
    others = [model.coefficients[k] for k in keep]
    if len(target.labels) == 1:
        frames = ((None, frames[0][1]),)
        others = [_of_one(c) for c in others]
    labels = [label for label, _ in model.tip_target]
    kept = [0] if target.tip else [labels.index(label) for label in target.labels or labels]
    around = replace(model.around, sights=Sights(model.around.sights.targets[kept]))
    arm = replace(
        model, coefficients=tuple(others), tip_target=frames, instruments=Instruments(), states={}, around=around
    )
    return SolvedModel(arm, fit.theta[keep], fit.covariance[np.ix_(keep, keep)])


def _of_one(c: Coefficient) -> Coefficient:
    """A coefficient of the only target."""
    return replace(c, station=None) if c.where == "tip_target" else c


def _of_target(untold: Sequence[Untold], fit: Fit, target: _Target) -> tuple[Untold, ...]:
    """What no reading told of the saved target: without what is of instruments and of frames that hold no target."""
    things = fit.model.instruments.names
    found = []
    for part in untold:
        own = [(c, value) for c, value in part if c.where not in things]
        own = [(c, v) for c, v in own if c.where != "tip_target" or not target.tip]
        own = [(c, v) for c, v in own if c.where != "tip_target" or not target.labels or c.station in target.labels]
        found.append(tuple((_of_one(c) if len(target.labels) == 1 else c, v) for c, v in own))
    return tuple(part for part in found if part)
