"""Tables of controllers: as their text says they are the robot, and nominal ones are those that makers publish."""

from importlib.metadata import distribution

import numpy as np
import pinocchio as pin
import pytest
import yaml
from repository import ROOT

from aridcal.engine.robot.chain import load_robot, parse_robot
from aridcal.engine.robot.dh import kinematics_yaml, modified_dh, standard_dh
from aridcal.engine.robot.splice import splice_origins

PUBLIC = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
OURS = ROOT / "urdf"
ROBOTS = {
    "arid": (OURS / "arid.urdf", "flange", None),
    "ur10": (OURS / "ur10.urdf", "tool0", None),
    "ur5": (PUBLIC / "ur_description/urdf/ur5_robot.urdf", "tool0", "base_link"),
    "panda": (PUBLIC / "panda_description/urdf/panda.urdf", "panda_link8", None),
    "xarm7": (PUBLIC / "xarm_description/urdf/xarm7.urdf", "link7", None),
    "baxter": (PUBLIC / "baxter_description/urdf/baxter.urdf", "left_gripper", "base"),
    "kinova": (PUBLIC / "kinova_description/robots/kinova.urdf", "j2s6s200_end_effector", None),
    "tiago": (PUBLIC / "tiago_description/robots/tiago.urdf", "arm_tool_link", None),
    "talos": (PUBLIC / "talos_data/robots/talos_left_arm.urdf", "wrist_left_ft_tool_link", None),
}
SCARA = [  # a quill that slides down, and turns about the same line; its arm's second axis points down too
    ("revolute", "0 0 0.4", "0 0 0", "0 0 1"),
    ("revolute", "0.3 0 0", "0 0 0", "0 0 -1"),
    ("prismatic", "0.2 0 0", "0 0 0", "0 0 -1"),
    ("continuous", "0 0 -0.1", "0 0 0", "0 0 1"),
]


def chain(joints):
    """The robot of (type, xyz, rpy, axis) for each joint."""
    text = '<robot name="r"><link name="0"/>'
    for k, (kind, xyz, rpy, axis) in enumerate(joints):
        text += f'<link name="{k + 1}"/><joint name="j{k}" type="{kind}"><parent link="{k}"/><child link="{k + 1}"/>'
        text += f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>'
        text += '<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>'
    return parse_robot((text + "</robot>").encode(), str(len(joints)))


def load(name):
    path, tip, base = ROBOTS[name]
    return load_robot(path, tip, base)


def corrected(robot, rng, size):
    """The chain with every origin, the tip's too, off by `size` (m and rad, 1 sigma), read back from its URDF."""
    placements = {j.name: j.origin for j in robot.joints}
    if robot.tip_joint:
        placements[robot.tip_joint] = robot.tip_origin
    origins = {}
    for name, T in placements.items():
        T = T * pin.SE3(pin.exp3(size * rng.normal(size=3)), size * rng.normal(size=3))
        origins[name] = (T.translation, pin.rpy.matrixToRpy(T.rotation))
    return parse_robot(splice_origins(robot.urdf, origins), robot.tip, robot.base)


def poses(robot, positions):
    """Pinocchio's T_base_tip of the robot's URDF."""
    model = pin.buildModelFromXML(robot.urdf.decode())
    data = model.createData()
    base, tip = model.getFrameId(robot.base), model.getFrameId(robot.tip)
    found = []
    for row in positions:
        q = pin.neutral(model)
        for name, value in zip(robot.names, row, strict=True):
            k = model.getJointId(name)
            both = [np.cos(value), np.sin(value)] if model.nqs[k] == 2 else [value]
            q[model.idx_qs[k] : model.idx_qs[k] + model.nqs[k]] = both
        pin.framesForwardKinematics(model, data, q)
        found.append(data.oMf[base].actInv(data.oMf[tip]).homogeneous)
    return np.array(found)


def random_positions(robot, rng, n):
    return rng.uniform(-2, 2, (n, len(robot.joints)))


def transform(values):
    xyz, rpy = [values[k] for k in "xyz"], [values[k] for k in ("roll", "pitch", "yaw")]
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def z_turn(q):
    return pin.SE3(pin.exp3(np.array([0.0, 0.0, q])), np.zeros(3))


