"""The scene of a calibration: what is drawn, where, and that the page works in a browser with no network."""

from __future__ import annotations

import base64
import http.client
import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import chromium
import numpy as np
import pinocchio as pin
import pytest
from lxml import etree
from scipy.spatial.transform import Rotation

import aridcal
from aridcal.engine.robot.chain import Robot, load_robot, parse_robot
from aridcal.engine.robot.link_shapes import find_mesh
from aridcal.engine.robot.meshes import TRIANGLES, weld
from aridcal.pages.drawing.robot_shapes import robot_shapes
from aridcal.pages.drawing.scene import LADDER, MOST_SCENE_ROWS, VIRIDIS, Scene, body_poses, scene_content, scene_page
from aridcal.view import main

ROOT = Path(aridcal.__file__).parents[1]
PUBLIC = Path(sys.prefix) / "lib" / f"python3.{sys.version_info.minor}" / "site-packages" / "cmeel.prefix" / "share"
PUBLIC = PUBLIC / "example-robot-data" / "robots"

TOY = """<robot name="{name}">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base"><visual><geometry><box size="0.3 0.3 0.2"/></geometry><material name="red"/></visual></link>
  <link name="arm"><visual><origin xyz="0.3 0 0" rpy="0 1.5708 0"/>
    <geometry><cylinder radius="0.08" length="0.6"/></geometry><material name="red"/></visual></link>
  <link name="slide"><visual><geometry><sphere radius="0.1"/></geometry><material name="red"/></visual></link>
  <link name="finger"/>
  <link name="tip"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="{x} 0 0.2" rpy="0.1 0 0.3"/>
    <axis xyz="0 0.6 0.8"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="reach" type="prismatic"><parent link="arm"/><child link="slide"/><origin xyz="0.6 0 0"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
  <joint name="follow" type="revolute"><parent link="slide"/><child link="finger"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
    <mimic joint="swing" multiplier="-2" offset="0.1"/></joint>
  <joint name="end" type="fixed"><parent link="finger"/><child link="tip"/><origin xyz="0.1 0 0"/></joint>
</robot>"""


IN_SIGHT = """(() => {
  const box = document.getElementById("flip").getBoundingClientRect();
  const there = document.elementFromPoint((box.left + box.right) / 2, (box.top + box.bottom) / 2);
  return box.left >= 0 && box.top >= 0 && box.right <= innerWidth && box.bottom <= innerHeight && Boolean(there.closest("#flip"));
})()"""
"""Whether before and after stand in the window, with nothing over them."""


def toy(x: float = 0.0, name: str = "toy", folder: Path = Path()) -> Robot:
    return parse_robot(TOY.format(x=x, name=name).encode(), "tip", "base", folder / "toy.urdf")


def example(n: int = 40, seed: int = 0, name: str = "toy") -> Scene:
    """A toy robot whose first joint is 4 mm off, seen with 0.1 mm of noise from a frame somewhere."""
    rng = np.random.default_rng(seed)
    nominal, calibrated = toy(name=name), toy(0.004, name)
    readings = np.column_stack([rng.uniform(-1, 1, n), rng.uniform(0, 0.5, n)])
    T_world_base = np.eye(4)
    T_world_base[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T_world_base[:3, 3] = [3.0, -1.0, 0.5]
    before, after = (
        target(robot, readings) @ T_world_base[:3, :3].T + [3.0, -1.0, 0.5] for robot in (nominal, calibrated)
    )
    measured = after + 1e-4 * rng.standard_normal((n, 3))
    outlier = np.arange(n) == 1
    measured[1] += 0.01
    return Scene(nominal, calibrated, readings, T_world_base, measured, {"nominal": before, "final": after},
                 np.arange(n) % 4 == 0, outlier)  # fmt: skip


def target(robot: Robot, readings: np.ndarray) -> np.ndarray:
    frame = robot.tree.frames[robot.tree.getFrameId("tip")]
    return (body_poses(robot, readings)[:, frame.parentJoint] @ frame.placement.homogeneous)[:, :3, 3]


def unpack(text: str, dtype: type = np.float32) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), dtype)


