"""A calibrated URDF means the same to readers that nobody here wrote: public robots, random corrections."""

import io
import re
import shutil
import subprocess
import sys
from importlib.metadata import distribution
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from lxml import etree

from aridcal.engine.fit.constants import constants
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot
from aridcal.engine.robot.splice import splice_origins

PUBLIC = Path(str(distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")))
ROBOTS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", None, "tool0"),
    "panda": ("panda_description/urdf/panda.urdf", None, "panda_link8"),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", None, "link7"),
    "kinova": ("kinova_description/robots/kinova.urdf", None, "j2s6s200_end_effector"),
    "baxter": ("baxter_description/urdf/baxter.urdf", "base", "left_gripper"),
    "tiago": ("tiago_description/robots/tiago.urdf", None, "arm_tool_link"),
}
CONFIGURATIONS = 1000
CLOSE = 1e-9

KDL = r"""
#include <kdl_parser/kdl_parser.hpp>
#include <kdl/chainfksolverpos_recursive.hpp>
#include <iostream>
int main(int, char** argv) {  // file base tip; joint values on stdin; nine numbers of the rotation and three of the place
  KDL::Tree tree;
  KDL::Chain chain;
  if (!kdl_parser::treeFromFile(argv[1], tree) || !tree.getChain(argv[2], argv[3], chain)) return 1;
  for (const auto& segment : chain.segments)
    if (segment.getJoint().getType() != KDL::Joint::None) std::cerr << segment.getJoint().getName() << "\n";
  KDL::ChainFkSolverPos_recursive solver(chain);
  KDL::JntArray q(chain.getNrOfJoints());
  KDL::Frame T;
  std::cout.precision(17);
  for (;;) {
    for (unsigned k = 0; k < q.rows(); ++k)
      if (!(std::cin >> q(k))) return 0;
    if (solver.JntToCart(q, T) < 0) return 2;
    for (double value : T.M.data) std::cout << value << " ";
    for (double value : T.p.data) std::cout << value << " ";
    std::cout << "\n";
  }
}
"""


class Calibrated:
    """A public robot with every constant off by centimetres and centiradians: the file, and where the model has the tip."""

    def __init__(self, name: str) -> None:
        file, base, self.tip = ROBOTS[name]
        nominal = load_robot(PUBLIC / file, self.tip, base)
        rng = np.random.default_rng(list(ROBOTS).index(name))
        model = Model(nominal, constants(nominal, "full"))
        theta = rng.normal(0.0, 1e-2, len(model.coefficients))
        origins = model.origins(theta).items()
        self.urdf = splice_origins(
            nominal.urdf, {n: (T.translation, pin.rpy.matrixToRpy(T.rotation)) for n, T in origins}
        )
        self.robot: Robot = nominal
        self.base = nominal.base
        low, high = np.clip(nominal.limits, -np.pi, np.pi).T
        assert nominal.readings == nominal.names
        self.q = rng.uniform(low, high, (CONFIGURATIONS, len(low)))
        self.R, self.p = model.poses(theta, model.rows(self.q))
        bare = Model(nominal, ())
        moved = bare.poses(np.zeros(0), bare.rows(self.q))[1] - self.p
        assert np.linalg.norm(moved, axis=1).min() > 1e-3  # the corrections matter

    def check(self, R: np.ndarray, p: np.ndarray) -> None:
        np.testing.assert_allclose(p, self.p, rtol=0, atol=CLOSE)
        np.testing.assert_allclose(R, self.R, rtol=0, atol=CLOSE)


@pytest.fixture(scope="module", params=ROBOTS)
def calibrated(request: pytest.FixtureRequest) -> Calibrated:
    return Calibrated(request.param)


def test_pinocchio_reads_back_the_model(calibrated):
    model = pin.buildModelFromXML(calibrated.urdf.decode())
    data = model.createData()
    base, tip = (model.getFrameId(name) for name in (calibrated.base, calibrated.tip))
    T = []
    for row in calibrated.q:
        q = pin.neutral(model)
        for name, value in zip(calibrated.robot.names, row, strict=True):
            k = model.getJointId(name)
            own = [np.cos(value), np.sin(value)] if model.nqs[k] == 2 else [value]
            q[model.idx_qs[k] : model.idx_qs[k] + model.nqs[k]] = own
        pin.framesForwardKinematics(model, data, q)
        T.append((data.oMf[base].inverse() * data.oMf[tip]).homogeneous)
    calibrated.check(np.array(T)[:, :3, :3], np.array(T)[:, :3, 3])


def test_yourdfpy_reads_back_the_model(calibrated):
    urdf = re.sub(rb"<mimic[^>]*>", b"", calibrated.urdf)  # of the gripper; yourdfpy would want its master's place
    robot = yourdfpy.URDF.load(io.BytesIO(urdf), load_meshes=False, build_collision_scene_graph=False)
    T = []
    for row in calibrated.q:
        robot.update_cfg(dict(zip(calibrated.robot.names, row, strict=True)))
        T.append(robot.get_transform(calibrated.tip, calibrated.base))
    calibrated.check(np.array(T)[:, :3, :3], np.array(T)[:, :3, 3])


def test_mujoco_reads_back_the_model(calibrated):
    mujoco = pytest.importorskip("mujoco")
    root = etree.fromstring(calibrated.urdf)
    for element in root.xpath("//visual | //collision | //inertial"):  # meshes are not here; some inertias are unreal
        element.getparent().remove(element)
    compiler = etree.SubElement(etree.SubElement(root, "mujoco"), "compiler")
    compiler.attrib.update({"fusestatic": "false", "boundmass": "0.001", "boundinertia": "0.001"})
    model = mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode"))
    data = mujoco.MjData(model)
    places = [model.joint(name).qposadr[0] for name in calibrated.robot.names]
    R, p = [], []
    for row in calibrated.q:
        data.qpos[places] = row
        mujoco.mj_kinematics(model, data)
        base, tip = data.body(calibrated.base), data.body(calibrated.tip)
        R_base = base.xmat.reshape(3, 3)
        R.append(R_base.T @ tip.xmat.reshape(3, 3))
        p.append(R_base.T @ (tip.xpos - base.xpos))
    calibrated.check(np.array(R), np.array(p))


def test_kinpy_reads_back_the_model(calibrated):
    kinpy = pytest.importorskip("kinpy")
    chain = kinpy.build_serial_chain_from_urdf(calibrated.urdf, calibrated.tip, calibrated.base)
    assert chain.get_joint_parameter_names() == list(calibrated.robot.names)
    T = np.array([chain.forward_kinematics(row).matrix() for row in calibrated.q])
    calibrated.check(T[:, :3, :3], T[:, :3, 3])


def test_check_urdf_accepts_the_file(calibrated, tmp_path):
    program = shutil.which("check_urdf", path=Path(sys.executable).parent) or shutil.which("check_urdf")
    if program is None:
        pytest.skip("check_urdf is not installed (Debian: liburdfdom-tools)")
    (tmp_path / "calibrated.urdf").write_bytes(calibrated.urdf)
    done = subprocess.run([program, tmp_path / "calibrated.urdf"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "Successfully Parsed XML" in done.stdout


@pytest.fixture(scope="module")
def kdl_program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler, header = shutil.which("g++"), Path("/usr/include/kdl_parser/kdl_parser.hpp")
    if compiler is None or not header.exists():
        pytest.skip("kdl_parser or g++ is not installed (Debian: libkdl-parser-dev g++)")
    folder = tmp_path_factory.mktemp("kdl")
    (folder / "kdl.cpp").write_text(KDL)
    command = [compiler, "-std=c++17", "-I/usr/include/eigen3", "kdl.cpp", "-o", "kdl", "-lkdl_parser", "-lorocos-kdl"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder / "kdl"


def test_kdl_parser_reads_back_the_model(calibrated, kdl_program, tmp_path):
    (tmp_path / "calibrated.urdf").write_bytes(calibrated.urdf)
    rows = "\n".join(" ".join(f"{v:.17g}" for v in row) for row in calibrated.q)
    command = [kdl_program, tmp_path / "calibrated.urdf", calibrated.base, calibrated.tip]
    done = subprocess.run(command, input=rows, capture_output=True, text=True, check=True)
    names = [line for line in done.stderr.splitlines() if line in calibrated.robot.names]
    assert names == list(calibrated.robot.names)
    T = np.array([[float(v) for v in line.split()] for line in done.stdout.splitlines()])
    calibrated.check(T[:, :9].reshape(-1, 3, 3), T[:, 9:])
