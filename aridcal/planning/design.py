"""Which configurations to measure next, and how well the target will be known then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from pydantic import ValidationError

from aridcal.effects.catalogue import KINDS, declared
from aridcal.effects.effect import Coefficient
from aridcal.errors import CampaignError, MeasurementError, nearest
from aridcal.inputs.campaign import EffectDeclaration
from aridcal.inputs.measurement_settings import MeasurementSettings
from aridcal.inputs.quantities import POSITION, column_of
from aridcal.inputs.query import load_query
from aridcal.inputs.tables import read_tables
from aridcal.model.reaching import draw_readings
from aridcal.planning.beforehand import Beforehand
from aridcal.planning.candidates import (
    LOOSE,
    Candidates,
    Told,
    allowed,
    draw_candidates,
    offers,
    reaching,
    target_columns,
    told,
)
from aridcal.planning.exchange import FEW, Choice, Criterion, best_choice, nested, rms_sigma, worst_sigma
from aridcal.planning.travel import short_order
from aridcal.robot.chain import Robot
from aridcal.search.diagnose import look
from aridcal.showing import SILENT, Progress

POOL, SMALL_POOL = 3000, 1000
"""Configurations to choose from, and the same where many are wanted, or each must be sought: twice as many make the choice better
by a per cent."""

EASY = ("pose", "position", "distance")
"""Kinds that can be measured in any configuration."""

PLACES = 300
"""Of the region: their mean is then known to a few per cent, and every choice is compared on the same ones."""

RANDOM = 100
"""Random choices that the best one is set beside."""

KNOWN = 0.1
"""Share of :data:`aridcal.planning.candidates.LOOSE` beyond which a sigma is that of what is assumed, not measured."""


@dataclass(frozen=True)
class Asked:
    """What a plan is to do.

    Attributes:
        n: Configurations.
        criterion: See :mod:`aridcal.planning.exchange`.
        region: Table of joints, or of places of the target, where it is to be known; None: anywhere in the joints' ranges.
        apart: Two effects that are to be told apart, ``WHERE.KIND`` each; none otherwise.
        seed: Of all that is drawn.
    """

    n: int
    criterion: Criterion = "A"
    region: Path | None = None
    apart: tuple[str, ...] = ()
    seed: int = 0


@dataclass(frozen=True)
class Sigma:
    """How well the target is known over the region with so many new configurations; NaN where it is not known at all.

    Attributes:
        n: So many.
        rms: All three directions together, [m].
        worst: At the worst place in the worst direction, [m].
    """

    n: int
    rms: float
    worst: float


@dataclass(frozen=True)
class Plan:
    """Configurations to measure next.

    Attributes:
        readings: In the order in which to visit them, shape (n, columns), [rad] or [m].
        labels: What each measures, by column.
        sigma: Against the number of configurations, the best ones first; with two effects to be told apart what these do to the
            target, each as far as the other leaves it open.
        random: RMS sigma of as many random configurations, the median of :data:`RANDOM` choices, [m]; NaN as for :class:`Sigma`.
        indices: Observability indices O1 to O5 of the rows so far and the planned ones together.
        unknowns: How many coefficients can be identified, with the planned rows.
        measured: Rows so far.
        notices: What was assumed.
    """

    readings: np.ndarray
    labels: dict[str, np.ndarray]
    sigma: tuple[Sigma, ...]
    random: float
    indices: tuple[float, ...]
    unknowns: int
    measured: int
    notices: tuple[str, ...]

    @property
    def at_n(self) -> Sigma:
        """Of the plan itself."""
        return next(s for s in self.sigma if s.n == len(self.readings))


def design(known: Beforehand, asked: Asked, progress: Progress = SILENT) -> Plan:
    """Choose configurations.

    Args:
        known: What is known before.
        asked: What they are for.
        progress: Called with what is being done.

    Raises:
        AridcalError: nothing can be planned, or something of what is asked needs mending.
    """
    drawing, choosing, chance = (np.random.default_rng(s) for s in np.random.SeedSequence(asked.seed).spawn(3))
    progress("drawing configurations")
    pool = POOL if asked.n <= FEW and known.campaign.measurements.kind in EASY else SMALL_POOL
    candidates = draw_candidates(known, max(pool, 4 * asked.n), 2 * asked.n, drawing)
    known = with_stated_effects(known, candidates)
    choice, of = question(known, asked, candidates, drawing)
    progress(f"choosing {asked.n} of {len(candidates.readings):,} configurations")
    chosen = best_choice(choice, asked.n, choosing)
    progress("saying what they will tell")
    return _plan(known, asked, candidates, choice, of, chosen, chance)


def with_stated_effects(known: Beforehand, candidates: Candidates) -> Beforehand:
    """The same with the effects that the campaign declares among what is identified; measured rows have them already.

    What depends on more than the joints (time, temperature) is not there to be planned with, and is named.
    """
    notices = []
    for declaration in () if len(known.rows) else known.campaign.effects:
        try:
            effect = _declared(known, declaration, str(known.campaign.path), candidates)
        except CampaignError as error:
            notices.append(f"not planned for: {error}")
            continue
        known = known.with_coefficients(tuple(c for c in effect if c not in known.model.coefficients))
    return replace(known, notices=(*known.notices, *notices))


def question(known: Beforehand, asked: Asked, candidates: Candidates, rng: np.random.Generator) -> tuple[Choice, Told]:
    """What is to be chosen from candidates, for what is asked, and what they tell."""
    effects = [_effect(known, name, candidates) for name in asked.apart]
    parts: list[list[int]] = []
    for effect in effects:
        known = known.with_coefficients(tuple(c for c in effect if c not in known.model.coefficients))
        parts.append([known.model.coefficients.index(c) for c in effect])
    of = told(known, candidates, asked.n)
    for name, part in zip(asked.apart, parts, strict=True):
        if not set(part) & set(of.kept):
            raise CampaignError(
                f"--apart {','.join(asked.apart)}: no configuration tells {name} from the other one and from the constants: the "
                "data of this kind cannot"
            )
    target = target_columns(known, of, _places(known, asked, rng), 0, parts)
    choice = Choice(of.candidates, of.known, target, np.ones(len(target)), of.things, asked.criterion)
    return choice, of


def _plan(
    known: Beforehand,
    asked: Asked,
    candidates: Candidates,
    choice: Choice,
    of: Told,
    chosen: Sequence[int],
    rng: np.random.Generator,
) -> Plan:
    """What is said of a choice."""
    most = min(2 * asked.n, len(candidates.readings))
    order = nested(choice, chosen, most)
    counts = {asked.n // 4, asked.n // 2, asked.n, most} - {0}
    counts |= {0} if len(known.rows) else set()
    drawn = [
        rms_sigma(choice, choice.information(rng.permutation(len(candidates.readings))[: asked.n]))
        for _ in range(RANDOM)
    ]
    way = np.array(chosen)[short_order(candidates.readings[list(chosen)])]
    titles = [offers(known).titles[k] for k in candidates.offer[way]]
    F = of.candidates[way].reshape(-1, of.candidates.shape[2])
    information = (of.measured + F.T @ F) * of.sizes * of.sizes[:, None]
    return Plan(
        readings=candidates.readings[way],
        labels={name: np.array([title[name] for title in titles]) for name in titles[0]},
        sigma=tuple(_sigma(choice, order[:count]) for count in sorted(counts)),
        random=_told(float(np.median(drawn))),
        indices=observability(information, of.things, len(known.rows) + asked.n),
        unknowns=len(of.kept),
        measured=len(known.rows),
        notices=known.notices,
    )


def _sigma(choice: Choice, chosen: Sequence[int]) -> Sigma:
    """What a choice makes of the region."""
    M = choice.information(chosen)
    rms = _told(rms_sigma(choice, M))
    return Sigma(len(chosen), rms, worst_sigma(choice, M) if np.isfinite(rms) else np.nan)


def _told(sigma: float) -> float:
    """A sigma; NaN where it is that of what is assumed."""
    return sigma if sigma < KNOWN * LOOSE else float("nan")


def observability(information: np.ndarray, solved_for: int, n: int) -> tuple[float, ...]:
    r"""The five indices in use, of the Jacobian in sigmas per [m] and [rad] with singular values s, L of them, from n rows.

    .. math:: O_1 = (s_1 \cdots s_L)^{1/L} / \sqrt n, \quad O_2 = s_L / s_1, \quad O_3 = s_L, \quad O_4 = s_L^2 / s_1, \quad
              O_5 = 1 / (1/s_1 + \ldots + 1/s_L)

    (Borm and Menq 1991; Driels and Pathre 1990; Nahvi, Hollerbach and Hayward 1994; Nahvi and Hollerbach 1996; Sun and
    Hollerbach 2008, doi:10.1109/ROBOT.2008.4543390, which compares them.)

    Args:
        information: Shape (D, D).
        solved_for: Unknowns, the first ones, that are solved for beside.
        n: Rows.
    """
    cross = information[solved_for:, :solved_for]
    inner = np.linalg.pinv(information[:solved_for, :solved_for], hermitian=True)
    values = np.linalg.eigvalsh(information[solved_for:, solved_for:] - cross @ inner @ cross.T)
    s = np.sqrt(np.maximum(values, 0.0))[::-1]
    with np.errstate(divide="ignore"):
        first = float(np.exp(np.mean(np.log(s))) / np.sqrt(n))
        last = float(1.0 / np.sum(1.0 / s))
    return first, float(s[-1] / s[0]), float(s[-1]), float(s[-1] ** 2 / s[0]), last


def _effect(known: Beforehand, name: str, candidates: Candidates) -> tuple[Coefficient, ...]:
    """Coefficients of an effect called ``WHERE.KIND``: as the campaign declares it, or as the kind has it.

    Raises:
        CampaignError: there is no such effect.
    """
    where, _, kind = name.rpartition(".")
    if not where or kind not in KINDS:
        raise CampaignError(
            f"--apart {name}: should be WHERE.KIND, joint_2.joint_gain for instance{nearest(kind, KINDS)}"
        )
    stated = [d for d in known.campaign.effects if (d.where, d.kind) == (where, kind)]
    try:
        declaration = stated[0] if stated else EffectDeclaration(kind=kind, where=where)
    except ValidationError as error:
        why = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise CampaignError(f"--apart {name}: {why}; declare it under `effects` of {known.campaign.path}") from None
    return _declared(known, declaration, f"--apart {name}", candidates)


def _declared(
    known: Beforehand, declaration: EffectDeclaration, place: str, candidates: Candidates
) -> tuple[Coefficient, ...]:
    """Coefficients of an effect, as candidates could show them."""
    observed, _ = look(known.model, candidates.rows(known))
    return declared(observed, declaration, place).coefficients


def _places(known: Beforehand, asked: Asked, rng: np.random.Generator) -> np.ndarray:
    """Readings of the region, shape (R, columns)."""
    if asked.region is not None:
        return region(known, asked.region, rng)
    readings = draw_readings(known.robot, PLACES, rng)
    inside = readings[allowed(known, readings, np.zeros(len(readings), dtype=int))]
    return inside if len(inside) else readings


def region(known: Beforehand, path: Path, rng: np.random.Generator) -> np.ndarray:
    """Readings of a table of joints, or of readings that bring the target to a table's places, shape (R, columns).

    Raises:
        MeasurementError: the table has neither, or a row of it cannot be used.
    """
    robot, settings = known.robot, known.campaign.measurements
    limit = known.campaign.limits.table
    names = set(read_tables([path], limit=limit).names)
    joints = [settings.columns.get(name, name) for name in robot.readings]
    places = [column_of(name, settings, robot.readings) for name in POSITION]
    if not (set(joints) <= names or set(places) <= names):
        raise MeasurementError(
            f"{path}: should have the columns of all joints ({', '.join(joints)}) or of the target's places ({', '.join(places)})"
        )
    by_joints = set(joints) <= names
    plain = settings.model_copy(update={"kind": "position"})
    query = load_query(path, robot.readings, robot.limits, robot.kinds, plain, poses=not by_joints, limit=limit)
    if query.refused:
        raise MeasurementError(f"{query.refused[0]}; mend the row, or delete it")
    if by_joints:
        return query.readings
    position = query.position
    assert position is not None

    def miss(R: np.ndarray, p: np.ndarray, rows: np.ndarray) -> np.ndarray:
        return p - position[rows]

    return reaching(known, 0, miss, len(position), rng, f"take places out of {path} that it cannot reach")


def as_table(plan: Plan, robot: Robot, settings: MeasurementSettings) -> pd.DataFrame:
    """Joints in the columns and units of a campaign's own table, and what each row measures."""
    labels = {column_of(name, settings, robot.readings): words for name, words in plan.labels.items()}
    return joint_table(plan.readings, robot, settings).assign(**labels)


def joint_table(readings: np.ndarray, robot: Robot, settings: MeasurementSettings) -> pd.DataFrame:
    """Readings, shape (n, columns), [rad] or [m], in the columns and units of a campaign's own table."""
    units = {"prismatic": settings.units.metres}
    columns = {
        settings.columns.get(name, name): values / units.get(kind, settings.units.radians)
        for name, kind, values in zip(robot.readings, robot.kinds, readings.T, strict=True)
    }
    return pd.DataFrame(columns)
