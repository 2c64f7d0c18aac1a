"""Robots in MuJoCo's own format: read as MuJoCo reads them, and written back with nothing but places of bodies changed."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import robots
import yaml
from exported import saved_from, written
from lxml import etree

import aridcal
from aridcal import export, identify, simulate
from aridcal.engine.fit.constants import constants, origins_of
from aridcal.engine.model.model import Model
from aridcal.engine.robot.chain import Robot, load_robot, parse_robot
from aridcal.engine.robot.splice_mjcf import check_written_back, splice_mjcf
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.system.errors import AridcalError

mujoco = pytest.importorskip("mujoco")

AGREES = 1e-9
"""[m] and in R."""

ARM = """<?xml version='1.0'?>
<!-- an arm as people write it: > and "quotes" in comments -->
<mujoco model="arm">
  <compiler angle="degree" eulerseq="zyX" autolimits="true"/>
  <option gravity="0 0 -9.81"/>
  <default>
    <joint damping="1" axis="0 0.6 0.8"/>
    <default class="arm"><joint range="-170 170"/><site pos="0 0 .1" euler="0 0 30"/>
      <default class="slider"><joint type="slide" range="-.3 .4" axis='1 0 0'/></default>
    </default>
  </default>
  <asset><texture name="t" type="2d" builtin="flat" width="4" height="4"/></asset>
  <worldbody>
    <light pos="0 0 3"/><geom type="plane" size="1 1 .1"/>
    <body name="base" pos=".1 .2 .3" euler="10 20 -30" childclass="arm">
      <inertial pos="0 0 .1" mass="2" diaginertia=".01 .01 .01"/>
      <body name = 'shoulder' pos = "0 .1 .4" axisangle="1 2 3 40">
        <joint name="pan" pos=".01 .02 .03" ref="20"/><geom size=".1"/>
        <body name="upper" xyaxes="0 1 0 -1 .1 .2"  pos="0.3 0 0"><joint name="lift" axis="0 1 0" limited="false"/>
          <inertial pos="0 0 .1" mass="2" fullinertia=".01 .02 .015 .001 0 -.001"/>
          <body name="carriage" zaxis="1 0.1 0.5"><joint class="slider" name="rail" ref=".1"/><geom size=".1"/>
            <body quat="2 0 1 1" pos="0.1 0 0"><joint name="roll" axis="0 0 2"/><geom size=".1"/>
              <body name="wrist" pos="0 0 .2"><joint name="bend"/><geom size=".1"/>
                <site name="tcp"/><site pos="1 1 1"/><site name="wrist" size=".01"/>
                <body name="finger" pos="0 .1 0"><joint name="grip" type="slide" axis="0 1 0"/>
                  <joint name="turn"/><geom size=".1"/></body>
                <body name="other" pos="0 -.1 0"><joint name="grip_2" type="slide" axis="0 1 0"/><geom size=".1"/></body>
              </body>
            </body>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <equality><joint joint1="grip" joint2="grip_2"/></equality>
  <actuator><motor joint="pan"/></actuator>
