"""FANUC's letters N U T: which position of the arm a pose is meant in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from calibrated import machine
from scipy.spatial.transform import Rotation

from aridcal.programs.axes import axes_of
from aridcal.programs.branches import controller, flange, positions_of_arm
from aridcal.programs.correct import OTHERWISE, Correction, correct
from aridcal.programs.fanuc import read
from aridcal.programs.frames import KnownFrames
from aridcal.programs.postures import posture_of
from aridcal.programs.targets import Branch
from aridcal.robot.chain import Robot, parse_robot

SIX = axes_of(("revolute",) * 6)

JOINTS = [
    ((0, 0, 0.67), "0 0 1"), ((0.312, 0, 0), "0 1 0"), ((0, 0, 1.075), "0 -1 0"),
    ((0, 0, 0.225), "-1 0 0"), ((1.28, 0, 0), "0 -1 0"), ((0.27, 0, 0), "-1 0 0"),
]  # fmt: skip
"""An arm with the lengths of an R-2000iB/165F (the flange as far out as the pose below says), axes as ROS-Industrial has them."""


def arm(joints: list[tuple[tuple[float, float, float], str]] = JOINTS, turned: str = "") -> Robot:
    """A URDF; ``turned`` gives all axes with these numbers the other sign."""
    parts = ['<robot name="f"><link name="l0"/>']
    for k, (xyz, axis) in enumerate(joints):
        sign = -1 if str(k + 1) in turned else 1
        own = " ".join(f"{sign * float(v) + 0.0:g}" for v in axis.split())
        place = " ".join(f"{v:g}" for v in xyz)
        parts.append(
            f'<joint name="j{k + 1}" type="revolute"><parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="{place}"/>'
            f'<axis xyz="{own}"/><limit lower="-6.2" upper="6.2" effort="1" velocity="1"/></joint><link name="l{k + 1}"/>'
        )
    return parse_robot("".join([*parts, "</robot>"]).encode(), "l6", "l0", Path("f.urdf"))


def pendant(*degrees: float) -> np.ndarray:
    """Readings of J1 to J6 as FANUC shows them, J3 from the horizontal."""
    q = np.radians(degrees)
    q[2] += q[1]
    return q


def test_a_published_pose_has_the_published_joints_and_letters() -> None:
    """The example of J. Wiley, The perils of six-axis robots (ONE Robotics, 2013): one pose, N U T and F U T."""
    robot = arm()
    posture = posture_of(robot, SIX)
    assert posture is not None
    no_flip = pendant(7.962, -5.284, -36.250, 77.661, -51.975, -79.273)
    flip = pendant(7.962, -5.284, -36.250, -102.339, 51.975, 100.727)
    for q in (no_flip, flip):
        T = flange(robot, q)
        np.testing.assert_allclose(T[:3, 3] - [0, 0, 0.67], [1.5, 0.0, 0.36], atol=1e-3)
    assert posture.fits("NUT", no_flip)
    assert not posture.fits("FUT", no_flip)
    assert posture.fits("FUT", flip)
    assert not posture.fits("NUT", flip)
    for wrong in ("NDT", "NUB"):
        assert not posture.fits(wrong, no_flip)


def every_position(T: np.ndarray) -> dict[str, np.ndarray]:
    """All positions of the arm at a pose in closed form, by their letters; of those that lean backwards the elbow's is ``?``."""
    found = {}
    centre = T[:3, 3] - 0.27 * T[:3, 0] - [0, 0, 0.67]
    long, bend = np.hypot(0.225, 1.28), np.arctan2(0.225, 1.28)
    for side, q1 in (("T", np.arctan2(centre[1], centre[0])), ("B", np.arctan2(-centre[1], -centre[0]))):
        r, z = np.hypot(*centre[:2]) * (1 if side == "T" else -1) - 0.312, centre[2]
        cosine = (1.075**2 + r**2 + z**2 - long**2) / (2 * 1.075 * np.hypot(r, z))
        for elbow, sign in (("U", 1), ("D", -1)):
            upper = np.arctan2(z, r) + sign * np.arccos(cosine)  # from level; more is further back
            fore = np.arctan2(z - 1.075 * np.sin(upper), r - 1.075 * np.cos(upper)) - bend
            q2, q3 = np.pi / 2 - upper, fore + np.pi / 2 - upper
            R = Rotation.from_euler("ZY", [q1, q2 - q3]).as_matrix().T @ T[:3, :3]
            q4, q5, q6 = -Rotation.from_matrix(R).as_euler("XYX")
            for wrist, last in (("N", (q4, q5, q6)), ("F", (q4 + np.pi, -q5, q6 + np.pi))):
                q = np.array([q1, q2, q3, *last])
                found[wrist + (elbow if side == "T" else f"?{sign}") + side] = np.angle(np.exp(1j * q))
    return found