@pytest.mark.parametrize("table", [standard_dh, modified_dh])
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("size", [0.0, 3e-3])
def test_dh_tables_give_the_chains_forward_kinematics(name, size, table):
    rng = np.random.default_rng(1)
    robot = corrected(load(name), rng, size)
    q = random_positions(robot, rng, 100)
    np.testing.assert_allclose(table(robot).poses(q), poses(robot, q), rtol=0, atol=1e-9)


@pytest.mark.parametrize("table", [standard_dh, modified_dh])
def test_dh_tables_hold_for_coincident_and_antiparallel_axes_and_sliding_joints(table):
    robot = chain(SCARA)
    q = random_positions(robot, np.random.default_rng(2), 50)
    np.testing.assert_allclose(table(robot).poses(q), poses(robot, q), rtol=0, atol=1e-14)


@pytest.mark.parametrize("table", [standard_dh, modified_dh])
def test_dh_tables_hold_for_axes_in_any_direction(table):
    rng = np.random.default_rng(3)
    for _ in range(30):
        kinds = rng.choice(["revolute", "prismatic"], 5)
        robot = chain([(kind, vector(rng), vector(rng), vector(rng)) for kind in kinds])
        q = random_positions(robot, rng, 20)
        got = table(robot)
        # Rounding grows with d, which grows as axes come near to parallel: two of 120 come within some degrees of it.
        reach = 1 + max(abs(row.d) for row in got.rows)
        np.testing.assert_allclose(got.poses(q), poses(robot, q), rtol=0, atol=1e-14 * reach)


def vector(rng):
    return " ".join(map(str, rng.normal(size=3)))


def test_nearly_parallel_axes_are_flagged_and_stay_within_nanometres():
    robot = load("ur10")
    nominal = {j.name: j.origin for j in robot.joints}["elbow_joint"]
    q = random_positions(robot, np.random.default_rng(4), 20)
    for degrees, flagged, offset in [
        (0.0, True, (0.0, 1e-9)),
        (0.09, True, (300, 500)),
        (0.9, True, (30, 50)),
        (1.1, False, (25, 40)),
    ]:
        turned = nominal.rotation @ pin.exp3(np.array([np.radians(degrees), 0.0, 0.0]))  # across the elbow's axis, y
        spliced = splice_origins(robot.urdf, {"elbow_joint": (nominal.translation, pin.rpy.matrixToRpy(turned))})
        tilted = parse_robot(spliced, robot.tip, robot.base)
        table = standard_dh(tilted)
        row = table.rows[1]
        assert row.joint == "shoulder_lift_joint"
        assert row.ill_conditioned is flagged
        assert offset[0] <= abs(row.d) <= offset[1]
        np.testing.assert_allclose(table.poses(q), poses(tilted, q), rtol=0, atol=1e-9)
        assert modified_dh(tilted).rows[1].ill_conditioned is flagged


def test_the_table_of_the_panda_is_the_one_its_maker_publishes():
    # Franka control interface documentation, "Denavit-Hartenberg parameters" (Craig's convention).
    published = {
        "a": [0, 0, 0, 0.0825, -0.0825, 0, 0.088],
        "d": [0.333, 0, 0.316, 0, 0.384, 0, 0.107],
        "alpha": [0, -90, 90, 90, -90, 90, 90],
        "theta": [0, 0, 0, 0, 0, 0, 0],
    }
    table = modified_dh(load("panda"))
    for key, values in published.items():
        got = [getattr(row, key) for row in table.rows]
        np.testing.assert_allclose(got, np.radians(values) if key == "alpha" else values, rtol=0, atol=1e-12)
    np.testing.assert_allclose(table.base.homogeneous, np.eye(4), rtol=0, atol=1e-15)
    np.testing.assert_allclose(table.tool.homogeneous, np.eye(4), rtol=0, atol=1e-15)


