"""Every kind of effect passes the same tests, from the table of kinds; and a new kind needs a row there and no more."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots
import yaml
from repository import ROOT
from searched import searched

from aridcal.engine.corrections.basis import FORMS, Basis, evaluate, values_of_bases
from aridcal.engine.corrections.catalogue import (
    EFFECT_KINDS,
    candidates,
    declared,
    is_of_head,
    kinds_table,
    usable_columns,
)
from aridcal.engine.corrections.effect import Coefficient, Effect
from aridcal.engine.corrections.effect_kind import EffectKind, ObservedRows
from aridcal.engine.corrections.labels import LABEL_COLUMN, label_columns
from aridcal.engine.corrections.loads import Payload, Surroundings, covariate_table
from aridcal.engine.corrections.sights import TARGET, Sights, sight_table
from aridcal.engine.instruments.camera_sonar import Head
from aridcal.engine.model.model import Model
from aridcal.files.campaign import EffectDeclaration, JobSettings
from aridcal.files.yaml_file import parse_settings
from aridcal.identify import main as identify
from aridcal.jobs.head1992.detections import head_things
from aridcal.simulate import main as simulate

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
    "drift": (AXIS | FRAME, ("time",)),
    "shift": (FRAME | AXIS, ("time",)),
    "payload_compliance": (AXIS | ACROSS, ("payload", ".payload_torque")),
    "tracker_scale": ({"scale"}, ()),
    "distance_scale": ({"scale"}, ()),
    "range_error": ({"square", "offset"}, (".wire_length",)),
    "wire_sag": ({"offset"}, (".wire_sag",)),
    "flatness": ({"offset"}, (".plate_1", ".plate_2")),
    "lens_distortion": ({"k1", "k2", "k3", "p1", "p2"}, ()),
    "focal_length": ({"f", "fx", "fy"}, ()),
    "principal_point": ({"cx", "cy"}, ()),
    "sonar_bias": ({"bias"}, ()),
    "sonar_scale": ({"scale"}, ()),
    "regional": ({"beta", "alpha", "axis", *FRAME}, ()),
    "residual_field": ({"x", "y", "z"}, TARGET),
    "unknown": (FRAME, ()),
}
BY = {"regional": "joint_1", "residual_field": "place"}
OF_THINGS = ("tracker_scale", "distance_scale", "range_error", "wire_sag", "flatness")
OF_ARM = [kind for kind in EFFECT_KINDS if not is_of_head(kind) and kind not in OF_THINGS]
HELD = {
    ("tracker", "laser"): ("scale", "square"),
    ("anchor", "rail"): ("scale",),
    ("plane", "table"): (),
    ("camera", "eye"): ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
}
HEAD_HELD = head_things(Head(np.zeros(13), np.zeros((2, 3)), "perpendicular", 1.0)).held
N = 40
MEASURED = ("time", "temperature", "temperature_hall", "payload", "joint_1_direction")
LABELS = ("station[a]", "station[b]")
DOCS = ROOT / "docs"


def observed() -> tuple[ObservedRows, Model, np.ndarray, dict[str, np.ndarray]]:
    """A chain with a rail and every column that an effect may want."""
    rng = np.random.default_rng(7)
    robot = robots.random_robot(11, "PRCR")
    q = robots.readings(robot, N, rng)
    columns = {name: rng.normal(0.0, 1.0, N) for name in MEASURED}
    columns["joint_1_direction"] = rng.choice([-1.0, 1.0], N)
    columns |= label_columns(LABELS, rng.choice(["a", "b", ""], N))
    lever = np.array([0.1, 0.2, 0.3])
    around = Surroundings(np.array([1.0, 9.0, -3.0]), (Payload(lever),), sights=Sights(lever[None]))
    table = covariate_table(robot, q, columns, around, np.zeros(N, dtype=int), {".gravity_", ".payload_"})
    table |= sight_table(robot, q, around.sights, around.gravity, np.zeros(N, dtype=int))
    frames = ((None, robots.random_placement(rng)),)
    return ObservedRows(robot, table, MEASURED, labels=LABELS), Model(robot, (), frames, frames, around), q, columns


def effects(kind: str) -> list[Effect]:
    held = HELD if kind in OF_THINGS else HEAD_HELD if is_of_head(kind) else {}
    found = candidates(replace(observed()[0], stated_components=held, referred=dict.fromkeys(held, N)), (kind,))
    assert found
    return found


def test_every_kind_of_the_table_has_a_contract() -> None:
    assert list(EFFECT_KINDS) == list(CONTRACT)
    assert all(kind.name == name for name, kind in EFFECT_KINDS.items())


def test_what_is_held_at_a_thing_may_be_wrong_and_what_is_identified_may_not() -> None:
    rows = observed()[0]
    kinds = ("lens_distortion", "focal_length", "principal_point", "distance_scale")
    assert not candidates(rows, kinds)
    found = {(e.kind, e.where, e.motion) for e in candidates(replace(rows, stated_components=HELD), kinds)}
    assert {("focal_length", "eye", ("fx", "fy")), ("distance_scale", "rail", ("scale",))} < found
    held = {("camera", "eye"): ("k1", "k2")}
    assert {e.motion for e in candidates(replace(rows, stated_components=held), kinds)} == {("k1",), ("k1", "k2")}
    assert all(not e.covariates for e in candidates(replace(rows, stated_components=HELD), kinds))


@pytest.mark.parametrize("kind", EFFECT_KINDS)
def test_a_kind_moves_and_depends_on_what_the_formats_say(kind: str) -> None:
    motions, endings = CONTRACT[kind]
    names = observed()[0].robot.names
    for effect in effects(kind):
        assert effect.kind == kind
        assert set(effect.motion) <= motions
        for name in effect.covariates:
            if endings:
                assert name == effect.where or any(e and name in (e, effect.where + e) for e in endings)
            else:
                assert name in (*names, *MEASURED, *((LABEL_COLUMN,) if effect.by == LABEL_COLUMN else ()))
    assert {e.by for e in effects(kind)} <= {
        "direction",
        "load",
        BY.get(kind),
        LABEL_COLUMN if kind == "regional" else None,
        None,
    }
    if kind == "joint_coupling":
        assert all(e.covariates == (e.with_,) != (e.where,) for e in effects(kind))


@pytest.mark.parametrize("kind", OF_ARM)
def test_a_kind_s_columns_are_finite_differences_of_the_exact_poses(kind: str) -> None:
    _, empty, q, columns = observed()
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


@pytest.mark.parametrize("kind", EFFECT_KINDS)
def test_a_kind_has_names_that_are_unique_and_no_two_effects_that_are_one(kind: str) -> None:
    found = effects(kind)
    for effect in found:
        names = [c.name for c in effect.coefficients]
        assert len(set(names)) == len(names)
        assert all(name.startswith(f"{effect.where}.") for name in names)
    for a, b in itertools.combinations(found, 2):
        assert set(a.coefficients) != set(b.coefficients)


@pytest.mark.parametrize("kind", OF_ARM)
def test_a_kind_can_be_declared_where_the_search_would_look_for_it(kind: str) -> None:
    where = observed()[0]
    for place, with_ in {(e.where, e.with_) for e in effects(kind)}:
        extra = {"with": with_} if with_ else {"by": BY[kind]} if kind == "regional" else {}
        found = declared(where, EffectDeclaration(kind=kind, where=place, **extra), "campaign.yaml")  # type: ignore[arg-type]
        assert (found.kind, found.where, found.with_) == (kind, place, with_)


@pytest.mark.parametrize("kind", EFFECT_KINDS)
def test_a_kind_has_the_bases_and_the_example_that_its_row_says(kind: str) -> None:
    row = EFFECT_KINDS[kind]
    used = {c.basis.form for e in effects(kind) for c in e.coefficients}
    # pairs are made from what the residual hints at; a constant in space must be declared
    assert used == set(row.bases) - ({"ball"} if kind == "regional" else {"bump2"})
    assert used <= {"1", *FORMS}
    head = "measurements: {kind: camera_sonar, head: head.yaml}\n" if is_of_head(kind) else ""
    text = f"format: 1\nrobot: {{urdf: a.urdf, tip: b}}\n{head}effects:\n  - {row.example}\n"
    (declaration,) = parse_settings(text, Path("campaign.yaml"), JobSettings).effects
    assert declaration.kind == kind


def test_the_documents_show_the_table_as_it_is() -> None:
    assert kinds_table() in (DOCS / "effects.md").read_text("utf-8")


@pytest.mark.parametrize(
    ("spoilt", "kind"), [("time", "drift"), ("payload", "payload_compliance"), ("temperature", "thermal")]
)
def test_a_column_with_a_hole_or_without_change_bars_the_effects_that_need_it(spoilt: str, kind: str) -> None:
    where, _, _, columns = observed()
    for broken in (np.where(np.arange(N) == 3, np.nan, 1.0 * np.arange(N)), np.full(N, 20.0)):
        good, barred = usable_columns(columns | {spoilt: broken, "temperature_hall": np.full(N, 20.0)})
        assert spoilt not in good
        assert any(spoilt in b.what for b in barred)
        table = {k: v for k, v in where.table.items() if k != spoilt}
        assert candidates(ObservedRows(where.robot, table, good), (kind,)) == []


def _toy(rows: ObservedRows) -> Iterator[Effect]:
    """A joint's error in proportion to the cube of the column ``toy``."""
    if "toy" in rows.measured:
        for j in rows.robot.joints:
            yield Effect("toy", j.name, (Coefficient(j.name, "axis", Basis("power", ("toy",), (0.0, 1.0, 3.0))),))


