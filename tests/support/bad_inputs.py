"""Bad inputs for every command: what is spoiled in which folder, and what the message must name."""

from __future__ import annotations

import base64
import itertools
import os
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from spoil import (
    Spoil,
    a_socket,
    as_parquet,
    cell,
    edit,
    instead,
    key,
    nothing,
    put,
    together,
    without,
)

IDENTIFY = ("identify", "campaign.yaml", "-o", "out")
INIT = ("init", "--urdf", "robot.urdf", "--measurements", "measurements.csv", "-o", "new.yaml")
PREDICT = ("predict", "calibration.yaml", "query.csv", "-o", "out.csv")
COMPENSATE = ("compensate", "calibration.yaml", "poses.csv", "-o", "out.csv")
MEASURE = ("measure", "head.yaml", "-o", "out.csv")
SHOOT = ("identify", "shooting.yaml", "-o", "out")
SIMULATE = ("simulate", "scenario.yaml", "-o", "out")

LONG = 5000 * "a"
HUGE = 10**400
BRACKETS = "a[/]b"
INJECTED = "a&#10;b: 1"


@dataclass(frozen=True)
class Case:
    """One bad input.

    Attributes:
        command: The command and its arguments, to be run in the folder.
        spoil: What is done to the sound files of the folder before.
        says: What the message must match.
    """

    command: tuple[str, ...]
    spoil: Spoil
    says: str


# ---------------------------------------------------------------- no regular file, or too large


NO_FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a pipe": (os.mkfifo, "is a pipe; only regular files are read"),
    "a device without end": (lambda path: path.symlink_to("/dev/zero"), "is a device; only regular files"),
    "a folder": (Path.mkdir, "is a folder"),
    "a socket": (a_socket, "is a socket; only regular files"),
    "a link to itself": (lambda path: path.symlink_to(path.name), "cannot be|no such file|link that leads round"),
    "a file of the kernel": (lambda path: path.symlink_to("/proc/self/maps"), "is empty"),
    "nothing": (lambda path: path.write_bytes(b""), "is empty"),
    "blanks": (lambda path: path.write_bytes(b" \n\n"), "is empty"),
}

RARE = {"a socket", "a link to itself", "a file of the kernel", "blanks"}

READ_BY: dict[str, tuple[str, ...]] = {
    "robot.urdf": IDENTIFY,
    "measurements.csv": INIT,
    "campaign.yaml": IDENTIFY,
    "calibration.yaml": PREDICT,
    "query.csv": PREDICT,
    "poses.csv": COMPENSATE,
    "head.yaml": MEASURE,
    "squares.csv": MEASURE,
    "shots.csv": MEASURE,
    "0.png": MEASURE,
    "scenario.yaml": SIMULATE,
}


def no_files() -> Iterator[tuple[str, Case]]:
    for name, command in READ_BY.items():
        for what, (make, says) in NO_FILES.items():
            if what in RARE and name not in ("campaign.yaml", "measurements.csv", "0.png"):  # one reader of each kind
                continue
            if (name, what) not in (("calibration.yaml", "a folder"),):  # a result folder is as good as its file
                linked = "lies outside the folder" if name == "0.png" else says
                yield f"{name} is {what}", Case(command, instead(name, make), rf"{re.escape(name)}.*({says}|{linked})")


def sparse(megabytes: float) -> Callable[[Path], None]:
    """A file of that size that takes no room on the disk."""

    def make(path: Path) -> None:
        with path.open("wb") as file:
            file.truncate(int(megabytes * 1e6))

    return make


TOO_LARGE = {
    "robot.urdf": (21, IDENTIFY, "21.0 MB, at most 20 MB.*urdf_mb"),
    "measurements.csv": (501, INIT, "501.0 MB, at most 500 MB.*table_mb"),
    "campaign.yaml": (2, IDENTIFY, "2.0 MB, at most 1 MB"),
    "calibration.yaml": (51, PREDICT, "51.0 MB, at most 50 MB"),
    "query.csv": (9000, PREDICT, "9,000.0 MB, at most 500 MB"),
    "head.yaml": (2, MEASURE, "2.0 MB, at most 1 MB"),
    "shots.csv": (501, MEASURE, "501.0 MB, at most 500 MB.*table_mb"),
    "0.png": (101, MEASURE, "101.0 MB, at most 100 MB.*image_mb"),
    "scenario.yaml": (2, SIMULATE, "2.0 MB, at most 1 MB"),
}


def too_large() -> Iterator[tuple[str, Case]]:
    for name, (size, command, says) in TOO_LARGE.items():
        yield f"{name} of {size} MB", Case(command, instead(name, sparse(size)), f"{re.escape(name)}.*{says}")
    lowered = key("campaign.yaml", "limits.table_mb", 0.001)
    yield "a table above the campaign's own limit", Case(IDENTIFY, lowered, r"measurements\.csv.*at most 0\.001 MB")


# ---------------------------------------------------------------- URDF


def urdf(body: str) -> Spoil:
    return put("robot.urdf", f'<robot name="r">{body}</robot>')


def links_in_a_row(count: int) -> str:
    links = "".join(f'<link name="l{k}"/>' for k in range(count + 1))
    joint = '<joint name="j{0}" type="fixed"><parent link="l{0}"/><child link="l{1}"/></joint>'
    return links + "".join(joint.format(k, k + 1) for k in range(count))


def links_side_by_side(count: int, kind: str = "fixed") -> str:
    joint = '<joint name="j{0}" type="{1}"><parent link="l0"/><child link="l{0}"/></joint>'
    links = "".join(f'<link name="l{k}"/>' for k in range(count + 1))
    return links + "".join(joint.format(k, kind) for k in range(1, count + 1))


def renamed(name: str) -> Spoil:
    """Another name for the third joint, in the URDF and in the table."""
    return edit("robot.urdf", 'name="joint_3"', f'name="{name}"')