@pytest.mark.parametrize("modified", [False, True])
def test_a_written_table_multiplied_out_as_its_text_says_is_the_robot(modified):
    rng = np.random.default_rng(5)
    robot = corrected(load("arid"), rng, 1e-2)
    table = (modified_dh if modified else standard_dh)(robot)
    read = yaml.safe_load(table.dump())
    q = random_positions(robot, rng, 1)
    T = placed(read["base"])
    for row, value in zip(read["rows"], q[0], strict=True):
        row["theta" if row["kind"] == "revolute" else "d"] += value
        screw_z = z_turn(row["theta"]) * pin.SE3(np.eye(3), np.array([0, 0, row["d"]]))
        screw_x = pin.SE3(pin.exp3(np.array([row["alpha"], 0, 0])), np.array([row["a"], 0, 0]))
        T = T * (screw_x * screw_z if modified else screw_z * screw_x)
    np.testing.assert_allclose((T * placed(read["tool"])).homogeneous, poses(robot, q)[0], rtol=0, atol=1e-12)


def placed(frame):
    return pin.SE3(pin.rpy.rpyToMatrix(*frame["rpy"]), np.array(frame["xyz"]))


@pytest.mark.parametrize(
    ("name", "published"),
    [  # universal-robots.com, "DH parameters for calculations of kinematics and dynamics": d1, a2, a3, d4, d5, d6
        ("ur10", (0.1273, -0.612, -0.5723, 0.163941, 0.1157, 0.0922)),
        ("ur5", (0.089159, -0.425, -0.39225, 0.10915, 0.09465, 0.0823)),
    ],
)
def test_a_nominal_ur_gives_the_kinematics_yaml_of_its_description(name, published):
    d1, a2, a3, d4, d5, d6 = published
    expected = {
        "shoulder": ([0, 0, d1], [0, 0, 0]),
        "upper_arm": ([0, 0, 0], [np.pi / 2, 0, 0]),
        "forearm": ([a2, 0, 0], [0, 0, 0]),
        "wrist_1": ([a3, 0, d4], [0, 0, 0]),
        "wrist_2": ([0, -d5, 0], [np.pi / 2, 0, 0]),
        "wrist_3": ([0, d6, 0], [np.pi / 2, np.pi, np.pi]),
    }
    robot = load(name)
    links = yaml.safe_load(kinematics_yaml(robot, robot))["kinematics"]
    assert list(links) == [*expected, "hash"]
    for link, (xyz, rpy) in expected.items():
        got = transform(links[link])
        np.testing.assert_allclose(got.translation, xyz, rtol=0, atol=1e-5)  # these URDFs carry five decimals
        np.testing.assert_allclose(got.rotation, pin.rpy.rpyToMatrix(*map(float, rpy)), rtol=0, atol=1e-9)


def test_a_calibrated_urs_kinematics_yaml_is_its_forward_kinematics_without_kilometres():
    rng = np.random.default_rng(6)
    nominal = load("ur10")
    for robot in (nominal, corrected(nominal, rng, 1e-5)):  # the second as if calibrated before, by its maker
        calibrated = corrected(robot, rng, 1e-3)
        text = kinematics_yaml(robot, calibrated)
        links = yaml.safe_load(text)["kinematics"]
        links.pop("hash")
        left = yaml.safe_load(text.splitlines()[1].partition(": ")[2])
        q = random_positions(nominal, rng, 20)
        for row, T_base_tip in zip(q, poses(calibrated, q), strict=True):
            T = z_turn(np.pi)  # base_link to base_link_inertia
            for values, angle in zip(links.values(), row, strict=True):
                T = T * transform(values) * z_turn(angle)
            np.testing.assert_allclose((T * transform(left)).homogeneous, T_base_tip, rtol=0, atol=1e-12)
        usual = yaml.safe_load(kinematics_yaml(nominal, nominal))["kinematics"]
        for link, values in links.items():
            apart = transform(usual[link]).actInv(transform(values))
            assert np.linalg.norm(apart.translation) < 0.02
            assert np.linalg.norm(pin.log3(apart.rotation)) < 0.02


