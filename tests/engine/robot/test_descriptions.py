"""Descriptions of robots as they come: xacro within its limits, packages, robots by name."""

from __future__ import annotations

import errno
import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
import pandas as pd
import pytest
import yaml

import aridcal
from aridcal import identify, init, simulate
from aridcal.engine.model.model import Model
from aridcal.engine.robot import described_robots, expand
from aridcal.engine.robot.chain import load_robot, parse_robot
from aridcal.engine.robot.expand import is_xacro, read_urdf
from aridcal.engine.robot.packages import find_package
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.system.errors import RobotError
from aridcal.system.reading.regular_files import Limit

HEAD = '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">'

ARM = f"""{HEAD}
  <xacro:include filename="$(find arm_parts)/urdf/segment.xacro"/>
  <xacro:property name="c" value="${{xacro.load_yaml('$(find arm_parts)/urdf/lengths.yaml')}}"/>
  <link name="base_link"/>
  <xacro:segment n="1" parent="base_link" z="${{c['a'] * $(arg size)}}" rpy="0 0 0"/>
  <xacro:segment n="2" parent="link_1" z="${{c['b'] * $(arg size)}}" rpy="${{pi / 2}} 0 0"/>
  <xacro:segment n="3" parent="link_2" z="${{sum([v for v in c['c']]) if False else 0.3}}" rpy="${{-pi / 2}} 0 0"/>
</robot>""".replace("sum([v for v in c['c']]) if False else 0.3", "len([v for v in range(3)]) * 0.1")

SEGMENT = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:macro name="segment" params="n parent z rpy">
    <link name="link_${n}"><visual><geometry>
      <mesh filename="package://arm_parts/meshes/link.stl"/></geometry></visual></link>
    <joint name="joint_${n}" type="revolute"><parent link="${parent}"/><child link="link_${n}"/>
      <origin xyz="0.1 0 ${z}" rpy="${rpy}"/><axis xyz="0 0 1"/>
      <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  </xacro:macro>
</robot>"""

PLAIN = """<robot name="arm"><link name="base_link"/><link name="link_1"/><link name="link_2"/><link name="link_3"/>
  <joint name="joint_1" type="revolute"><parent link="base_link"/><child link="link_1"/><origin xyz="0.1 0 0.8" rpy="0 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="joint_2" type="revolute"><parent link="link_1"/><child link="link_2"/>
    <origin xyz="0.1 0 0.7" rpy="1.5707963267948966 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="joint_3" type="revolute"><parent link="link_2"/><child link="link_3"/>
    <origin xyz="0.1 0 0.3" rpy="-1.5707963267948966 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint></robot>"""
"""What `ARM` says at size 2, written by hand."""


def write_package(folder: Path, name: str = "arm_parts") -> Path:
    """A package of ROS with a xacro file; returns that file."""
    (folder / "urdf").mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (folder / "urdf" / "segment.xacro").write_text(SEGMENT)
    (folder / "urdf" / "lengths.yaml").write_text("{a: 0.4, b: 0.35}")
    (folder / "urdf" / "arm.urdf.xacro").write_text(ARM)
    return folder / "urdf" / "arm.urdf.xacro"


def hostile(folder: Path, body: str) -> Path:
    path = folder / "bad.urdf.xacro"
    path.write_text(f"{HEAD}{body}</robot>")
    return path


def write_table(folder: Path) -> Path:
    """Places that an arm of `PLAIN` was measured at, whose second axis is 2 mm too far from the first."""
    robot = parse_robot(PLAIN.replace("0.1 0 0.7", "0.102 0 0.7").encode(), "link_3")
    q = np.random.default_rng(0).uniform(-2, 2, (60, 3))
    model = Model(robot, ())
    _, p = model.poses(np.zeros(0), model.rows(q))
    table = pd.DataFrame(q, columns=list(robot.names)).assign(x=p[:, 0], y=p[:, 1], z=p[:, 2])
    table += 1e-5 * np.random.default_rng(1).standard_normal(table.shape)
    table.to_csv(folder / "m.csv", index=False)
    return folder / "m.csv"