URDFS: dict[str, tuple[Spoil, str]] = {
    "4,000 links in a row": (urdf(links_in_a_row(4000)), "'l4000' is 4,000 joints from the root, at most 200"),
    "201 links in a row": (urdf(links_in_a_row(201)), "201 joints from the root, at most 200.*Merge"),
    "10,001 links": (urdf(links_side_by_side(10_000)), "has 10,001 links, at most 10,000"),
    "1,000 moving joints": (urdf(links_side_by_side(1000, "continuous")), "1,000 joints move, at most 150"),
    "a loop": (
        urdf(
            '<link name="a"/><link name="b"/>'
            '<joint name="j" type="fixed"><parent link="a"/><child link="b"/></joint>'
            '<joint name="k" type="fixed"><parent link="b"/><child link="a"/></joint>'
        ),
        "form a loop.*delete or turn",
    ),
    "a link that is its own parent": (
        urdf('<link name="a"/><joint name="j" type="fixed"><parent link="a"/><child link="a"/></joint>'),
        "'a' form a loop",
    ),
    "2,000 roots": (urdf("".join(f'<link name="l{k}"/>' for k in range(2000))), "'l9' … have no parent"),
    "a joint with a line break in its name": (
        renamed(INJECTED),
        r"line \d+: a joint: the name 'a\\nb: 1' holds a control",
    ),
    "a joint with an escape in its name": (renamed("a&#9;b"), r"the name 'a\\tb' holds a control character.*rename"),
    "a joint of 5,000 letters": (renamed(LONG), r"line \d+: a joint: the name 'a+…' has 5,000 characters"),
    "a joint with a separator of paragraphs in its name": (
        renamed("a\u2029b"),
        r"'a\\u2029b' holds a control character",
    ),
    "a joint with markup that is no column": (renamed(BRACKETS), r"no column 'a\[/\]b'"),
    "a joint in bold red that is no column": (renamed("[bold red]"), r"no column '\[bold red\]'"),
    "a link with a line break in its name": (
        edit("robot.urdf", "<link name=", '<link name="x&#13;y"/><link name='),
        r"a link: the name 'x\\ry' holds a control",
    ),
    "a robot with a line break in its name": (
        edit("robot.urdf", '<robot name="[^"]*"', '<robot name="x&#10;y"'),
        r"the robot: the name 'x\\ny' holds",
    ),
    "a link of no name": (edit("robot.urdf", "<link name=", "<link/><link name="), "a link has no name: give it one"),
    "a link twice": (edit("robot.urdf", "<link name=", '<link name="flange"/><link name='), "'flange' is there twice"),
    "a joint of no name": (edit("robot.urdf", '<joint name="joint_3"', "<joint"), "a joint has no name"),
    "a joint twice": (renamed("joint_2"), "joint 'joint_2' is there twice"),
    "a parent that is not there": (
        edit("robot.urdf", r'<parent link="[^"]*"', '<parent link="nowhere"'),
        "its parent link 'nowhere' is not in the file",
    ),
    "a child that is not said": (edit("robot.urdf", r"<child link=[^>]*>", ""), "its child link '' is not in the file"),
    "a floating joint": (
        edit("robot.urdf", r'(?<=<joint name="joint_3" type=")\w+', "floating"),
        "'joint_3' on the chain is 'floating': only",
    ),
    "a type of 5,000 letters": (
        edit("robot.urdf", r'(?<=<joint name="joint_3" type=")\w+', LONG),
        "'joint_3' on the chain is 'a+…'",
    ),
    "1e308 in an origin": (
        edit("robot.urdf", r'<origin xyz="[^"]*"', '<origin xyz="1e308 0 0"'),
        r"xyz='1e308 0 0'>: 3 finite numbers",
    ),
    "infinity in an origin": (
        edit("robot.urdf", r'<origin xyz="[^"]*"', '<origin xyz="inf 0 0"'),
        "xyz='inf 0 0'>: 3 finite numbers",
    ),
    "words in an origin": (edit("robot.urdf", r'<origin xyz="[^"]*"', '<origin xyz="a b c"'), "xyz='a b c'>"),
    "two numbers in an origin": (edit("robot.urdf", r'<origin xyz="[^"]*"', '<origin xyz="1 2"'), "xyz='1 2'>"),
    "5,000 letters in an origin": (edit("robot.urdf", r'<origin xyz="[^"]*"', f'<origin xyz="{LONG}"'), "xyz='a+…'>"),
    "an axis of zeros": (edit("robot.urdf", r'<axis xyz="[^"]*"', '<axis xyz="0 0 0"'), "its axis is zero: say"),
    "an axis of 1e308": (edit("robot.urdf", r'<axis xyz="[^"]*"', '<axis xyz="1e308 0 0"'), "axis xyz='1e308 0 0'"),
    "a limit in words": (edit("robot.urdf", r'lower="[^"]*"', 'lower="low"'), "limit lower='low'>: 1 finite number"),
    "a limit of nan": (edit("robot.urdf", r'lower="[^"]*"', 'lower="nan"'), "limit lower='nan'>: 1 finite number"),
    "limits exchanged": (edit("robot.urdf", r'lower="[^"]*"', 'lower="999"'), "lower limit 999 is above.*exchange"),
    "a mass of 1e308": (edit("robot.urdf", r'mass value="[^"]*"', 'mass value="1e308"'), "mass value='1e308'"),
    "a mass of nan": (edit("robot.urdf", r'mass value="[^"]*"', 'mass value="nan"'), "mass value='nan'"),
    "an inertia of 1e308": (edit("robot.urdf", r'ixx="[^"]*"', 'ixx="1e308"'), "inertia ixx='1e308'"),
    "a master that is not there": (
        edit("robot.urdf", "</joint>", '<mimic joint="nobody"/></joint>'),
        "mimics 'nobody'",
    ),
    "a joint that mimics itself": (
        edit("robot.urdf", r'(?<=<joint name="joint_3" type=")(\w+)">', 'revolute"><mimic joint="joint_3"/>'),
        "'joint_3' mimics itself.*delete",
    ),
    "a multiplier of 1e308": (
        edit("robot.urdf", "</joint>", '<mimic joint="joint_2" multiplier="1e308"/></joint>'),
        "multiplier='1e308'",
    ),
    "a quaternion": (edit("robot.urdf", "<origin ", '<origin quat_xyzw="0 0 0 1" '), "quat_xyzw, which few.*write"),
    "an entity": (
        put("robot.urdf", '<!DOCTYPE r [<!ENTITY a "b">]><robot name="&a;"/>'),
        "has a DOCTYPE.*Remove",
    ),
    "a billion laughs": (
        put(
            "robot.urdf",
            "<!DOCTYPE r [<!ENTITY a0 'ha'>"
            + "".join(f"<!ENTITY a{k + 1} '{10 * f'&a{k};'}'>" for k in range(9))
            + "]><robot name='r'>&a9;</robot>",
        ),
        "DOCTYPE|well-formed",
    ),
    "an outer entity": (
        put("robot.urdf", '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]><robot name="r">&a;</robot>'),
        "has a DOCTYPE",
    ),
    "an entity that is not there": (urdf("&nobody;"), "not well-formed XML.*nobody"),
    "nested 100,000 deep": (urdf("<a>" * 100_000), "not well-formed XML.*Mend"),
    "an attribute of 11 MB": (urdf(f'<link name="{"a" * 11_000_000}"/>'), "not well-formed|11,000,000 characters"),
    "an attribute twice": (urdf('<link name="a" name="b"/>'), "not well-formed XML.*name.*Mend"),
    "NUL": (urdf("\0"), "not well-formed XML.*Mend"),
    "half of it": (urdf('<link name="a"'), "not well-formed XML.*Mend"),
    "xacro": (
        urdf('<xacro:macro xmlns:xacro="http://www.ros.org/wiki/xacro"/>'),
        "xacro cannot expand it: xacro:macro: missing attribute 'name'",
    ),
    "no robot": (put("robot.urdf", "<rob/>"), "the top element is <rob>, not <robot>"),
    "SDF": (put("robot.urdf", "<sdf/>"), "is SDF, Gazebo's format"),
    "MJCF": (put("robot.urdf", "<mujoco/>"), "no link 'flange'"),
    "a top element of 5,000 letters": (put("robot.urdf", f"<{LONG}/>"), "the top element is <a+…>"),
    "no links": (urdf(""), "no link 'flange'"),
    "an unknown encoding": (
        put("robot.urdf", '<?xml version="1.0" encoding="klingon"?><robot name="r"/>'),
        "not well-formed",
    ),
    "UTF-7 by its declaration": (
        put("robot.urdf", b'<?xml version="1.0" encoding="utf-8"?><robot name="\xff\xfe"/>'),
        "not well-formed",
    ),
}


def urdfs() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in URDFS.items():
        yield f"a URDF with {what}", Case(IDENTIFY, spoil, rf"robot\.urdf.*({says})" if "column" not in says else says)
    by_others = {"init": INIT, "simulate": SIMULATE}
    for command, arguments in by_others.items():
        for what in ("a joint with a line break in its name", "a loop", "NUL"):
            spoil, says = URDFS[what]
            yield f"{command} of a URDF with {what}", Case(arguments, spoil, says)


# ---------------------------------------------------------------- settings


NUMBERS = {"1e308": 1e308, "nan": np.nan, "inf": np.inf, "10^400": HUGE, "words": "many", "a list": [1], "truth": True}

NUMBER_KEYS = {
    "robot.gravity.2": ("campaign.yaml", r"robot\.gravity"),
    "measurements.noise.position": ("campaign.yaml", r"measurements\.noise\.position"),
    "measurements.noise.rotation": ("campaign.yaml", r"measurements\.noise\.rotation"),
    "frames.world_base.xyz.0": ("campaign.yaml", r"frames\.world_base\.xyz\[0\]"),
    "frames.tip_target.rpy.2": ("campaign.yaml", r"frames\.tip_target\.rpy\[2\]"),
    "limits.table_mb": ("campaign.yaml", r"limits\.table_mb"),
    "effects.0.order.0": ("campaign.yaml", r"effects\[0\]\.order"),
    "effects.1.at.time": ("campaign.yaml", r"effects\[1\]\.at"),
    "effects.2.at.row": ("campaign.yaml", r"effects\[2\]\.at"),
    "camera.fx": ("head.yaml", r"camera\.fx"),
    "camera.width": ("head.yaml", r"camera"),
    "sonars.std": ("head.yaml", r"sonars\.std"),
    "sonars.positions.1.0": ("head.yaml", r"sonars\.positions\[1\]\[0\]"),
    "tip_camera.xyz.2": ("head.yaml", r"tip_camera\.xyz\[2\]"),
    "truth.n": ("scenario.yaml", r"truth\.n"),
    "truth.seed": ("scenario.yaml", r"truth\.seed"),
    "truth.noise.position": ("scenario.yaml", r"truth\.noise\.position"),
    "truth.parameters.joint_2.pitch": ("scenario.yaml", r"truth\.parameters"),
}

FULL = together(
    key("campaign.yaml", "robot.gravity", [0.0, 0.0, -9.81]),
    key("campaign.yaml", "frames", {"world_base": {"xyz": [0, 0, 0]}, "tip_target": {"rpy": [0, 0, 0]}}),
    key(
        "campaign.yaml",
        "effects",
        [
            {"kind": "joint_harmonic", "where": "joint_2", "order": [1]},
            {"kind": "shift", "where": "world_base", "at": {"time": 1.0}},
            {"kind": "shift", "where": "tip_target", "at": {"row": 5}},
        ],
    ),
)
"""Every number of a campaign has its place."""

READS = {"campaign.yaml": IDENTIFY, "head.yaml": MEASURE, "scenario.yaml": SIMULATE}


def numbers() -> Iterator[tuple[str, Case]]:
    for place, (file, says) in NUMBER_KEYS.items():
        for what, value in NUMBERS.items():
            if place == "effects.0.order.0" and what == "a list":
                continue
            once = place in ("limits.table_mb", "camera.fx", "truth.n")  # such digits are refused before keys are read
            if what == "10^400" and not once:
                continue
            if what == "10^400":  # Python itself does not write so many digits
                marked = key(file, place, "DIGITS")
                spoil = together(FULL, marked, edit(file, "DIGITS", "9" * 401))
                says_so = "the number 9+… is too large: write a smaller one"
            else:
                spoil, says_so = together(FULL, key(file, place, value)), says
            yield f"{what} for {place}", Case(READS[file], spoil, rf"{re.escape(file)}, line \d+.*({says_so})")