</mujoco>
"""

URDFS = {
    "ur_description/urdf/ur3_robot.urdf": "tool0",
    "ur_description/urdf/ur5_robot.urdf": "tool0",
    "ur_description/urdf/ur10_robot.urdf": "tool0",
    "panda_description/urdf/panda.urdf": "panda_hand_tcp",
    "kinova_description/robots/kinova.urdf": "j2s6s200_end_effector",
    "xarm_description/urdf/xarm7.urdf": "link7",
    "z1_description/urdf/z1.urdf": "link06",
    "so_arm_description/urdf/so101.urdf": "gripper_link",
    "alex_description/urdf/alex_nub_hands.urdf": "leftNub",
    "baxter_description/urdf/baxter.urdf": "left_wrist",
}
"""Ten arms of example-robot-data."""


def calibrated(robot: Robot, seed: int = 0) -> SavedModel:
    """A calibration of all constants."""
    coefficients = constants(robot, "full")
    return saved_from(Model(robot, coefficients), np.random.default_rng(seed).normal(0.0, 1e-2, len(coefficients)))


def in_mujoco(content: bytes, robot: Robot, q: np.ndarray, site: bool) -> np.ndarray:
    """The tip in the base for rows of readings, as MuJoCo has it."""
    model = mujoco.MjModel.from_xml_string(content.decode())
    data, T = mujoco.MjData(model), []
    for row in q:
        data.qpos[:] = model.qpos0
        for name, value in zip(robot.readings, row, strict=True):
            data.qpos[model.joint(name).qposadr[0]] = value
        mujoco.mj_kinematics(model, data)
        tip = data.site(robot.tip) if site else data.body(robot.tip)
        of_tip, of_base = np.eye(4), np.eye(4)
        of_tip[:3, :3], of_tip[:3, 3] = tip.xmat.reshape(3, 3), tip.xpos
        base = data.body(robot.base)
        of_base[:3, :3], of_base[:3, 3] = base.xmat.reshape(3, 3), base.xpos
        T.append(np.linalg.inv(of_base) @ of_tip)
    return np.array(T)


def check_same(content: bytes, model: Model, theta: np.ndarray, site: bool) -> None:
    """MuJoCo has the tip where the model has it."""
    q = robots.readings(model.robot, 20, np.random.default_rng(1), 0.5)
    R, p = model.poses(theta, model.rows(q))
    T = in_mujoco(content, model.robot, q, site)
    np.testing.assert_allclose(T[:, :3, :3], R, rtol=0, atol=AGREES)
    np.testing.assert_allclose(T[:, :3, 3], p, rtol=0, atol=AGREES)


def without_places(content: bytes) -> bytes:
    """A file without the places of its bodies and sites."""
    tag = rb"<(body|site)((?:\s+[\w-]+\s*=\s*(?:\"[^\"]*\"|'[^']*'))*)"
    place = rb"\s+(pos|quat|euler|axisangle|xyaxes|zaxis)\s*=\s*(\"[^\"]*\"|'[^']*')"
    return re.sub(tag, lambda match: b"<" + match[1] + re.sub(place, b"", match[2]), content)


@pytest.mark.parametrize(("base", "tip"), [("world", "tcp"), ("base", "wrist"), ("upper", "tcp"), ("tcp", "base")])
def test_mujoco_has_the_tip_where_we_have_it_before_and_after_and_all_other_bytes_are_kept(base: str, tip: str) -> None:
    robot = parse_robot(ARM.encode(), tip, base, Path("arm.xml"))
    check_written_back(robot)
    nominal = Model(robot, ())
    swapped = tip == "base"
    if not swapped:
        check_same(ARM.encode(), nominal, np.zeros(0), tip == "tcp")
    saved = calibrated(robot)
    model, theta = saved.geometric.model, saved.geometric.theta
    content = splice_mjcf(robot, origins_of(model, theta))
    assert content != ARM.encode() and without_places(content) == without_places(ARM.encode())
    if not swapped:
        check_same(content, model, theta, tip == "tcp")
    again = parse_robot(content, tip, base)
    R, p = Model(again, ()).poses(np.zeros(0), Model(again, ()).rows(q := np.full((1, len(again.readings)), 0.2)))
    R_model, p_model = model.poses(theta, model.rows(q))
    np.testing.assert_allclose(R, R_model, rtol=0, atol=AGREES)
    np.testing.assert_allclose(p, p_model, rtol=0, atol=AGREES)


@pytest.mark.parametrize("arm", URDFS)
def test_an_arm_that_mujoco_itself_wrote_as_mjcf_comes_back_calibrated(arm: str, tmp_path: Path) -> None:
    path = robots.SHARED_ROBOTS / arm
    if not path.exists():
        pytest.skip("this arm is not in example-robot-data")
    root = etree.fromstring(path.read_bytes())
    for element in root.xpath("//visual | //collision | //mimic"):  # meshes are not MuJoCo's, and mimics its equalities
        element.getparent().remove(element)
    compiler = etree.SubElement(etree.SubElement(root, "mujoco"), "compiler")
    compiler.attrib.update(
        {"fusestatic": "false", "boundmass": "0.001", "boundinertia": "0.001", "balanceinertia": "true"}
    )
    file = tmp_path / "arm.xml"
    mujoco.mj_saveLastXML(str(file), mujoco.MjModel.from_xml_string(etree.tostring(root, encoding="unicode")))
    robot = load_robot(file, URDFS[arm], "world")
    saved = calibrated(robot)
    content = splice_mjcf(robot, origins_of(saved.geometric.model, saved.geometric.theta))
    assert without_places(content) == without_places(file.read_bytes())
    check_same(content, saved.geometric.model, saved.geometric.theta, False)


def test_a_campaign_of_mjcf_is_calibrated_and_its_file_comes_back_calibrated(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(ARM)
    scenario = {
        "format": 1,
        "robot": {"mjcf": "arm.xml", "base": "base", "tip": "tcp"},
        "truth": {"n": 60, "seed": 1, "parameters": {"bend.z": 0.004, "lift.roll": 0.002}},
    }
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(scenario))
    assert simulate.main([str(tmp_path / "scenario.yaml"), "-o", str(tmp_path / "c"), "--quiet"]) == 0
    assert (tmp_path / "c" / "arm.xml").read_bytes() == ARM.encode()
    assert identify.main([str(tmp_path / "c" / "campaign.yaml"), "--quiet"]) == 0
    results = tmp_path / "c" / "results"
    content = (results / "calibrated.xml").read_bytes()
    assert without_places(content) == without_places(ARM.encode())
    calibration = aridcal.load(results)
    robot = parse_robot((results / "calibrated.urdf").read_bytes(), "tcp", "base")
    q = np.full((1, 5), 0.1)
    R, p = Model(robot, ()).poses(np.zeros(0), Model(robot, ()).rows(q))
    T = in_mujoco(content, robot, q, True)
    np.testing.assert_allclose(T[:, :3, 3], p, rtol=0, atol=AGREES)
    np.testing.assert_allclose(T[:, :3, :3], R, rtol=0, atol=AGREES)
    assert export.main([str(results), "--mjcf", str(tmp_path / "again.xml"), "--quiet"]) == 0
    assert (tmp_path / "again.xml").read_bytes() == content
    assert len(calibration.predict(pd.DataFrame(q, columns=list(robot.readings)))) == 1


def broken(old: str, new: str) -> str:
    """The arm with a part of its text replaced, which is there."""
    assert old in ARM
    return ARM.replace(old, new, 1)


REFUSED = {
    "free": (broken('<joint name="pan" pos=".01 .02 .03" ref="20"/>', "<freejoint/>"), "tcp", "a free joint"),
    "ball": (broken('<joint name="bend"/>', '<joint name="bend" type="ball"/>'), "tcp", "'bend' of MJCF: a ball joint"),
    "include": (
        broken("<asset>", '<include file="more.xml"/><asset>'),
        "tcp",
        "<include> of MJCF: what it brings may move joints",
    ),
    "included body": (broken("<light", '<include file="more.xml"/><light'), "tcp", "line 14: <include>"),
    "frame": (broken("<light", '<frame pos="1 0 0"/><light'), "tcp", "<frame> of MJCF"),
    "composite": (broken("<light", '<composite type="cable"/><light'), "tcp", "<composite> of MJCF"),
    "section": (broken("<asset>", "<gearbox/><asset>"), "tcp", "<gearbox> of MJCF: is not understood"),
    "class": (broken('childclass="arm"', 'childclass="leg"'), "tcp", "no <default> has the class 'leg'"),
    "two turns": (broken('zaxis="1 0.1 0.5"', 'zaxis="1 0 0" quat="1 0 0 0"'), "tcp", "has quat and zaxis: keep one"),
    "numbers": (broken('pos="0 .1 .4"'.replace("=", " = "), 'pos="0 .1"'), "tcp", "3 finite numbers"),
    "no axis": (broken('axis="0 1 0" limited', 'axis="0 0 0" limited'), "tcp", "'lift' of MJCF: its axis is zero"),
    "twice": (broken('body name="upper"', 'body name="base"'), "tcp", "'base' is there already"),
    "global": (broken('angle="degree"', 'angle="degree" coordinate="global"'), "tcp", "should be local"),
    "entities": (broken("<mujoco", "<!DOCTYPE x><mujoco"), "tcp", "DOCTYPE"),
    "two joints": (ARM, "finger", "'turn': the `pos` of its body cannot hold"),
    "tied": (
        broken('<site name="tcp"/>', "").replace('<body name="other"', '<body name="other"'),
        "other",
        "<joint> ties 'grip_2'",
    ),
    "welded": (broken("</equality>", '<weld body1="upper" body2="finger"/></equality>'), "tcp", "<weld> ties 'upper'"),
    "anchor at the tip": (ARM, "shoulder", "name a site or a body beyond it"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_mjcf_says_and_we_do_not_understand_is_refused_by_its_name(what: str) -> None:
    text, tip, words = REFUSED[what]
    with pytest.raises(AridcalError, match=re.escape(words)):
        check_written_back(parse_robot(text.encode(), tip, "base", Path("arm.xml")))


def test_an_arm_cannot_be_described_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    keys = {"format": 1, "robot": {"mjcf": "a.xml", "urdf": "a.urdf", "tip": "t"}, "measurements": {"file": "t.csv"}}
    (tmp_path / "campaign.yaml").write_text(yaml.safe_dump(keys))
    assert identify.main([str(tmp_path / "campaign.yaml")]) == 2
    assert "has `urdf` and `mjcf`: write one" in capsys.readouterr().err


@pytest.mark.parametrize("codec", ["utf-8-sig", "latin-1"])
def test_bytes_of_any_encoding_and_line_end_are_kept(codec: str, tmp_path: Path) -> None:
    name = "iso-8859-1" if codec == "latin-1" else "utf-8"
    text = ARM.replace("<?xml version='1.0'?>", f"<?xml version='1.0' encoding='{name}'?>").replace(
        "an arm", "Süd &amp; é"
    )
    before = text.replace("\n", "\r\n").encode(codec)
    robot = parse_robot(before, "tcp", "base")
    saved = calibrated(robot)
    content = splice_mjcf(robot, origins_of(saved.geometric.model, saved.geometric.theta))
    assert content != before and without_places(content) == without_places(before)
    assert SavedModel.load(written(saved, tmp_path / "r")).final.model.robot.mjcf == before
