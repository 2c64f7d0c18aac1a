"""Every kind of effect passes the same tests."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest
import robots

from aridcal.campaign import EFFECT_KINDS, HEAD_KINDS, EffectDeclaration
from aridcal.catalogue import KINDS, Scene, candidates, declared, usable_columns
from aridcal.effects import Effect, Surroundings, covariate_table
from aridcal.model import Model

AXIS, ACROSS, FRAME = {"axis"}, {"t1", "t2", "r1", "r2"}, {"x", "y", "z", "roll", "pitch", "yaw"}

# kind: motions that it may have, and what each of its covariates must end with ("" for the joint's own reading)
CONTRACT: dict[str, tuple[set[str], tuple[str, ...]]] = {
    "joint_gain": (AXIS, ("",)),
    "joint_harmonic": (AXIS, ("",)),
    "joint_map": (AXIS, ("",)),
    "joint_backlash": (AXIS, ("_direction", ".gravity_torque")),
    "joint_compliance": (AXIS, (".gravity_torque",)),
    "bearing_compliance": (
        {"r1", "r2", "roll", "pitch", "yaw"},
        (*(f".gravity_moment_{c}" for c in ("r1", "r2", "roll", "pitch", "yaw")), ""),
    ),
    "axis_wobble": (ACROSS, ("",)),
    "rail_straightness": ({"t1", "t2"}, ("",)),
    "rail_angular": ({"roll", "pitch", "yaw"}, ("",)),
    "joint_coupling": (AXIS, ()),
    "thermal": (AXIS | FRAME, ("temperature", "temperature_hall", "")),
    "drift": (FRAME, ("time",)),
    "payload_compliance": (AXIS | ACROSS, ("payload", ".payload_torque")),
    "unknown": (FRAME, ()),
}
N = 40
MEASURED = ("time", "temperature", "temperature_hall", "payload", "joint_1_direction")


def scene() -> tuple[Scene, Model, np.ndarray, dict[str, np.ndarray]]:
    """A chain with a rail and every column that an effect may want."""
    rng = np.random.default_rng(7)
    robot = robots.random_robot(11, "PRCR")
    q = robots.readings(robot, N, rng)
    columns = {name: rng.normal(0.0, 1.0, N) for name in MEASURED}
    columns["joint_1_direction"] = rng.choice([-1.0, 1.0], N)
    around = Surroundings(np.array([1.0, 9.0, -3.0]), np.array([0.1, 0.2, 0.3]))
    table = covariate_table(robot, q, columns, around, np.zeros(N, dtype=int), {".gravity_", ".payload_"})
    frames = ((None, robots.random_placement(rng)),)
    return Scene(robot, table, MEASURED), Model(robot, (), frames, frames, around), q, columns


def effects(kind: str) -> list[Effect]:
    found = candidates(scene()[0], (kind,))
    assert found
    return found


def test_the_table_holds_every_kind_that_a_campaign_may_declare() -> None:
    assert {*KINDS, *HEAD_KINDS} == set(EFFECT_KINDS)
    assert list(KINDS) == list(CONTRACT)


@pytest.mark.parametrize("kind", CONTRACT)
def test_a_kind_moves_and_depends_on_what_the_formats_say(kind: str) -> None:
    motions, endings = CONTRACT[kind]
    names = scene()[0].robot.names
    for effect in effects(kind):
        assert effect.kind == kind
        assert set(effect.motion) <= motions
        for name in effect.covariates:
            if endings:
                assert name == effect.where or any(e and name in (e, effect.where + e) for e in endings)
            else:
                assert name in (*names, *MEASURED)
    if kind == "joint_coupling":
        assert all(e.covariates == (e.with_,) != (e.where,) for e in effects(kind))


@pytest.mark.parametrize("kind", CONTRACT)
def test_a_kind_s_columns_are_finite_differences_of_the_exact_poses(kind: str) -> None:
    _, empty, q, columns = scene()
    found = effects(kind)
    for effect in {id(e): e for e in (found[0], found[len(found) // 2], found[-1])}.values():
        model = empty.with_coefficients(effect.coefficients)
        rows = model.rows(q, columns)
        theta = np.random.default_rng(1).normal(0.0, 1e-3, len(effect.coefficients))
        _, _, J = model.jacobian(theta, rows)
        assert np.isfinite(J).all()
        step = 1e-6
        for k in range(len(theta)):
            shift = step * (np.arange(len(theta)) == k)
            (Ra, pa), (Rb, pb) = (model.poses(theta + s, rows) for s in (shift, -shift))
            turn = [pin.log3(a @ b.T) for a, b in zip(Ra, Rb, strict=True)]
            seen = np.hstack([pa - pb, turn]) / (2 * step)
            np.testing.assert_allclose(J[:, :, k], seen, atol=1e-7 * max(1.0, np.abs(J).max()))


@pytest.mark.parametrize("kind", CONTRACT)
def test_a_kind_has_names_that_are_unique_and_no_two_effects_that_are_one(kind: str) -> None:
    found = effects(kind)
    for effect in found:
        names = [c.name for c in effect.coefficients]
        assert len(set(names)) == len(names)
        assert all(name.startswith(f"{effect.where}.") for name in names)
    for a, b in itertools.combinations(found, 2):
        assert set(a.coefficients) != set(b.coefficients)


@pytest.mark.parametrize("kind", CONTRACT)
def test_a_kind_can_be_declared_where_the_search_would_look_for_it(kind: str) -> None:
    where = scene()[0]
    for effect in effects(kind):
        extra = {"with": effect.with_} if effect.with_ else {}
        found = declared(where, EffectDeclaration(kind=kind, where=effect.where, **extra), "campaign.yaml")  # type: ignore[arg-type]
        assert (found.kind, found.where, found.with_) == (kind, effect.where, effect.with_)


@pytest.mark.parametrize(
    ("spoilt", "kind"),
    [
        ("time", "drift"),
        ("payload", "payload_compliance"),
        ("temperature", "thermal"),
    ],
)
def test_a_column_with_a_hole_or_without_change_bars_the_effects_that_need_it(spoilt: str, kind: str) -> None:
    where, _, _, columns = scene()
    for broken in (np.where(np.arange(N) == 3, np.nan, 1.0 * np.arange(N)), np.full(N, 20.0)):
        good, barred = usable_columns(columns | {spoilt: broken, "temperature_hall": np.full(N, 20.0)})
        assert spoilt not in good
        assert any(spoilt in b.what for b in barred)
        table = {k: v for k, v in where.table.items() if k != spoilt}
        assert candidates(Scene(where.robot, table, good), (kind,)) == []