PATHS = {"NUL": "a\0b", "a line break": "a\nb", "5,000 letters": LONG, "a number": 5, "a list": [["a"]], "nothing": ""}

PATH_KEYS = {
    "robot.urdf": "campaign.yaml",
    "measurements.file": "campaign.yaml",
    "measurements.head": "shooting.yaml",
    "squares": "head.yaml",
    "shots": "head.yaml",
}


def paths() -> Iterator[tuple[str, Case]]:
    commands = READS | {"shooting.yaml": SHOOT}
    for place, file in PATH_KEYS.items():
        for what, value in PATHS.items():
            says = rf"{re.escape(file)}, line \d+: {re.escape(place)}.*(control character|cannot be the name|file name)"
            yield f"{what} for {place}", Case(commands[file], key(file, place, value), says)
    for option in ("campaign", "calibration", "head", "scenario", "out"):
        command = {
            "campaign": IDENTIFY,
            "calibration": PREDICT,
            "head": MEASURE,
            "scenario": SIMULATE,
            "out": COMPENSATE,
        }[option]
        last = option == "out"
        for what, text in (("NUL", "a\0b.csv"), ("a line break", "a\nb.csv"), ("5,000 letters", f"{LONG}.csv")):
            arguments = (*command[:-1], text) if last else (command[0], text, *command[2:])
            says = r"a(\\x00|\\n|a+).*(control character: rename|cannot be the name of a file.*Give another)"
            yield f"{what} for the argument {option}", Case(arguments, nothing, says)
    yield "a scene that is no file", Case(("view", f"{LONG}"), nothing, "cannot be the name of a file")
    yield (
        "a result folder that is not there",
        Case(("view", "[bold red]"), nothing, r"\[bold red\] does not exist. Run"),
    )
    yield "a folder without a result", Case(("view", "."), nothing, "not a result folder.*Run")
    pipe = together(lambda folder: (folder / "r").mkdir(), lambda folder: os.mkfifo(folder / "r" / "scene.html"))
    yield "a scene that is a pipe", Case(("view", "r"), pipe, "r is not a result folder|is a pipe")


SETTINGS: dict[str, tuple[Spoil, str]] = {
    "a format of 5,000 hexadecimal digits": (
        edit("campaign.yaml", "format: 1", "format: 0x" + 5000 * "f"),
        "0xf+… is too large",
    ),
    "a format of 5,000 digits": (edit("campaign.yaml", "format: 1", "format: " + 5000 * "9"), "9+… is too large"),
    "a format in binary": (edit("campaign.yaml", "format: 1", "format: 0b" + 300 * "1"), "0b1+… is too large"),
    "a format in base 60": (edit("campaign.yaml", "format: 1", "format: 1" + 3000 * ":59"), "is too large"),
    "a format in words": (edit("campaign.yaml", "format: 1", "format: one"), "reads format 1 only, not 'one'"),
    "a format of 5,000 letters": (edit("campaign.yaml", "format: 1", f"format: {LONG}"), "format 1 only, not 'a+…"),
    "no format": (edit("campaign.yaml", "format: 1\n", ""), "'format' is missing; write"),
    "a billion laughs": (
        put(
            "campaign.yaml",
            "a: &a [ha]\n" + "".join(f"{c}: &{c} [{10 * f'*{p}, '}]\n" for p, c in itertools.pairwise("abcdefghi")),
        ),
        r"line 2: the alias \*a is refused",
    ),
    "an anchor of 5,000 letters": (put("campaign.yaml", f"a: &{LONG} 1\nb: *{LONG}\n"), r"the alias \*a+… is refused"),
    "a merge": (put("campaign.yaml", "a: &a {b: 1}\nc: {<<: *a}\n"), r"alias \*a is refused"),
    "a tag": (put("campaign.yaml", "format: !!python/object/apply:os.system [ls]\n"), "the tag .* is refused"),
    "a tag of its own": (put("campaign.yaml", "format: !x 1\n"), "the tag !x is refused; write"),
    "100,000 brackets": (put("campaign.yaml", "a: " + 100_000 * "["), "nested more than 50 deep"),
    "100,000 levels of keys": (
        put("campaign.yaml", "".join(f"{k * ' '}a:\n" for k in range(1000))),
        "nested more than 50",
    ),
    "300,000 items": (put("campaign.yaml", "- 1\n" * 240_000), "more than 200,000 keys|no `key: value`"),
    "a key that is a list": (put("campaign.yaml", "format: 1\n? [1]\n: 2\n"), "a key must be a plain word"),
    "a key that is a number": (
        put("campaign.yaml", "format: 1\n5: 2\n"),
        "YAML reads this key as a int; put it in quotes",
    ),
    "a key that is a truth": (
        put("campaign.yaml", "format: 1\nyes: 2\n"),
        "reads this key as a bool; put it in quotes",
    ),
    "a key twice": (edit("campaign.yaml", "format: 1", "format: 1\nformat: 1"), "format: this key is there twice"),
    "a key of 5,000 letters": (edit("campaign.yaml", "format: 1", f"format: 1\n? {LONG}\n: 1"), "a+….*unknown key"),
    "a key with an escape": (edit("campaign.yaml", "format: 1", 'format: 1\n"a\\eb": 1'), r"a\\x1bb: unknown key"),
    "a key in bold": (edit("campaign.yaml", "format: 1", 'format: 1\n"[bold]x": 1'), r"\[bold\]x: unknown key"),
    "a control character": (put("campaign.yaml", "format: 1\x07\n"), "line 1: holds a character that YAML forbids"),
    "two documents": (put("campaign.yaml", "format: 1\n---\nformat: 1\n"), r"campaign\.yaml"),
    "a date that is none": (edit("campaign.yaml", "format: 1", "format: 2024-02-30"), "not valid YAML|format 1 only"),
    "UTF-16": (put("campaign.yaml", "format: 1\n".encode("utf-16")), "is not UTF-8 text; save"),
    "a tip that is a list": (key("campaign.yaml", "robot.tip", [1]), r"robot\.tip: should be a valid string"),
    "a tip with markup": (key("campaign.yaml", "robot.tip", "[bold red]x"), r"no link '\[bold red\]x'.*`robot\.tip`"),
    "a tip that closes markup": (key("campaign.yaml", "robot.tip", BRACKETS), r"no link 'a\[/\]b'"),
    "a tip of 5,000 letters": (key("campaign.yaml", "robot.tip", LONG), "no link 'a+…'.*`robot.tip`"),
    "a base with an escape": (key("campaign.yaml", "robot.base", "a\x1b[2J"), r"no link 'a\\x1b\[2J'.*`robot.base`"),
    "a gravity of two numbers": (
        key("campaign.yaml", "robot.gravity", [0, 1]),
        r"robot\.gravity: should be `world` or",
    ),
    "a kind that is none": (
        key("campaign.yaml", "measurements.kind", "poses"),
        r"measurements\.kind.*did you mean 'pose'",
    ),
    "a column for nobody": (
        key("campaign.yaml", "measurements.columns", {"joint_9": "q"}),
        r"columns\.joint_9: is neither",
    ),
    "a column with a line break": (
        key("campaign.yaml", "measurements.columns", {"joint_2": "a\nb"}),
        r"no column 'a\\+nb'",
    ),
    "a unit that is none": (key("campaign.yaml", "measurements.units.length", "km"), r"units\.length: 'km' is unknown"),
    "an order of axes that is none": (
        key("campaign.yaml", "measurements.orientation", {"euler": "XXY", "columns": ["a", "b", "c"]}),
        "'XXY' is no sequence",
    ),
    "two columns of three angles": (
        key("campaign.yaml", "measurements.orientation", {"euler": "XYZ", "columns": ["a", "b"]}),
        r"orientation\.columns",
    ),
    "effects that are no list": (key("campaign.yaml", "effects", {"kind": "x"}), "effects: should be a list"),
    "an effect at a place with markup": (
        key("campaign.yaml", "effects", [{"kind": "joint_compliance", "where": BRACKETS}]),
        r"'a\[/\]b'",
    ),
    "a backlash without a way to switch": (
        key("campaign.yaml", "effects", [{"kind": "joint_gain", "where": "joint_2", "by": "load"}]),
        r"`by` belongs to",
    ),
    "an effect of a column that is not there": (
        key(
            "campaign.yaml",
            "effects",
            [{"kind": "unknown", "where": "joint_2", "motion": ["axis"], "covariates": ["[bold]"]}],
        ),
        "effects: unknown at joint_2 cannot be fitted",
    ),
    "the same column for two joints": (
        key("campaign.yaml", "measurements.columns", {"joint_2": "joint_3"}),
        "'joint_3' would be two quantities; map",
    ),
    "a limit of nothing": (key("campaign.yaml", "limits.urdf_mb", 0), r"limits\.urdf_mb: should be greater than 0"),
    "an unknown limit": (key("campaign.yaml", "limits.tables_mb", 5), r"limits\.tables_mb: unknown key.*'table_mb'"),
    "an URDF above its own limit": (
        key("campaign.yaml", "limits.urdf_mb", 1e-4),
        r"robot\.urdf.*raise `limits: \{urdf_mb",
    ),
}


def settings() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in SETTINGS.items():
        yield f"a campaign with {what}", Case(IDENTIFY, spoil, says)


