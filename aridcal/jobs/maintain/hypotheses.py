r"""What may have moved on a calibrated robot: each suspect is a small prior on some coefficients of the model.

A suspect h is a set of directions :math:`D_h` (K, d) in the space of the coefficients: the change of these is
:math:`D_h a` with :math:`a \sim N(0, s^2 I)`, its size s unknown. The zero of a joint has one direction, a frame six.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from aridcal.engine.corrections.effect import ANGULAR, FRAME_COMPONENTS, Coefficient
from aridcal.engine.instruments.setup import TIP
from aridcal.engine.model.model import LabelledFrames, Model
from aridcal.engine.rows.dataset import Dataset
from aridcal.engine.trust.wander import zero_of
from aridcal.jobs.calibrate.saved_model import SolvedModel

CHANGE_SIZES = tuple((10.0 ** np.arange(-5.0, 1.01, 0.5)).tolist())
"""[m] and [rad] by which a zero or a frame may have moved, each as likely: from what no instrument sees to a motor or a tracker
that was set up anew anywhere; steps of three lose 0.1 of the logarithm of the evidence."""

EFFECT_RATIOS = tuple((10.0 ** np.arange(-1.5, 1.51, 0.5)).tolist())
"""Times its own size by which an effect may have changed: from a thirtieth to thirty times."""

FORMS_WITHOUT_CHANGE = ("ones", "step")
"""Forms that are no effect of the robot as it is now: constants, and what happened once."""


@dataclass(frozen=True)
class Hypothesis:
    """A hypothesis: something of the robot that may have moved.

    Attributes:
        kind: ``zero``, ``frame`` or ``effect``.
        where: The joint or frame.
        words: Its name in sentences.
        directions: Of a change of size 1, in coefficients of the wide model, shape (K, d).
        sizes: That the change may have.
        turns: True of the zero of a joint that turns: it may be anywhere around.
    """

    kind: str
    where: str
    words: str
    directions: np.ndarray
    sizes: tuple[float, ...]
    turns: bool = False

    @property
    def touched(self) -> np.ndarray:
        """Indices of the coefficients that a change moves."""
        return np.flatnonzero(np.any(self.directions != 0.0, axis=1))


def widened(solved: SolvedModel) -> SolvedModel:
    """A solved model with every coefficient that a suspect may need: those that it lacked are 0, with no variance."""
    model = solved.model
    needed = [*map(zero_of, model.robot.joints), *_of_frames(model)]
    missing = [c for c in dict.fromkeys(needed) if c not in model.coefficients]
    count = len(model.coefficients)
    covariance = np.zeros((count + len(missing), count + len(missing)))
    covariance[:count, :count] = solved.covariance
    theta = np.concatenate([solved.theta, np.zeros(len(missing))])
    return SolvedModel(model.with_coefficients((*model.coefficients, *missing)), theta, covariance)


def suspects(wide: SolvedModel, rows: Dataset, new: Collection[tuple[str, str | None]] = ()) -> tuple[Hypothesis, ...]:
    """All suspects: zeros of joints, frames, effects.

    Args:
        wide: See :func:`widened`.
        rows: N rows; of frames that are per station or target only those of these rows are suspects.
        new: Frames, by where they are and their label, that are not those of the calibration.
    """
    model = wide.model
    number = {c: k for k, c in enumerate(model.coefficients)}

    def along(coefficients: Sequence[Coefficient]) -> np.ndarray:
        directions = np.zeros((len(number), len(coefficients)))
        directions[[number[c] for c in coefficients], range(len(coefficients))] = 1.0
        return directions

    candidates = [
        Hypothesis(
            "zero",
            joint.name,
            f"the zero of {model.robot.place_in_words(joint.name)}",
            along([zero_of(joint)]),
            CHANGE_SIZES,
            joint.kind != "prismatic",
        )
        for joint in model.robot.joints
    ]
    stations = set() if rows.labels.station is None else set(rows.labels.station.tolist())
    targets = stations if rows.labels.target is None else set(rows.labels.target.tolist()) - {TIP}
    for where, frames, noun in (
        ("world_base", model.world_base, "the base (or the instrument)"),
        ("tip_target", model.tip_target, "the tool (or the target on it)"),
    ):
        labels_of_rows = stations if where == "world_base" else targets
        of_rows = [label for label, _ in frames if label is None or label in labels_of_rows]
        for label in [label for label in of_rows if (where, label) not in new]:
            coefficients = [
                Coefficient(where, c, station=label)
                for c in FRAME_COMPONENTS
                if rows.sees_turns or where == "world_base" or c not in ANGULAR
            ]
            name = where if label is None else f"{where}[{label}]"
            at = "station" if rows.labels.target is None or where == "world_base" else "target"
            words = (
                noun if label is None else f"{noun} at station {label}" if at == "station" else f"the target {label}"
            )
            candidates.append(Hypothesis("frame", name, words, along(coefficients), CHANGE_SIZES))
    return (*candidates, *_effects(wide))


def _effects(wide: SolvedModel) -> Iterator[Hypothesis]:
    """Each effect of the model: coefficients at one place that depend on the same covariates.

    Each coefficient may change by itself, but a map only as a whole: samples that change one by one fit what is no part of it.
    """
    for (where, of, smooth), indices in effect_groups(wide.model.coefficients).items():
        values = wide.theta[indices]
        size = float(np.sqrt(np.mean(values**2)))
        if size > 0.0:
            directions = np.zeros((len(wide.theta), 1 if smooth else len(indices)))
            directions[indices] = values[:, None] if smooth else size * np.eye(len(indices))
            words = effect_in_words(wide.model.robot.place_in_words(where), of)
            yield Hypothesis("effect", where, words, directions, EFFECT_RATIOS)


def effect_groups(coefficients: Sequence[Coefficient]) -> dict[tuple[str, tuple[str, ...], bool], list[int]]:
    """Indices of the coefficients of each effect, by where it is, what it depends on, and whether that is a smooth function."""
    groups: dict[tuple[str, tuple[str, ...], bool], list[int]] = {}
    for k, c in enumerate(coefficients):
        if not c.basis.constant and c.basis.form not in FORMS_WITHOUT_CHANGE:
            groups.setdefault((c.where, c.basis.of, c.basis.smooth), []).append(k)
    return groups


def effect_in_words(where: str, of: Sequence[str]) -> str:
    """The name of an effect whose kind is not in the calibration."""
    return f"the effect at {where} that depends on {' and '.join(of)}"


def _of_frames(model: Model) -> Iterator[Coefficient]:
    frames: tuple[tuple[str, LabelledFrames], ...] = (
        ("world_base", model.world_base),
        ("tip_target", model.tip_target),
    )
    for where, placements in frames:
        for label, _ in placements:
            yield from (Coefficient(where, component, station=label) for component in FRAME_COMPONENTS)
