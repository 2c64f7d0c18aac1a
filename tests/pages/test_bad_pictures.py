"""Pictures that cannot be drawn: each costs one notice that names it, and no figure, no file and no other picture."""

from __future__ import annotations

import json
import os
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import chromium
import numpy as np
import pytest
import robots
from lxml import etree

from aridcal import identify
from aridcal.calibration import Calibration
from aridcal.engine.robot import meshes
from aridcal.engine.robot.chain import Robot, parse_robot
from aridcal.engine.robot.meshes import NotDrawable, read_meshes
from aridcal.jobs.calibrate import pipeline
from aridcal.jobs.calibrate.controllers import ControllerExports, controller_exports
from aridcal.jobs.calibrate.folder import result_document
from aridcal.jobs.calibrate.outcome import Outcome
from aridcal.jobs.calibrate.saving import calibration
from aridcal.pages.drawing import robot_shapes, scene
from aridcal.pages.drawing.html import LONGEST_NOTICE, attempt, collect_notices, note
from aridcal.pages.report import page

BALL = '<geometry><sphere radius="0.1"/></geometry>'
SLIVER = np.array([[0, 0, 0], [1, 0, 0], [1, 1e-5, 0]], float)
TRIANGLE = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0.1]], float)


def stl(*triangles: np.ndarray, count: int | None = None) -> bytes:
    """A binary STL, perhaps with a false count of its triangles."""
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *triangle.ravel(), 0) for triangle in triangles)
    return bytes(80) + struct.pack("<I", len(triangles) if count is None else count) + body


def obj(vertices: str = "v 0 0 0\nv .3 0 0\nv 0 .2 .1\n", faces: str = "f 1 2 3\n", head: str = "") -> bytes:
    return f"{head}{vertices}{faces}".encode()