SCENARIOS: dict[str, tuple[Spoil, str]] = {
    "no truth": (without("scenario.yaml", "truth"), "truth: this key is missing"),
    "a campaign for a scenario": (
        key("scenario.yaml", "truth", 5),
        "truth: should be a valid mapping|truth: should be",
    ),
    "ten million rows and one": (key("scenario.yaml", "truth.n", 10_000_001), r"truth\.n: should be less"),
    "no rows": (key("scenario.yaml", "truth.n", 0), r"truth\.n: should be greater"),
    "a constant that is none": (
        key("scenario.yaml", "truth.parameters", {"joint_2.pich": 1e-3}),
        r"truth\.parameters\.joint_2\.pich.*did you mean",
    ),
    "a constant with markup": (
        key("scenario.yaml", "truth.parameters", {BRACKETS: 1e-3}),
        r"parameters\.a\[/\]b: there is no",
    ),
    "a deviation below zero": (
        key("scenario.yaml", "truth.parameters", {"joint_2.pitch": {"std": -1}}),
        r"std: should be greater",
    ),
    "outliers of 120 %": (
        key("scenario.yaml", "truth.outliers", {"share": 1.2, "size": 5}),
        r"outliers\.share: should be less",
    ),
    "outliers of no noise": (
        together(
            without("scenario.yaml", "truth.noise"), key("scenario.yaml", "truth.outliers", {"share": 0.1, "size": 5})
        ),
        r"truth\.outliers\.size is in sigmas",
    ),
    "an effect that is none": (
        key("scenario.yaml", "truth.effects", [{"kind": "magic", "where": "joint_2", "coefficients": 1}]),
        "'magic' is unknown",
    ),
    "an effect at no joint": (
        key("scenario.yaml", "truth.effects", [{"kind": "joint_gain", "where": "[bold]", "coefficients": 1}]),
        r"\[bold\]",
    ),
    "an effect with too many coefficients": (
        key("scenario.yaml", "truth.effects", [{"kind": "joint_gain", "where": "joint_2", "coefficients": [1, 2, 3]}]),
        "coefficients|coefficient",
    ),
    "units": (
        key("scenario.yaml", "measurements.units", {"angle": "deg"}),
        "units: the table is written in SI; delete",
    ),
    "sockets": (
        key("scenario.yaml", "truth.instruments", {"points": 3}),
        "truth.instruments: no row refers to such things",
    ),
    "stations": (key("scenario.yaml", "frames.world_base.per", "station"), "stations are not simulated; delete"),
    "effects by station": (
        key(
            "scenario.yaml",
            "truth.effects",
            [{"kind": "regional", "where": "joint_2", "by": "station", "coefficients": 1}],
        ),
        "stations are not simulated; name a joint",
    ),
    "two columns of one name": (key("scenario.yaml", "measurements.columns", {"x": "y"}), "would be called 'y'"),
}


def scenarios() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in SCENARIOS.items():
        yield f"a scenario with {what}", Case(SIMULATE, spoil, rf"scenario\.yaml.*({says})")


# ---------------------------------------------------------------- tables


HEADER = "joint_1,joint_2,joint_3,joint_4,x,y,z,qx,qy,qz,qw"
ROW = "1,1,1,1,1,1,1,0,0,0,1"

TABLES: dict[str, tuple[Spoil, str]] = {
    "a line of 20 MB": (
        put("measurements.csv", HEADER + "\n" + 20_000_000 * "1"),
        "a row has more than 16 MB.*line break|line 2 has 1. Decimal",
    ),
    "a header of 20 MB": (
        put("measurements.csv", 20_000_000 * "a" + "\n1\n"),
        r"line 1: has 20\.0 MB; is a line break missing",
    ),
    "a header cell of 200,000 letters": (
        put("measurements.csv", 200_000 * "a" + ",b\n1,2\n"),
        "line 1: is not a header row",
    ),
    "a name of 5,000 letters": (put("measurements.csv", f"{LONG},b\n1,2\n"), "a column: the name 'a+…' has 5,000"),
    "a million columns": (
        put("measurements.csv", ",".join(map(str, range(10**6))) + ",a\n" + 10**6 * "1,"),
        "has 1,000,001 columns, at most 10,000",
    ),
    "the same column 9,001 times": (
        put("measurements.csv", "a" + 9_000 * ",a" + "\n1" + 9_000 * ",1"),
        "'a' is there twice",
    ),
    "a column with a line break in its name": (
        put("measurements.csv", f'"x\ny",{HEADER}\n1,{ROW}\n'),
        r"measurements\.csv",
    ),
    "a column with an escape in its name": (
        put("measurements.csv", f"x\x1b[2J,{HEADER}\n1,{ROW}\n"),
        r"'x\\x1b\[2J' holds a control",
    ),
    "a column with NUL in its name": (
        put("measurements.csv", f"x\0y,{HEADER}\n1,{ROW}\n"),
        r"'x\\x00y' holds a control",
    ),
    "a column with a bell": (put("measurements.csv", f"x\x07,{HEADER}\n1,{ROW}\n"), r"'x\\x07' holds a control"),
    "NUL in every cell": (cell("measurements.csv", "joint_2", "1\0"), r"column 'joint_2', 1\\x00: not a number"),
    "an escape in every cell": (cell("measurements.csv", "joint_2", "\x1b]0;x\x07"), r"\\x1b\]0;x\\x07: not a number"),
    "markup in every cell": (cell("measurements.csv", "joint_2", "[/]"), r"column 'joint_2', \[/\]: not a number"),
    "5,000 letters in every cell": (cell("measurements.csv", "joint_2", LONG), "column 'joint_2', a+…?: not a number"),
    "bytes of Latin-1 in line 3": (
        put("measurements.csv", f"{HEADER}\n{ROW}\n".encode() + b"\xe4\n"),
        "line 3: is not UTF-8",
    ),
    "Latin-1 after a million bytes": (
        put("measurements.csv", (f"{HEADER}\n" + f"{ROW}\n" * 50_000).encode() + b"\xe4\n"),
        "line 50002: is not UTF-8",
    ),
    "half a letter at its end": (
        put("measurements.csv", f"{HEADER}\n{ROW}\n".encode() + "ä".encode()[:1]),
        "line 3: is not UTF-8",
    ),
    "UTF-16": (put("measurements.csv", f"{HEADER}\n{ROW}\n".encode("utf-16")), "line 1: is not UTF-8 text; save"),
    "UTF-16 without a mark": (
        put("measurements.csv", f"{HEADER}\n{ROW}\n".encode("utf-16-le")),
        r"holds a control|not UTF-8",
    ),
    "rows of commas": (put("measurements.csv", f"{HEADER}\n{',' * HEADER.count(',')}\n"), "has a header but no rows"),
    "an open quote": (put("measurements.csv", f'{HEADER}\n"{ROW}\n' + f"{ROW}\n" * 50), "quote is left open"),
    "an open quote in its header": (put("measurements.csv", f'"{HEADER}\n{ROW}\n'), r"measurements\.csv"),
    "a cell of two lines": (
        put("measurements.csv", f'{HEADER},n\n{ROW},"a\nb"\n' + f"{ROW},c\n" * 5),
        "line 2: a quote is left open",
    ),
    "only quotes": (put("measurements.csv", '"""\n"""\n'), r"measurements\.csv"),
    "semicolons": (put("measurements.csv", f"{HEADER}\n{ROW}\n".replace(",", ";")), "convert it to commas"),
    "tabs": (put("measurements.csv", f"{HEADER}\n{ROW}\n".replace(",", "\t")), "convert it to commas"),
    "rows of two cells": (put("measurements.csv", f"{HEADER}\n" + "1,2\n" * 9), "no row has as many cells"),
    "200,000 rows of two cells": (
        put("measurements.csv", f"{HEADER}\n" + "1,2\n" * 200_000),
        "line 2: has 2 cells.*100,000 rows more",
    ),
    "ten million blank lines": (
        put("measurements.csv", f"{HEADER}\n{ROW}\n" + "\n" * 10_000_000 + ROW),
        "would take 880 MB, at most 500",
    ),
    "a hundred million empty cells": (
        put("measurements.csv", ",".join(f"c{k}" for k in range(10_000)) + "\n" + ("," * 9_999 + "\n") * 7_000),
        "7,001 rows of 10,000 columns would take 560 MB",
    ),
    "numbers of 400 digits": (
        cell("measurements.csv", "joint_2", "9" * 400),
        "joint_2.*(not finite|implausibly|not a number)",
    ),
    "hexadecimal": (cell("measurements.csv", "joint_2", "0x1p3"), "not a number"),
    "1e308 for a position": (cell("measurements.csv", "x", "1e308"), "'x', 1e308: implausibly large"),
    "-1e308 for a joint": (cell("measurements.csv", "joint_2", "-1e308"), "implausibly large"),
    "quaternions of 1e308": (
        together(*(cell("measurements.csv", c, "1e308") for c in ("qx", "qy", "qz", "qw"))),
        "implausibly large",
    ),
    "quaternions of 1e-320": (
        together(*(cell("measurements.csv", c, "1e-320") for c in ("qx", "qy", "qz", "qw"))),
        "norm of the quaternion is not 1",
    ),
    "sigmas of 1e308": (
        together(*(cell("measurements.csv", f"std_{c}", "1e308") for c in "xyz")),
        "implausibly large.*rows: ignore",
    ),
    "sigmas of 0": (
        together(*(cell("measurements.csv", f"std_{c}", "0") for c in "xyz")),
        "a sigma must be positive.*rows: ignore",
    ),
    "labels with a line break": (
        together(
            cell("measurements.csv", "station", "a\x0bb"), key("campaign.yaml", "frames.world_base.per", "station")
        ),
        r"'station', a\\x0bb: a label with control",
    ),
    "labels of 5,000 letters": (
        together(cell("measurements.csv", "station", LONG), key("campaign.yaml", "frames.world_base.per", "station")),
        "'station', a+…?: a label with control characters, or too long",
    ),
    "a split in markup": (cell("measurements.csv", "split", "[bold]"), r"'split', \[bold\]: neither train nor test"),
    "ordered as Python does": (put("measurements.csv", repr({"joint_1": [1, 2]})), r"measurements\.csv"),
    "a web page": (
        put("measurements.csv", "<!doctype html>\n<html>\n<body>Not found</body></html>\n"),
        r"measurements\.csv",
    ),
    "an archive": (put("measurements.csv", b"PK\x03\x04" + bytes(range(256)) * 40), r"measurements\.csv"),
}


