"""An outcome as a calibration that predicts and commands: the arm and its target without the instruments, and what was seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from aridcal import __version__
from aridcal.effects.sights import Sights
from aridcal.fit.least_squares import LEAST_FREEDOM, Fit
from aridcal.fit.noise import contradicted
from aridcal.fit.thing_starts import TIP
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.catalogue import KINDS as INSTRUMENTS
from aridcal.instruments.channels import columns, spread
from aridcal.instruments.setup import Instruments
from aridcal.model.model import ONE_FRAME
from aridcal.result.calibration_file import Ranges
from aridcal.result.outcome import Outcome
from aridcal.result.saved_model import SavedModel, SolvedModel

SAME = 2e-3
"""Share of its range by which values of a quantity may differ and still be one: noise of a reading that is set to levels."""

NEIGHBOURS = 10
"""Steps on either side with which a step from one value to the next is compared: enough for their mean to within a quarter,
and few enough that rows may thin out towards the ends of a range."""

FEWEST = 8
"""Steps on both sides together without which nothing is called a hole: a few levels of a payload have none."""

WIDE = 8.0
"""Mean neighbouring steps that make a hole: of 50 rows drawn evenly one held-out row in 400 falls into such a step, so that six
joints together flag 2 % of them without a reason."""

EDGE = 0.5
"""Mean neighbouring steps beside the last value before a hole that still count as seen."""

SPREAD = 3.0
"""Times the largest standard deviation of a prediction at the fitted rows, beyond which a prediction extrapolates. Between rows
that surround it no function that they fix is that uncertain."""

CHANNELS = (slice(0, 3), slice(3, 6))
"""Position and rotation in the six numbers of a pose."""


def calibration(outcome: Outcome) -> SavedModel:
    """The whole model, self-contained."""
    campaign, m = outcome.campaign, outcome.measurements
    used = ~m.test & ~outcome.outlier
    seen = dict(zip(outcome.robot.readings, m.readings.T, strict=True))
    final = outcome.stage("final").fit
    for name in final.model.needs:
        seen[name] = m.covariates[name]
    record = {
        "campaign": campaign.text,
        "data": {"files": [f.name for f in m.files], "sha256": m.sha256, "rows": len(m), "train": int(used.sum())},
        "derived_columns": [name for name in m.derived if name in seen],
        "versions": {"aridcal": __version__, "pinocchio": pin.__version__, "numpy": np.__version__},
    }
    if not m.blocks:
        record["scatter"] = _scatter(outcome, used)
    target = _saved_target(m, outcome.head is not None)
    if len(target.labels) > 1:
        record["frames_by"] = "target"
    solved = _solved(final, target)
    fitted = m.select(used)
    if target.labels and m.target is not None:
        fitted = fitted.select(np.isin(m.target[used], target.labels))
    std = solved.std(fitted.readings, fitted.covariates, _asked_by(fitted, target))
    if not target.turns:  # that of a target whose rotation was never measured says nothing
        std[:, 3:] = np.inf
    if not target.moves:
        std[:, :3] = np.inf
    if m.blocks:
        position, rotation = outcome.at_target.noise(spread(outcome.noise, outcome.channels))
    else:
        position, rotation = float(outcome.noise[0]), float(outcome.noise[-1])
    return SavedModel(
        _solved(outcome.stage("geometric").fit, target),
        solved,
        "pose" if target.turns else "position",
        campaign.robot.gravity,
        (position, rotation if target.turns else 1.0),
        {name: (float(np.nanmin(v[used])), float(np.nanmax(v[used]))) for name, v in seen.items()},
        record,
        {name: found for name, v in seen.items() if (found := holes(v[used]))},
        largest(std),
    )


def _scatter(outcome: Outcome, used: np.ndarray) -> dict[str, dict[str, float]]:
    """What the fitted rows scatter by about the final model, by channel: the declared noise as long as they agree with it.

    Args:
        outcome: Of rows of one target.
        used: Fitted rows, shape (N,) bool.
    """
    fit, rows = outcome.stage("final").fit, outcome.measurements
    train = rows.select(rows.train)
    surprise = contradicted(train, fit.estimated, fit.freedom)
    left = fit.freedom / fit.numbers
    found = {}
    for k, (channel, part) in enumerate(zip(outcome.channels, columns(outcome.channels), strict=True)):
        stated = rows.sigma[k]
        residual = outcome.stage("final").residual[used][:, part]
        freedom = left * residual.size
        if stated is not None and surprise[k] == 1.0:
            found[channel.name] = {"sigma": float(stated), "freedom": np.inf}
        elif freedom > LEAST_FREEDOM and np.any(residual != 0.0):
            found[channel.name] = {"sigma": float(np.sqrt(np.mean(residual**2) / left)), "freedom": float(freedom)}
    return found


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
    if not m.blocks:
        return _Target((), m.sees_turns, True, head)
    every = () if m.target is None else tuple(sorted(set(m.target.tolist())))

    def kinds(labels: tuple[str, ...]) -> set[str]:
        own = np.ones(len(m), dtype=bool) if m.target is None else np.isin(np.asarray(m.target), labels)
        return {m.blocks[b].kind for b in np.unique(m.block[own])}

    # what instruments reach for comes before the tip that cameras see, and a place before an attitude
    placed = tuple(label for label in every if label != TIP and kinds((label,)) != {"inclination"})
    labels = placed or tuple(label for label in every if label == TIP) or every
    measured = kinds(labels)
    return _Target(labels, any(INSTRUMENTS[kind].turns for kind in measured), measured != {"inclination"}, head)


def _asked_by(rows: Dataset, target: _Target) -> np.ndarray | None:
    """Labels by which a saved model tells its frames apart: of stations, or of several targets."""
    return rows.target if len(target.labels) > 1 else rows.station


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
        others = [replace(c, station=None) if c.where == "tip_target" else c for c in others]
    labels = [label for label, _ in model.tip_target]
    kept = [0] if target.tip else [labels.index(label) for label in target.labels or labels]
    around = replace(model.around, sights=Sights(model.around.sights.targets[kept]))
    arm = replace(
        model, coefficients=tuple(others), tip_target=frames, instruments=Instruments(), states={}, around=around
    )
    return SolvedModel(arm, fit.theta[keep], fit.covariance[np.ix_(keep, keep)])


def holes(values: np.ndarray) -> Ranges:
    """Where nothing was seen inside a range: steps between neighbouring values far wider than those around them.

    The steps around are the measure, not a width in radians: it then fits any quantity, dense or sparse rows, and rows that
    thin out towards the ends.

    Args:
        values: Of one quantity, shape (N,).

    Returns:
        Lowest and highest value of each hole, its edges left out, in rising order.
    """
    values = np.sort(values)
    apart = np.flatnonzero(np.diff(values) > SAME * (values[-1] - values[0]))
    low, high = values[apart], values[apart + 1]
    steps = high - low
    found = []
    for k, step in enumerate(steps):
        around = np.concatenate([steps[max(k - NEIGHBOURS, 0) : k], steps[k + 1 : k + 1 + NEIGHBOURS]])
        if len(around) >= FEWEST and step > WIDE * (usual := float(around.mean())):
            found.append((float(low[k] + EDGE * usual), float(high[k] - EDGE * usual)))
    return tuple(found)


def largest(std: np.ndarray) -> tuple[float, float]:
    """Largest standard deviation of position and rotation, all three axes together, of poses known to (N, 6)."""
    position, rotation = (float(np.linalg.norm(std[:, axes], axis=1).max()) for axes in CHANNELS)
    return position, rotation


def inside(values: np.ndarray, ranges: Ranges) -> np.ndarray:
    """True where a value, shape (N,), lies strictly inside one of some ranges."""
    within = [(values > low) & (values < high) for low, high in ranges]
    return np.any(within, axis=0) if within else np.zeros(len(values), dtype=bool)