# ---- shapes ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("urdf", "tip", "bare"),
    [
        # dae, several materials
        ("panda_description/urdf/panda.urdf", "panda_hand", r"panda_link[0-6]"),
        # stl, some mirrored by their scale, more triangles in all than are drawn
        ("talos_data/robots/talos_reduced.urdf", "gripper_left_base_link", r"no link"),
    ],
)
def test_meshes_lie_where_pinocchio_puts_them_and_together_stay_within_the_allowance(
    urdf: str, tip: str, bare: str
) -> None:
    path = PUBLIC / urdf
    if not path.is_file():
        pytest.skip("example-robot-data is not installed")
    root = etree.parse(path).getroot()
    for link in root.iterfind("link"):
        if re.fullmatch(bare, link.get("name")):
            etree.strip_elements(link, "visual")
    robot = parse_robot(etree.tostring(root), tip, None, path)
    shapes, notices = robot_shapes(robot)
    assert notices == ()
    geometry = pin.buildGeomFromUrdfString(
        robot.tree, robot.urdf.decode(), pin.GeometryType.VISUAL, package_dirs=[str(PUBLIC.parents[1])]
    )
    theirs: dict[int, list[np.ndarray]] = {}
    whole = 0
    for thing in (t for t in geometry.geometryObjects if isinstance(t.geometry, pin.hppfcl.BVHModelBase)):
        whole += thing.geometry.num_tris
        points = thing.geometry.vertices()
        theirs.setdefault(thing.parentJoint, []).append(
            points @ thing.placement.rotation.T + thing.placement.translation
        )
    mine: dict[int, list[np.ndarray]] = {}
    for shape in (s for s in shapes if s.kind == "mesh"):
        points = shape.vertices @ shape.placement[:3, :3].T + shape.placement[:3, 3]
        mine.setdefault(shape.joint, []).append(points)
    assert mine.keys() == theirs.keys()
    for joint in theirs:
        a, b = np.vstack(mine[joint]), np.vstack(theirs[joint])
        for extreme in (np.min, np.max):
            # Thinning rounds the corners of large meshes by less than that; a wrong scale, turn or mirror is off by more.
            np.testing.assert_allclose(extreme(a, axis=0), extreme(b, axis=0), atol=0.02 * np.ptp(b, axis=0).max())
    assert (whole > 1.2 * TRIANGLES) == ("talos" in urdf)
    assert 0.8 * min(TRIANGLES, whole) < sum(len(s.faces) for s in shapes) <= TRIANGLES


def test_primitives_lie_where_pinocchio_puts_them() -> None:
    robot = load_robot(ROOT / "urdf" / "arid.urdf", "flange")
    shapes, notices = robot_shapes(robot)
    theirs = pin.buildGeomFromUrdfString(robot.tree, robot.urdf.decode(), pin.GeometryType.VISUAL).geometryObjects
    assert notices == ()
    assert len(shapes) == len(theirs) > 50
    rest = list(theirs)
    for shape in shapes:
        shape_at = pin.SE3(shape.placement)
        same = [t for t in rest if t.parentJoint == shape.joint and t.placement.isApprox(shape_at, 1e-9)
                and np.allclose(t.meshColor[:3], shape.colour)]  # fmt: skip
        for thing in same:
            thing.geometry.computeLocalAABB()
        np.testing.assert_allclose(
            replace(shape, placement=np.eye(4)).corners().max(axis=0), same[0].geometry.aabb_local.max_, atol=1e-6
        )
        rest.remove(same[0])


def test_a_thinned_mesh_keeps_its_form() -> None:
    u, v = (grid.ravel() for grid in np.meshgrid(np.linspace(0, np.pi, 120), np.linspace(0, 2 * np.pi, 240)))
    ball = np.column_stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)])
    k = np.arange(120 * 240).reshape(240, 120)
    squares = np.stack([k[:-1, :-1], k[1:, :-1], k[1:, 1:], k[:-1, 1:]], axis=-1).reshape(-1, 4)
    faces = np.vstack([squares[:, [0, 1, 2]], squares[:, [0, 2, 3]]])

    def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
        a, b, c = (vertices[faces[:, n]] for n in range(3))
        return float(abs(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6))

    vertices, kept = weld(ball, faces, 3000)
    assert 1000 < len(kept) <= 3000
    assert len(np.unique(vertices, axis=0)) == len(vertices)
    assert volume(vertices, kept) == pytest.approx(4 / 3 * np.pi, rel=0.03)


# ---- meshes that are and are not found -------------------------------------------------------------------------------