def tables() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in TABLES.items():
        yield f"a table with {what}", Case(IDENTIFY, spoil, says)
    other = key("campaign.yaml", "measurements.file", "m.xlsx")
    yield (
        "a table of another kind",
        Case(IDENTIFY, together(put("m.xlsx", b"PK"), other), r"m\.xlsx: is no readable workbook"),
    )
    wide = put("measurements.csv", ",".join(f"c{k}" for k in range(10_000)) + "\n" + ",".join("1" * 10_000) + "\n")
    yield "a table of 10,000 columns that are not the joints'", Case(IDENTIFY, wide, "no column 'joint_1'.*9,970 more")
    many = put("measurements.csv", ",".join(f"c{k}" for k in range(1_000)) + "\n" + ",".join("1" * 1_000) + "\n")
    yield "init of 1,000 columns", Case(INIT, many, r"measurements\.csv: no columns for the joints.*970 more")
    yield (
        "init of 100,000 columns",
        Case(
            INIT,
            put("measurements.csv", ",".join(f"c{k}" for k in range(100_000)) + "\n1\n"),
            "has 100,000 columns, at most 10,000",
        ),
    )


def zeros(count: int, names: tuple[str, ...] = ("joint_1",)) -> pa.Table:
    column = pa.DictionaryArray.from_arrays(pa.array(np.zeros(count, np.int8)), pa.array([0.0])).dictionary_decode()
    return pa.table({name: column for name in names})


def a_parquet_of_zeros(folder: Path) -> None:
    """7e7 zeros in two columns: row groups that say the same, in 10 kB."""
    rows = 5_000_000
    table = zeros(rows, ("joint_1", "joint_2"))
    with pq.ParquetWriter(folder / "m.parquet", table.schema) as writer:
        for _ in range(7):
            writer.write_table(table, row_group_size=rows)
    key("campaign.yaml", "measurements.file", "m.parquet")(folder)


def a_word_in_every_row(folder: Path) -> None:
    """One word of a megabyte, stored once, in 2,000 rows."""
    words = pa.DictionaryArray.from_arrays(pa.array(np.zeros(2000, np.int32)), pa.array([1_000_000 * "a"]))
    pq.write_table(pa.table({"joint_1": np.zeros(2000), "note": words}), folder / "m.parquet")
    key("campaign.yaml", "measurements.file", "m.parquet")(folder)


def cut(share: float) -> Spoil:
    """A parquet file of which the end is missing."""

    def spoil(folder: Path) -> None:
        as_parquet(zeros(100))(folder)
        content = (folder / "m.parquet").read_bytes()
        (folder / "m.parquet").write_bytes(content[: int(share * len(content))])

    return spoil


def flipped(place: int) -> Spoil:
    """A parquet file with other bytes somewhere in its footer."""

    def spoil(folder: Path) -> None:
        as_parquet(zeros(100))(folder)
        content = bytearray((folder / "m.parquet").read_bytes())
        content[-place : 4 - place] = b"\xff\xff\xff\x7f"
        (folder / "m.parquet").write_bytes(content)

    return spoil


PARQUETS: dict[str, tuple[Spoil, str]] = {
    "7e7 zeros": (a_parquet_of_zeros, "35,000,000 rows of 2 columns would take 560 MB, at most 500 MB.*table_mb"),
    "a long word in every row": (a_word_in_every_row, "the words of column 'note' would take 2,000 MB, at most 500"),
    "half of it": (cut(0.5), "is not a readable Parquet file"),
    "its first bytes": (cut(0.01), "is not a readable Parquet file|is empty"),
    "a footer without end": (flipped(8), "is not a readable Parquet file"),
    "other bytes in its footer": (flipped(60), "is not a readable Parquet file|no column"),
    "other bytes further up": (flipped(120), "is not a readable Parquet file|no column"),
    "no rows": (as_parquet(zeros(0)), "has columns but no rows"),
    "no columns": (as_parquet(pa.table({})), "line 1 is empty; it should name"),
    "lists for joints": (as_parquet(pa.table({"joint_1": [[1.0, 2.0]] * 5})), "'joint_1' holds lists or structures"),
    "a column with a line break in its name": (as_parquet(pa.table({"a\nb": [1.0]})), r"'a\\nb' holds a control"),
    "a column of 5,000 letters": (as_parquet(pa.table({LONG: [1.0]})), "'a+…' has 5,000 characters"),
    "a column twice": (as_parquet(pa.Table.from_arrays([pa.array([1.0])] * 2, names=["a", "a"])), "'a' is there twice"),
    "numbers for names": (as_parquet(pa.table({"1": [1.0], "2": [2.0]})), "line 1 holds numbers"),
    "csv inside": (
        together(put("m.parquet", HEADER), key("campaign.yaml", "measurements.file", "m.parquet")),
        "is not a readable Parquet file",
    ),
}


def parquets() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in PARQUETS.items():
        yield f"a parquet with {what}", Case(IDENTIFY, spoil, rf"m\.parquet.*({says})")


# ---------------------------------------------------------------- init


INITS: dict[str, tuple[Spoil, str]] = {
    "quaternions of zeros": (
        together(*(cell("measurements.csv", c, "0") for c in ("qx", "qy", "qz", "qw"))),
        "quaternion",
    ),
    "some quaternions of zeros": (
        together(
            *(cell("measurements.csv", c, "0", every=False) for c in ("qx", "qy", "qz", "qw")),
            cell("measurements.csv", "joint_2", "abc"),
        ),
        "joint_2",
    ),
    "1e308 for every position": (together(*(cell("measurements.csv", c, "1e308") for c in "xyz")), "measurements.csv"),
    "1e308 for a joint": (cell("measurements.csv", "joint_2", "1e308"), "measurements.csv"),
    "1e308 for quaternions": (
        together(*(cell("measurements.csv", c, "1e308") for c in ("qx", "qy", "qz", "qw"))),
        "qx",
    ),
    "inf for a joint": (cell("measurements.csv", "joint_2", "inf"), "joint_2|rows have all joints"),
    "nan for a position": (cell("measurements.csv", "x", "nan"), "measurements.csv"),
    "words for a joint": (cell("measurements.csv", "joint_2", "[/]"), "joint_2|rows have all joints"),
    "one row": (put("measurements.csv", f"{HEADER}\n{ROW}\n"), "1 rows have all joints and positions; 4 are the least"),
    "no joints": (put("measurements.csv", "a,b\n1,2\n3,4\n"), "no columns for the joints"),
    "no position": (
        put("measurements.csv", "joint_1,joint_2,joint_3,joint_4\n" + "1,2,3,4\n" * 9),
        "no columns for the target's position",
    ),
    "a damaged header": (edit("measurements.csv", "joint_3", "joint_3\x00"), r"'joint_3\\x00' holds a control"),
    "half of a header": (edit("measurements.csv", "joint_3,joint_4.*?\n", "joint_3,joint\n"), r"measurements\.csv"),
    "columns with markup": (edit("measurements.csv", "joint_3", "[/]"), "joint_3, though for joints beyond"),
}


def inits() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in INITS.items():
        yield f"init of a table with {what}", Case(INIT, spoil, says)
    there = ("init", "--urdf", "robot.urdf", "--measurements", "measurements.csv", "-o", "campaign.yaml")
    yield "init over a campaign", Case(there, nothing, r"campaign\.yaml: exists already; delete")
    swapped = ("init", "--urdf", "measurements.csv", "--measurements", "robot.urdf", "-o", "new.yaml")
    yield "init with files exchanged", Case(swapped, nothing, r"robot\.urdf: should be a \.csv")


# ---------------------------------------------------------------- calibrations


WRONG_TYPE = {"text": "x", "a number": 5, "a list": ["x"], "a mapping": {"x": 1}, "nothing": None}

