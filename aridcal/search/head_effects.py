"""The measuring head's own errors: lens and sonars, found by what the arm and each shot by itself say about them.

A number of the head (a focal length, a sonar's bias) moves every measured pose by a known twist and leaves a known trace
within each shot (:mod:`aridcal.head.reduction`). The first is an effect at the target whose columns come from the shots,
with the arm's own columns taken off; the second knows nothing of the arm. Their normal equations add.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.effects.catalogue import KINDS, head_candidates, merged
from aridcal.effects.effect import Coefficient, Effect
from aridcal.effects.head_kinds import head_effect, moves
from aridcal.errors import CampaignError, nearest
from aridcal.fit.least_squares import Fit
from aridcal.fit.normal_equations import RANK, NormalEquations, balanced
from aridcal.fit.problem import problem, scaled
from aridcal.head.reduction import Head, Reduced
from aridcal.inputs.campaign import EffectDeclaration
from aridcal.inputs.dataset import Dataset
from aridcal.instruments.channels import spread
from aridcal.search.evidence import Score, score
from aridcal.search.scoring import ALPHA
from aridcal.search.stepwise import CLOSE

LEAST = 1e-2
"""Share of the squared misfit that an effect must take away to matter, as for the arm's."""

BETTER = 1.0
"""[nat] by which another effect must do better to take an effect's place."""

SMALL = 1e-6
"""Share of a column's square that must be left off the others' columns: below it is rounding."""

PARTNER = 0.05
"""Share of the largest part in a sum of columns that makes a coefficient worth naming as a partner."""


@dataclass(frozen=True)
class System:
    """Normal equations of the head's numbers, linear about where they are now, written for their distance from the start.

    Attributes:
        together: From arm and shots, H unknowns, one channel in units of sigma.
        alone: From the shots alone.
        response: What the arm's coefficients do when a number of the head moves, shape (K, H).
    """

    together: NormalEquations
    alone: NormalEquations
    response: np.ndarray

    @property
    def information(self) -> np.ndarray:
        """Of arm and shots, shape (H, H)."""
        return self.together.AA[0]


@dataclass(frozen=True)
class Choice:
    """Effects of the head that were taken.

    Attributes:
        effects: Declared and found, each once.
        declared: Which of them the campaign states.
        values: Of their coefficients, one effect after the other, shape (d,).
        covariance: Of those, shape (d, d).
        directions: Which of the head's numbers each coefficient moves, shape (H, d).
        p_values: Of each effect, after correction for the number of candidates.
        confounded: For each effect, those that are confounded with it in these data.
        redundant: Names of declared coefficients that are confounded with others, and with which.
        tested: Number of candidates.
    """

    effects: tuple[Effect, ...]
    declared: tuple[bool, ...]
    values: np.ndarray
    covariance: np.ndarray
    directions: np.ndarray
    p_values: tuple[float, ...]
    confounded: tuple[tuple[Effect, ...], ...]
    redundant: dict[str, tuple[str, ...]]
    tested: int

    @property
    def step(self) -> np.ndarray:
        """What the effects add to the head's numbers, shape (H,)."""
        return np.asarray(self.directions @ self.values)

    @property
    def coefficients(self) -> tuple[Coefficient, ...]:
        """Of all effects, in their order."""
        return tuple(c for e in self.effects for c in e.coefficients)

    def of(self, effect: Effect) -> np.ndarray:
        """Which of the coefficients are an effect's, shape (d,) bool."""
        return np.array([c in effect.coefficients for c in self.coefficients], dtype=bool)


def candidates(head: Head, kinds: Iterable[str]) -> list[Effect]:
    """Everything that may be wrong with a head."""
    return head_candidates(head.names, kinds)


def stated(head: Head, declarations: Sequence[EffectDeclaration], place: str) -> list[Effect]:
    """The effects of the head that a campaign declares.

    Raises:
        CampaignError: The head has no such effect.
    """
    known = candidates(head, KINDS)
    found = []
    for d in declarations:
        own = [e for e in known if e.kind == d.kind and e.where == d.where]
        if not own:
            there = sorted({e.where for e in known if e.kind == d.kind})
            raise CampaignError(f"{place}: effects: {d.kind} has no place {d.where!r}{nearest(d.where, there)}")
        if d.motion is not None:
            names = dict.fromkeys(c.component for e in own for c in e.coefficients)
            for component in d.motion:
                if component not in names:
                    raise CampaignError(
                        f"{place}: effects: {d.kind} at {d.where} has no {component!r}{nearest(component, names)}"
                    )
            own = [head_effect(d.kind, d.where, *d.motion)]
        found.append(own[0])
    return found


