r"""Things solved for beside the rest of the model: thousands of points or markers cost what they must, and no more.

Rows of one thing (or of several that ties join: a *group* g) have columns B by what is unknown of it, and columns J by the K
coefficients of the model. For weights w and noise :math:`\sigma_c` of channel c,

.. math:: H_g = \sum_c B_c^T B_c / \sigma_c^2 + T_g, \qquad C_g = \sum_c B_c^T J_c / \sigma_c^2, \qquad
          b_g = \sum_c B_c^T r_c / \sigma_c^2 + t_g

with T and t from prior knowledge of the group. Its unknowns follow any step of the coefficients,

.. math:: \lambda_g = H_g^{-1} (b_g - C_g \theta) = y_g - X_g \theta

and what they do not take up are the columns J - B X and the residuals r - B y: the Schur complement of the joint normal
equations, and the variable projection of Golub and Pereyra (1973, doi:10.1137/0710036) in Kaufman's form.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components

from aridcal.engine.fit.normal_equations import NormalEquations, directions
from aridcal.engine.instruments.channels import Channels, columns
from aridcal.engine.instruments.setup import Instruments, Tie
from aridcal.engine.model.predictions import Observations, ThingStates
from aridcal.engine.numerics import TINY

TIE_STEP = 1e-6
"""Work: Change [m] or [rad] over which ties are differentiated: rounding and curvature are then alike, 1e-10."""


@dataclass(frozen=True)
class Groups:
    """Which unknowns of things are solved for together: G groups of U unknowns at the most.

    Attributes:
        row: Group of each row, shape (N,); -1 for none.
        role: Number of the role of the row's thing, shape (N,); -1 for none.
        thing: Number of that thing, shape (N,).
        roles: Names of the roles.
        group: Group of each thing, shape (L,) by role; -1 where nothing of it is unknown.
        slot: Which of its group's unknowns each component of a thing is, shape (L, u) by role; -1 where it is known.
        unknown: Which of the U unknowns each group has, shape (G, U) bool.
    """

    row: np.ndarray
    role: np.ndarray
    thing: np.ndarray
    roles: tuple[str, ...]
    group: Mapping[str, np.ndarray]
    slot: Mapping[str, np.ndarray]
    unknown: np.ndarray

    def select(self, rows: np.ndarray) -> Groups:
        """The groups with some of the rows alone."""
        return replace(self, row=self.row[rows], role=self.role[rows], thing=self.thing[rows])

    def columns(self, by_thing: np.ndarray, rows: slice | np.ndarray) -> np.ndarray:
        """Columns of the groups' unknowns, shape (n, m, U), from those of the rows' own things, shape (n, m, u)."""
        B = np.zeros((*by_thing.shape[:2], self.unknown.shape[1]))
        role, thing = self.role[rows], self.thing[rows]
        for number, name in enumerate(self.roles):
            members = np.flatnonzero(role == number)
            if name not in self.slot or not len(members):
                continue
            slots = self.slot[name][thing[members]]
            for component in range(slots.shape[1]):
                fixed = slots[:, component] < 0
                rows_here = members[~fixed]
                B[rows_here, :, slots[~fixed, component]] = by_thing[rows_here, :, component]
        return B


@dataclass(frozen=True)
class PriorRows:
    """Prior knowledge of groups as T rows of unit noise: ties, and places with a declared uncertainty.

    Attributes:
        group: Group of each row, shape (T,).
        by: Columns of the group's unknowns, shape (T, U).
        misfit: Declared minus present value, in sigmas, shape (T,).
    """

    group: np.ndarray
    by: np.ndarray
    misfit: np.ndarray


@dataclass
class Sums:
    """Sums over the rows of groups while these pass, for unit noise; C channels.

    Attributes:
        BB: B'B, shape (C, G, U, U).
        BJ: B'J, shape (C, G, U, K).
        Br: B'r, shape (C, G, U).
    """

    BB: np.ndarray
    BJ: np.ndarray
    Br: np.ndarray

    def add(self, group: np.ndarray, B: np.ndarray, J: np.ndarray, r: np.ndarray, channels: Channels) -> None:
        """Add rows of groups (n,), columns (n, m, U) and (n, m, K) and residuals (n, m), all times the root of their weight."""
        members = np.flatnonzero(group >= 0)
        if not len(members):
            return
        places, number = np.unique(group[members], return_inverse=True)
        gather = coo_array(
            (np.ones(len(members)), (number, np.arange(len(members)))), shape=(len(places), len(members))
        ).tocsr()
        for c, part in enumerate(columns(channels)):
            b, j, e = B[members][:, part], J[members][:, part], r[members][:, part]
            for total, each in (
                (self.BB, np.einsum("nmu,nmv->nuv", b, b)),
                (self.BJ, b.transpose(0, 2, 1) @ j),
                (self.Br, np.einsum("nmu,nm->nu", b, e)),
            ):
                total[c][places] += (gather @ each.reshape(len(members), -1)).reshape(len(places), *each.shape[1:])


@dataclass(frozen=True)
class Elimination:
    """Groups solved for.

    Attributes:
        X: How their unknowns follow the coefficients, shape (G, U, K).
        y: Their step where the coefficients stay, shape (G, U).
        inverse: H^-1, shape (G, U, U).
        squares: Sum of squares of the prior knowledge, in sigmas.
        rank: Unknowns that rows and prior knowledge determine, shape (G,).
    """

    X: np.ndarray
    y: np.ndarray
    inverse: np.ndarray
    squares: float
    rank: np.ndarray

    def rows(self, group: np.ndarray, B: np.ndarray, J: np.ndarray, r: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals (n, m) and columns (n, m, K) of rows, less the part that their groups take up."""
        grouped = group >= 0
        r, J = r.copy(), J.copy()
        J[grouped] -= B[grouped] @ self.X[group[grouped]]
        r[grouped] -= np.einsum("nmu,nu->nm", B[grouped], self.y[group[grouped]])
        return r, J


