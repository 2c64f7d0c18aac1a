"""A second look at a calibration, from its own rows: halves, folds, single rows, and what they tell of the constants."""

from __future__ import annotations

from dataclasses import dataclass

from aridcal.engine.fit.least_squares import Fit
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.combinations import Identifiability, identifiability
from aridcal.engine.trust.cross_validation import Folds, Influence, folds, influence, rows_of
from aridcal.engine.trust.halves import Halves, halves
from aridcal.system.progress import SILENT, Progress


@dataclass(frozen=True)
class SecondLook:
    """What parts of its rows say of a calibration; None where there are too few rows.

    Attributes:
        halves: Halves of the geometric and of the final model, by stage; of the final alone where both models are the same.
        folds: Errors of the final model on folds that were left out.
        influence: How the final model changes without each row.
        identifiability: What the rows tell of the arm's constants.
    """

    halves: dict[str, Halves | None]
    folds: Folds | None
    influence: Influence | None
    identifiability: Identifiability | None


def second_look(geometric: Fit, final: Fit, train: Dataset, progress: Progress = SILENT) -> SecondLook:
    """Look at a calibration once more.

    Args:
        geometric: Frames and constants.
        final: The whole model, with the covariance of the weights that it was fitted with.
        train: The rows that both were fitted to.
        progress: Told how far each pass over them is.
    """
    stages = {"geometric": geometric} if geometric.model.names != final.model.names else {}
    rows = rows_of(final, train, progress)
    return SecondLook(
        halves={name: halves(fit, train, progress) for name, fit in (stages | {"final": final}).items()},
        folds=folds(final, train, rows),
        influence=influence(final, rows),
        identifiability=identifiability(geometric, train, progress),
    )