def directions(head: Head, coefficients: Sequence[Coefficient]) -> np.ndarray:
    """Which of the head's numbers each coefficient moves, shape (H, d)."""
    moved = [[moves(c, number) for c in coefficients] for number in head.names]
    return np.array(moved, dtype=float).reshape(len(head.phi), len(coefficients))


def system(fit: Fit, rows: Dataset, reduced: Reduced, moved: np.ndarray) -> System:
    r"""Set up the normal equations.

    With A the columns of the arm and G those of the head's numbers, the arm follows a number by
    :math:`-(A^T A)^{-1} A^T G`: what it cannot take up is :math:`G + A\,response`.

    Args:
        fit: The arm's model, fitted to the rows.
        rows: N rows.
        reduced: The same rows as shots.
        moved: How far the head's numbers are from their start, shape (H,).
    """
    r, J = problem(fit.model, rows).linearised(fit.theta)
    weight = np.sqrt(fit.weight)[:, None] / spread(fit.sigma, rows.channels)
    A = (J * weight[:, :, None]).reshape(r.size, -1)
    G = (-scaled(reduced.sensitivity, rows.relative) * weight[:, :, None]).reshape(r.size, -1)
    r = (r * weight).ravel()
    response = -fit.covariance @ (A.T @ G)
    freedom = float(fit.weight.sum()) * len(weight[0]) - fit.spent
    # What the arm's model lacks, as long as it lacks anything, counts as noise.
    noise = max(float(r @ r) / max(freedom, 1.0), 1.0)
    trust = reduced.trust
    own = NormalEquations(
        AA=np.einsum("n,nij->ij", trust, reduced.information)[None],
        Ar=(trust @ reduced.pull)[None],
        rr=np.array([float(trust @ reduced.misfit)]),
        count=np.array([float(trust @ reduced.freedom)]),
    )
    across = G + A @ response
    # At its minimum the arm's own gradient is nil: the residual needs no projection.
    both = NormalEquations(
        AA=(across.T @ across / noise + own.AA[0])[None],
        Ar=(G.T @ r / noise + own.Ar[0])[None],
        rr=float(r @ r) / noise + own.rr,
        count=freedom + own.count,
    )
    return System(_from_start(both, moved), _from_start(own, moved), response)


def _from_start(here: NormalEquations, moved: np.ndarray) -> NormalEquations:
    """Equations for steps from here, written for distances from a start that lies ``moved`` behind, shape (H,)."""
    M, s = here.AA[0], here.Ar[0]
    rr = here.rr + 2 * s @ moved + moved @ M @ moved
    return NormalEquations(here.AA, (s + M @ moved)[None], rr, here.count)


def choose(equations: System, head: Head, declared: Sequence[Effect], library: Sequence[Effect]) -> Choice:
    """Take the declared effects and those that the shots ask for; one at a time, each tried again when another came in."""
    fixed, redundant = _independent(equations, head, declared)
    taken: list[Effect] = []
    tested = len(library)

    def ranked(others: Sequence[Effect]) -> list[tuple[float, Effect]]:
        """What could be added to the declared effects and some others, the best first."""
        scores = [(_score(equations, head, (*fixed, *others), e, tested), e) for e in library]
        return sorted(((s.gain, e) for s, e in scores if s.gain > 0), key=lambda pair: -pair[0])

    for _ in range(2 * tested):
        best = next(iter(ranked(taken)), None)
        if best is None:
            break
        taken.append(best[1])
        for e in list(taken):
            others = [t for t in taken if t is not e]
            again = ranked(others)
            mine = next((gain for gain, other in again if other == e), 0.0)
            if not again:
                taken = others
            elif again[0][0] > mine + BETTER and again[0][1] not in others:
                taken = [*others, again[0][1]]
    effects, _ = _independent(equations, head, _merged([*fixed, *taken]))
    H = directions(head, [c for e in effects for c in e.coefficients])
    covariance = _inverse(H.T @ equations.information @ H)
    there = {(e.kind, e.where) for e in effects}
    p_values, confounded = [], []
    for e in effects:
        others = [o for o in effects if o is not e]
        own = _score(equations, head, others, e)
        rivals = [t for t in library if (t.kind, t.where) not in there]
        close = [t for t in rivals if _score(equations, head, others, t).gain > own.gain - CLOSE]
        p_values.append(min(1.0, own.p_value * max(tested, 1)))
        confounded.append(tuple(_merged(close)))
    return Choice(
        effects=tuple(effects),
        declared=tuple((e.kind, e.where) in {(f.kind, f.where) for f in fixed} for e in effects),
        values=covariance @ (H.T @ equations.together.Ar[0]),
        covariance=covariance,
        directions=H,
        p_values=tuple(p_values),
        confounded=tuple(confounded),
        redundant=redundant,
        tested=tested,
    )