# ---------------------------------------------------------------- xacro


def test_a_xacro_file_is_the_robot_that_it_says(tmp_path: Path) -> None:
    """The second road: the same arm written by hand. Macros, includes, YAML, arithmetic and arguments are all in it."""
    path = write_package(tmp_path / "ws" / "a_clone_called_otherwise")
    arm, same = load_robot(path, "link_3", arguments={"size": "2"}), parse_robot(PLAIN.encode(), "link_3")
    assert arm.names == same.names
    for onward, other in zip(arm.onward, same.onward, strict=True):
        assert np.allclose(onward.homogeneous, other.homogeneous, rtol=0, atol=1e-15)
    assert str(tmp_path).encode() not in arm.urdf  # the same wherever it lies


def test_a_file_without_macros_keeps_its_bytes(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    said = (
        PLAIN.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ').encode() + b"\r\n <!-- ${x} -->"
    )
    path.write_bytes(said)
    assert read_urdf(path) == said and not is_xacro(said, path)
    with pytest.raises(RobotError, match=r"arm\.urdf: is no xacro file, which alone has arguments: delete size"):
        read_urdf(path, arguments={"size": "2"})


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({}, r"its argument 'size' has no value: .*`--argument size=VALUE`.*`robot.arguments: \{size: VALUE\}`"),
        ({"sice": "2", "size": "2"}, "has no argument 'sice' .did you mean 'size'.*Its arguments: size"),
    ],
)
def test_arguments_are_asked_for_and_checked(arguments: dict[str, str], said: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=said):
        read_urdf(write_package(tmp_path / "arm_parts"), arguments=arguments)


def test_xacro_evaluates_nothing_that_was_not_checked(tmp_path: Path) -> None:
    """The attack that xacro alone lets through (its own guard looks at the outermost names only), all ways in."""
    for body in (
        '<link name="${[x.__class__ for x in [1]]}"/>',
        '<link name="$(eval [x.real for x in [1]][0].f_code)"/>',
        '<xacro:property name="a" value="${(x for x in []).gi_code}"/><link name="${a}"/>',
        '<xacro:macro name="m" params="a:=${len.real}"><link name="${a}"/></xacro:macro><xacro:m/>',
        '<xacro:if value="${str.mro}"/>',
    ):
        with pytest.raises(RobotError, match="which is not evaluated"):
            read_urdf(hostile(tmp_path, body))
    with pytest.raises(RobotError, match="is not defined"):
        read_urdf(hostile(tmp_path, '<link name="${python.type(1)}"/>'))


def removes(path: Path) -> str:
    """An expression that removes a file: a generator's code, replaced by that of a function, in a function of its own."""
    code = eval(f"lambda some: some.__self__.__import__('os').remove({str(path)!r})").__code__
    keys = ("co_code", "co_consts", "co_names", "co_varnames", "co_argcount", "co_nlocals", "co_flags", "co_stacksize")
    parts = ", ".join(f"{key}={getattr(code, key)!r}" for key in keys)
    return f"python.type(lambda: 0)((x for x in ()).gi_code.replace({parts}), dict())(len)"


def test_no_expression_removes_a_file(tmp_path: Path) -> None:
    from xacro import create_global_symbols, safe_eval

    kept = tmp_path / "kept"
    kept.touch()
    safe_eval(removes(kept), create_global_symbols())
    assert not kept.exists()  # xacro alone lets it pass
    kept.touch()
    with pytest.raises(RobotError, match="which is not evaluated"):
        read_urdf(hostile(tmp_path, f"<link name={quoteattr('${' + removes(kept) + '}')}/>"))
    assert kept.exists()


BOMBS = {
    "a number": '<link name="${9**9**9}"/>',
    "a pipe": '<xacro:include filename="pipe"/>',
}