@pytest.mark.parametrize("turned", ["", "1", "23", "4", "5", "6", "123456"])
def test_each_of_the_eight_positions_of_a_pose_has_letters_of_its_own(turned: str) -> None:
    robot = arm(turned=turned)
    posture = posture_of(robot, SIX)
    assert posture is not None
    signs = np.array([-1.0 if str(k + 1) in turned else 1.0 for k in range(6)])
    rng = np.random.default_rng(1)
    low, high = [-1, -0.5, -0.5, -1.2, -1.8, -1], [1, 0.2, 0.3, 1.2, -0.4, 1]
    for start in rng.uniform(low, high, (20, 6)) * signs:
        T = flange(robot, start)
        stands = {letters: q * signs for letters, q in every_position(T).items() if np.isfinite(q).all()}
        assert sum(letters.endswith("T") for letters in stands) == 4
        for letters, q in stands.items():
            np.testing.assert_allclose(flange(robot, q), T, atol=1e-9)
            for other in (w + e + s for w in "NF" for e in "UD" for s in "TB"):
                same = other == letters if letters[-1] == "T" else other[0] + other[2] == letters[0] + letters[-1]
                assert posture.fits(other, q) == same


def test_letters_choose_the_position_whatever_is_near() -> None:
    robot = arm()
    posture = posture_of(robot, SIX)
    assert posture is not None
    no_flip = pendant(7.962, -5.284, -36.250, 77.661, -51.975, -79.273)
    flip = pendant(7.962, -5.284, -36.250, -102.339, 51.975, 100.727)
    branch = Branch(fits=lambda q: posture.fits("NUT", q), settled=True)
    found = positions_of_arm(controller(robot), flange(robot, flip), branch, flip)
    np.testing.assert_allclose(np.exp(1j * found[0]), np.exp(1j * no_flip), atol=1e-3)


def test_other_arms_have_no_letters() -> None:
    offset = [*JOINTS[:4], ((1.28, 0.0, 0.0), "0 -1 0"), ((0.27, 0.0, 0.05), "-1 0 0")]
    leaning = [*JOINTS[:3], ((0, 0, 0.225), "0 0 1"), *JOINTS[4:]]
    for joints in (offset, leaning):
        assert posture_of(arm(joints), SIX) is None
    assert posture_of(arm(), axes_of(("revolute",) * 5)) is None


def test_a_program_says_its_letters() -> None:
    body = "GP1:\n UF : 0, UT : 1, CONFIG : '{}',\n X = 1.0 mm, Y = 2.0 mm, Z = 3.0 mm,\n W = 1.0 deg, P = 2.0 deg, R = 3.0 deg"
    for config, letters in (
        ("F D B, 0, 0, -1", "FDB"),
        ("NUT,0,0,0", "NUT"),
        ("N R D B, 0, 0, 0", ""),
        ("1, 0, 0, 0", ""),
    ):
        text = f"/PROG A\n/MN\n1:L P[1] ;\n/POS\nP[1]{{\n{body.format(config)}\n}};\n/END\n"
        (target,) = read(text, SIX, KnownFrames(tools={"1": np.eye(4)}))
        assert target.branch.letters == letters


def test_orientation_of_the_published_pose() -> None:
    """W P R of the published pose, about fixed axes; the flange's z is along it, as FANUC's tool frame has it."""
    T = flange(arm(), pendant(7.962, -5.284, -36.250, 77.661, -51.975, -79.273))
    face = Rotation.from_euler("xyz", [135.0, -45.0, 0.0], degrees=True).as_matrix()
    np.testing.assert_allclose(T[:3, 0], face[:, 2], atol=1e-3)


def test_a_program_is_corrected_in_the_position_that_its_letters_say() -> None:
    """The same numbers as where the nearest position is the one that the letters mean, others than where it is not."""
    saved = machine(5, n=60, robot=arm()).saved
    no_flip = pendant(7.962, -5.284, -36.250, 77.661, -51.975, -79.273)
    flip = pendant(7.962, -5.284, -36.250, -102.339, 51.975, 100.727)

    def corrected(config: str, start: np.ndarray, at: np.ndarray = no_flip) -> Correction:
        T = flange(saved.final.model.robot, at)
        numbers = [*(1e3 * T[:3, 3]), *Rotation.from_matrix(T[:3, :3]).as_euler("xyz", degrees=True)]
        words = zip("XYZWPR", numbers, ["mm"] * 3 + ["deg"] * 3, strict=True)
        body = f"GP1:\n UF : 0, UT : 1, {config}\n {', '.join(f'{name} = {value:.6f} {unit}' for name, value, unit in words)}"
        text = f"/PROG A\n/MN\n1:L P[1] ;\n/POS\nP[1]{{\n{body}\n}};\n/END\n"
        return correct(saved, read(text, SIX, KnownFrames(tools={"1": np.eye(4)})), {}, start)[0]

    meant, near = corrected("CONFIG : 'F U T, 0, 0, 0',", no_flip), corrected("", flip)
    assert meant.texts == near.texts != corrected("", no_flip).texts
    assert (meant.positions, meant.doubt, meant.remark) == (1, 0.0, "")
    far = pendant(0.0, 50.0, -10.0, 20.0, -40.0, 0.0)  # too far to be reached backwards
    odd = corrected("CONFIG : 'N U B, 0, 0, 0',", far, far)
    assert odd.remark == f"{OTHERWISE} (N U B)"
    assert odd.texts == corrected("", far, far).texts
