import difflib
import io
import re
from importlib.metadata import distribution

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree
from scipy.spatial.transform import Rotation

from aridcal.errors import RobotError
from aridcal.urdf_writer import splice_origins

ROBOTS = distribution("example-robot-data").locate_file("cmeel.prefix/share/example-robot-data/robots")
PUBLIC = (
    "ur_description/urdf/ur10_robot.urdf",
    "panda_description/urdf/panda.urdf",
    "so_arm_description/urdf/so100.urdf",  # CRLF
    "xarm_description/urdf/xarm7.urdf",
    "kinova_description/robots/kinova.urdf",
    "baxter_description/urdf/baxter.urdf",
    "talos_data/robots/talos_full_v2.urdf",
    "pr2_description/urdf/pr2.urdf",
)
VALUES = re.compile(rb"""\s(xyz|rpy)\s*=\s*("[^"]*"|'[^']*')""")
FOREIGN = """<?xml version="1.0"?>
<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
  <!-- <joint name="a"><origin xyz="9 9 9"/></joint> -->
  <xacro:macro name="m"><joint name="a"><origin xyz="8 8 8"/></joint></xacro:macro>
  <transmission name="t"><joint name="a"><origin xyz="7 7 7"/></joint></transmission>
  <ros2_control name="c"><joint name="a"><origin xyz="6 6 6"/></joint></ros2_control>
  <gazebo reference="a"><origin xyz="5 5 5"/></gazebo>
  <link name="base"><visual><origin xyz="4 4 4"/></visual></link>
  <joint name="a" type="revolute"><sensor><origin xyz="3 3 3"/></sensor><!-- <origin xyz="2 2 2"/> -->
    <![CDATA[<origin xyz="1 1 1"/>]]><parent link="base"/><child link="l"/><axis xyz="0 0 1"/><origin xyz="0 0 0"/>
  </joint>
  <link name="l"/>
</robot>
"""


def public(name):
    return (ROBOTS / name).read_bytes()


def random_origins(rng, names):
    return {name: (rng.normal(size=3), rng.uniform(-1.5, 1.5, 3)) for name in names}


def nodes(urdf, names):
    """Every node of the document in order, the named joints' xyz and rpy (and origins that hold no more) left out."""
    found = []
    root = etree.fromstring(urdf)
    ours = {j.find("origin") for j in root.findall("joint") if j.get("name") in names}
    for node in root.iter():
        attributes = dict(node.attrib)
        if node in ours:
            attributes = {k: v for k, v in attributes.items() if k not in ("xyz", "rpy")}
        if node not in ours or attributes or len(node):
            found.append((node.tag, attributes, (node.text or "").strip()))
        found.append((node.tail or "").strip())
    return [f for f in found if f]


def read_back(urdf):
    found = {}
    for joint in etree.fromstring(urdf).findall("joint"):
        origin = joint.find("origin")
        got = {} if origin is None else origin.attrib
        found[joint.get("name")] = tuple([float(v) for v in got.get(k, "0 0 0").split()] for k in ("xyz", "rpy"))
    return found


def joint_urdf(body, newline="\n"):
    lines = ['<robot name="r">', '  <link name="b"/>', '  <link name="c"/>', body, "</robot>", ""]
    return newline.join(lines).encode()