@pytest.mark.parametrize("variable", [None, "ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"])
def test_package_uris_are_resolved(variable: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    home = {None: tmp_path, "ROS_PACKAGE_PATH": tmp_path / "ros", "AMENT_PREFIX_PATH": tmp_path / "ros" / "share"}[
        variable
    ]
    mesh = home / "my_robot" / "meshes" / "link.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_bytes(b"")
    folder = tmp_path / "my_robot" / "urdf" if variable is None else tmp_path / "elsewhere"
    if variable is not None:
        monkeypatch.setenv(variable, f"/nowhere{os.pathsep}{tmp_path / 'ros'}")
    folder.mkdir(parents=True)
    robot = parse_robot(TOY.format(x=0, name="toy").encode(), "tip", "base", folder / "toy.urdf")
    assert find_mesh("package://my_robot/meshes/link.stl", robot).samefile(mesh)
    assert find_mesh(f"file://{mesh}", robot) == mesh
    assert find_mesh(os.path.relpath(mesh, folder), robot).samefile(mesh)


@pytest.mark.parametrize(
    ("spoilt", "why"),
    [
        ("<sphere/>", "`radius` of <sphere> should be a positive number"),
        ('<box size="1 2"/>', "`size` of <box> should be 3 positive numbers"),
        ('<box size="1 2 x"/>', "should be numbers, not '1 2 x'"),
        ('<capsule radius="1"/>', "<capsule> is no shape of URDF"),
    ],
)
def test_a_shape_that_is_wrong_is_named_and_the_rest_is_drawn(spoilt: str, why: str) -> None:
    text = TOY.format(x=0, name="toy").replace('<sphere radius="0.1"/>', spoilt)
    shapes, notices = robot_shapes(parse_robot(text.encode(), "tip", "base"))
    assert [s.kind for s in shapes] == ["box", "cylinder"]
    assert len(notices) == 1 and "'slide'" in notices[0] and why in notices[0]


def test_a_robot_without_visuals_is_a_stick_figure_that_moves_with_its_joints() -> None:
    bare = re.sub(r"<visual>.*?</visual>", "", TOY.format(x=0, name="toy"), flags=re.S)
    robot = parse_robot(bare.encode(), "tip", "base")
    shapes, notices = robot_shapes(robot)
    assert "stick figure" in notices[0]
    poses = body_poses(robot, np.array([[0.4, 0.2]]))[0]
    for rod in (s for s in shapes if s.kind == "cylinder"):
        ends = rod.placement[:3, 3] + np.outer([-0.5, 0.5], rod.size[1] * rod.placement[:3, 2])
        np.testing.assert_allclose(ends[0], 0, atol=1e-12)  # in the frame of the joint it comes from
        nearest = np.linalg.norm([T[:3, 3] - (poses[rod.joint] @ [*ends[1], 1])[:3] for T in poses], axis=1).min()
        assert nearest < 1e-9 or robot.tree.names[robot.tree.children[rod.joint][0]] == "reach"


# ---- where things are ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("base", "tip"), [("base", "tip"), ("slide", "tip"), ("tip", "base")])
def test_bodies_move_as_pinocchio_moves_them(base: str, tip: str) -> None:
    robot = parse_robot(TOY.format(x=0.1, name="toy").encode(), tip, base)
    rng = np.random.default_rng(0)
    readings = rng.uniform(0, 0.5, (20, len(robot.readings)))
    model = pin.buildModelFromXML(robot.urdf.decode())
    data = model.createData()
    for row, T in zip(readings, body_poses(robot, readings), strict=True):
        by_name = {"swing": 0.0, "reach": 0.0} | dict(zip(robot.readings, row, strict=True))
        q = np.array([by_name["swing"], by_name["reach"], 0.1 - 2 * by_name["swing"]])
        pin.framesForwardKinematics(model, data, q)
        T_base = data.oMf[model.getFrameId(base)]
        carried = (
            range(model.njoints) if robot.climbs else model.subtrees[model.frames[model.getFrameId(base)].parentJoint]
        )
        for k in carried:  # what is above the base is drawn at rest
            np.testing.assert_allclose(T[k], (T_base.inverse() * data.oMi[k]).homogeneous, atol=1e-12)


def test_targets_and_errors_are_drawn_in_the_frame_of_the_base_of_their_own_row() -> None:
    scene = example()
    rng = np.random.default_rng(5)
    n = len(scene.measured)
    T = np.tile(np.eye(4), (n, 1, 1))  # a frame for each row, as with stations
    T[:, :3, :3] = Rotation.random(n, rng=rng).as_matrix()
    T[:, :3, 3] = rng.uniform(-5, 5, (n, 3))
    in_base = {name: target(robot, scene.readings) for name, robot in (("a", scene.nominal), ("b", scene.calibrated))}

    def in_world(points: np.ndarray) -> np.ndarray:
        return np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]

    moved = replace(scene, T_world_base=T, measured=in_world(in_base["b"]),
                    predicted={"nominal": in_world(in_base["a"]), "final": in_world(in_base["b"])})  # fmt: skip
    content = scene_content(moved, robot_shapes(scene.nominal)[0])
    np.testing.assert_allclose(unpack(content["measured"]).reshape(-1, 3), in_base["b"], atol=1e-6)
    nominal, final = (unpack(stage["error"]).reshape(-1, 3) for stage in content["stages"])
    np.testing.assert_allclose(nominal, in_base["a"] - in_base["b"], atol=1e-8)
    np.testing.assert_allclose(final, 0, atol=1e-12)
    assert content["stages"][0]["rms"] == pytest.approx(4.0, rel=1e-6)  # the first joint is 4 mm off