def collada(nodes: str, root: str = '<instance_geometry url="#g"/>') -> bytes:
    """One triangle, and nodes that show it."""
    source = "".join(f'<param name="{axis}" type="float"/>' for axis in "XYZ")
    return f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
    <asset><unit meter="1"/></asset><library_geometries><geometry id="g"><mesh><source id="p">
    <float_array id="a" count="9">0 0 0 1 0 0 0 1 0</float_array><technique_common><accessor source="#a" count="3" stride="3">
    {source}</accessor></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
    <triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1 2</p></triangles></mesh></geometry>
    </library_geometries><library_nodes>{nodes}</library_nodes><library_visual_scenes><visual_scene id="s"><node id="root">
    {root}</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene>
    </COLLADA>""".encode()


def bomb() -> bytes:
    """COLLADA whose ten nodes each show the next one ten times: 1 KB, ten thousand million triangles."""
    nodes = "".join(f'<node id="n{k}">{10 * f"""<instance_node url="#n{k + 1}"/>"""}</node>' for k in range(10))
    last = '<node id="n10"><instance_geometry url="#g"/></node>'
    return collada(nodes + last, '<instance_node url="#n0"/>')


def huge_png() -> bytes:
    """The head of a picture of 10,000 million pixels."""
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I4sIIBBBBB", 13, b"IHDR", 100_000, 100_000, 8, 2, 0, 0, 0)


TEXTURED = obj(
    head="mtllib skin.mtl\nusemtl skin\n", vertices="v 0 0 0\nv .3 0 0\nv 0 .2 .1\nvt 0 0\n", faces="f 1/1 2/1 3/1\n"
)

FILES: dict[str, bytes] = {
    "good.stl": stl(TRIANGLE),
    "sliver.stl": stl(SLIVER),
    "twice.stl": stl(TRIANGLE[[0, 0, 1]]),
    "nothing.stl": b"solid nothing\nendsolid",
    "empty.stl": b"",
    "cut.stl": stl(TRIANGLE, TRIANGLE)[:100],
    "lying.stl": stl(TRIANGLE, count=4_000_000_000),
    "infinite.stl": stl(np.full((3, 3), np.inf)),
    "huge.stl": stl(1e30 * TRIANGLE),
    "noise.dae": np.random.default_rng(0).bytes(3000),
    "loop.dae": collada('<node id="n"><instance_node url="#n"/></node>', '<instance_node url="#n"/>'),
    "nobody.dae": collada("", ""),
    "outside.obj": obj(faces="f 1 2 9\n"),
    "nan.obj": obj(vertices="v 0 0 nan\nv 1 0 0\nv 0 1 0\n"),
    "skin.mtl": b"newmtl skin\nKd 1 0 0\nmap_Kd skin.png\n",
    "skin.png": huge_png(),
    "textured.obj": TEXTURED,
    "elsewhere.obj": TEXTURED.replace(b"skin.mtl", b"../../../../../../etc/passwd"),
    "lost.gltf": json.dumps(
        {"asset": {"version": "2.0"}, "buffers": [{"uri": "/etc/passwd", "byteLength": 9}]}
    ).encode(),
    "many.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 4000000000\nproperty float x\nend_header\n",
    "model.zip": b"PK\x05\x06" + bytes(18),
    "a b [red].stl": b"solid nothing",
}


def mesh(name: str, more: str = "") -> str:
    return f'<geometry><mesh filename="{name}" {more}/></geometry>'


def spoilt(shape: str) -> str:
    return f"<geometry>{shape}</geometry>"


BAD: dict[str, tuple[str, str]] = {
    # What stands in a <visual>, and what the notice says of it.
    "rpy_text": (f'<origin rpy="abc"/>{BALL}', "`rpy` of <origin> should be numbers, not 'abc'"),
    "rpy_inf": (f'<origin rpy="inf 0 0"/>{BALL}', "`rpy` of <origin> should be numbers"),
    "xyz_two": (f'<origin xyz="1 2"/>{BALL}', "should be 3 numbers"),
    "xyz_nan": (f'<origin xyz="0 nan 0"/>{BALL}', "`xyz` of <origin> should be numbers"),
    "xyz_overflow": (f'<origin xyz="1e400 0 0"/>{BALL}', "`xyz` of <origin> should be numbers"),
    "xyz_far": (f'<origin xyz="1e300 0 0"/>{BALL}', "beyond 1e+06 m"),
    "quaternion": (f'<origin quat_xyzw="0 0 0 1"/>{BALL}', "write the rotation as rpy"),
    "box_one": (spoilt('<box size="1"/>'), "`size` of <box> should be 3 positive numbers, not '1'"),
    "box_nan": (spoilt('<box size="nan 1 1"/>'), "`size` of <box> should be numbers"),
    "box_none": (spoilt("<box/>"), "`size` of <box> should be 3 positive numbers"),
    "box_minus": (spoilt('<box size="1 -1 1"/>'), "3 positive numbers"),
    "box_flat": (spoilt('<box size="1 1 0"/>'), "3 positive numbers"),
    "box_large": (spoilt('<box size="1e308 1e308 1e308"/>'), "beyond 1e+06 m"),
    "sphere_none": (spoilt("<sphere/>"), "`radius` of <sphere> should be a positive number"),
    "sphere_blank": (spoilt('<sphere radius=" "/>'), "a positive number"),
    "sphere_comma": (spoilt('<sphere radius="0,5"/>'), "should be numbers, not '0,5'"),
    "sphere_long": (spoilt(f'<sphere radius="{"x" * 5000}"/>'), "…"),
    "cylinder_short": (spoilt('<cylinder radius="1"/>'), "`length` of <cylinder>"),
    "cylinder_inf": (spoilt('<cylinder radius="1" length="inf"/>'), "`length` of <cylinder> should be numbers"),
    "capsule": (spoilt('<capsule radius="1"/>'), "<capsule> is no shape of URDF"),
    "geometry_empty": ("<geometry/>", "has no shape"),
    "visual_empty": ("", "has no shape"),
    "mesh_unnamed": (spoilt("<mesh/>"), "no mesh ''"),
    "scale_nan": (mesh("good.stl", 'scale="nan nan nan"'), "`scale` of <mesh> should be numbers"),
    "scale_two": (mesh("good.stl", 'scale="1 1"'), "`scale` of <mesh> should be 3 numbers"),
    "scale_zero": (mesh("good.stl", 'scale="0 0 0"'), "so thin that nothing of it can be seen"),
    "scale_far": (mesh("good.stl", 'scale="1e300 1 1"'), "beyond 1e+06 m"),
    "sliver": (mesh("sliver.stl"), "so thin that nothing of it can be seen"),
    "no_area": (mesh("twice.stl"), "mesh"),
    "no_faces": (mesh("nothing.stl"), "'nothing.stl'"),
    "empty_file": (mesh("empty.stl"), "'empty.stl'"),
    "cut_short": (mesh("cut.stl"), "'cut.stl'"),
    "lying_count": (mesh("lying.stl"), "'lying.stl'"),
    "infinite": (mesh("infinite.stl"), "'infinite.stl'"),
    "huge_numbers": (mesh("huge.stl"), "beyond 1e+06 m"),
    "noise": (mesh("noise.dae"), "'noise.dae'"),
    "loop": (mesh("loop.dae"), "'loop.dae'"),
    "nobody": (mesh("nobody.dae"), "'nobody.dae'"),
    "outside": (mesh("outside.obj"), "'outside.obj'"),
    "not_numbers": (mesh("nan.obj"), "mesh"),
    "lost_buffer": (mesh("lost.gltf"), "'lost.gltf'"),
    "many_vertices": (mesh("many.ply"), "'many.ply'"),
    "archive": (mesh("model.zip"), "none of the formats"),
    "password": (mesh("../../../../../../../../../etc/passwd"), "none of the formats"),
    "password_uri": (mesh("file:///etc/passwd"), "none of the formats"),
    "missing": (mesh("lost.stl"), "no mesh 'lost.stl'"),
    "lost_package": (mesh("package://lost/a.dae"), "no mesh 'package://lost/a.dae'"),
    "from_afar": (mesh("http://example.com/a.stl"), "is not a local file"),
    "long_name": (mesh("n" * 300 + ".stl"), "File name too long"),
    "long_path": (mesh("d/" * 5000 + ".stl"), "File name too long"),
    "line_break": (mesh("a&#10;b.stl"), r"no mesh 'a\nb.stl'"),
    "markup": (mesh("a b [red].stl"), "'a b [red].stl'"),
    "folder": (mesh("folder.stl"), "no mesh"),
    "pipe": (mesh("pipe.stl"), "no mesh"),
    "device": (mesh("device.stl"), "no mesh"),
    "circle": (mesh("circle.stl"), "no mesh"),
    "too_large": (mesh("sparse.stl"), "has 60 MB, more than 50"),
}  # fmt: skip

PALE: dict[str, str] = {
    # Colours that are none: the shape is drawn in grey.
    "rgba_text": '<color rgba="red"/>',
    "rgba_two": '<color rgba="1 0"/>',
    "rgba_255": '<color rgba="255 0 0 1"/>',
    "rgba_nan": '<color rgba="nan 0 0 1"/>',
    "rgba_blank": '<color rgba=""/>',
}

DRAWN: dict[str, str] = {
    "plain": BALL,
    "mesh": mesh("good.stl", 'scale="0.5 0.5 0.5"'),
    "mirrored": mesh("good.stl", 'scale="-1 1 1"'),
    "texture_of_10_gigapixels": mesh("textured.obj"),  # the picture is not looked at, its colour is
    "colours_elsewhere": mesh("elsewhere.obj"),
    "named_colour": f'{BALL}<material name="nobody"/>',
}


def link(name: str, *visuals: str) -> str:
    """A link that hangs from the robot's base."""
    shown = "".join(f"<visual>{visual}</visual>" for visual in visuals)
    return (
        f'<link name="{name}">{shown}</link><joint name="to {name}" type="fixed"><parent link="base_link"/>'
        f'<child link="{name}"/></joint>'
    )