@dataclass(frozen=True)
class Projector:
    """Takes the part that unknowns of groups take up off columns: (1 - B H^-1 B'W) of N rows.

    Attributes:
        B: Columns of the rows' own group, shape (N, m, U).
        group: Of each row, shape (N,); -1 for none.
        pull: H^-1 B'W of each row, shape (N, U, m), for unit noise.
    """

    B: np.ndarray
    group: np.ndarray
    pull: np.ndarray

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Columns, shape (N, m, d), less the part that groups take up."""
        grouped, number, gather = self._members
        each = self.pull[grouped] @ values[grouped]
        steps = (gather @ each.reshape(len(grouped), -1)).reshape(-1, *each.shape[1:])
        remainder = values.copy()
        remainder[grouped] -= self.B[grouped] @ steps[number]
        return remainder

    @cached_property
    def _members(self) -> tuple[np.ndarray, np.ndarray, csr_array]:
        """Rows of groups, the group of each, and the matrix that sums over the rows of each group: a search asks often."""
        grouped = np.flatnonzero(self.group >= 0)
        number = self.group[grouped]
        ones = (np.ones(len(grouped)), (number, np.arange(len(grouped))))
        return grouped, number, coo_array(ones, shape=(number.max() + 1, len(grouped))).tocsr()


def projector(
    B: np.ndarray, group: np.ndarray, elimination: Elimination, weight: np.ndarray, sigma: np.ndarray
) -> Projector:
    """The projector that takes groups off columns.

    Args:
        B: Of all rows, scaled, shape (N, m, U).
        group: Of each row, shape (N,).
        elimination: The groups solved.
        weight: Of each row, shape (N,).
        sigma: Noise of each number of a row, shape (m,).
    """
    pull = np.zeros((len(B), B.shape[2], B.shape[1]))
    grouped = group >= 0
    weighed = B[grouped] * (weight[grouped, None] / sigma**2)[:, :, None]
    pull[grouped] = elimination.inverse[group[grouped]] @ weighed.transpose(0, 2, 1)
    return Projector(B, group, pull)


def groups(measured: Observations) -> Groups | None:
    """Groups of the things of roles that may have many; None where none of these things has an unknown."""
    things = {name: t for name, t in measured.instruments.things.items() if t.role.many}
    first = dict(zip(things, np.cumsum([0, *(len(t) for t in things.values())]).tolist(), strict=False))
    count = sum(len(t) for t in things.values())
    if not any(t.free.any() for t in things.values()):
        return None
    pairs = [
        [first[tie.role] + things[tie.role].names.index(name) for name in (tie.first, tie.second)]
        for tie in measured.instruments.ties
        if {tie.first, tie.second} <= set(things[tie.role].names)
    ]
    ends = np.array(pairs, dtype=int).reshape(-1, 2)
    joined = coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(count, count))
    _, label = connected_components(joined, directed=False)
    counts = np.zeros(len(np.unique(label)), dtype=int)
    group, slot = {}, {}
    for name, t in things.items():
        group[name] = label[first[name] : first[name] + len(t)].copy()
        slot[name] = np.full(t.free.shape, -1)
        for k in np.flatnonzero(t.free.any(axis=1)).tolist():
            components = np.flatnonzero(t.free[k])
            slot[name][k, components] = counts[group[name][k]] + np.arange(len(components))
            counts[group[name][k]] += len(components)
        group[name][~t.free.any(axis=1)] = -1
    role, thing = measured.many()
    row = np.full(len(measured), -1)
    for number, name in enumerate(measured.roles):
        of_role = role == number
        if name in group:
            row[of_role] = group[name][thing[of_role]]
    unknown = np.arange(counts.max(initial=0)) < counts[:, None]
    return Groups(row, role, thing, measured.roles, group, slot, unknown)


def prior_rows(groups: Groups, instruments: Instruments, states: ThingStates) -> PriorRows:
    """Ties and declared uncertainties of things as rows, linearised where the things are."""
    rows: list[tuple[int, np.ndarray, float]] = []
    width = groups.unknown.shape[1]
    for tie in instruments.ties:
        row = _row_of_tie(tie, groups, instruments, states, width)
        if row is not None:
            rows.append(row)
    for name, slot in groups.slot.items():
        things = instruments.things[name]
        for k, component in np.argwhere((slot >= 0) & np.isfinite(things.std)).tolist():
            std = things.std[k, component]
            by = np.zeros(width)
            by[slot[k, component]] = 1.0 / std
            deviation = (things.start[k, component] - states[name][k, component]) / std
            rows.append((int(groups.group[name][k]), by, float(deviation)))
    return PriorRows(
        group=np.array([g for g, _, _ in rows], dtype=int),
        by=np.array([by for _, by, _ in rows]).reshape(-1, width),
        misfit=np.array([deviation for _, _, deviation in rows]),
    )


def _row_of_tie(
    tie: Tie, groups: Groups, instruments: Instruments, states: ThingStates, width: int
) -> tuple[int, np.ndarray, float] | None:
    """A tie as a row: group, columns, and declared minus present value in sigmas; None where no end of it has an unknown."""
    things = instruments.things[tie.role]
    if not {tie.first, tie.second} <= set(things.names):
        return None
    pair = [things.names.index(name) for name in (tie.first, tie.second)]
    ends = [states[tie.role][k] for k in pair]
    group = max(int(groups.group[tie.role][k]) for k in pair)
    if group < 0 or not np.isfinite(np.concatenate(ends)).all():
        return None
    by = np.zeros(width)
    for end, k in enumerate(pair):
        for component in np.flatnonzero(groups.slot[tie.role][k] >= 0).tolist():
            change = np.zeros((2, len(things.role.components)))
            change[:, component] = TIE_STEP, -TIE_STEP
            ahead, back = things.role.moved(np.array([ends[end], ends[end]]), change)
            slope = (_value_of_tie(tie, ahead, ends[1 - end]) - _value_of_tie(tie, back, ends[1 - end])) / (
                2.0 * TIE_STEP
            )
            by[groups.slot[tie.role][k, component]] = slope / tie.std
    return group, by, (tie.value - _value_of_tie(tie, *ends)) / tie.std


def _value_of_tie(tie: Tie, first: np.ndarray, second: np.ndarray) -> float:
    """The quantity that a tie fixes: the distance of two points, or the cosine of the angle of two normals, in either order."""
    a, b = first[:3], second[:3]
    return float(np.linalg.norm(a - b) if tie.form == "distance" else a @ b)


def solved(sums: Sums, groups: Groups, beforehand: PriorRows, sigma: np.ndarray) -> Elimination:
    """Solve for all groups.

    Args:
        sums: Over their rows.
        groups: The groups.
        beforehand: Prior knowledge of them.
        sigma: Noise of each channel, shape (C,).
    """
    per = 1.0 / sigma**2
    H, C, b = (np.tensordot(per, total, axes=1) for total in (sums.BB, sums.BJ, sums.Br))
    np.add.at(H, beforehand.group, beforehand.by[:, :, None] * beforehand.by[:, None, :])
    np.add.at(b, beforehand.group, beforehand.by * beforehand.misfit[:, None])
    values, vectors, scale = directions(H)
    inverse = (vectors * (1.0 / values)[:, None, :]) @ vectors.transpose(0, 2, 1)
    inverse = inverse * scale[:, :, None] * scale[:, None, :]
    X, y = inverse @ C, np.einsum("guv,gv->gu", inverse, b)
    return Elimination(X, y, inverse, float(np.sum(beforehand.misfit**2)), np.isfinite(values).sum(axis=1))


def reduced(
    equations: NormalEquations, sums: Sums, elimination: Elimination, beforehand: PriorRows, sigma: np.ndarray
) -> NormalEquations:
    """Normal equations of the coefficients with the groups solved for; prior knowledge counts in the groups' main channel.

    Args:
        equations: Of all rows, groups held.
        sums: Over the rows of the groups.
        elimination: The groups solved.
        beforehand: Prior knowledge of them.
        sigma: Noise of each channel, shape (C,).
    """
    AA, Ar, rr, count = (value.copy() for value in (equations.AA, equations.Ar, equations.rr, equations.count))
    X, y = elimination.X, elimination.y
    flat = X.reshape(X.shape[0] * X.shape[1], X.shape[2])
    for c in range(len(sigma)):
        cross = sums.BJ[c].reshape(flat.shape).T @ flat
        inner = sums.BB[c] @ X
        AA[c] += flat.T @ inner.reshape(flat.shape) - cross - cross.T
        pull = np.einsum("guv,gv->gu", sums.BB[c], y)
        Ar[c] += flat.T @ (pull - sums.Br[c]).ravel() - sums.BJ[c].reshape(flat.shape).T @ y.ravel()
        rr[c] += float(np.sum(y * (pull - 2.0 * sums.Br[c])))
    first = int(np.argmax(np.einsum("cguu->c", sums.BB)))
    by = tied_columns(X, beforehand)
    remainder = beforehand.misfit - np.einsum("tu,tu->t", beforehand.by, y[beforehand.group])
    AA[first] += sigma[first] ** 2 * by.T @ by
    Ar[first] += sigma[first] ** 2 * by.T @ remainder
    rr[first] += sigma[first] ** 2 * float(remainder @ remainder)
    share = np.einsum("cguu->cg", sums.BB) / (sigma**2)[:, None]
    share = share / np.maximum(share.sum(axis=0), TINY)
    count[first] += len(beforehand.misfit)
    return NormalEquations(AA, Ar, np.maximum(rr, 0.0), np.maximum(count - share @ elimination.rank, 0.0))


def states_after_step(
    states: ThingStates, groups: Groups, instruments: Instruments, step: np.ndarray
) -> dict[str, np.ndarray]:
    """Where the things are after a step of the groups' unknowns, shape (G, U)."""
    after = dict(states)
    for name, slot in groups.slot.items():
        role, group = instruments.things[name].role, groups.group[name]
        change = np.where(slot >= 0, step[group[:, None], np.maximum(slot, 0)], 0.0)
        there = group >= 0
        after[name] = states[name].copy()
        after[name][there] = role.moved(states[name][there], change[there])
    return after


def tied_columns(X: np.ndarray, beforehand: PriorRows) -> np.ndarray:
    """Prior knowledge of the groups as rows of the coefficients, in sigmas, shape (T, K); X as of :class:`Elimination`."""
    return -np.einsum("tu,tuk->tk", beforehand.by, X[beforehand.group])