@pytest.mark.parametrize("name", PUBLIC)
def test_only_the_origins_of_public_robots_change(name):
    rng = np.random.default_rng(1)
    before = public(name)
    joints = [j.get("name") for j in etree.fromstring(before).findall("joint")]
    origins = random_origins(rng, rng.permutation(joints)[: len(joints) // 2 + 1])
    after = splice_origins(before, origins)

    assert nodes(after, origins) == nodes(before, origins)
    expected = read_back(before) | {n: (list(xyz), list(rpy)) for n, (xyz, rpy) in origins.items()}
    assert read_back(after) == expected
    old, new = before.splitlines(keepends=True), after.splitlines(keepends=True)
    for kind, i, j, k, m in difflib.SequenceMatcher(None, old, new, autojunk=False).get_opcodes():
        if kind != "equal":
            assert kind in ("replace", "insert")
            assert VALUES.sub(b"", b"".join(old[i:j])) in (VALUES.sub(b"", b"".join(new[k:m])), b"")
            assert all(b"<origin" in line or b"xyz" in line or b"rpy" in line for line in new[k:m])


@pytest.mark.parametrize("name", PUBLIC[:6])
def test_pinocchio_and_yourdfpy_place_every_link_where_the_new_origins_say(name):
    rng = np.random.default_rng(2)
    before = re.sub(rb"<mimic[^>]*>", b"", public(name))  # Pinocchio leaves mimic joints free, yourdfpy drives them
    expected = pin.buildModelFromXML(before.decode())
    origins = random_origins(rng, expected.names[1:])
    model = pin.buildModelFromXML(splice_origins(before, origins).decode())

    # A joint's placement starts with the fixed joints in front of its own origin.
    for name_, (xyz, rpy) in origins.items():
        k = expected.getJointId(name_)
        was, now = placement(*read_back(before)[name_]), placement(xyz, rpy)
        expected.jointPlacements[k] = expected.jointPlacements[k] * was.inverse() * now
    q = pin.randomConfiguration(model, -np.ones(model.nq), np.ones(model.nq))
    data, expected_data = model.createData(), expected.createData()
    pin.framesForwardKinematics(model, data, q)
    pin.framesForwardKinematics(expected, expected_data, q)
    for got, want in zip(data.oMf, expected_data.oMf, strict=True):
        np.testing.assert_allclose(got.homogeneous, want.homogeneous, rtol=0, atol=1e-13)

    spliced = io.BytesIO(splice_origins(before, origins))
    robot = yourdfpy.URDF.load(spliced, load_meshes=False, build_collision_scene_graph=False)
    robot.update_cfg({n: angle(model, q, n) for n in robot.actuated_joint_names})
    for frame, got in zip(model.frames, data.oMf, strict=True):
        if frame.type == pin.BODY and frame.name != "universe":
            np.testing.assert_allclose(robot.get_transform(frame.name), got.homogeneous, rtol=0, atol=1e-12)


def placement(xyz, rpy):
    return pin.SE3(Rotation.from_euler("xyz", rpy).as_matrix(), np.array(xyz))


def angle(model, q, name):
    k = model.getJointId(name)
    own = q[model.idx_qs[k] : model.idx_qs[k] + model.nqs[k]]
    return np.arctan2(own[1], own[0]) if len(own) == 2 else own[0]


def test_joints_of_foreign_tags_comments_and_deeper_origins_are_not_the_robots():
    after = splice_origins(FOREIGN.encode(), {"a": (np.array([0.5, 0, 0]), np.zeros(3))})
    assert after == FOREIGN.replace('xyz="0 0 0"', 'xyz="0.5 0.0 0.0"').encode()


# Random documents: the generator writes the file with the old and with the new values, so every byte is known.
SPACE = st.sampled_from([" ", "  ", "\t", "\n    "])
NUMBER = st.floats(allow_nan=False, allow_infinity=False).map(lambda v: v + 0.0)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
NOISE = st.sampled_from(
    ["", "<!-- <origin xyz='1 2 3'/> -->", "<?pi <joint>?>", "<gazebo><joint name='j0'><origin/></joint></gazebo>", "é"]
)


def write(vector):
    return " ".join(repr(v) for v in vector)


@st.composite
def joints(draw, name):
    """One joint as (text before, text after, wanted vectors)."""
    quote, eq = draw(st.sampled_from("\"'")), draw(st.sampled_from(["=", " = ", "= ", " ="]))
    wanted = {"xyz": draw(VECTOR), "rpy": draw(VECTOR)}
    gap = draw(st.sampled_from(["", " ", "\n    ", "\n\n\t", " <!-- hinge --> ", " <!-- hinge -->\n  "]))
    open_ = f"<joint{draw(SPACE)}name{eq}{quote}{name}{quote} type='fixed'>"
    rest = "<parent link='b'/><child link='c'/>" + draw(NOISE)
    keys = draw(st.sampled_from([[], ["xyz"], ["rpy"], ["xyz", "rpy"], ["rpy", "xyz"]]))
    added = "".join(f" {k}={quote}{write(wanted[k])}{quote}" for k in wanted if k not in keys and any(wanted[k]))
    if not keys and draw(st.booleans()):
        indent = re.search(r"(\n[ \t]*)?$", gap).group()
        new = f"<origin{added}/>{indent}" if added else ""
        body = f"{open_}{gap}%s{rest}</joint>"
        return body % "", body % new, wanted
    own = draw(st.sampled_from("\"'")) if draw(st.booleans()) else quote
    foreign = draw(st.sampled_from(["", " note='a > b xyz=\"1 1 1\"'", " aé='&lt;'"]))
    old = {k: draw(st.sampled_from(["0 0 0", " 1e3\t2 3", "&#48; 1 2", write(wanted[k])])) for k in keys}
    same = {k: [float(v) for v in old[k].replace("&#48;", "0").split()] == list(wanted[k]) for k in keys}

    def attributes(values):
        return "".join(f"{s}{k}{eq}{own}{values[k]}{own}" for k, s in zip(keys, spaces, strict=True))

    spaces = [draw(SPACE) for _ in keys]
    end = draw(st.sampled_from(["/>", " />", "></origin>", "\n  >\n  </origin >"]))
    before = f"{open_}{gap}{rest}<origin{foreign}{attributes(old)}{end}</joint>"
    new = {k: old[k] if same[k] else write(wanted[k]) for k in keys}
    return before, f"{open_}{gap}{rest}<origin{foreign}{attributes(new)}{added}{end}</joint>", wanted


@st.composite
def documents(draw):
    """(bytes before, bytes after, origins) in a random encoding, with random line ends."""
    number = draw(st.integers(1, 4))
    parts = [draw(joints(f"j{k}&amp;é")) for k in range(number)]
    encoding = draw(st.sampled_from(["utf-8", "utf-8-sig", "iso-8859-1", "utf-16", "utf-16-be", "utf-16-le"]))
    newline = draw(st.sampled_from(["\n", "\r\n"]))
    declared = encoding.removesuffix("-sig").removesuffix("-be").removesuffix("-le")
    head = f"<?xml version='1.0' encoding='{declared}'?>\n" if encoding != "utf-8" or draw(st.booleans()) else ""
    head += draw(st.sampled_from(["", "<!-- é -->\n", "<?pi é?>"])) + "<robot name='é'><link name='b'/>"
    noise = [draw(NOISE) for _ in parts]
    shuffled = draw(st.permutations(range(number)))
    touched = draw(st.sets(st.sampled_from(range(number)), min_size=1))

    def text(which):
        joints_ = (parts[k][which if k in touched else 0] + "\n" + noise[k] for k in shuffled)
        return (head + "".join(joints_) + "</robot>\n").replace("\n", newline).encode(encoding)

    origins = {f"j{k}&é": tuple(np.array(parts[k][2][key]) for key in ("xyz", "rpy")) for k in touched}
    return text(0), text(1), origins


@settings(max_examples=300, deadline=None, derandomize=True, database=None)
@given(documents())
def test_random_documents_change_in_the_origins_and_nowhere_else(document):
    before, after, origins = document
    assert splice_origins(before, origins) == after
    assert nodes(after, origins) == nodes(before, origins)


def test_an_inserted_origin_follows_the_files_line_ends_indentation_and_quotes():
    body = "\r\n".join(["  <joint name='j' type='fixed'>", "\t\t<parent link='b'/><child link='c'/>", "  </joint>"])
    after = splice_origins(joint_urdf(body, "\r\n"), {"j": (np.array([1.0, 0, 0]), np.zeros(3))})
    assert b"type='fixed'>\r\n\t\t<origin xyz='1.0 0.0 0.0'/>\r\n\t\t<parent" in after


def test_any_float64_reads_back_exactly():
    rng = np.random.default_rng(3)
    before = joint_urdf('<joint name="j" type="fixed"><parent link="b"/><child link="c"/></joint>')
    for scale in 10.0 ** rng.uniform(-300, 300, 200):
        xyz, rpy = rng.normal(size=(2, 3)) * scale
        assert read_back(splice_origins(before, {"j": (xyz, rpy)})) == {"j": (list(xyz), list(rpy))}


def test_the_origins_that_a_file_already_has_leave_its_bytes_alone():
    before = public(PUBLIC[0])
    assert splice_origins(before, read_back(before)) == before


def test_splicing_back_the_old_values_gives_back_the_old_origins():
    before = public(PUBLIC[2])
    old = read_back(before)
    after = splice_origins(before, random_origins(np.random.default_rng(4), list(old)))
    assert read_back(after) != old
    assert read_back(splice_origins(after, old)) == old


@pytest.mark.parametrize(
    ("urdf", "says"),
    [
        (b"", "well-formed"),
        (b"<robot><joint name='j'>", "well-formed"),
        (b"<?xml version='1.0' encoding='nonsense'?><robot/>", "well-formed"),
        (b"<?xml version='1.0' encoding='shift_jis'?><robot/>", "well-formed"),
        (b"<?xml version='1.0' encoding='utf-8'?><robot name='\xe9'/>", "well-formed"),
        (b"<robot><joint name='j' name='j'/></robot>", "well-formed"),
        (b"<!DOCTYPE robot><robot/>", "DOCTYPE"),
        (b"<!DOCTYPE r [<!ENTITY a 'aa'><!ENTITY b '&a;&a;'>]><robot>&b;</robot>", "DOCTYPE"),
        (b"<!DOCTYPE r [<!ENTITY f SYSTEM 'file:///etc/passwd'>]><robot>&f;</robot>", "DOCTYPE"),
        (b"<robot>&undefined;</robot>", "well-formed"),
        (b"<sdf><joint name='j'/></sdf>", "<sdf>, not <robot>"),
        (b"<robot><joint name='j'/><joint name='j'/></robot>", "'j' twice"),
        (b"<robot><joint name='j'/></robot>", "neither a parent nor a child"),
        (b"<robot><joint name='j'><origin quat_xyzw='0 0 0 1'/></joint></robot>", "quat_xyzw"),
        (b"<robot><joint name='jj'/></robot>", "no joint 'j' (did you mean 'jj'?)"),
        (b"<robot><link name='j'/><a><joint name='j'><origin/></joint></a></robot>", "no joint 'j'"),
    ],
)
def test_a_file_that_cannot_be_spliced_is_refused_with_the_reason(urdf, says):
    with pytest.raises(RobotError, match=re.escape(says)):
        splice_origins(urdf, {"j": (np.ones(3), np.ones(3))})


@pytest.mark.parametrize("bad", [[np.nan, 0, 0], [np.inf, 0, 0], [0, 0]])
def test_what_is_no_origin_is_never_written(bad):
    before = joint_urdf('<joint name="j" type="fixed"><parent link="b"/><child link="c"/></joint>')
    with pytest.raises(RobotError, match=r"joint 'j': its new xyz"):
        splice_origins(before, {"j": (np.array(bad), np.zeros(3))})


def test_pinocchios_rpy_rebuild_the_rotation_to_rounding_at_gimbal_lock_too():
    # The writer relies on pin.rpy.matrixToRpy for the rpy it is given; scipy is the second road.
    rng = np.random.default_rng(5)
    worst = 0.0
    for off in [None, 0.0, *10.0 ** np.arange(-17, 0)]:
        pitch = rng.uniform(-np.pi / 2, np.pi / 2, 300)
        if off is not None:
            pitch = rng.choice([-1, 1], 300) * (np.pi / 2 - off * rng.uniform(-1, 1, 300))
        rpy = np.column_stack([rng.uniform(-np.pi, np.pi, 300), pitch, rng.uniform(-np.pi, np.pi, 300)])
        for rotation in Rotation.from_euler("xyz", rpy).as_matrix():
            got = Rotation.from_euler("xyz", pin.rpy.matrixToRpy(rotation)).as_matrix()
            worst = max(worst, np.abs(got - rotation).max())
    assert worst < 10 * np.finfo(float).eps