@pytest.mark.parametrize("body", BOMBS.values(), ids=BOMBS)
def test_a_file_that_does_not_end_is_given_up(body: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(expand, "SECONDS", 1)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(RobotError, match="xacro takes more than 1 s"):
        read_urdf(hostile(tmp_path, body))


def test_memory_and_size_have_limits(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match="takes more than 1 GB"):
        read_urdf(hostile(tmp_path, "<link name=\"${len('a' * 10**10)}\"/>"))
    many = '<xacro:macro name="m"><link name="' + "x" * 500 + '"/></xacro:macro>' + "<xacro:m/>" * 500
    with pytest.raises(RobotError, match=r"expands to 0\.3 MB, more than may be read"):
        read_urdf(hostile(tmp_path, many), Limit(0.1))


@pytest.mark.parametrize(
    ("body", "said"),
    [
        (
            '<xacro:include filename="$(find lost)/a.xacro"/>',
            "needs the package 'lost', which is not found: say where it is: `init --package lost=FOLDER`",
        ),
        ('<xacro:include filename="lost.xacro"/>', "No such file or directory"),
        ("<xacro:nothing/>", "unknown macro name: xacro:nothing"),
        ("<xacro:if", "xacro cannot expand it: .*line 1"),
    ],
)
def test_what_is_wrong_with_a_xacro_file_is_named(body: str, said: str, tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"bad\.urdf\.xacro: .*" + said):
        read_urdf(hostile(tmp_path, body))


def test_entities_are_refused_in_the_file_and_have_limits_in_what_it_includes(tmp_path: Path) -> None:
    lines = "".join(f'<!ENTITY a{k} "{f"&a{k - 1};" * 10}">' for k in range(1, 12))
    bomb = f'<!DOCTYPE r [<!ENTITY a0 "ha">{lines}]><robot name="r"><link name="b">&a11;</link></robot>'
    (tmp_path / "laughs.xacro").write_text(bomb)
    with pytest.raises(RobotError, match="has a DOCTYPE: DTDs and entities are refused"):
        read_urdf(tmp_path / "laughs.xacro")
    with pytest.raises(RobotError, match="amplification"):
        read_urdf(hostile(tmp_path, '<xacro:include filename="laughs.xacro"/>'))


def test_xacro_writes_nothing(tmp_path: Path) -> None:
    """No file, no byte code, no cache: the folder and the package's own are as before."""
    path = write_package(tmp_path / "arm_parts")
    before = sorted(tmp_path.rglob("*"))
    read_urdf(path, arguments={"size": "1"})
    assert sorted(tmp_path.rglob("*")) == before


def test_the_process_that_expands_can_write_no_byte(tmp_path: Path) -> None:
    """The attack: an expression got out after all."""
    attack = (
        "from aridcal.engine.robot.expand import _within_limits; _within_limits(5)\n"
        f"file = open({str(tmp_path / 'mark')!r}, 'w')\ntry:\n    file.write('x' * 10_000); file.flush()\n"
        "except OSError as error:\n    print('refused', error.errno)\n"
    )
    done = subprocess.run([sys.executable, "-c", attack], capture_output=True, text=True, check=False)
    assert done.stdout == f"refused {errno.EFBIG}\n" and (tmp_path / "mark").stat().st_size == 0


def test_without_the_extra_the_way_out_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_package(tmp_path / "arm_parts")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RobotError, match=r'`pip install "aridcal\[xacro\]"` .*, or run xacro first'):
        read_urdf(path)
    with pytest.raises(RobotError, match=r'ur5e: there is no such file.*`pip install "aridcal\[xacro\]"`'):
        described_robots.named_robot("ur5e")


# ---------------------------------------------------------------- packages


