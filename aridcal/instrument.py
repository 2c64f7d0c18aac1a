"""The measuring head's own errors: lens and sonars, found by what the arm and each shot by itself say about them.

A number of the head (a focal length, a sonar's bias) moves every measured pose by a known twist and leaves a known trace
within each shot (:mod:`aridcal.head.reduction`). The first is an effect at the target whose columns come from the shots,
with the arm's own columns taken off; the second knows nothing of the arm. Their normal equations add.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from aridcal.campaign import HEAD_KINDS, EffectDeclaration
from aridcal.catalogue import merged
from aridcal.effects import Coefficient, Effect
from aridcal.errors import CampaignError, nearest
from aridcal.evidence import Score, score
from aridcal.head.reduction import Head, Reduced
from aridcal.residual import linearise, scaled
from aridcal.scoring import ALPHA
from aridcal.search import CLOSE
from aridcal.solver import Data, Fit

LEAST = 1e-2  # share of the squared misfit that an effect must take away to matter
BETTER = 1.0  # nats by which another effect must do better to take an effect's place
SMALL = 1e-6  # share of a column's square that must be left off the others' columns
LENS = (("k1",), ("k1", "k2"), ("k1", "k2", "k3"), ("p1", "p2"))


@dataclass(frozen=True)
class System:
    """Normal equations of the head's numbers, linear about where they are now, written for their distance from the start.

    Attributes:
        information: From arm and shots together, and from the shots alone, shape (2, H, H).
        pull: Likewise, shape (2, H).
        left: Squared misfit at the start, in sigmas, shape (2,).
        count: Numbers measured, shape (2,).
        response: What the arm's coefficients do when a number of the head moves, shape (K, H).
    """

    information: np.ndarray
    pull: np.ndarray
    left: np.ndarray
    count: np.ndarray
    response: np.ndarray

    @property
    def all(self) -> tuple[np.ndarray, ...]:
        """Information, pull, misfit and count: of arm and shots together, then of the shots alone."""
        return self.information, self.pull, self.left, self.count


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
        confounded: For each effect, those that these data cannot tell from it.
        redundant: Names of declared coefficients that cannot be told from others, and from which.
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


def candidates(head: Head, kinds: Sequence[str]) -> list[Effect]:
    """Everything that may be wrong with a head."""
    sonars = [f"sonar_{k + 1}" for k in range(len(head.positions))]
    found = [_effect("lens_distortion", "camera", *names) for names in LENS]
    found += [_effect("focal_length", "camera", *names) for names in (("f",), ("fx", "fy"))]
    found += [_effect("principal_point", "camera", "cx", "cy")]
    if sonars:
        found += [_effect(f"sonar_{what}", where, what) for what in ("bias", "scale") for where in ("sonars", *sonars)]
    return [e for e in found if e.kind in kinds]


def stated(head: Head, declarations: Sequence[EffectDeclaration], place: str) -> list[Effect]:
    """The effects of the head that a campaign declares.

    Raises:
        CampaignError: The head has no such effect.
    """
    known = candidates(head, HEAD_KINDS)
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
            own = [_effect(d.kind, d.where, *d.motion)]
        found.append(own[0])
    return found


def _effect(kind: str, where: str, *components: str) -> Effect:
    return Effect(kind, where, tuple(Coefficient(where, c) for c in components))


def unit(coefficient: Coefficient) -> str:
    """Unit of a coefficient of the head."""
    if coefficient.where == "camera":
        return "px" if coefficient.component[0] in "fc" else "1"
    return "m" if coefficient.component == "bias" else "1"


def directions(head: Head, coefficients: Sequence[Coefficient]) -> np.ndarray:
    """Which of the head's numbers each coefficient moves, shape (H, d)."""
    H = np.zeros((len(head.phi), len(coefficients)))
    for k, c in enumerate(coefficients):
        for row, name in enumerate(head.names):
            where, component = name.split(".")
            same = component == c.component or (c.component == "f" and component in ("fx", "fy"))
            H[row, k] = same and (where == c.where or (c.where == "sonars" and where.startswith("sonar_")))
    return H


def system(fit: Fit, data: Data, reduced: Reduced, moved: np.ndarray) -> System:
    """Set up the normal equations.

    Args:
        fit: The arm's model, fitted to the rows.
        data: N rows.
        reduced: The same rows as shots.
        moved: How far the head's numbers are from their start, shape (H,).
    """
    r, J = linearise(fit.model, fit.theta, data.rows, data.measured)
    weight = np.sqrt(fit.weight)[:, None] / np.repeat([fit.sigma.position, fit.sigma.rotation], 3)
    G = -scaled(reduced.sensitivity, data.measured) * weight[:, :, None]
    A, G = ((J * weight[:, :, None]).reshape(r.size, -1), G.reshape(r.size, -1))
    r = (r * weight).ravel()
    response = -fit.covariance @ (A.T @ G)
    freedom = float(fit.weight.sum()) * 6 - fit.spent
    # What the arm's model lacks, as long as it lacks anything, counts as noise.
    noise = max(float(r @ r) / max(freedom, 1.0), 1.0)
    trust = reduced.trust
    own, own_pull = np.einsum("n,nij->ij", trust, reduced.information), trust @ reduced.pull
    misfit, count = float(trust @ reduced.misfit), float(trust @ reduced.freedom)
    # What the arm cannot take up. At its minimum its own gradient is nil: the residual needs no projection.
    across = G + A @ response
    information = np.array([across.T @ across / noise + own, own])
    pull = np.array([G.T @ r / noise + own_pull, own_pull])
    left = np.array([float(r @ r) / noise + misfit, misfit])
    left = left + 2 * pull @ moved + np.einsum("i,kij,j->k", moved, information, moved)
    return System(information, pull + information @ moved, left, np.array([freedom + count, count]), response)


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
    covariance = _inverse(H.T @ equations.information[0] @ H)
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
        values=covariance @ (H.T @ equations.pull[0]),
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
    M = equations.information[0]
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
                redundant[c.name] = tuple(b.name for b, s in zip(kept, size, strict=True) if s > 0.05 * largest)
        if mine:
            found.append(replace(effect, coefficients=tuple(mine)))
    return found, redundant


def _inverse(M: np.ndarray) -> np.ndarray:
    if len(M) == 0:
        return M
    scale = 1.0 / np.sqrt(np.maximum(np.diag(M), 1e-300))
    return np.asarray(np.linalg.pinv(M * np.outer(scale, scale), hermitian=True, rcond=1e-12) * np.outer(scale, scale))


def _score(equations: System, head: Head, others: Sequence[Effect], effect: Effect, tested: int | None = None) -> Score:
    """What an effect adds to others.

    With the number of candidates ``tested`` it is nothing unless it stands out from arm and shots together, by more than
    matters, and from the shots alone: what an arm lacks can look like many things, but it leaves no trace within a shot.
    """
    E = directions(head, effect.coefficients)
    A = directions(head, [c for e in others for c in e.coefficients])
    found = []
    for M, s, left, count in zip(*equations.all, strict=True):
        back = A @ _inverse(A.T @ M @ A) @ A.T
        left = max(left - float(s @ back @ s), 1e-9)
        own = score(E.T @ (M - M @ back @ M) @ E, E.T @ (s - M @ back @ s), np.diag(E.T @ M @ E), left, count)
        found.append((own, -np.expm1(-2.0 * own.gain / count)))
    (total, share), (alone, _) = found
    if tested is not None and (max(total.p_value, alone.p_value) * tested > ALPHA or share < LEAST):
        return Score(0.0, 1.0, 0)
    return total