def _merged(effects: Sequence[Effect]) -> list[Effect]:
    groups: dict[tuple[str, str], list[Effect]] = {}
    for e in effects:
        groups.setdefault((e.kind, e.where), []).append(e)
    return [merged(group) for group in groups.values()]


def _independent(
    equations: System, head: Head, effects: Sequence[Effect]
) -> tuple[list[Effect], dict[str, tuple[str, ...]]]:
    """Effects without the coefficients that are sums of those before them; those, and what they are sums of."""
    M = equations.information
    kept: list[Coefficient] = []
    found: list[Effect] = []
    redundant: dict[str, tuple[str, ...]] = {}
    for effect in effects:
        mine = []
        for c in effect.coefficients:
            A, e = directions(head, kept), directions(head, [c])[:, 0]
            own, gram = float(e @ M @ e), A.T @ M @ A
            share = _inverse(gram) @ (A.T @ M @ e)
            if own - float(share @ (A.T @ M @ e)) > SMALL * own:
                mine.append(c)
                kept.append(c)
            else:
                size = np.abs(share) * np.sqrt(np.maximum(np.diag(gram), 0.0))
                largest = max(size, default=0.0)
                redundant[c.name] = tuple(b.name for b, s in zip(kept, size, strict=True) if s > PARTNER * largest)
        if mine:
            found.append(replace(effect, coefficients=tuple(mine)))
    return found, redundant


def _inverse(M: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of equations brought to unit diagonal: combinations of numbers may be redundant here."""
    if len(M) == 0:
        return M
    S, scale = balanced(M)
    return np.asarray(np.linalg.pinv(S, hermitian=True, rcond=RANK) * np.outer(scale, scale))


def _score(equations: System, head: Head, others: Sequence[Effect], effect: Effect, tested: int | None = None) -> Score:
    """What an effect adds to others.

    With the number of candidates ``tested`` it is nothing unless it stands out from arm and shots together, by more than
    matters, and from the shots alone: what an arm lacks can look like many things, but it leaves no trace within a shot.
    """
    E = directions(head, effect.coefficients)
    A = directions(head, [c for e in others for c in e.coefficients])
    found = []
    for equations_of in (equations.together, equations.alone):
        M, s, left = _off(equations_of, A)
        count = float(equations_of.count[0])
        own = score(E.T @ M @ E, E.T @ s, np.diag(E.T @ equations_of.AA[0] @ E), left, count)
        share = -np.expm1(-2.0 * own.gain / count)
        found.append((own, share))
    (total, share), (alone, _) = found
    if tested is not None and (max(total.p_value, alone.p_value) * tested > ALPHA or share < LEAST):
        return Score(0.0, 1.0, 0)
    return total


def _off(equations: NormalEquations, A: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Information (H, H), pull (H,) and squares left when combinations A of the numbers, shape (H, d), are solved for."""
    M, s = equations.AA[0], equations.Ar[0]
    back = A @ _inverse(A.T @ M @ A) @ A.T
    left = max(float(equations.rr[0]) - float(s @ back @ s), 1e-9)
    return M - M @ back @ M, s - M @ back @ s, left