def links() -> str:
    painted = {name: f'{BALL}<material name="{name}">{colour}</material>' for name, colour in PALE.items()}
    bad = {name: visual for name, (visual, _) in BAD.items()}
    return "".join(link(name, visual) for name, visual in (bad | painted | DRAWN).items())


def put_files(folder: Path) -> None:
    """The mesh files, and what only looks like one."""
    for name, content in FILES.items():
        (folder / name).write_bytes(content)
    (folder / "folder.stl").mkdir()
    os.mkfifo(folder / "pipe.stl")
    (folder / "device.stl").symlink_to("/dev/zero")
    (folder / "circle.stl").symlink_to("circle.stl")
    with (folder / "sparse.stl").open("wb") as file:
        file.truncate(60_000_000)


@pytest.fixture(scope="module")
def truth() -> robots.Truth:
    return robots.simulate(bare(), 60, np.random.default_rng(0), noise=1e-4)


def bare() -> Robot:
    """A UR10 that has no shapes."""
    root = etree.fromstring(robots.ur10().urdf)
    for part in [*root.findall("link/visual"), *root.findall("link/collision")]:
        part.getparent().remove(part)
    return parse_robot(etree.tostring(root), "tool0")


def dressed(robot: Robot, more: str, folder: Path) -> Robot:
    """The robot with more links."""
    urdf = robot.urdf.replace(b"</robot>", f"{more}</robot>".encode())
    return parse_robot(urdf, robot.tip, robot.base, folder / "robot.urdf")