def test_the_page_stands_upright_against_gravity() -> None:
    for gravity in ([0, 9.81, 0], [0, 0, 9.81], [1.0, -2.0, 3.0]):
        content = scene_content(replace(example(), gravity=np.array(gravity, float)), robot_shapes(toy())[0])
        R = np.array(content["upright"]).reshape(4, 4).T[:3, :3]  # column by column, as three.js has it
        np.testing.assert_allclose(R @ gravity, [0, 0, -np.linalg.norm(gravity)], atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)


def test_errors_are_scored_on_test_rows_without_outliers() -> None:
    scene = example()
    scored = scene.test & ~scene.outlier
    error = np.linalg.norm(scene.predicted["final"] - scene.measured, axis=1)
    content = scene_content(scene, robot_shapes(scene.nominal)[0])
    assert content["stages"][1]["rms"] == pytest.approx(1e3 * np.sqrt(np.mean(error[scored] ** 2)), rel=1e-6)
    assert content["scored"] == "held-out rows"
    untested = scene_content(replace(scene, test=np.zeros_like(scene.test)), robot_shapes(scene.nominal)[0])
    assert untested["scored"] == "all rows"


def test_the_magnification_makes_errors_of_any_size_visible_and_does_not_overdo_it() -> None:
    shapes = robot_shapes(toy())[0]
    for size in (1e-2, 1.0, 30.0):
        scene = example()
        predicted = {k: scene.measured + size * (p - scene.measured) for k, p in scene.predicted.items()}
        content = scene_content(replace(scene, predicted=predicted), shapes)
        extent = np.linalg.norm(np.ptp(unpack(content["seen"]).reshape(-1, 3), axis=0))
        before, after = (
            np.percentile(np.linalg.norm(unpack(s["error"]).reshape(-1, 3), axis=1), 90) * content["factor"] / extent
            for s in content["stages"]
        )
        assert content["factor"] in LADDER
        assert 0.02 < before < 0.3
        assert after > 0.002