TOY = EffectKind(
    "toy",
    where="a joint",
    words="the joint follows the cube of a toy",
    bases=("power",),
    example="{kind: toy, where: joint_2}",
    doc="toy",
    testable=_toy,
    columns=lambda _: ("toy",),
)
SIGMA = 1e-4
TRUTH = {"kind": "toy", "where": "elbow_joint", "coefficients": [2e-3]}


@pytest.mark.parametrize("stated", [True, False], ids=["declared", "sought"])
def test_a_new_kind_is_one_row_and_goes_through_the_whole_loop(
    stated: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    known = {kind: EFFECT_KINDS[kind] for kind in ("joint_gain", "joint_compliance")}
    scenario = {
        "format": 1,
        "robot": {"urdf": str(robots.URDF / "ur10.urdf"), "base": "base_link", "tip": "tool0"},
        "measurements": {"noise": {"position": SIGMA, "rotation": SIGMA}},
        "diagnosis": {"candidates": [*known, "toy"]},
        "effects": [{"kind": "toy", "where": "elbow_joint"}] if stated else [],
        "truth": {"n": 80, "noise": {"position": SIGMA, "rotation": SIGMA}, "effects": [TRUTH]},
    }
    file, made, out = tmp_path / "scenario.yaml", tmp_path / "made", tmp_path / "out"
    file.write_text(yaml.safe_dump(scenario), "utf-8")
    assert simulate([str(file), "-o", str(made)]) == 2  # there is no such kind
    monkeypatch.setitem(EFFECT_KINDS, "toy", TOY)
    assert simulate([str(file), "-o", str(made)]) == 0
    if stated:
        arm = searched(made / "campaign.yaml").arm
        assert [(e.kind, e.where) for e in arm.diagnosed.declared] == [("toy", "elbow_joint")]
        k = [c.basis.of for c in arm.diagnosed.fit.model.coefficients].index(("toy",))
        assert abs(arm.diagnosed.fit.theta[k] - 2e-3) < 5 * arm.diagnosed.fit.std[k]
        return
    assert identify([str(made / "campaign.yaml"), "--out", str(out)]) == 0

    result = json.loads((out / "result.json").read_text("utf-8"))
    (found,) = result["effects"]
    assert (found["kind"], found["where"], found["declared"]) == ("toy", "elbow_joint", False)
    assert found["covariates"] == ["toy"]
    (coefficient,) = found["coefficients"]
    assert abs(coefficient["value"] - 2e-3) < 5 * coefficient["std"]
    assert result["verdict"] == "noise_floor"
    assert TOY.words in (out / "report.html").read_text("utf-8")
    assert "`toy`" in kinds_table()


def test_bases_evaluated_together_are_those_one_by_one() -> None:
    rng = np.random.default_rng(0)
    table = {name: rng.uniform(0.1, 2.0, 50) for name in "abc"}
    counts = {"ones": (0, 0), "linear": (1, 1), "power": (1, 3), "sin": (1, 1), "cos": (1, 1), "sign": (1, 0), "bump": (1, 2),
              "bump2": (2, 4), "ball": (3, 4), "times_power": (2, 3), "step": (1, 1), "label": (1, 0)}  # fmt: skip
    assert counts.keys() == FORMS.keys()
    bases = [Basis(form, tuple(rng.permutation(list("abc"))[:of].tolist()),
                   (*rng.uniform(0.5, 2.0, max(numbers - 1, 0)).tolist(), *([float(k + 1)] if numbers else [])))
             for form, (of, numbers) in counts.items() for k in range(4)]  # fmt: skip
    bases.append(Basis("label", ("nobody",)))  # counts as absent
    bases = [bases[k] for k in rng.permutation(len(bases))]
    found = values_of_bases(bases, table)
    np.testing.assert_allclose(found, np.column_stack([evaluate(b, table) for b in bases]), rtol=1e-14, atol=1e-14)