@pytest.fixture(scope="module")
def attacked(
    tmp_path_factory: pytest.TempPathFactory,
) -> tuple[Robot, tuple[robot_shapes.LinkShape, ...], tuple[str, ...]]:
    """A robot with every bad picture at once, what is drawn of it, and what is said."""
    folder = tmp_path_factory.mktemp("attacked")
    put_files(folder)
    robot = dressed(bare(), links(), folder)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(robot_shapes, "MOST_SHAPE_NOTICES", 1000)
        patched.setattr(meshes, "ROBOT_SECONDS", 3600)  # all are looked at, however busy the machine is
        drawn, notices = robot_shapes.robot_shapes(robot)
    return robot, drawn, notices


Attacked = tuple[Robot, tuple[robot_shapes.LinkShape, ...], tuple[str, ...]]


def test_there_are_attacks_enough() -> None:
    assert len(BAD) + len(PALE) > 60


LOST = [name for name, (_, why) in BAD.items() if why.startswith("no mesh")]
"""Links whose mesh is not there: what is said of them is one line for each package."""


def test_meshes_that_are_not_there_are_one_line_with_the_hint(attacked: Attacked) -> None:
    about = [notice for notice in attacked[2] if "without a mesh file" in notice]
    beside = "put it where the URDF looks for it, or leave it so"
    assert about == [
        f"not drawn: {len(LOST) - 1} shapes without a mesh file ('' and {len(LOST) - 2} more); {beside}",
        "not drawn: 1 shape without a mesh file ('package://lost/a.dae'); package lost: say where it is: `init --package "
        "lost=FOLDER` (in a campaign `robot.packages`), ROS_PACKAGE_PATH or AMENT_PREFIX_PATH",
    ]
    assert all(notice.isprintable() for notice in about)


@pytest.mark.parametrize("name", [name for name in BAD if name not in LOST])
def test_a_bad_picture_gives_one_notice_with_its_link_and_the_reason(name: str, attacked: Attacked) -> None:
    about = [notice for notice in attacked[2] if f"link '{name}'" in notice]
    assert len(about) == 1, about
    assert about[0].startswith(f"link '{name}' is not drawn: ")
    assert BAD[name][1] in about[0]
    assert about[0].isprintable() and len(about[0]) < LONGEST_NOTICE + 100
    assert ".py:" not in about[0]  # none is a bug of ours


