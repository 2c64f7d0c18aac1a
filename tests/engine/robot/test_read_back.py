"""Written URDFs are read back: what no longer says what the model says is refused, what is the user's own fault is said."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import robots

import aridcal.engine.fit.constants
from aridcal.engine.corrections.basis import ALWAYS
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants, urdf_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot, parse_robot, with_limbs
from aridcal.engine.robot.read_back import ReadBackError, link_places
from aridcal.engine.robot.tree import read_tree
from aridcal.identify import main
from aridcal.jobs.calibrate.urdf_files import write_urdf

NAMES = ("ur5", "panda", "baxter", "tiago", "talos")
FILES = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", None, "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", None, "panda_link8"),
    "baxter": ("baxter_description/urdf/baxter.urdf", "base", "left_gripper"),
    "tiago": ("tiago_description/robots/tiago.urdf", None, "arm_tool_link"),
    "talos": ("talos_data/robots/talos_full_v2.urdf", "torso_2_link", "gripper_left_base_link"),
}


def public(name: str) -> Robot:
    file, base, tip = FILES[name]
    return load_robot(robots.SHARED_ROBOTS / file, tip, base)


def wrong(robot: Robot, seed: int = 0) -> tuple[Model, np.ndarray]:
    """A model with every constant off by some centimetres and centiradians."""
    model = Model(robot, constants(robot, "full"))
    return model, np.random.default_rng(seed).normal(0.0, 1e-2, len(model.coefficients))


@pytest.mark.parametrize("name", NAMES)
def test_public_robots_with_their_mimics_are_written_without_a_word(name: str, tmp_path: Path) -> None:
    model, theta = wrong(public(name))
    assert write_urdf(tmp_path / "calibrated.urdf", model, theta) == ()
    assert (tmp_path / "calibrated.urdf").read_bytes() == urdf_of(model, theta)


def test_a_robot_of_two_arms_and_the_zeros_of_its_joints_are_written(tmp_path: Path) -> None:
    file, base, tip = FILES["talos"]
    robot = with_limbs(load_robot(robots.SHARED_ROBOTS / file, tip, base), ["gripper_right_base_link"])
    zeros = tuple(Coefficient(name, "axis", ALWAYS) for name in robot.readings)
    model = Model(robot, (*constants(robot, "full"), *zeros))
    theta = np.random.default_rng(1).normal(0.0, 1e-2, len(model.coefficients))
    assert write_urdf(tmp_path / "calibrated.urdf", model, theta) == ()


def test_places_of_links_are_those_of_pinocchio() -> None:
    """The third road, by which both readers are judged."""
    robot = public("ur5")
    tree, model = read_tree(robot.urdf, robot.path), robot.tree
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (4, model.nq))
    places = link_places(tree, dict(zip(list(model.names)[1:], q.T, strict=True)), {})
    data = model.createData()
    for k, own in enumerate(q):
        pin.framesForwardKinematics(model, data, own)
        for link, T in places.items():
            frame = model.getFrameId(link, pin.FrameType.BODY)
            np.testing.assert_allclose(T[k], data.oMf[frame].homogeneous, atol=1e-12)


DAMAGES: dict[str, Callable[[bytes], bytes]] = {
    "an origin": lambda urdf: urdf.replace(b"-0.1719 0.612", b"-0.1719 0.6120001"),
    "an axis": lambda urdf: urdf.replace(b'<axis xyz="0 1 0"/>', b'<axis xyz="0 1 1e-6"/>', 1),
    "a link's name": lambda urdf: urdf.replace(b'"forearm_link"', b'"fore_link"'),
    "half of it is missing": lambda urdf: urdf[: len(urdf) // 2],
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_urdf_damaged_after_the_splice_is_refused_and_nothing_appears(
    damage: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = robots.ur10()
    model, theta = Model(robot, constants(robot, "full")), np.zeros(len(constants(robot, "full")))
    good = urdf_of(model, theta)
    bad = DAMAGES[damage](good)
    assert bad != good
    monkeypatch.setattr(aridcal.engine.fit.constants, "splice_origins", lambda *_: bad)
    with pytest.raises(ReadBackError, match=r"calibrated\.urdf: .*nothing was written") as refused:
        write_urdf(tmp_path / "calibrated.urdf", model, theta)
    assert not list(tmp_path.iterdir())
    if damage == "an origin":
        assert refused.value.link is not None and repr(refused.value.link) in str(refused.value)


def test_a_model_that_folds_its_constants_wrongly_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Both readers agree with such a file; the model's own kinematics do not."""
    model, theta = wrong(robots.ur10())
    folded = Model.origins

    def shifted(self: Model, values: np.ndarray) -> dict[str, pin.SE3]:
        found = folded(self, values)
        return found | {"elbow_joint": found["elbow_joint"] * pin.SE3(np.eye(3), np.array([1e-7, 0.0, 0.0]))}

    monkeypatch.setattr(Model, "origins", shifted)
    with pytest.raises(ReadBackError, match="the model has link 'tool0' elsewhere") as refused:
        write_urdf(tmp_path / "calibrated.urdf", model, theta)
    assert refused.value.link == "tool0" and not list(tmp_path.iterdir())