PLACES: dict[str, tuple[str, ...]] = {
    "kind": ("a number", "a list", "text"),
    "robot": ("text", "a list", "nothing"),
    "robot.base": ("a number", "nothing"),
    "robot.tip": ("a list", "nothing"),
    "robot.gravity": ("text", "a number"),
    "robot.urdf": ("a number", "text", "nothing"),
    "robot.urdf_encoding": ("text", "a number"),
    "robot.urdf_sha256": ("text", "a list"),
    "robot.urdf_name": ("a list",),
    "noise": ("text", "a list", "nothing"),
    "noise.position": ("text", "a list", "nothing"),
    "ranges": ("text", "a list"),
    "ranges.joint_2": ("text", "a number", "a list"),
    "holes.joint_2": ("a number", "a list"),
    "largest_std.position": ("text", "a list"),
    "geometric": ("text", "nothing", "a list"),
    "final": ("text", "nothing", "a mapping"),
    "final.coefficients": ("text", "a mapping", "a list"),
    "final.coefficients.0.value": ("text", "a list", "nothing"),
    "final.coefficients.0.where": ("text", "a number"),
    "final.coefficients.0.component": ("a number", "a list"),
    "final.coefficients.0.basis": ("text", "nothing"),
    "final.coefficients.0.basis.form": ("text", "a number"),
    "final.coefficients.0.station": ("a number", "a list"),
    "final.covariance": ("text", "nothing"),
    "final.covariance.data": ("text", "a number", "a list"),
    "final.world_base": ("text", "nothing", "a list"),
    "final.world_base.0.quaternion": ("text", "a list", "a number"),
    "final.world_base.0.xyz": ("text", "a list"),
    "final.loads": ("text", "nothing"),
    "final.loads.gravity": ("text", "a number"),
    "campaign": ("a number", "a list"),
    "format": ("text", "a number"),
}

CALIBRATIONS: dict[str, tuple[Spoil, str]] = {
    **{
        f"no {place}": (without("calibration.yaml", place), r"is missing|expected")
        for place in (
            "robot",
            "kind",
            "final",
            "geometric",
            "noise",
            "ranges",
            "robot.urdf",
            "robot.tip",
            "robot.urdf_sha256",
            "final.coefficients",
            "final.covariance",
            "final.covariance.data",
            "final.world_base",
            "final.loads",
            "final.loads.gravity",
            "final.world_base.0.quaternion",
            "final.coefficients.0.basis.of",
            "format",
        )
    },
    "one coefficient less": (without("calibration.yaml", "final.coefficients.0"), "bytes, 1 coefficients need 8"),
    "no place of the base": (key("calibration.yaml", "final.world_base", []), "final.world_base"),
    "a covariance of nan": (
        key("calibration.yaml", "final.covariance.data", base64.b64encode(struct.pack("<3d", 1, np.nan, 1)).decode()),
        "holds what is no finite number",
    ),
    "a covariance that is no base64": (key("calibration.yaml", "final.covariance.data", "*" * 32), "is no base64"),
    "a value of nan": (
        key("calibration.yaml", "final.coefficients.0.value", np.nan),
        r"value: should be a finite number",
    ),
    "a value of 1e308": (key("calibration.yaml", "final.coefficients.0.value", 1e308), "value: should be less"),
    "a quaternion of zeros": (key("calibration.yaml", "final.world_base.0.quaternion", [0, 0, 0, 0]), "norm 1"),
    "a quaternion of nan": (
        key("calibration.yaml", "final.tip_target.0.quaternion", [np.nan, 0, 0, 1]),
        "finite number",
    ),
    "a place of 1e308": (key("calibration.yaml", "final.tip_target.0.xyz", [1e308, 0, 0]), "should be less"),
    "an unknown function": (
        key("calibration.yaml", "final.coefficients.0.basis", {"form": "magic", "of": ["x"], "numbers": []}),
        "'magic'",
    ),
    "a function that lacks numbers": (
        key("calibration.yaml", "final.coefficients.0.basis", {"form": "power", "of": ["joint_2"], "numbers": [1.0]}),
        "'power'",
    ),
    "a function that divides by zero": (
        key(
            "calibration.yaml", "final.coefficients.0.basis", {"form": "bump", "of": ["joint_2"], "numbers": [1.0, 0.0]}
        ),
        "'bump'",
    ),
    "a function of nothing": (
        key("calibration.yaml", "final.coefficients.0.basis", {"form": "sin", "of": [], "numbers": [1.0]}),
        "'sin'",
    ),
    "a coefficient of no joint": (
        key("calibration.yaml", "final.coefficients.0.where", "joint_9"),
        "joint_9|cannot be computed",
    ),
    "a motion that is none": (
        key("calibration.yaml", "final.coefficients.0.component", "sideways"),
        "sideways|cannot be computed",
    ),
    "a label with an escape": (
        key("calibration.yaml", "final.world_base.0.station", "a\x1bb"),
        "holds a control character",
    ),
    "another URDF": (edit("calibration.yaml", "<robot ", '<robot x="1" '), "its hash differs"),
    "another tip": (key("calibration.yaml", "robot.tip", "nowhere"), "the robot in it.*no link 'nowhere'"),
    "a URDF of another encoding": (key("calibration.yaml", "robot.urdf_encoding", "utf-16"), "urdf_encoding"),
    "a range of nobody": (
        key("calibration.yaml", "ranges.joint_9", [0.0, 1.0]),
        "nothing depends on 'joint_9'.*did you mean",
    ),
    "an infinite range": (key("calibration.yaml", "ranges.joint_2", [-np.inf, 1.0]), "finite number"),
    "a range of three numbers": (key("calibration.yaml", "ranges.joint_2", [0.0, 1.0, 2.0]), r"ranges\.joint_2"),
    "a campaign that is none": (key("calibration.yaml", "campaign", "format: 5\n"), "the campaign in calibration.yaml"),
    "a campaign that laughs": (key("calibration.yaml", "campaign", "a: &a 1\nb: *a\n"), r"alias \*a is refused"),
    "an alias": (edit("calibration.yaml", "kind: pose", "kind: &a pose\nx: *a"), r"alias \*a is refused"),
    "a tag": (edit("calibration.yaml", "kind: pose", "kind: !!python/name:os.system x"), "the tag .* is refused"),
    "a key twice": (edit("calibration.yaml", "kind: pose", "kind: pose\nkind: pose"), "kind: this key is there twice"),
    "5,000 digits": (edit("calibration.yaml", "format: 1", "format: " + 5000 * "9"), "9+… is too large"),
    "noise after it": (edit("calibration.yaml", "kind: pose", "kind: pose\n\x00"), "a character that YAML forbids"),
    "deep brackets": (edit("calibration.yaml", "kind: pose", "kind: " + 500 * "["), "nested more than 50"),
    "only its beginning": (
        lambda folder: put("calibration.yaml", (folder / "calibration.yaml").read_bytes()[:1500])(folder),
        r"calibration\.yaml",
    ),
    "only its half": (
        lambda folder: put("calibration.yaml", (folder / "calibration.yaml").read_bytes()[:6000])(folder),
        r"calibration\.yaml",
    ),
    "a campaign in its place": (
        lambda folder: put("calibration.yaml", (folder / "campaign.yaml").read_bytes())(folder),
        "missing",
    ),
    "a table in its place": (
        lambda folder: put("calibration.yaml", (folder / "query.csv").read_bytes())(folder),
        "no `key: value`",
    ),
}


def calibrations() -> Iterator[tuple[str, Case]]:
    commands = (PREDICT, COMPENSATE)
    number = 0
    for place, types in PLACES.items():
        for kind in types:
            spoil = key("calibration.yaml", place, WRONG_TYPE[kind])
            last = (
                "its hash differs"
                if kind == "text" and place in ("robot.urdf", "robot.urdf_sha256")
                else place.split(".")[-1].removesuffix("form")
            )
            yield (
                f"a calibration with {kind} for {place}",
                Case(commands[number % 2], spoil, rf"calibration\.yaml.*{last}"),
            )
            number += 1
    for what, (spoil, says) in CALIBRATIONS.items():
        yield f"a calibration with {what}", Case(commands[number % 2], spoil, rf"calibration\.yaml.*({says})|{says}")
        number += 1


