"""A calibration as files of simulators and descriptions: another program reads them, and has every link where we have it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pinocchio as pin
import pytest
import robots
from exported import saved_from, spoilt, written
from lxml import etree
from scipy.stats import chi2

from aridcal import export
from aridcal.engine.corrections.basis import Basis
from aridcal.engine.corrections.effect import Coefficient
from aridcal.engine.fit.constants import constants, urdf_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot, parse_robot
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.export.draws import draws

AGREES = 1e-9
"""[m] and in R: quaternions and angles of files, some metres of links."""

ARMS = {
    "ur_description/urdf/ur5_robot.urdf": "tool0",
    "panda_description/urdf/panda.urdf": "panda_hand_tcp",
    "kinova_description/robots/kinova.urdf": "j2s6s200_end_effector",
    "xarm_description/urdf/xarm7.urdf": "link7",
    "z1_description/urdf/z1.urdf": "link06",
    "so_arm_description/urdf/so101.urdf": "gripper_link",
    "tiago_description/robots/tiago.urdf": "arm_7_link",
}


def arm_of(name: str) -> Robot:
    """An arm of the tests, or of example-robot-data."""
    made = {
        "random": lambda: robots.random_robot(1),
        "gantry": lambda: robots.random_robot(2, "PPPRR"),
        "arid": robots.arid,
        "ur10": robots.ur10,
    }
    if name not in ARMS:
        return made[name]()
    path = robots.SHARED_ROBOTS / name
    if not path.exists():
        pytest.skip("this arm is not in example-robot-data")
    return load_robot(path, ARMS[name])


def off_by_constants(robot: Robot, size: float = 1e-2) -> SavedModel:
    """A calibration of all constants of a robot."""
    coefficients = constants(robot, "full")
    return saved_from(Model(robot, coefficients), np.random.default_rng(0).normal(0.0, size, len(coefficients)))


def places(saved: SavedModel, seed: int = 0) -> tuple[dict[str, np.ndarray], dict[str, float], str]:
    """Every link from the root, by Pinocchio, and where the moving joints are; mimics follow."""
    model, robot = saved.geometric.model, saved.geometric.model.robot
    tree = pin.buildModelFromXML(urdf_of(model, saved.geometric.theta).decode())
    rng, data, q = np.random.default_rng(seed), tree.createData(), pin.neutral(tree)
    free = {name: float(rng.uniform(-1.0, 1.0)) for name in tree.names[1:]}
    at = {
        name: drive.offset + sum(factor * free[master] for master, factor in drive.factors.items())
        for name, drive in robot.mimics.items()
    }
    at = free | at
    for name, value in at.items():
        k = tree.getJointId(name)
        q[tree.idx_qs[k] : tree.idx_qs[k] + tree.nqs[k]] = value if tree.nqs[k] == 1 else (np.cos(value), np.sin(value))
    pin.framesForwardKinematics(tree, data, q)
    bodies = [frame.name for frame in tree.frames if frame.type == pin.FrameType.BODY and frame.name != "universe"]
    return {name: data.oMf[tree.getFrameId(name, pin.FrameType.BODY)].homogeneous for name in bodies}, at, bodies[0]


def in_mujoco(file: Path, at: Mapping[str, float], names: Mapping[str, object]) -> dict[str, np.ndarray]:
    """Every body as MuJoCo has it."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_path(str(file))
    data = mujoco.MjData(model)
    for name, value in at.items():
        data.qpos[model.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(model, data)
    T = {}
    for name in names:
        T[name] = np.eye(4)
        T[name][:3, :3], T[name][:3, 3] = data.body(name).xmat.reshape(3, 3), data.body(name).xpos
    return T


def check_same(there: Mapping[str, np.ndarray], here: Mapping[str, np.ndarray], root: str) -> None:
    """Both have each link at the same place in the root."""
    for name, T in here.items():
        inside = np.linalg.inv(there[root]) @ there[name]
        np.testing.assert_allclose(inside, np.linalg.inv(here[root]) @ T, rtol=0, atol=AGREES, err_msg=name)


@pytest.mark.parametrize("arm", ["random", "gantry", "arid", "ur10", *ARMS])
def test_mujoco_has_every_link_of_an_arm_where_pinocchio_has_it_in_calibrated_urdf(arm: str, tmp_path: Path) -> None:
    saved = off_by_constants(arm_of(arm))
    assert export.main([str(written(saved, tmp_path / "r")), "--mjcf", str(tmp_path / "a.xml")]) == 0
    here, at, root = places(saved)
    check_same(in_mujoco(tmp_path / "a.xml", at, here), here, root)


def test_what_a_calibration_without_a_weight_or_with_a_mesh_needs_is_in_mjcf(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    import trimesh

    text = robots.random_chain(np.random.default_rng(1), "RR").decode()
    for mass in ("", '<mass value="0"/>'):
        root = etree.fromstring(text.encode())
        for inertial in root.findall("link/inertial"):
            inertial.getparent().remove(inertial)
        link = root.find("link[@name='link_1']")
        assert link is not None
        shapes = '<box size="1 2 3"/>', '<mesh filename="ball.STL" scale="2 2 2"/>', '<mesh filename="lost.stl"/>'
        for shape in shapes:
            link.append(etree.fromstring(f'<collision><origin xyz="1 2 3"/><geometry>{shape}</geometry></collision>'))
        link.append(etree.fromstring(f"<inertial>{mass}</inertial>"))
        robot = parse_robot(etree.tostring(root), "tip")
        saved = off_by_constants(robot)
        folder = tmp_path / f"r{len(mass)}"
        written(saved, folder)
        trimesh.creation.icosphere(radius=0.5).export(folder / "ball.STL", file_type="stl")
        assert export.main([str(folder), "--mjcf", str(folder / "a.xml")]) == 0
        here, at, first = places(saved)
        check_same(in_mujoco(folder / "a.xml", at, here), here, first)
        assert len(etree.parse(folder / "a.xml").findall(".//geom")) == 2


def in_sdf(file: Path, at: Mapping[str, float]) -> dict[str, np.ndarray]:
    """Every link by the frame semantics of SDF 1.7 and later: `relative_to`, and what moves is the child of a joint."""
    model = etree.parse(file).find("model")
    assert model is not None

    def pose(element: etree._Element) -> np.ndarray:
        numbers = np.array([float(x) for x in (element.findtext("pose") or "0 0 0 0 0 0").split()])
        return pin.SE3(pin.rpy.rpyToMatrix(numbers[3:]), numbers[:3]).homogeneous

    by_child = {joint.findtext("child"): joint for joint in model.findall("joint")}

    def place(link: str) -> np.ndarray:
        joint = by_child.get(link)
        if joint is None:
            return np.eye(4)
        parent, name = joint.findtext("parent"), joint.get("name", "")
        assert parent is not None and joint.find("pose").get("relative_to") == parent
        own = model.find(f"link[@name='{link}']")
        assert own is not None and own.find("pose").get("relative_to") == name and not pose(own)[:3, 3].any()
        kind, T = joint.get("type"), np.eye(4)
        if kind != "fixed":
            axis = np.array([float(x) for x in joint.findtext("axis/xyz", "").split()])
            twist = np.r_[axis * at[name], 0, 0, 0] if kind == "prismatic" else np.r_[0, 0, 0, axis * at[name]]
            T = pin.exp6(twist).homogeneous
        return (np.eye(4) if parent == "world" else place(parent)) @ pose(joint) @ T

    return {str(link.get("name")): place(str(link.get("name"))) for link in model.findall("link")}


@pytest.mark.parametrize("arm", ["random", "gantry", "panda_description/urdf/panda.urdf"])
def test_sdf_has_every_link_where_calibrated_urdf_has_it(arm: str, tmp_path: Path) -> None:
    saved = off_by_constants(arm_of(arm))
    assert export.main([str(written(saved, tmp_path / "r")), "--sdf", str(tmp_path / "a.sdf")]) == 0
    here, at, root = places(saved)
    check_same(in_sdf(tmp_path / "a.sdf", at), here, root)
    parsing = pytest.importorskip(
        "pydrake.multibody.parsing", reason="drake is not installed: SDF read by its rules alone"
    )
    from pydrake.multibody.plant import MultibodyPlant

    plant = MultibodyPlant(1e-3)
    parsing.Parser(plant).AddModels(str(tmp_path / "a.sdf"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    for name, value in at.items():
        joint, q = plant.GetJointByName(name), plant.GetPositions(context)
        q[joint.position_start()] = value
        plant.SetPositions(context, q)
    there = {name: plant.GetBodyByName(name).EvalPoseInWorld(context).GetAsMatrix4() for name in here}
    check_same(there, here, root)


def test_a_description_that_uses_the_macro_has_the_origins_of_calibrated_urdf(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    saved = off_by_constants(robots.ur10())
    assert export.main([str(written(saved, tmp_path / "r")), "--xacro", str(tmp_path / "origins.xacro")]) == 0
    root = etree.fromstring(saved.geometric.model.robot.urdf)
    X = "http://www.ros.org/wiki/xacro"
    uses = etree.Element("robot", name="ur10", nsmap={"xacro": X})
    etree.SubElement(uses, f"{{{X}}}include", filename="origins.xacro")
    for element in root:
        if element.tag == "joint":
            origin = element.find("origin")
            assert origin is not None
            element.replace(origin, etree.Element(f"{{{X}}}calibrated_origin", joint=element.get("name", "")))
        uses.append(element)
    (tmp_path / "ur10.urdf.xacro").write_bytes(etree.tostring(uses))
    used = load_robot(tmp_path / "ur10.urdf.xacro", "tool0")
    model = saved.geometric.model
    calibrated = parse_robot(urdf_of(model, saved.geometric.theta), "tool0")
    for there, here in zip(used.onward, calibrated.onward, strict=True):
        np.testing.assert_array_equal(there.homogeneous, here.homogeneous)


def test_draws_have_the_covariance_that_the_calibration_states_and_each_its_urdf(tmp_path: Path) -> None:
    robot, rng = robots.ur10(), np.random.default_rng(5)
    sag = Coefficient("elbow_joint", "axis", Basis("linear", ("elbow_joint.gravity_torque",), (0.0,)))
    coefficients = (*constants(robot, "full")[:11], sag)
    K, count = len(coefficients), 2000
    spread = rng.normal(size=(K, K)) * np.array([1e-3] * (K - 1) + [1e-7])[:, None]
    spread[:, 3] = 0.0  # one combination less than coefficients: singular
    saved = saved_from(Model(robot, coefficients), rng.normal(0.0, 1e-3, K))
    final = replace(saved.final, covariance=spread @ spread.T)
    folder = written(replace(saved, final=final), tmp_path / "r")
    command = [str(folder), "--randomize", "3", "--seed", "7", "-o"]
    assert export.main([*command, str(tmp_path / "a")]) == 0 == export.main([*command, str(tmp_path / "b")])
    table = pd.read_csv(tmp_path / "a" / "draws.csv")
    assert list(table.columns) == [c.name for c in coefficients]
    drawn = draws(final, count, 7)
    np.testing.assert_allclose(table.to_numpy(), drawn[:3], rtol=1e-9)  # more draws begin with the same ones
    away = drawn - final.theta
    distance = np.sum(away @ np.linalg.pinv(final.covariance, rcond=1e-14, hermitian=True) * away, axis=1)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], count * (K - 1))
    assert low < distance.sum() < high
    for k in (1, 2, 3):
        text = (tmp_path / "a" / f"model_{k}.urdf").read_bytes()
        assert (
            text == (tmp_path / "b" / f"model_{k}.urdf").read_bytes() == urdf_of(final.model, table.to_numpy()[k - 1])
        )
    assert export.main([str(folder), "--randomize", "2", "-o", str(tmp_path / "a")]) == 0
    assert sorted(p.name for p in (tmp_path / "a").iterdir()) == [
        "draws.csv",
        "frames.csv",
        "model_1.urdf",
        "model_2.urdf",
    ]


def test_every_form_of_basis_has_a_column_of_its_own_in_the_draws(tmp_path: Path) -> None:
    saved = spoilt(3, robots.random_robot(1))
    assert export.main([str(written(saved, tmp_path / "r")), "--randomize", "1", "-o", str(tmp_path / "a")]) == 0
    table = pd.read_csv(tmp_path / "a" / "draws.csv")
    drawn = pd.read_csv(tmp_path / "a" / "frames.csv").iloc[0]
    for where, ((_, frame),) in zip(
        ("world_base", "tip_target"), saved.final.model.frames(table.to_numpy()[0]), strict=True
    ):
        T = pin.XYZQUATToSE3(np.array([drawn[f"{where}.{key}"] for key in ("x", "y", "z", "qx", "qy", "qz", "qw")]))
        np.testing.assert_allclose(T.homogeneous, frame.homogeneous, rtol=0, atol=1e-12)
    assert list(table.columns) == [c.name for c in saved.final.model.coefficients]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--randomize", "3"], "-o DIR"),
        (["-o", "out"], "--randomize N"),
        (["--randomize", "0", "-o", "out"], "from 1 to"),
        (["--randomize", "2", "-o", "mine"], "has model_1.urdf, and no draws.csv"),
        (["--mjcf", "a.mjcf"], "should be a .xml file"),
        (["--mjcf", "mine/own.xml"], "own.xml: is there"),
        (["--sdf", "a.xml"], "should be a .sdf file"),
    ],
)
def test_what_cannot_be_written_is_refused_and_what_is_there_stays(
    options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    written(off_by_constants(robots.arid()), Path("r"))
    Path("mine").mkdir()
    for name in ("own.xml", "model_1.urdf"):
        (Path("mine") / name).write_text("mine\n")
    before = sorted(map(str, tmp_path.rglob("*")))
    assert export.main(["r", *options]) == 2
    assert words in " ".join(capsys.readouterr().err.split())
    assert sorted(map(str, tmp_path.rglob("*"))) == before


def test_the_list_has_what_there_is_for_whom_and_the_error_that_remains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = written(off_by_constants(robots.arid()), tmp_path / "r")
    (folder / "joint_offsets.yaml").write_text(
        "# joint offsets alone: 1.144 mm RMS position error on 9 held-out rows, 1 mm from the full model there.\n"
        "# All exports: nominal 1.152 mm, joint offsets alone 1.144, URDF alone 0.443, + joint maps 0.275, full model 0.083.\n"
    )
    (folder / "calibrated.urdf").write_text("<robot/>")
    assert export.main([str(folder), "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    shown = dict(zip((line.strip() for line in lines[1::2]), lines[::2], strict=True))
    error = {how.split(f"{folder}")[1].split()[0].strip("/"): line.rsplit(", ", 1)[1] for how, line in shown.items()}
    assert error["--mjcf"] == error["calibrated.urdf"] == "0.443 mm on the same rows"
    assert error["--c"] == error["--ros2"] == error["PROGRAM"] == "0.083 mm on the same rows"
    assert (
        error["--table"] == "0.275 mm on the same rows" and error["joint_offsets.yaml"] == "1.144 mm on the same rows"
    )
    assert "kinematics.yaml" not in error  # this calibration has none