def test_ten_thousand_rows_make_a_page_of_few_megabytes() -> None:
    scene = example(12_000)
    text = scene_page(scene)
    content = embedded(text)
    assert len(text) < 3e6
    assert len(content["rows"]) == MOST_SCENE_ROWS == len(set(content["rows"]))
    assert content["rows"][0] == 0
    assert content["rows"][-1] == 11_999
    assert len(unpack(content["measured"])) == 36_000
    poses = unpack(content["poses"][1]).reshape(MOST_SCENE_ROWS, content["bodies"], 7)
    bodies = sorted({s.joint for s in robot_shapes(scene.nominal)[0]})
    row = scene.readings[content["rows"][17]][None]
    expected = body_poses(scene.calibrated, row)[0, bodies]
    np.testing.assert_allclose(poses[17, :, :3], expected[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(Rotation.from_quat(poses[17, :, 3:]).as_matrix(), expected[:, :3, :3], atol=1e-6)


def embedded(text: str) -> dict:
    found = re.search(r'<script type="application/json" id="scene">(.*?)</script>', text, re.S)
    assert found is not None
    return json.loads(found[1])


def test_colours_are_viridis() -> None:
    from matplotlib import colormaps, colors

    assert list(VIRIDIS) == [colors.to_hex(colormaps["viridis"](t)) for t in np.linspace(0.2, 1, len(VIRIDIS))]


def test_hostile_names_stay_text_and_the_page_fetches_nothing() -> None:
    scene = example(name="&lt;/script&gt;&lt;script&gt;alert(1)&lt;/script&gt;")
    text = scene_page(scene)
    assert embedded(text)["title"] == "</script><script>alert(1)</script>"
    assert "<script>alert(1)" not in text
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)=", text)


# ---- the command -----------------------------------------------------------------------------------------------------


STARTED = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell may start us with Ctrl-C ignored, which children inherit
from aridcal.view import main
sys.exit(main())
"""


@contextmanager
def viewed(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`aridcal view` of a folder, in a process of its own, and its address."""
    quiet = {k: v for k, v in os.environ.items() if k not in ("BROWSER", "DISPLAY", "WAYLAND_DISPLAY")}
    with subprocess.Popen([sys.executable, "-c", STARTED, str(folder)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                          text=True, env=quiet) as process:  # fmt: skip
        try:
            assert process.stdout is not None
            yield process, process.stdout.readline().split()[0]
        finally:
            process.kill()


def asked(url: str, **headers: str) -> tuple[int, str]:
    """Status and body of a page, asked for with headers of our own."""
    request = urllib.request.Request(url, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=chromium.PATIENCE) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_the_command_serves_the_scene_alone_and_ends_with_a_signal(tmp_path: Path) -> None:
    (tmp_path / "scene.html").write_text("<body><p>the scene</p></body>")
    (tmp_path / "calibration.yaml").write_text("secret")
    with viewed(tmp_path) as (process, url):
        assert url.startswith("http://127.0.0.1:")
        assert "<p>the scene</p>" in asked(url)[1]
        (tmp_path / "scene.html").write_text("another")
        assert asked(url + "scene.html")[1].startswith("another")
        (tmp_path / "scene.html").unlink()  # as while the folder is exchanged
        assert asked(url)[1].startswith("another")
        for path in ("calibration.yaml", "../calibration.yaml", "%2e%2e/", "static/index.html", "scenexhtml"):
            status, said = asked(url + path)
            assert status == 404 and "secret" not in said
        process.send_signal(signal.SIGTERM)
        assert process.wait(timeout=chromium.PATIENCE) == 128 + signal.SIGTERM
        assert "Traceback" not in process.stderr.read()  # type: ignore[union-attr]
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(url, timeout=chromium.PATIENCE)


def test_only_this_computer_can_connect_and_only_its_pages_are_answered(tmp_path: Path) -> None:
    """Neither the page nor meshcat's own socket for drawing commands can be reached from elsewhere.

    An attacker's name may point to 127.0.0.1 (DNS rebinding); his page may open a websocket to it from anywhere.
    """
    (tmp_path / "scene.html").write_text("the scene")
    with viewed(tmp_path) as (process, url):
        ours = Path(f"/proc/{process.pid}")
        inodes = {re.sub(r"\D", "", link) for fd in (ours / "fd").iterdir() if "socket" in (link := str(fd.readlink()))}
        lines = [
            line.split() for name in ("tcp", "tcp6") for line in (ours / "net" / name).read_text().splitlines()[1:]
        ]
        listening = [line[1] for line in lines if line[3] == "0A" and line[9] in inodes]
        port = int(url.rstrip("/").rpartition(":")[2])
        assert listening == [f"0100007F:{port:04X}"]  # 127.0.0.1, as the kernel writes it
        assert (ours / "task" / str(process.pid) / "children").read_text() == ""

        home = url.removeprefix("http://").rstrip("/")
        good = ("127.0.0.1", "localhost", home, f"localhost:{port}", f"[::1]:{port}", "localhost:8080")
        for host in good:
            assert asked(url, Host=host)[0] == 200, host
        bad = ("evil.example", f"evil.example:{port}", "127.0.0.1.evil.example", "localhost.evil.example", "127.0.0.1@evil",
               "10.0.0.1", "0.0.0.0", "[::1", "evil.example#127.0.0.1")  # fmt: skip
        for host in bad:
            for path in ("", "live", "elsewhere"):
                status, said = asked(url + path, Host=host)
                assert status in (400, 403) and "scene" not in said, host

        handshake = {"Connection": "Upgrade", "Upgrade": "websocket", "Sec-WebSocket-Version": "13",
                     "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA=="}  # fmt: skip

        def opened(**headers: str) -> int:
            connection = http.client.HTTPConnection(home, timeout=chromium.PATIENCE)
            connection.request("GET", "/live", headers=handshake | headers)
            status = connection.getresponse().status
            connection.close()
            return status

        assert opened(Origin=f"http://{home}") == opened() == 101
        for origin in ("http://evil.example", "null", "http://127.0.0.1:1", f"http://{home}.evil.example"):
            assert opened(Origin=origin) == 403, origin
        assert opened(Host="evil.example", Origin="http://evil.example") == 403


def test_ctrl_c_ends_the_command_at_any_time(tmp_path: Path) -> None:
    """From its first line on, and with a browser connected and waiting."""
    (tmp_path / "scene.html").write_text("the scene")
    for wait in (0.0, 0.3):
        with viewed(tmp_path) as (process, url):
            host, port = url.removeprefix("http://").rstrip("/").split(":")
            with socket.create_connection((host, int(port))) as browser:
                browser.sendall(b"GET /live HTTP/1.1\r\nHost: localhost\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
                                b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n")  # fmt: skip
                time.sleep(wait)
                process.send_signal(signal.SIGINT)
                assert process.wait(timeout=chromium.PATIENCE) == 130
            said = process.stderr.read()  # type: ignore[union-attr]
            assert "interrupted" in said and "Traceback" not in said and "rror" not in said, said


def test_a_folder_without_a_result_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for folder in (tmp_path, tmp_path / "missing"):
        assert main([str(folder)]) == 2
        message = capsys.readouterr().err
        assert str(folder) in message
        assert "aridcal identify" in message


# ---- in a browser ----------------------------------------------------------------------------------------------------


def with_effect(scene: Scene) -> Scene:
    """The same with an effect that moves the target by 1 mm upwards, and three places of known uncertainty."""
    up = np.tile([0.0, 0.0, 1e-3], (len(scene.measured), 1))
    places = np.array([[0.5, 0.0, 0.5], [0.5, 0.5, 0.5], [0.5, -0.5, 0.5]])
    return replace(
        scene,
        line=np.arange(40) + 2,
        moved={"joint_map at swing": up},
        places=places,
        sigma=np.array([1e-5, 5e-5, 1e-4]),
    )


def red(pixels: np.ndarray) -> int:
    """Pixels of the toy's red paint, lit from anywhere."""
    r, g, b = np.moveaxis(pixels[:, 330:], -1, 0)
    return int(((r > 60) & (g < 0.35 * r) & (b < 0.35 * r)).sum())


def changed(before: np.ndarray, after: np.ndarray) -> int:
    """Pixels of the room that differ."""
    return int((np.abs(before - after)[:, 330:].max(axis=-1) > 12).sum())


@pytest.fixture(scope="module")
def scene() -> Scene:
    return with_effect(example())


@pytest.fixture(scope="module")
def shown(scene: Scene, browser: chromium.Browser, tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Page]:
    path = tmp_path_factory.mktemp("scene") / "scene.html"
    path.write_text(scene_page(scene))
    with browser.open(path, 800, 600) as opened:
        opened.wait("document.documentElement.dataset.ready")
        yield opened


@pytest.fixture
def page(shown: chromium.Page) -> Iterator[chromium.Page]:
    """The scene, which each test leaves as it was."""
    yield shown
    assert shown.console == []
    assert shown.requests == []


def choose(page: chromium.Page, control: str, value: object) -> None:
    """Set a slider or a list."""
    page.evaluate(f"""(() => {{
      const control = document.getElementById("{control}");
      control.value = {json.dumps(value)};
      for (const event of ["input", "change"]) control.dispatchEvent(new Event(event));
    }})()""")


def click(page: chromium.Page, selector: str) -> None:
    page.evaluate(f"document.querySelector({json.dumps(selector)}).click()")


def read(page: chromium.Page, control: str) -> str:
    return str(page.evaluate(f"document.getElementById('{control}').innerText"))


def test_the_page_draws_robot_ghost_targets_and_needles(page: chromium.Page) -> None:
    whole = before = page.pixels()
    assert red(whole) > 2000  # the robot
    assert len(np.unique(whole[:, :330].reshape(-1, 3), axis=0)) > 50  # the panel
    parts = {"calibrated": 5000, "nominal": 500, "targets": 100, "vectors": 100}
    for name, least in parts.items():
        click(page, f"input[name={name}]")
        without = page.pixels()
        assert changed(before, without) > least, name
        if name == "calibrated":
            assert red(without) < 0.05 * red(whole)  # the base's red axis is left
        before = without
    for name in parts:
        click(page, f"input[name={name}]")
    assert changed(whole, page.pixels()) < 20


def test_before_and_after_are_one_click_apart(page: chromium.Page, scene: Scene) -> None:
    assert page.evaluate(IN_SIGHT)
    assert [page.evaluate(f"document.getElementById('{side}').className") for side in ("was", "is")] == ["", "on"]
    errors = [stage["rms"] for stage in scene_content(scene, robot_shapes(scene.nominal)[0])["stages"]]
    shown = [
        float(page.evaluate(f"document.getElementById('{side}').textContent").split()[1]) for side in ("was", "is")
    ]
    assert shown == pytest.approx([errors[0], errors[-1]], rel=5.1e-3)
    click(page, "#flip")
    assert [page.evaluate(f"document.getElementById('{side}').className") for side in ("was", "is")] == ["on", ""]
    assert page.evaluate("document.querySelector('input[name=stage]:checked').value") == "0"
    click(page, "#flip")
    assert page.evaluate("document.querySelector('input[name=stage]:checked').value") == "1"
    assert read(page, "stages").split("\n")[::2] == ["nominal", "final"]
    assert read(page, "count") == "40 measured poses"


def test_rows_are_stepped_through_with_buttons_keys_and_slider(page: chromium.Page, scene: Scene) -> None:
    still = page.pixels()
    choose(page, "row", 7)
    page.evaluate("window.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}))")
    assert read(page, "line") == "10"
    errors = [1e3 * np.linalg.norm(p[8] - scene.measured[8]) for p in scene.predicted.values()]
    assert read(page, "here") == f"held-out row: nominal {errors[0]:.3g} → final {errors[1]:.3g} mm"
    shown = page.evaluate("document.getElementById('readings').textContent")
    assert shown == f"swing{np.degrees(scene.readings[8, 0]):.1f} °reach{1e3 * scene.readings[8, 1]:.1f} mm"
    assert changed(still, page.pixels()) > 5000  # the robot stands elsewhere
    click(page, "#back")
    assert read(page, "line") == "9"
    click(page, "#worst")
    off = np.linalg.norm(scene.predicted["final"] - scene.measured, axis=1)
    assert read(page, "line") == str(2 + int(np.argmax(np.where(scene.outlier, 0, off))))
    choose(page, "row", 0)


def test_an_effect_switched_off_leaves_what_it_explained(page: chromium.Page, scene: Scene) -> None:
    click(page, "input[name=effect]")
    scored = scene.test & ~scene.outlier
    left = scene.predicted["final"] - scene.moved["joint_map at swing"] - scene.measured
    rms = 1e3 * np.sqrt(np.mean(np.sum(left[scored] ** 2, axis=1)))
    assert read(page, "stages").split("\n")[-1] == f"{rms:.3g} mm"
    assert "Without the effects switched off" in read(page, "alone")
    assert "joint_map at swing" in read(page, "effects")
    assert read(page, "effects").endswith("1.00 mm")
    click(page, "input[name=effect]")
    assert "Without the effects switched off" not in read(page, "alone")


def test_the_room_is_coloured_by_errors_and_by_uncertainty(page: chromium.Page) -> None:
    plain = page.pixels()
    choose(page, "field", "error")
    errors = page.pixels()
    assert changed(plain, errors) > 3000
    choose(page, "field", "sigma")
    sigma = page.pixels()
    assert changed(errors, sigma) > 3000
    assert "0.1 mm" in read(page, "ticks")
    choose(page, "field", "none")
    assert changed(plain, page.pixels()) < 20


def test_on_a_phone_the_panel_opens_below_the_robot(browser: chromium.Browser, scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "scene.html").write_text(scene_page(scene))
    with browser.open(tmp_path / "scene.html", 390, 800) as page:
        page.wait("document.documentElement.dataset.ready")
        assert page.evaluate("document.documentElement.scrollWidth") == 390
        both = page.evaluate("document.getElementById('flip').textContent")
        assert re.fullmatch(r"before [\d.]+ mm → after [\d.]+ mm", both)
        assert page.evaluate(IN_SIGHT)
        assert page.evaluate("document.getElementById('panel').getBoundingClientRect().height") < 80
        page.evaluate("document.getElementById('panel').open = true")
        page.wait("document.querySelector('canvas').getBoundingClientRect().height < 450")
        box = "document.getElementById('panel').getBoundingClientRect()"
        assert (
            page.evaluate(f"{box}.top")
            >= page.evaluate("document.querySelector('canvas').getBoundingClientRect().bottom") - 1
        )
        assert page.console == []


# ---- live ------------------------------------------------------------------------------------------------------------


def replaced(file: Path, text: str) -> None:
    """Another file in the place of this one in one step: nobody reads half of it."""
    file.with_suffix(".new").write_text(text)
    file.with_suffix(".new").replace(file)


def exchanged(folder: Path, page: str) -> None:
    """Another result in the place of this one, as identify leaves it: another folder, which was not there for a moment."""
    new, old = folder.with_name("new"), folder.with_name("old")
    new.mkdir()
    (new / "scene.html").write_text(page)
    folder.rename(old)
    new.rename(folder)
    shutil.rmtree(old)


def becomes(page: chromium.Page, condition: str) -> None:
    """Wait for something that a page says after it was loaded anew: meanwhile it answers nothing."""
    end = time.monotonic() + chromium.PATIENCE
    while time.monotonic() < end:
        with suppress(AssertionError):
            return page.wait(condition)
    raise AssertionError(f"never became true: {condition}")


def test_the_browser_follows_the_folder_and_loads_a_page_of_another_version_anew(
    browser: chromium.Browser, scene: Scene, tmp_path: Path
) -> None:
    folder = tmp_path / "results"
    folder.mkdir()
    (folder / "scene.html").write_text(scene_page(scene))
    drawn = example(seed=1)
    other = replace(
        with_effect(drawn), predicted={name: place + [0, 0, 0.002] for name, place in drawn.predicted.items()}
    )
    with viewed(folder) as (process, url), browser.open(url, 800, 600) as page:
        page.wait("document.documentElement.dataset.ready && document.getElementById('live').textContent === 'live'")
        page.evaluate("window.same = true")
        assert red(page.pixels()) > 2000
        choose(page, "row", 7)
        choose(page, "factor", 9)
        click(page, "input[name=vectors]")
        said, camera = read(page, "stages"), page.evaluate(CAMERA)

        exchanged(folder, scene_page(other))
        page.wait("document.getElementById('live').textContent.includes('redrawn')")
        assert read(page, "stages") != said  # the errors are those of the new scene
        assert f"{content_of(other)['stages'][1]['rms']:.3g}" in read(page, "stages")
        assert read(page, "times") == f"×{LADDER[9]}"
        assert read(page, "line") == "9"  # what was chosen stays: the row, what is shown, where one stands
        assert not page.evaluate("document.querySelector('input[name=vectors]').checked")
        assert page.evaluate(CAMERA) == camera
        assert page.evaluate("document.querySelectorAll('#panel').length") == 1
        page.evaluate("window.dispatchEvent(new KeyboardEvent('keydown', {key: 'ArrowRight'}))")
        assert read(page, "line") == "10"  # and not two rows on: the earlier scene listens no more

        exchanged(folder, scene_page(scene))
        page.wait(f"document.getElementById('stages').innerText === {json.dumps(said)}")
        assert page.evaluate("window.same")  # the page was never loaded anew
        assert page.console == []
        assert page.requests == []

        replaced(folder / "scene.html", "<body><p id='told'>no picture</p></body>")
        becomes(page, "document.getElementById('told')")
        replaced(folder / "scene.html", re.sub('"script":"[0-9a-f]+"', '"script":"older"', scene_page(scene)))
        becomes(page, "window.calibrationScene?.script === 'older'")
        replaced(folder / "scene.html", scene_page(scene))
        becomes(page, "window.calibrationScene && window.calibrationScene.script !== 'older'")
        becomes(page, "document.getElementById('live').textContent === 'live'")
        process.send_signal(signal.SIGINT)
        page.wait("document.getElementById('live').textContent.includes('ended')")


CAMERA = "window.calibrationScene.viewer.camera.position.toArray().join()"


def content_of(scene: Scene) -> dict:
    return scene_content(scene, robot_shapes(scene.nominal)[0])


def test_opened_as_a_file_the_page_asks_nobody(page: chromium.Page) -> None:
    assert page.evaluate("window.calibrationScene.viewer.connection === undefined")
    assert read(page, "live") == ""