QUERIES: dict[str, tuple[tuple[str, ...], Spoil, str]] = {
    "a query without a joint": (PREDICT, put("query.csv", "joint_1\n1\n"), r"query\.csv: no column 'joint_2'"),
    "a query in words": (
        PREDICT,
        cell("query.csv", "joint_2", "[bold]"),
        r"column 'joint_2', \[bold\]: not a number.*write",
    ),
    "a query of 1e308": (PREDICT, cell("query.csv", "joint_2", "1e308"), "no row can be predicted.*implausibly large"),
    "a query of nan": (PREDICT, cell("query.csv", "joint_2", "nan"), "no row can be predicted"),
    "a query with a broken row": (
        PREDICT,
        put("query.csv", "joint_1,joint_2,joint_3,joint_4\n1,1,1\n1,1,2,-1\n"),
        "line 2: .*mend",
    ),
    "a query for a pipe": (PREDICT, instead("query.csv", os.mkfifo), "is a pipe"),
    "an answer of another kind": ((*PREDICT[:-1], "out.txt"), nothing, r"out\.txt: should be a \.csv or \.parquet"),
    "an answer over a pipe": (
        (*PREDICT[:-1], "pipe.csv"),
        lambda folder: os.mkfifo(folder / "pipe.csv"),
        r"pipe\.csv: is a device or a pipe",
    ),
    "poses in words": (COMPENSATE, cell("poses.csv", "x", "far"), "column 'x', far: not a number"),
    "poses of 1e308": (COMPENSATE, cell("poses.csv", "x", "1e308"), "implausibly large|no row can be commanded"),
    "poses without a rotation": (COMPENSATE, put("poses.csv", "x,y,z\n1,1,1\n"), r"poses\.csv: no column 'qx'"),
    "poses with quaternions of zeros": (
        COMPENSATE,
        together(*(cell("poses.csv", c, "0") for c in ("qx", "qy", "qz", "qw"))),
        "quaternion is not 1",
    ),
    "a grid of one point": (
        ("compensate", "calibration.yaml", "--grid", "1", "-o", "out.csv"),
        nothing,
        "at least 2 points",
    ),
    "a grid in words": (
        ("compensate", "calibration.yaml", "--grid", "many", "-o", "out.csv"),
        nothing,
        "invalid int value",
    ),
    "a grid without end": (
        ("compensate", "calibration.yaml", "--grid", "100000", "-o", "out.csv"),
        nothing,
        "grid.*points.*(fewer|less)",
    ),
    "a grid over a range that is not known": (
        ("compensate", "calibration.yaml", "--grid", "3", "-o", "out.csv"),
        without("calibration.yaml", "ranges.joint_2"),
        "in which range joint_2 was measured: run",
    ),
    "a seed in words": ((*IDENTIFY, "--seed", "x"), nothing, "--seed: should be a whole number from 0 on"),
    "a seed below zero": ((*IDENTIFY, "--seed", "-1"), nothing, "--seed"),
    "another day that is not there": (
        (*IDENTIFY, "--verify", "later.csv"),
        nothing,
        r"later\.csv: there is no such file",
    ),
    "another day of a pipe": (
        (*IDENTIFY, "--verify", "later.csv"),
        lambda folder: os.mkfifo(folder / "later.csv"),
        r"later\.csv: is a pipe",
    ),
}


def queries() -> Iterator[tuple[str, Case]]:
    for what, (command, spoil, says) in QUERIES.items():
        yield what, Case(command, spoil, says)


# ---------------------------------------------------------------- the measuring head


def png(width: int, height: int) -> bytes:
    """The header of a picture of that size, and nothing of it."""
    header = b"IHDR" + struct.pack(">II5B", width, height, 8, 0, 0, 0, 0)
    end = struct.pack(">I", 0) + b"IEND" + struct.pack(">I", zlib.crc32(b"IEND"))
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header)) + end


def encoded(ending: str, width: int, height: int) -> bytes:
    return bytes(cv2.imencode(ending, np.zeros((height, width), np.uint8))[1])


def tiff(width: int, height: int) -> bytes:
    tags = struct.pack("<HHII", 256, 4, 1, width) + struct.pack("<HHII", 257, 4, 1, height)
    return b"II*\0" + struct.pack("<IH", 8, 2) + tags + b"\0\0\0\0"


IMAGES: dict[str, tuple[bytes, str]] = {
    "a PNG of 60,000 x 60,000": (png(60_000, 60_000), "is 60000 x 60000 pixels, the camera 64 x 48"),
    "a PNG of four billion squared": (png(2**32 - 1, 2**32 - 1), "is 4294967295 x 4294967295 pixels"),
    "a PNG of no width": (png(0, 48), "no image of a known kind, or damaged: save it"),
    "a PNG cut off": (png(64, 48), "cannot be decoded: is the file complete|or damaged"),
    "a PNG of eight bytes": (b"\x89PNG\r\n\x1a\n", "no image of a known kind, or damaged"),
    "a JPEG of another size": (encoded(".jpg", 640, 480), "is 640 x 480 pixels"),
    "a JPEG of 65,535 x 65,535": (b"\xff\xd8\xff\xc0\x00\x0b\x08\xff\xff\xff\xff\x01", "is 65535 x 65535 pixels"),
    "a JPEG of fill bytes": (b"\xff\xd8" + 1_000_000 * b"\xff", "or damaged"),
    "a JPEG of segments without length": (b"\xff\xd8" + 100_000 * b"\xff\xe0\x00\x00", "or damaged"),
    "a BMP of another size": (encoded(".bmp", 640, 480), "is 640 x 480 pixels"),
    "a BMP of two billion squared": (
        b"BM" + bytes(12) + struct.pack("<Iii", 40, 2**31 - 1, -(2**31)),
        "is 2147483647 x",
    ),
    "a TIFF of another size": (encoded(".tiff", 640, 480), "is 640 x 480 pixels"),
    "a TIFF of four billion squared": (tiff(2**32 - 1, 2**32 - 1), "is 4294967295 x 4294967295"),
    "a TIFF whose tags are elsewhere": (b"II*\0\xff\xff\xff\x7f", "or damaged"),
    "a PGM of another size": (encoded(".pgm", 640, 480), "is 640 x 480 pixels"),
    "a PGM of a googol": (b"P5 " + 100 * b"9" + b" 1 255\n", "pixels, the camera|or damaged"),
    "a PGM of 5,000 digits": (b"P5 " + 900 * b"9" + b" -1 255\n", "or damaged"),
    "a WebP of another size": (encoded(".webp", 640, 480), "is 640 x 480 pixels"),
    "a film": (b"RIFF\0\0\0\0AVI LIST", "or damaged"),
    "a GIF": (b"GIF89a\xff\xff\xff\xff\0\0\0", "no image of a known kind"),
    "a text": (b"no image", "no image of a known kind"),
}


def charuco(**wrong: object) -> Spoil:
    """A head that looks at a ChArUco board, with something wrong about it."""
    board = {"squares_x": 5, "squares_y": 7, "square": 0.04, "marker": 0.03, "dictionary": "DICT_4X4_50"} | wrong
    keys = [key("head.yaml", k, v) for k, v in {"target": "charuco", **board}.items()]
    return together(without("head.yaml", "sonars"), *keys, put("shots.csv", "image,square\n0.png,0\n"))


HEADS: dict[str, tuple[Spoil, str]] = {
    "squares at infinity": (
        cell("squares.csv", "x", "inf"),
        r"squares\.csv, line 2: column 'x', inf: should be a number",
    ),
    "squares of 1e308": (cell("squares.csv", "x", "1e308"), r"squares\.csv, line 2: column 'x', 1e308"),
    "squares with quaternions of zeros": (cell("squares.csv", "qw", "0"), "not of unit length"),
    "squares with quaternions of 1e308": (cell("squares.csv", "qw", "1e308"), r"squares\.csv, line 2"),
    "an index at infinity": (cell("squares.csv", "index", "inf"), "column 'index', inf: should be a number"),
    "an index of 1e308": (cell("squares.csv", "index", "1e308"), "column 'index', 1e308"),
    "half an index": (cell("squares.csv", "index", "0.5"), "'index', 0.5: should be a whole number"),
    "an index twice": (cell("squares.csv", "index", "3"), "'index', 3: appears twice"),
    "no index": (put("squares.csv", "x,y\n1,2\n"), r"squares\.csv: no column 'index'"),
    "a square at infinity": (cell("shots.csv", "square", "inf"), r"square.*inf.*should be the index"),
    "a square of 1e308": (cell("shots.csv", "square", "1e308"), "square.*1e308|no square"),
    "a square in words": (cell("shots.csv", "square", "[/]"), r"'\[/\]' should be the index of a square"),
    "a square below zero": (cell("shots.csv", "square", "-1"), "no square -1"),
    "no square, no robot": (put("shots.csv", "image,h1,h2,h3\n0.png,1,1,1\n"), "no column 'square'; add it"),
    "no image": (cell("shots.csv", "image", ""), "no image is named"),
    "an image with NUL": (cell("shots.csv", "image", "a\0b.png"), r"holds a control character: rename"),
    "an image with a line break": (cell("shots.csv", "image", "a\tb.png"), "holds a control character: rename"),
    "an image of 5,000 letters": (
        cell("shots.csv", "image", f"{LONG}.png"),
        "cannot be the name of a file.*Give another",
    ),
    "an image with markup that is not there": (
        cell("shots.csv", "image", "[/].png"),
        r"\[/\]\.png: there is no such image",
    ),
    "an image elsewhere": (cell("shots.csv", "image", "../0.png"), "outside the folder of the shots"),
    "ranges at infinity": (cell("shots.csv", "h1", "inf"), "h1: the range is missing or no number"),
    "ranges of 1e308": (cell("shots.csv", "h1", "1e308"), r"h1: a range of 1e\+308 m cannot be right"),
    "ranges in words": (cell("shots.csv", "h1", "near"), "h1: the range is missing or no number"),
    "ranges that are not there": (put("shots.csv", "image,square,h1\n0.png,0,1\n"), "no column 'h2'.*'h3'"),
    "two sonars": (key("head.yaml", "sonars.positions", [[0, 0, 0], [1, 0, 0]]), r"sonars\.positions"),
    "sonars on a line": (key("head.yaml", "sonars.positions", [[0, 0, 0], [1, 0, 0], [2, 0, 0]]), "sit on one line"),
    "no sonars": (without("head.yaml", "sonars"), "add `sonars`"),
    "a camera of 200 megapixels": (
        together(key("head.yaml", "camera.width", 20_000), key("head.yaml", "camera.height", 10_000)),
        r"20000 x 10000 are 200 megapixels, at most 100.*image_megapixels",
    ),
    "a camera of no width": (key("head.yaml", "camera.width", 0), r"camera\.width: should be greater than 0"),
    "four coefficients of distortion": (key("head.yaml", "camera.distortion", [0, 0, 0, 0]), r"camera\.distortion"),
    "a target that is none": (key("head.yaml", "target", "chess"), "target: "),
    "an unknown dictionary": (charuco(dictionary="[bold]"), r"dictionary|\[bold\]"),
    "a board without its square": (
        together(*(key("head.yaml", k, v) for k, v in {"target": "charuco", "squares_x": 5}.items())),
        "also needs: squares_y",
    ),
    "a board of a million squares": (charuco(squares_x=1_000_000, squares_y=1_000_000), "board|squares"),
    "a board square at infinity": (charuco(square=np.inf), r"square: should be a finite number"),
    "a quarter of the image limit": (
        key("head.yaml", "limits.image_megapixels", 1e-4),
        "raise `limits: {image_megapixels",
    ),
}