@pytest.mark.parametrize("variable", ["ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH", "given", "nested"])
def test_packages_are_found_wherever_ros_would_find_them(
    variable: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    inside = {"AMENT_PREFIX_PATH": "share/lost", "nested": "some_repository/lost"}.get(variable, "lost")
    place = tmp_path / "ws" / inside
    place.mkdir(parents=True)
    away = tmp_path / "elsewhere"
    away.mkdir()
    assert find_package("lost", away, {}) is None
    if variable == "given":
        assert find_package("lost", away, {"lost": place}) == place
        assert find_package("lost", place, {"lost": away}) == away  # what the user says comes first
        return
    path = f"/nowhere{os.pathsep}{tmp_path / 'ws'}"
    monkeypatch.setenv("ROS_PACKAGE_PATH" if variable == "nested" else variable, path)
    assert find_package("lost", away, {}) == place


# ---------------------------------------------------------------- campaigns


def test_init_and_identify_take_a_xacro_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From the macros to the constant that was wrong, with the package somewhere else and named by hand."""
    monkeypatch.chdir(tmp_path)
    path = write_package(tmp_path / "away" / "arm_parts")
    shutil.move(path, tmp_path / "arm.urdf.xacro")
    shutil.move(tmp_path / "away" / "arm_parts", tmp_path / "away" / "clone")
    write_table(tmp_path)
    ours = ["--urdf", "arm.urdf.xacro", "--measurements", "m.csv", "--argument", "size:=2"]
    (tmp_path / "away" / "clone" / "package.xml").unlink()
    assert init.main(ours) == 2
    assert "needs the package 'arm_parts', which is not found: say where it is: `init --package arm_parts=FOLDER`" in (
        capsys.readouterr().err.replace("\n", " ")
    )
    assert init.main([*ours, "--package", "arm_parts=away/clone"]) == 0
    written = yaml.safe_load((tmp_path / "campaign.yaml").read_text())["robot"]
    assert written["packages"] == {"arm_parts": "away/clone"} and written["arguments"] == {"size": "2"}
    assert nominal_robot(load_campaign(tmp_path / "campaign.yaml")).packages == {
        "arm_parts": tmp_path / "away" / "clone"
    }
    assert identify.main(["campaign.yaml"]) == 0
    said = capsys.readouterr().out.replace("\n", " ")
    assert (
        "put it where the URDF looks for it, or leave it so. Until then a stick figure" in said
    )  # the package is there, the mesh is not
    assert said.count("not drawn: 3 shapes without a mesh file ('package://arm_parts/meshes/link.stl')") == 1
    # plain, and the constant is in it
    made = parse_robot((tmp_path / "results" / "calibrated.urdf").read_bytes(), "link_3")
    assert abs(made.joints[1].origin.translation[0] - 0.102) < 1e-4


def test_python_proposes_from_a_xacro_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    path = write_package(tmp_path / "arm_parts")
    campaign = aridcal.propose(path, write_table(tmp_path), arguments={"size": "2"})
    assert campaign.robot.arguments == {"size": "2"} and campaign.robot.tip == "link_3"


def test_a_simulation_of_a_xacro_file_can_be_calibrated_where_it_lies_and_elsewhere(tmp_path: Path) -> None:
    """Beside the scenario the file is named with its arguments; elsewhere its plain URDF is written."""
    write_package(tmp_path / "arm_parts")
    robot = {"urdf": "arm_parts/urdf/arm.urdf.xacro", "tip": "link_3", "arguments": {"size": 2}}
    keys = {"format": 1, "robot": robot | {"packages": {"arm_parts": "arm_parts"}}, "truth": {"n": 20}}
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(keys))
    for out, urdf in ((tmp_path / "here", "arm.urdf"), (tmp_path / "away" / "there", "arm.urdf")):
        assert simulate.main([str(tmp_path / "scenario.yaml"), "--out", str(out)]) == 0
        campaign = load_campaign(out / "campaign.yaml")
        assert campaign.robot.urdf == out / urdf and not campaign.robot.arguments
        assert campaign.robot.packages["arm_parts"].resolve() == tmp_path / "arm_parts"
        assert np.isclose(nominal_robot(campaign).joints[1].origin.translation[2], 0.7)


@pytest.mark.parametrize(("name", "plain"), [("a.urdf.xacro", "a.urdf"), ("a.xacro", "a.urdf"), ("a.urdf", "a.urdf")])
def test_what_is_expanded_is_called_as_a_urdf(name: str, plain: str) -> None:
    assert expand.plain_name(Path("b.c") / name) == Path("b.c") / plain


def test_an_argument_may_be_a_number_or_a_truth_in_yaml(tmp_path: Path) -> None:
    text = "format: 1\nrobot: {urdf: a.urdf, tip: t, arguments: {a: 2, b: true, c: x}}\nmeasurements: {file: m.csv}\n"
    (tmp_path / "c.yaml").write_text(text)
    assert load_campaign(tmp_path / "c.yaml").robot.arguments == {"a": "2", "b": "true", "c": "x"}


def test_values_may_hold_what_separates_names_from_them() -> None:
    assert init.pair("a=b:=c=d") == ("a", "b:=c=d") and init.pair("a:=b") == ("a", "b")


def test_a_pair_needs_both_its_halves(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        init.main(["--urdf", "a.urdf", "--measurements", "m.csv", "--package", "lost"])
    assert "'lost' should be NAME=VALUE" in capsys.readouterr().err


# ---------------------------------------------------------------- robots by name


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of robot_descriptions with nothing in it, and a git that would complain of any network."""
    monkeypatch.setenv("ROBOT_DESCRIPTIONS_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def test_nothing_is_downloaded_unasked(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(
        RobotError, match=r"ur5e_description: is not in the cache .*`robot_descriptions pull ur5e_description`"
    ):
        aridcal.propose("ur5e", write_table(tmp_path))
    assert not cache.exists()  # not even a clone that was begun


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("ur55e", "no robot of that name in robot_descriptions .did you mean 'ur5"),
        ("ur5e_mj", "ur5e_mj_description: robot_descriptions has it as MJCF only"),
    ],
)
def test_names_that_are_none_are_told(name: str, said: str, cache: Path) -> None:
    with pytest.raises(RobotError, match=said):
        described_robots.named_robot(name)