@pytest.mark.parametrize("name", ["panda", "kinova", "arid"])
def test_kinematics_yaml_of_other_robots_put_into_their_urdf_is_the_calibrated_one(name):
    rng = np.random.default_rng(7)
    nominal = load(name)
    calibrated = corrected(nominal, rng, 1e-5)  # small enough for numbers that YAML would read as text: 1e-05
    read = yaml.safe_load(kinematics_yaml(nominal, calibrated))
    prefix = "panda_" if name == "panda" else ""
    assert [prefix + key for key in read] == [*nominal.names, nominal.tip_joint]
    T = {prefix + key: entry["kinematic"] for key, entry in read.items()}
    origins = {n: ([v[k] for k in "xyz"], [v[k] for k in ("roll", "pitch", "yaw")]) for n, v in T.items()}
    q = random_positions(nominal, rng, 20)
    spliced = parse_robot(splice_origins(nominal.urdf, origins), nominal.tip, nominal.base)
    np.testing.assert_allclose(poses(spliced, q), poses(calibrated, q), rtol=0, atol=1e-14)


def mounted(urdf, base):
    """A UR on a pedestal: the chain starts at ``base``, 0.7 m below ``base_link`` and turned."""
    extra = f'<link name="{base}"/><joint name="pedestal" type="fixed"><parent link="{base}"/><child link="base_link"/>'
    extra += '<origin xyz="0.1 -0.2 0.7" rpy="0.3 0.1 -0.4"/></joint></robot>'
    return urdf.replace(b"</robot>", extra.encode())


def test_a_ur_on_a_pedestal_has_the_same_kinematics_yaml():
    """The chain may start at `world`: ur_description's frames still start at its base_link."""
    rng = np.random.default_rng(8)
    plain = load("ur10")
    calibrated = corrected(plain, rng, 1e-3)
    on_it = [parse_robot(mounted(robot.urdf, "world"), "tool0", "world") for robot in (plain, calibrated)]
    wanted = yaml.safe_load(kinematics_yaml(plain, calibrated))["kinematics"]
    found = yaml.safe_load(kinematics_yaml(*on_it))["kinematics"]
    for link in ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3"):
        assert found[link] == pytest.approx(wanted[link], abs=1e-12)


def test_a_chain_from_base_link_inertia_has_the_same_kinematics_yaml():
    rng = np.random.default_rng(9)
    plain = load("ur10")
    calibrated = corrected(plain, rng, 1e-3)
    turned = []
    for robot in (plain, calibrated):
        text = robot.urdf.decode().replace('"base_link"', '"base_link_inertia"')
        first = next(j for j in robot.joints)
        turn = z_turn(np.pi) * first.origin
        origins = {first.name: (turn.translation, pin.rpy.matrixToRpy(turn.rotation))}
        turned.append(parse_robot(splice_origins(text.encode(), origins), "tool0"))
    assert turned[0].base == "base_link_inertia"
    wanted = yaml.safe_load(kinematics_yaml(plain, calibrated))["kinematics"]
    found = yaml.safe_load(kinematics_yaml(*turned))["kinematics"]
    for link in wanted.keys() - {"hash"}:
        assert found[link] == pytest.approx(wanted[link], abs=1e-12)


def test_another_layout_for_a_ur_is_not_taken_silently():
    robot = load("ur10")
    renamed = parse_robot(robot.urdf.replace(b'"base_link"', b'"foot"'), "tool0")
    text = kinematics_yaml(renamed, renamed)
    assert text.startswith("# Each joint's own <origin>, not the layout of ur_description: ")
    assert "foot" in text.splitlines()[0]
    assert set(yaml.safe_load(text)) >= set(robot.names)


def test_kinematics_yaml_has_no_far_branches_and_no_rounding():
    nominal = load("ur10")
    calibrated = corrected(nominal, np.random.default_rng(10), 1e-3)
    usual, found = (yaml.safe_load(kinematics_yaml(nominal, robot))["kinematics"] for robot in (nominal, calibrated))
    for link in found.keys() - {"hash"}:
        assert found[link] == pytest.approx(usual[link], abs=0.02)
        assert all(value == 0 or abs(value) > 1e-14 for value in usual[link].values())