@pytest.mark.parametrize("name", PALE)
def test_a_bad_colour_is_grey(name: str, attacked: Attacked) -> None:
    about = [notice for notice in attacked[2] if f"link '{name}'" in notice]
    assert len(about) == 1
    assert about[0].startswith(f"link '{name}' is drawn in grey: `rgba` of <color> should be")


def test_all_else_is_drawn(attacked: Attacked) -> None:
    _, drawn, notices = attacked
    assert len(notices) == len(BAD) - len(LOST) + 2 + len(PALE)
    assert len(drawn) == len(PALE) + len(DRAWN)
    red = [shape for shape in drawn if shape.colour == (1.0, 0.0, 0.0)]
    assert [shape.kind for shape in red] == ["mesh"]  # the textured one, in its material's colour
    assert (
        sum(shape.colour == robot_shapes.GREY for shape in drawn) == len(drawn) - 2
    )  # an OBJ without colours has its own grey


def test_a_calibration_loses_nothing_by_bad_pictures(
    truth: robots.Truth, outcome: Outcome, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    put_files(tmp_path)
    model = replace(truth.model, robot=dressed(truth.model.robot, links(), tmp_path))
    assert identify.main([str(robots.write_campaign(tmp_path, replace(truth, model=model)))]) == 0
    out, said = capfd.readouterr()
    assert "Traceback" not in said and "rror:" not in said  # Pinocchio, too, would complain of each visual
    results = tmp_path / "results"
    plain = json.loads(json.dumps(result_document(outcome)))
    assert json.loads((results / "result.json").read_text()) | {"seconds": 0} == plain | {"seconds": 0}
    sizes = {path.name: path.stat().st_size for path in results.iterdir()}
    assert sizes.keys() >= {"report.html", "scene.html", "calibrated.urdf", "calibration.yaml", "residuals.csv",
                            "frames.yaml", "kinematics.yaml", "joint_offsets.yaml", "dh.yaml"}  # fmt: skip
    assert min(sizes.values()) > 0
    assert "note: scene.html: link 'rpy_text' is not drawn: `rpy` of <origin> should be numbers, not 'abc'" in out
    assert 2 < out.count("note: ") < 15  # and how many more there are


# ---- meshes ----------------------------------------------------------------------------------------------------------


def test_a_mesh_that_kills_its_reader_costs_itself_alone_and_no_module_beside_it_is_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader starts in the user's folder, where there may be a file called as one that it imports."""
    os.mkfifo(tmp_path / "endless.stl")  # nobody writes it: its reader waits until it is killed
    for name in ("first.stl", "last.stl"):
        (tmp_path / name).write_bytes(stl(TRIANGLE))
    for name in ("trimesh", "json", "aridcal"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('I was run')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    paths = [tmp_path / name for name in ("first.stl", "endless.stl", "last.stl")]
    others = children()

    def kill() -> None:
        until(lambda: len(children()) > len(others))
        (reader,) = set(children()).difference(others)
        until(lambda: waits(reader))
        os.kill(int(reader), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    first, bad, last = read_meshes(paths).values()
    killer.join()
    assert isinstance(bad, NotDrawable) and "its reader died of it" in str(bad)
    for sound in (first, last):
        assert not isinstance(sound, NotDrawable)
        np.testing.assert_allclose(sound[0][1][sound[0][2]].reshape(3, 3), TRIANGLE, atol=1e-6)
    assert children() == others


def test_a_reader_that_takes_long_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    os.mkfifo(tmp_path / "endless.stl")
    monkeypatch.setattr(meshes, "FILE_SECONDS", 1)
    (bad,) = read_meshes([tmp_path / "endless.stl"]).values()
    assert isinstance(bad, NotDrawable) and "longer than 1 s" in str(bad)


def test_a_reader_that_takes_much_memory_is_stopped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "bomb.dae").write_bytes(bomb())
    monkeypatch.setattr(meshes, "MESH_MEMORY_GB", 0.45)
    monkeypatch.setattr(meshes, "FILE_SECONDS", 3600)  # memory is short before time is
    (bad,) = read_meshes([tmp_path / "bomb.dae"]).values()
    assert isinstance(bad, NotDrawable) and "longer" not in str(bad)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere the reader ends when its time is over")
def test_a_reader_dies_with_the_command_that_started_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "endless.stl")
    code = "\n".join([
        "import sys; from pathlib import Path; from aridcal.engine.robot import meshes",
        "meshes.FILE_SECONDS = 3600",  # by itself it would not end while we wait
        "meshes.read_meshes([Path(sys.argv[1])])",
    ])  # fmt: skip
    with subprocess.Popen([sys.executable, "-c", code, str(tmp_path / "endless.stl")]) as command:
        begun = Path(f"/proc/{command.pid}/task/{command.pid}/children")
        until(lambda: all(map(waits, begun.read_text().split() or ["none"])))
        reader = Path(f"/proc/{int(begun.read_text())}")
        command.kill()
    until(lambda: not reader.exists() or "Z" in (reader / "stat").read_text().rpartition(")")[2])


def waits(process: str) -> bool:
    """Whether a process sleeps for half a second: it waits for what does not come."""
    for _ in range(25):
        if Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "S":
            return False
        time.sleep(0.02)
    return True


def until(condition: Callable[[], bool]) -> None:
    """Wait for something that comes soon, and fail if it never does."""
    end = time.monotonic() + chromium.PATIENCE
    while time.monotonic() < end:
        with suppress(OSError):  # a process that ends while it is looked at
            if condition():
                return
        time.sleep(0.02)
    raise AssertionError("it never came")


def test_no_mesh_is_begun_after_the_time_of_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in "abc":
        (tmp_path / f"{name}.stl").write_bytes(stl(TRIANGLE))
    seconds = iter(range(0, 1000, 40))  # each look at the clock is 40 s later
    monkeypatch.setattr(meshes, "time", SimpleNamespace(monotonic=lambda: float(next(seconds))))
    monkeypatch.setattr(meshes, "ROBOT_SECONDS", 90)
    first, second, third = read_meshes([tmp_path / f"{name}.stl" for name in "abc"]).values()
    assert not isinstance(first, NotDrawable) and not isinstance(second, NotDrawable)
    assert isinstance(third, NotDrawable) and "those before it took 90 s" in str(third)


def test_meshes_together_have_a_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    paths = [tmp_path / f"{name}.stl" for name in "abc"]
    for path in paths:
        path.write_bytes(stl(*100 * [TRIANGLE]))
    monkeypatch.setattr(meshes, "ROBOT_MB", 2.5 * len(stl(*100 * [TRIANGLE])) / 1e6)
    found = list(read_meshes([*paths, *paths]).values())
    assert [isinstance(each, NotDrawable) for each in found] == [True, False, False]  # the refused come first
    assert "in all" in str(found[0])


def test_where_no_reader_can_be_started_the_meshes_are_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.stl").write_bytes(stl(TRIANGLE))
    for program in ("/nowhere/python", "/bin/false"):
        monkeypatch.setattr(sys, "executable", program)
        (found,) = read_meshes([tmp_path / "a.stl"]).values()
        assert isinstance(found, NotDrawable) and "start" in str(found)


def test_a_robot_of_very_many_shapes_is_drawn_in_part(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "good.stl").write_bytes(stl(*20 * [TRIANGLE]))
    robot = dressed(bare(), link("many", *3000 * [BALL]), tmp_path)
    drawn, notices = robot_shapes.robot_shapes(robot)
    assert len(drawn) == robot_shapes.MOST_SHAPES
    assert notices == ("of 3,000 visuals only the first 2,000 are drawn",)
    monkeypatch.setattr(robot_shapes, "MOST_TRIANGLES", 50)
    drawn, notices = robot_shapes.robot_shapes(dressed(bare(), link("many", *4 * [mesh("good.stl")]), tmp_path))
    assert len(drawn) == 2 and len(notices) == 1
    assert "50 triangles" in notices[0]


def children() -> list[str]:
    """Processes that we have started and that are left."""
    return Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()


# ---- the pages -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def outcome(truth: robots.Truth, tmp_path_factory: pytest.TempPathFactory) -> Outcome:
    return pipeline.identify(robots.write_campaign(tmp_path_factory.mktemp("outcome"), truth))


@pytest.fixture(scope="module")
def handover(outcome: Outcome) -> ControllerExports:
    return controller_exports(outcome)


def fails(error: Exception) -> Callable[..., object]:
    def raises(*_: object, **__: object) -> object:
        raise error

    return raises


ERRORS = [ZeroDivisionError("oops"), MemoryError(), RecursionError("deep"), OSError(36, "File name too long"),
          KeyError("a\nb"), AssertionError()]  # fmt: skip


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_an_error_of_any_kind_is_a_notice_with_its_place(error: Exception) -> None:
    with collect_notices() as notices:
        said = attempt("a picture", fails(error), lambda notice: notice)
    assert notices == [said]
    assert str(said).startswith(f"a picture is not drawn: {type(error).__name__}")
    assert "test_bad_pictures.py:" in str(said) and str(said).isprintable()


def test_a_section_that_fails_is_a_line_and_the_rest_of_the_report_stands(
    outcome: Outcome, handover: ControllerExports, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = page.page(outcome, handover)
    monkeypatch.setattr("aridcal.pages.report.fit_section._axis_table", fails(ZeroDivisionError("oops")))
    notices = page.write_report(outcome, handover, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text("utf-8")
    assert len(notices) == 1
    assert notices[0].startswith("report.html: the rest of section '4. Does the model fit?' is not drawn: ")
    parts = [etree.HTML(source).xpath("//section") for source in (whole, text)]
    for before, after in zip(*parts, strict=True):
        if before.get("id") == "fits":
            assert after.xpath("count(.//svg)") > 0  # what came before the failure
            assert notices[0] in " ".join(after.xpath(".//p[@class='missing']/text()"))
        else:
            assert etree.tostring(before) == etree.tostring(after)


def test_a_figure_that_fails_is_a_line_in_its_place(
    outcome: Outcome, handover: ControllerExports, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aridcal.pages.drawing.figures.legend", fails(ValueError("no legend")))
    notices = page.write_report(outcome, handover, tmp_path / "report.html")
    body = etree.HTML((tmp_path / "report.html").read_text("utf-8"))
    assert len(notices) >= 3
    assert all("the figure '" in notice and "no legend" in notice for notice in notices)
    assert len(body.xpath("//p[@class='missing']")) == len(notices)
    assert len(body.xpath("//section")) == 9
    assert body.xpath("//svg")


def test_each_picture_of_a_sound_result_is_drawn(outcome: Outcome, handover: ControllerExports, tmp_path: Path) -> None:
    """Otherwise the tests above would hide a bug instead of showing that one is survived."""
    assert page.write_report(outcome, handover, tmp_path / "report.html") == ()
    assert scene.write_scene(outcome, tmp_path / "scene.html") == (
        "scene.html: no link has a shape that can be drawn: the robot is drawn as a stick figure",
    )


@pytest.mark.parametrize(
    ("where", "error"),
    [
        ("drawing.scene.scene", KeyError("a")),
        ("drawing.scene.scene_content", MemoryError()),
        ("drawing.scene.robot_shapes", OSError(36, "File name too long")),
        ("report.page._chapters", RecursionError("deep")),
    ],
)
def test_a_whole_page_that_fails_is_a_page_that_says_so(
    where: str,
    error: Exception,
    outcome: Outcome,
    handover: ControllerExports,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(f"aridcal.pages.{where}", fails(error))
    path = tmp_path / "page.html"
    notices = scene.write_scene(outcome, path) if "scene" in where else page.write_report(outcome, handover, path)
    assert type(error).__name__ in notices[-1]
    assert etree.HTML(path.read_text("utf-8")).xpath("string(//p[@class='missing'])") == notices[-1]


def test_python_users_lose_no_file_and_are_warned_of_what_is_missing(
    outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = Calibration(calibration(outcome), outcome)
    monkeypatch.setattr("aridcal.pages.drawing.scene.scene_content", fails(ZeroDivisionError("oops")))
    monkeypatch.setattr("aridcal.pages.report.page._chapters", fails(ZeroDivisionError("no report")))
    with pytest.warns(UserWarning, match=r"scene\.html is not drawn: ZeroDivisionError: oops"):
        shown = found.scene(tmp_path / "there.html")
    assert "oops" in shown.html == (tmp_path / "there.html").read_text("utf-8")
    with pytest.warns(UserWarning, match=r"report\.html is not drawn: ZeroDivisionError: no report"):
        assert "no report" in found.report().html
    with pytest.warns(UserWarning, match="oops"):
        found.save(tmp_path / "results")
    names = {path.name for path in (tmp_path / "results").iterdir()}
    assert names >= {"report.html", "scene.html", "result.json", "calibration.yaml", "calibrated.urdf", "dh.yaml"}


def test_an_interruption_is_no_failed_picture() -> None:
    for stop in (KeyboardInterrupt, SystemExit):
        with pytest.raises(stop):
            attempt("a picture", fails(stop()), lambda notice: notice)  # type: ignore[arg-type]


def test_notices_are_collected_once_each_and_only_where_somebody_asks() -> None:
    note("nobody listens")
    with collect_notices() as outer:
        note("a")
        with collect_notices() as inner:
            note("b")
            note("b")
        note("c")
    assert (outer, inner) == (["a", "c"], ["b"])


def test_a_reason_is_one_printable_line_of_bounded_length() -> None:
    with collect_notices() as notices:
        attempt("it", fails(ValueError("x" * 10_000 + "\n\x1b[31m\x00")), lambda notice: None)
    assert notices[0].isprintable() and len(notices[0]) < LONGEST_NOTICE + 100
    assert "test_bad_pictures.py:" in notices[0]


def test_names_that_utf_8_has_not_are_written_somehow(
    outcome: Outcome, handover: ControllerExports, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aridcal.pages.report.page._chapters", lambda *_: [])
    odd = replace(outcome, measurements=outcome.measurements.with_origin(files=(Path(os.fsdecode(b"m\xff.csv")),)))
    assert page.write_report(odd, handover, tmp_path / "report.html") == ()
    assert "m\\udcff.csv" in (tmp_path / "report.html").read_text("utf-8")


def test_a_thinned_scene_keeps_the_flagged_rows_and_says_so(
    outcome: Outcome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("aridcal.pages.drawing.drawn_rows.MOST_DRAWN", 20)
    monkeypatch.setattr("aridcal.pages.drawing.drawn_rows.SOUND_DRAWN", 4)
    odd = np.isin(np.arange(len(outcome.outlier)), [1, 2, 5, 7, len(outcome.outlier) - 1])
    drawn = scene.scene(replace(outcome, outlier=odd))
    assert sorted(drawn.line[drawn.outlier].tolist()) == sorted(outcome.measurements.origin.line[odd].tolist())
    assert 5 < len(drawn.line) <= 20 and len(drawn.measured) == len(drawn.readings) == len(drawn.line)
    assert (np.diff(drawn.line) > 0).all()
    scene.write_scene(replace(outcome, outlier=odd), tmp_path / "scene.html")
    said = f"{len(drawn.line)} of {len(odd)} rows drawn: every flagged one (5), every "
    assert said in (tmp_path / "scene.html").read_text("utf-8")