def test_a_robot_in_the_cache_is_taken_by_its_name(
    cache: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The package's own module says where the file is, and which arguments it needs."""
    monkeypatch.chdir(tmp_path)
    for who in ("AUTHOR", "COMMITTER"):
        monkeypatch.setenv(f"GIT_{who}_NAME", "a")
        monkeypatch.setenv(f"GIT_{who}_EMAIL", "a@b.c")
    made = tmp_path / "made"
    write_package(made, "ur_description").rename(made / "urdf" / "ur.urdf.xacro")
    text = (
        (made / "urdf" / "ur.urdf.xacro").read_text().replace("arm_parts", "ur_description").replace("size", "ur_type")
    )
    (made / "urdf" / "ur.urdf.xacro").write_text(
        text.replace("$(arg ur_type)", "(2.0 if '$(arg ur_type)' == 'ur5e' else 1.0)").replace(
            HEAD, f'{HEAD}<xacro:arg name="ur_type" default="ur5x"/><xacro:arg name="name" default="ur"/>'
        )
    )
    for command in (["init", "-q"], ["add", "."], ["commit", "-qm", "made"]):
        subprocess.run(["git", "-C", str(made), *command], check=True)
    commit = subprocess.run(["git", "-C", str(made), "rev-parse", "HEAD"], check=True, capture_output=True, text=True)
    sha = commit.stdout.strip()
    monkeypatch.setenv("ROBOT_DESCRIPTION_COMMIT", sha)
    from robot_descriptions._repositories import REPOSITORIES

    inside = REPOSITORIES["Universal_Robots_ROS2_Description"].cache_path
    shutil.move(made, (place := cache / f"{inside}-{sha}" / inside).parent.mkdir(parents=True) or place)
    campaign = aridcal.propose("ur5e", write_table(tmp_path))
    assert campaign.robot.urdf == place / "urdf" / "ur.urdf.xacro"
    assert campaign.robot.packages == {"ur_description": place}
    assert campaign.robot.arguments == {"ur_type": "ur5e", "name": "ur5e"}
    assert np.isclose(nominal_robot(campaign).joints[0].origin.translation[2], 0.8)
