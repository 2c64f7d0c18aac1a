r"""Which constants and effects changed: the fewest that explain how the poses of two calibrations differ.

What differs is :math:`z \sim N(0, 1)` where nothing changed (:mod:`aridcal.jobs.history.difference`), and the change of a
coefficient adds :math:`x\,a` to it. Candidates are the zeros of the joints, each constant, and each effect as a whole. The
one that takes most off the squares of z enters, as in forward selection, until what is left is what the uncertainty explains:

.. math:: a = (X^T X)^{-1} X^T z, \qquad \operatorname{cov} a = (X^T X)^{-1}, \qquad
          p = K P\big(F(m, \nu) > (|z|^2 - |z - X a|^2) / m\big)

with m numbers of a candidate and K candidates (Bonferroni 1936). X holds the covariance of all coefficients of both calibrations,
so that a change is judged by what is left of it when all that is uncertain took its share, and not by its own sigma alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import fdtrc

from aridcal.engine.fit.normal_equations import across
from aridcal.jobs.history.difference import Difference
from aridcal.jobs.maintain.bounds import FALSE_ALARMS
from aridcal.jobs.maintain.hypotheses import effect_groups, effect_in_words

MOST_CHANGES = 8
"""Most causes that are named: with more, it is no longer a change of this robot."""

ALIKE_SQUARES = 6.0
"""Squares by which two candidates may differ to be told apart: odds of 20 to 1."""

ONE_MOTION_SHARE = 1e-4
"""Share of its squares that two columns may differ by to be one motion: second-order terms of constants off by a centimetre."""

NEAR_MOTION_SHARE = 0.01
"""Share of its squares that a column may differ by from a zero's to be called by that name: it is the same joint's own axis."""

VISIBLE_SHARE = 1e-5
"""Share of a column's squares that must be left when motions of base and target took theirs: second-order terms leave less."""

EFFECT_RANK_SHARE = 1e-4
"""Share of the largest singular value below which columns of one effect make one another up, likewise."""


@dataclass(frozen=True)
class NamedChange:
    """Something that changed.

    Attributes:
        words: Its name.
        names: Of its m coefficients.
        units: Of each coefficient.
        before: Values in the first calibration; 0 where it has none.
        value: Change of each coefficient, shape (m,).
        std: Uncertainty of the change by both calibrations, shape (m,).
        p_value: Chance of as much where nothing changed, for all candidates together.
        alike: Other candidates that would explain as much.
        sureness: Squares that the cause takes off; causes are in this order.
    """

    words: str
    names: tuple[str, ...]
    units: tuple[str, ...]
    before: tuple[float, ...]
    value: np.ndarray
    std: np.ndarray
    p_value: float
    alike: tuple[str, ...]
    sureness: float


@dataclass(frozen=True)
class Causes:
    """What changed between two calibrations.

    Attributes:
        changes: The causes, the surest first.
        rest: Chance of what the causes leave, where nothing else changed.
    """

    changes: tuple[NamedChange, ...]
    rest: float


@dataclass(frozen=True)
class _Candidate:
    """Something that may have changed: indices of its columns in the difference, and its columns of z, shape (r, m)."""

    words: str
    own: tuple[int, ...]
    X: np.ndarray
    zero: bool = False


def causes(of: Difference, moved: Mapping[str, float] | None = None) -> Causes:
    """Name what changed; nothing where the difference is what the uncertainty explains.

    Args:
        of: Two calibrations.
        moved: Coefficients that were moved in the first one before they were compared, by name, and by how much: they are among
            the causes.
    """
    moved = moved or {}
    candidates = list(_candidates(of))
    chosen = [c for c in candidates if moved and all(of.columns[k].coefficient.name in moved for k in c.own)]
    alike: dict[str, tuple[str, ...]] = {}
    residual = _residual(of.z, chosen)
    while of.p_of(float(residual @ residual), len(of.z) - _width(chosen)) < FALSE_ALARMS and len(chosen) < MOST_CHANGES:
        others = [c for c in candidates if c not in chosen]
        gains = [_gain(c, chosen, residual) for c in others]
        chances = [_log_p(of, gain, c.X.shape[1]) for gain, c in zip(gains, others, strict=True)]
        if not others or min(chances) + np.log(len(candidates)) > np.log(FALSE_ALARMS):
            break
        best = int(np.argmin(chances))
        alike_best = [k for k, gain in enumerate(gains) if gain > gains[best] - ALIKE_SQUARES]
        best = next((k for k in alike_best if others[k].zero), best)  # what moves most often: a zero
        alike[others[best].words] = tuple(
            others[k].words for k in alike_best if not _one_motion(others[k], others[best])
        )
        chosen.append(others[best])
        residual = _residual(of.z, chosen)
    while chosen:
        causes_found = [
            _cause(of, chosen, k, len(candidates), alike.get(c.words, ()), moved) for k, c in enumerate(chosen)
        ]
        insignificant = [c for c, cause in zip(chosen, causes_found, strict=True) if cause.p_value > FALSE_ALARMS]
        if not insignificant:
            break
        chosen.remove(insignificant[-1])
    if not chosen:
        causes_found = []
    residual = _residual(of.z, chosen)
    causes_found.sort(key=lambda cause: -cause.sureness)
    return Causes(tuple(causes_found), of.p_of(float(residual @ residual), len(of.z) - _width(chosen)))