def heads() -> Iterator[tuple[str, Case]]:
    for what, (content, says) in IMAGES.items():
        yield f"an image that is {what}", Case(MEASURE, put("0.png", content), rf"0\.png: .*({says})")
    for what, (spoil, says) in HEADS.items():
        yield f"a head with {what}", Case(MEASURE, spoil, says)
    for what in ("squares at infinity", "an image with NUL", "an image of 5,000 letters", "a camera of 200 megapixels"):
        spoil, says = HEADS[what]
        yield f"a campaign of a head with {what}", Case(SHOOT, spoil, says)
    for what in ("a PNG of 60,000 x 60,000", "a TIFF of four billion squared"):
        content, says = IMAGES[what]
        yield f"a campaign with {what}", Case(SHOOT, put("0.png", content), says)
    text = "campaign.yaml: `kind: camera_sonar`|measurements: `kind: camera_sonar`"
    yield "a head and a table", Case(SHOOT, key("shooting.yaml", "measurements.file", "measurements.csv"), text)


# ---------------------------------------------------------------- measurements of other kinds


EYE = {"fx": 700.0, "fy": 700.0, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480}

OWN_COLUMNS: dict[str, dict[str, object]] = {
    "point": {"point": "a"},
    "distance": {"distance": 1.0, "anchor": "a"},
    "plane": {"plane": "a", "reading": 0.0},
    "pixels": {"u": 1.0, "v": 1.0, "marker": "a"},
    "inclination": {"gx": 0.0, "gy": 0.0, "gz": 1.0},
}


def measuring(kind: str, instruments: dict[str, object] | None = None, **columns: object) -> Spoil:
    """The campaign with a table of another kind; columns of None are not there."""
    own = OWN_COLUMNS[kind] | columns
    cells = [cell("measurements.csv", name, value) for name, value in own.items() if value is not None]
    known = ({"cameras": {"eye": EYE}} if kind == "pixels" else {}) | (instruments or {})
    settings = {"kind": kind, "file": "measurements.csv"}
    set_keys = [key("campaign.yaml", "measurements", settings), key("campaign.yaml", "instruments", known)]
    return together(*cells, without("campaign.yaml", "measurements"), *set_keys)


def lengths(*triples: tuple[str, str, float]) -> dict[str, object]:
    return {"lengths": [{"between": [a, b], "length": length} for a, b, length in triples]}


def known_points(text: str) -> Spoil:
    return together(measuring("point", {"points": "points.csv"}), put("points.csv", text))


def two_blocks(first: dict[str, object], second: dict[str, object]) -> Spoil:
    return key(
        "campaign.yaml", "measurements", [{"file": "measurements.csv"} | first, {"file": "measurements.csv"} | second]
    )


INSTRUMENTS: dict[str, tuple[Spoil, str]] = {
    "a length to a point that nobody touched": (
        measuring("point", lengths(("a", "b", 0.1))),
        r"lengths\[0\].*no usable row refers to 'b'",
    ),
    "a length with markup": (measuring("point", lengths(("a", BRACKETS, 0.1))), r"no usable row refers to 'a\[/\]b'"),
    "lengths that contradict": (
        measuring("point", lengths(("a", "b", 1), ("b", "a", 2))),
        r"lengths\[1\]: b and a are 2 m apart here",
    ),
    "a triangle that does not close": (
        measuring("point", lengths(("a", "b", 1), ("b", "c", 1), ("c", "a", 3))),
        "a and c cannot be 3 m apart.*check these",
    ),
    "a length of 1e308": (measuring("point", lengths(("a", "b", 1e308))), r"lengths\[0\]\.length: should be less"),
    "points without a label": (measuring("point", point=""), "no usable row: 30 x empty.*Mend"),
    "points without a column": (
        measuring("point", point=None),
        r"no column 'point'.*`kind: point` needs it|no column 'point'",
    ),
    "a known point twice": (
        known_points("point,x,y,z\na,0,0,0\na,0,0,1\n"),
        r"points\.csv, line 3.*appears twice; delete",
    ),
    "a known point with an escape": (
        known_points('point,x,y,z\n"a\x1bb",0,0,0\n'),
        r"points\.csv, line 2.*control character",
    ),
    "a known point of 1e308": (
        known_points("point,x,y,z\na,1e308,0,0\n"),
        r"points\.csv, line 2: column 'x', 1e308: should be a number",
    ),
    "known points in mm": (known_points("point,x,y,z\na,1000,0,0\n"), r"points\.csv: x y z cannot be in m.*give"),
    "known points that are a device": (
        together(known_points(""), instead("points.csv", lambda path: path.symlink_to("/dev/zero"))),
        r"points\.csv: is a device",
    ),
    "known points that are not there": (measuring("point", {"points": "no.csv"}), r"no\.csv: there is no such file"),
    "distances in mm": (
        measuring("distance", distance=1234.5),
        "'distance' cannot be in m.*write `units: {length: mm}`",
    ),
    "wires of no length": (measuring("distance", distance=0.0), "no usable row: 30 x a distance must be positive"),
    "an anchor of scale 0": (
        measuring("distance", {"anchors": {"a": {"scale": 0}}}),
        r"anchors\.a\.scale: should be greater",
    ),
    "an anchor that is a joint": (
        measuring("distance", anchor="joint_2"),
        "the anchor 'joint_2' has the name of a joint: rename",
    ),
    "planes of no name": (measuring("plane", plane=" "), "no usable row: 30 x empty"),
    "a right angle to a plane that nobody touched": (
        measuring("plane", {"perpendicular": [["a", "b"]]}),
        "no usable row refers to 'b'",
    ),
    "a normal of length 0": (
        measuring("plane", {"planes": {"a": {"normal": [0, 0, 0]}}}),
        r"planes\.a\.normal: .*write \[0, 0, 1\]",
    ),
    "a camera of nobody": (
        measuring("pixels", camera="ear"),
        "line 2: column 'camera', ear: there is no such camera.*add it",
    ),
    "a camera of no name": (measuring("pixels", camera=" "), "no usable row: 30 x empty"),
    "marks outside the image": (measuring("pixels", u=640), "no usable row: 30 x outside the image of 640 x 480"),
    "a marker that is not on the board": (
        together(
            measuring("pixels", {"markers": {"file": "markers.csv"}}), put("markers.csv", "marker,x,y,z\nb,0,0,0\n")
        ),
        "no usable row: 30 x no such marker in markers.csv",
    ),
    "a camera of 10^9 pixels": (
        measuring("pixels", {"cameras": {"eye": {**EYE, "width": 10**18}}}),
        r"cameras\.eye\.width: should be less",
    ),
    "a camera in bold that is no key": (
        measuring("pixels", {"cameras": {"[bold]": {"fx": 5}}}),
        r"cameras\.\[bold\]\.width",
    ),
    "gravity of no length": (measuring("inclination", gz=0.0), "no usable row: 30 x gravity of length 0"),
    "two blocks of one name": (
        two_blocks({"kind": "pose"}, {"kind": "pose"}),
        r"measurements\[1\]\.name: two blocks are called 'pose'",
    ),
    "a head among blocks": (
        two_blocks({"kind": "pose"}, {"kind": "camera_sonar"}),
        r"measurements\[1\]\.kind: .*`aridcal measure`",
    ),
    "a block that is a word": (key("campaign.yaml", "measurements", ["pose"]), r"measurements\[0\]: should be a"),
    "noise of another channel": (
        two_blocks({"kind": "pose"}, {"kind": "point", "noise": {"pixel": 1}}),
        r"\[1\]: noise\.pixel: .*write",
    ),
}


def instruments() -> Iterator[tuple[str, Case]]:
    for what, (spoil, says) in INSTRUMENTS.items():
        yield f"instruments: {what}", Case(IDENTIFY, spoil, says)


CASES: dict[str, Case] = {}
for group in (
    no_files,
    too_large,
    urdfs,
    numbers,
    paths,
    settings,
    scenarios,
    tables,
    parquets,
    inits,
    calibrations,
    queries,
    heads,
    instruments,
):
    for name, case in group():
        assert name not in CASES, name
        CASES[name] = case