SHAPELESS = (b'<link name="forearm_link">', b'<link name="forearm_link"><visual/>')

FINGERS = b"".join(
    b'<link name="finger_%d"/><joint name="finger_joint_%d" type="revolute"><parent link="tool0"/><child link="finger_%d"/>'
    b'<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>%s</joint>' % (k, k, k, mimic)
    for k, mimic in enumerate((b'<mimic joint="finger_joint_1"/>', b'<mimic joint="finger_joint_2"/>', b""))
)
"""The first follows the second, which follows the third: yourdfpy follows one step only, in the order of the file."""

PECULIAR = {
    "a shape of nothing": (*SHAPELESS, "cannot read it (TypeError", "and, without shapes and inertias, by yourdfpy"),
    "a mimic of a mimic": (b"</robot>", FINGERS + b"</robot>", "has link 'finger_0' elsewhere", "Pinocchio alone"),
}


@pytest.mark.parametrize("what", PECULIAR)
def test_what_yourdfpy_cannot_read_of_the_users_own_file_is_said_and_passed_over(what: str, tmp_path: Path) -> None:
    plain, (old, new, why, instead) = robots.ur10(), PECULIAR[what]
    urdf = plain.urdf.replace(old, new, 1)
    assert urdf != plain.urdf
    model, theta = wrong(parse_robot(urdf, plain.tip, plain.base, plain.path))
    (said,) = write_urdf(tmp_path / "calibrated.urdf", model, theta)
    assert said.startswith(f"ur10.urdf: yourdfpy {why}")
    assert said.endswith(instead)
    assert (tmp_path / "calibrated.urdf").is_file()


def test_a_whole_calibration_says_what_the_second_reader_cannot_read_and_refuses_a_damaged_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    truth = robots.simulate(robots.ur10(), 40, np.random.default_rng(1), noise=1e-4)
    path = robots.write_campaign(tmp_path, truth, diagnosis={"enabled": False})
    (urdf,) = tmp_path.glob("*.urdf")
    urdf.write_bytes(urdf.read_bytes().replace(*SHAPELESS, 1))
    assert main([str(path)]) == 0
    assert f"note: {urdf.name}: yourdfpy cannot read it" in capsys.readouterr().out
    good = (tmp_path / "results" / "calibrated.urdf").read_bytes()
    splice = aridcal.engine.fit.constants.splice_origins
    monkeypatch.setattr(
        aridcal.engine.fit.constants, "splice_origins", lambda *a: splice(*a).replace(b"shoulder_link", b"sholder_link")
    )
    assert main([str(path)]) == 2
    assert "calibrated.urdf: Pinocchio" in capsys.readouterr().err
    assert (tmp_path / "results" / "calibrated.urdf").read_bytes() == good