def unobservable_zeros(of: Difference) -> tuple[str, ...]:
    """Joints, with their limbs, of which a zero that moved looks like a base or a tool that was set up anew."""
    residual = across(of.free, np.column_stack([column.moves for column in of.columns]))
    return tuple(
        of.robot.place_in_words(column.coefficient.where)
        for column, motion in zip(of.columns, residual.T, strict=True)
        if column.coefficient.basis.form == "ones"
        and not motion @ motion > VISIBLE_SHARE * float(column.moves @ column.moves)
    )


def _width(chosen: list[_Candidate]) -> int:
    return sum(c.X.shape[1] for c in chosen)


def _candidates(of: Difference) -> Iterator[_Candidate]:
    """Zeros first, then constants, then effects; of several that are one motion the first, and none that cannot be told."""
    coefficients = [column.coefficient for column in of.columns]
    moves = np.column_stack([column.moves for column in of.columns])
    distinct = across(of.free, moves)
    visible = np.sum(distinct**2, axis=0) > VISIBLE_SHARE * np.sum(moves**2, axis=0)
    X = of.whitened(distinct)
    zeros = [k for k, c in enumerate(coefficients) if c.basis.form == "ones"]
    constants = [k for k, c in enumerate(coefficients) if c.basis.constant]
    motions: list[np.ndarray] = []
    for k in (*zeros, *constants):
        length = float(np.linalg.norm(X[:, k]))
        if not visible[k] or length == 0.0:
            continue
        way = X[:, k] / length
        if all(1.0 - float(way @ other) ** 2 > ONE_MOTION_SHARE for other in motions):
            motions.append(way)
            c = coefficients[k]
            zero = c.basis.form == "ones"
            place = of.robot.place_in_words(c.where)
            words = f"the zero of {place}" if zero else place.replace(c.where, c.name, 1)
            yield _Candidate(words, (k,), X[:, [k]], zero)
    for (where, on, _), of_effect in effect_groups(coefficients).items():
        tellable = [k for k in of_effect if visible[k] and np.any(X[:, k] != 0.0)]
        if tellable:
            words = effect_in_words(of.robot.place_in_words(where), on)
            yield _Candidate(words, tuple(tellable), _independent(X[:, tellable]))


def _one_motion(a: _Candidate, b: _Candidate) -> bool:
    """True of one candidate twice, and of two that no row tells apart as long as changes are small."""
    if a.words == b.words:
        return True
    if a.X.shape[1] != 1 or b.X.shape[1] != 1:
        return False
    x, y = a.X[:, 0], b.X[:, 0]
    return float(x @ y) ** 2 > (1.0 - NEAR_MOTION_SHARE) * float(x @ x) * float(y @ y)


def _independent(X: np.ndarray) -> np.ndarray:
    """Independent columns that span what X (r, m) spans."""
    U, S, _ = np.linalg.svd(X, full_matrices=False)
    significant = EFFECT_RANK_SHARE * S[0] < S
    return np.asarray(U[:, significant] * S[significant])


def _stack(chosen: list[_Candidate]) -> np.ndarray:
    return np.hstack([c.X for c in chosen])


def _residual(z: np.ndarray, chosen: list[_Candidate]) -> np.ndarray:
    """Z (r,) less what candidates explain of it."""
    if not chosen:
        return z
    return across(_stack(chosen), z[:, None])[:, 0]


def _gain(candidate: _Candidate, chosen: list[_Candidate], residual: np.ndarray) -> float:
    """Squares that one more candidate takes off the residual of the chosen ones."""
    X = across(_stack(chosen), candidate.X) if chosen else candidate.X
    after = across(X, residual[:, None])[:, 0]
    return float(residual @ residual - after @ after)


def _log_p(of: Difference, squares: float, count: int) -> float:
    """Logarithm of the chance of a gain; -inf where that is below any float."""
    with np.errstate(divide="ignore"):
        return float(np.log(fdtrc(count, min(of.freedom, 1e9), max(squares, 0.0) / count)))


def _cause(
    of: Difference,
    chosen: list[_Candidate],
    k: int,
    tests: int,
    alike: tuple[str, ...],
    moved: Mapping[str, float],
) -> NamedChange:
    """The k-th of several chosen changes, fitted beside the others."""
    candidate = chosen[k]
    others = [c for c in chosen if c is not candidate]
    z = _residual(of.z, others)
    columns = [of.columns[i] for i in candidate.own]
    before = np.array([moved.get(column.coefficient.name, 0.0) for column in columns])
    X = of.whitened(across(of.free, np.column_stack([column.moves for column in columns])))
    if others:
        X = across(_stack(others), X)
    # coefficients of an effect may replace one another: of all changes that fit the shortest
    inverse = np.linalg.pinv(X, rcond=EFFECT_RANK_SHARE)
    z = z + X @ before  # what was moved already, is a change, too
    gain = _gain(candidate, others, z)
    before_values = [0.0 if np.isnan(column.values[0]) else column.values[0] for column in columns]
    return NamedChange(
        words=candidate.words,
        names=tuple(column.coefficient.name for column in columns),
        units=tuple(column.unit for column in columns),
        before=tuple((before_values - before).tolist()),
        value=inverse @ z,
        std=np.sqrt(np.sum(inverse**2, axis=1)),
        p_value=min(1.0, tests * float(np.exp(_log_p(of, gain, candidate.X.shape[1])))),
        alike=alike,
        sureness=gain,
    )
