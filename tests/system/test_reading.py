"""Files of a user, read safely: what is refused before it is read, and what is right although it looks odd."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import robots

import aridcal
from aridcal.engine.robot.chain import parse_robot
from aridcal.engine.robot.tree import MAX_DEPTH, MAX_MOVING, read_tree
from aridcal.files.tables import read_tables
from aridcal.files.yaml_file import Limits, Section, Settings
from aridcal.system.errors import AridcalError, MeasurementError, RobotError, nearest, printable, shortened
from aridcal.system.reading.images import image_size
from aridcal.system.reading.regular_files import Limit, read_file
from aridcal.system.reading.user_names import check_name, check_path

PACKAGE = Path(aridcal.__file__).parent

# ---------------------------------------------------------------- files


def test_a_file_is_read_up_to_its_limit_and_not_beyond(tmp_path: Path) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"a" * 1000)
    assert read_file(path, AridcalError, Limit(0.001)) == b"a" * 1000
    path.write_bytes(b"a" * 1001)
    with pytest.raises(AridcalError, match=r"f: has 0\.0 MB, at most 0\.001 MB are read; raise `limits: \{here: …\}`"):
        read_file(path, AridcalError, Limit(0.001, "here"))


def test_a_link_to_a_file_is_read(tmp_path: Path) -> None:
    (tmp_path / "f").write_bytes(b"content")
    (tmp_path / "link").symlink_to("f")
    assert read_file(tmp_path / "link", AridcalError, Limit(1)) == b"content"


def test_a_file_that_becomes_a_pipe_between_two_looks_is_not_waited_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The attack: a regular file while it is looked at, a pipe when it is opened."""
    path = tmp_path / "f"
    path.write_bytes(b"content")
    opened = os.open

    def exchange(*arguments: object) -> int:
        path.unlink()
        os.mkfifo(path)
        return opened(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(os, "open", exchange)
    with pytest.raises(AridcalError, match="is a pipe"):
        read_file(path, AridcalError, Limit(1))


def test_a_file_that_grows_while_it_is_read_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "f"
    path.write_bytes(b"content")
    looked = os.fstat

    def append(number: int) -> os.stat_result:
        status = looked(number)
        with path.open("ab") as file:
            file.write(b"more")
        return status

    monkeypatch.setattr(os, "fstat", append)
    with pytest.raises(AridcalError, match="grew while it was read: wait"):
        read_file(path, AridcalError, Limit(1))


def test_every_limit_of_a_campaign_is_the_readers_own_unless_raised() -> None:
    usual = Limits()
    assert (usual.urdf, usual.table, usual.image) == (
        Limit(20, "urdf_mb"),
        Limit(500, "table_mb"),
        Limit(100, "image_mb"),
    )
    assert {limit.key for limit in (usual.urdf, usual.table, usual.image)} | {"image_megapixels"} == set(
        Limits.model_fields
    )
    assert Limits(table_mb=5.0).table.megabytes == 5.0
    assert issubclass(Settings, Section) and "limits" in Settings.model_fields


def test_nobody_else_reads_a_users_file() -> None:
    """By the source: what is read whole is read by ``read_file``, but for files of the package itself."""
    reads = re.compile(r"\.(read_bytes|read_text|fromfile|imread|read_pickle|genfromtxt|loadtxt)\(")
    found = {
        path.relative_to(PACKAGE).as_posix() for path in PACKAGE.rglob("*.py") if reads.search(path.read_text("utf-8"))
    }
    assert found <= {
        "pages/drawing/page_frame.py",
        "pages/certificate.py",  # its own folder's files, and again those that were read
        "pages/drawing/one_page.py",
        "pages/drawing/scene.py",
        "calibration.py",
        "jobs/export/ros2_files.py",  # a text of the package itself
        "view.py",
        "system/writing/staging.py",
        "engine/robot/meshes.py",  # in a process of its own, within limits of its own
        "engine/model/memory.py",  # what the system says of its memory
    }


# ---------------------------------------------------------------- names


@pytest.mark.parametrize(
    "name", ["joint_1", "Gelenk ä", "関節", "a[/]b", "[bold red]", "a: b", "#1", "yes", "'\"", "J₁ (°)"]
)
def test_a_name_that_can_be_shown_is_a_name(name: str, tmp_path: Path) -> None:
    check_name(name, "here", AridcalError)
    check_path(tmp_path / name, AridcalError)
    assert printable(name) == name


@pytest.mark.parametrize(
    "letter", ["\0", "\n", "\r", "\t", "\x07", "\x1b", "\x7f", "\x85", "\u2028", "\u2029", "\ud800"]
)
def test_a_letter_that_breaks_a_line_is_spelt_out_in_the_refusal(letter: str, tmp_path: Path) -> None:
    for check in (
        lambda: check_name(f"a{letter}b", "here", AridcalError),
        lambda: check_path(Path(f"a{letter}b"), AridcalError),
    ):
        with pytest.raises(AridcalError, match="rename") as caught:
            check()
        said = str(caught.value)
        assert letter not in said and said.isprintable()
        assert eval(f"'{printable(letter)}'") == letter


def test_a_hint_among_ever_so_many_names_is_short() -> None:
    names = [f"column {k} {'a' * 1000}" for k in range(100_000)]
    assert len(nearest("colum 5", names)) < 3000
    assert shortened("a" * 61) == "a" * 59 + "…" and shortened("a" * 60) == "a" * 60


# ---------------------------------------------------------------- URDF


def a_row_of(count: int, kind: str = "fixed") -> bytes:
    links = "".join(f'<link name="l{k}"/>' for k in range(count + 2))
    joint = (
        '<joint name="j{0}" type="{2}"><parent link="l{0}"/><child link="l{1}"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
    )
    joints = "".join(joint.format(k, k + 1, kind if k else "revolute") for k in range(count + 1))
    return f'<robot name="r">{links}{joints}</robot>'.encode()


def test_the_deepest_tree_that_is_allowed_is_read_in_the_stack_of_a_thread(tmp_path: Path) -> None:
    """The reason of the limit: 512 kB is what macOS gives to a thread. In a process of its own: a failure is a crash."""
    code = f"""
import threading
from pathlib import Path
from aridcal.engine.robot.chain import parse_robot
def read():
    print(parse_robot(Path("deep.urdf").read_bytes(), "l{MAX_DEPTH}").tree.nframes)
threading.stack_size(512 * 1024)
thread = threading.Thread(target=read)
thread.start()
thread.join()
"""
    (tmp_path / "deep.urdf").write_bytes(a_row_of(MAX_DEPTH - 1))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path, check=False)
    assert done.returncode == 0 and int(done.stdout) > MAX_DEPTH
    with pytest.raises(RobotError, match=f"l{MAX_DEPTH + 1}' is {MAX_DEPTH + 1} joints from the root"):
        read_tree(a_row_of(MAX_DEPTH), Path("r.urdf"))


def test_as_many_moving_joints_as_are_allowed_are_read() -> None:
    robot = parse_robot(a_row_of(MAX_MOVING - 1, "revolute"), f"l{MAX_MOVING}")
    assert len(robot.joints) == robot.tree.nv == MAX_MOVING
    with pytest.raises(RobotError, match="joints move, at most"):
        parse_robot(a_row_of(MAX_MOVING, "revolute"), f"l{MAX_MOVING}")


def test_masters_of_masters_multiply_whatever_the_order_of_the_file() -> None:
    """Second road: composed by hand."""
    names = ["d", "a", "c", "b"]
    mimic = {"a": ("b", 2.0, 1.0), "b": ("c", 3.0, -1.0), "c": ("d", 0.5, 0.25)}
    parts = ['<robot name="r"><link name="w"/>']
    for name in names:
        follows = mimic.get(name)
        tag = "" if follows is None else '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*follows)
        parts.append(
            f'<link name="{name}"/><joint name="{name}" type="continuous"><parent link="w"/><child link="{name}"/>{tag}</joint>'
        )
    found = read_tree(("".join(parts) + "</robot>").encode(), Path("r.urdf")).mimics
    d = 0.7
    c = 0.5 * d + 0.25
    b = 3.0 * c - 1.0
    a = 2.0 * b + 1.0
    for name, value in {"a": a, "b": b, "c": c}.items():
        assert found[name].factors.keys() == {"d"}
        assert found[name].factors["d"] * d + found[name].offset == pytest.approx(value, abs=1e-15)


def test_a_limit_that_means_none_is_none() -> None:
    urdf = robots.arid().urdf.replace(b'lower="0"', b'lower="-1e16"', 1)
    assert parse_robot(urdf, "flange").columns[0].lower == -np.inf


# ---------------------------------------------------------------- tables


def test_parquet_of_every_type_is_what_pandas_reads(tmp_path: Path) -> None:
    """Words are read as they are stored and written out again: nothing of that may be seen."""
    rng = np.random.default_rng(0)
    table = pd.DataFrame({
        "number": rng.normal(size=50), "count": np.arange(50), "flag": rng.random(50) < 0.5,
        "word": rng.choice(["a", "b", None], 50), "kind": pd.Categorical(rng.choice(["x", "y"], 50)),
        "when": pd.date_range("2024-01-01", periods=50),
        "small": np.arange(50, dtype=np.int8), "half": rng.normal(size=50).astype(np.float32),
    })  # fmt: skip
    table.to_parquet(tmp_path / "m.parquet")
    read = read_tables([tmp_path / "m.parquet"])
    again = pd.read_parquet(tmp_path / "m.parquet")
    assert list(read.names) == list(again.columns)
    for name in again.columns:
        theirs = pa.chunked_array([pa.array(again[name], from_pandas=True)])
        assert [str(v) for v in read.cells[name][0].to_pylist()] == [str(v) for v in theirs.to_pylist()], name


def test_lists_in_a_parquet_are_left_out_where_that_was_asked_for(tmp_path: Path) -> None:
    """Nothing tells how much they take: a few bytes may stand for a thousand million zeros in one row."""
    pq.write_table(pa.table({"a": [1.0] * 5, "b": [[1.0, 2.0]] * 5, "c": [{"d": "x"}] * 5}), tmp_path / "m.parquet")
    with pytest.raises(MeasurementError, match=r"'b' holds lists or structures, .* `ignore: \[b\]`"):
        read_tables([tmp_path / "m.parquet"])
    read = read_tables([tmp_path / "m.parquet"], spare=("b", "c"))
    assert read.names == ("a",) and set(read.partial) == {"b", "c"}
    assert read_tables([tmp_path / "m.parquet"], spare=None).names == ("a",)


def test_a_parquet_of_many_groups_is_one_table(tmp_path: Path) -> None:
    pq.write_table(pa.table({"a": np.arange(100.0), "b": ["x"] * 100}), tmp_path / "m.parquet", row_group_size=7)
    read = read_tables([tmp_path / "m.parquet"])
    np.testing.assert_array_equal(read.numbers("a")[0], np.arange(100.0))
    assert set(read.texts("b")) == {"x"}


def test_a_large_table_is_read_where_the_campaign_allows_it(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("a,b\n" + "1,2\n" * 200)
    with pytest.raises(MeasurementError, match=r"at most 0\.0005 MB are read; raise `limits: \{table_mb"):
        read_tables([tmp_path / "m.csv"], limit=Limit(5e-4, "table_mb"))
    assert len(read_tables([tmp_path / "m.csv"], limit=Limit(1))) == 200


def test_a_blank_line_counts_as_a_line_wherever_it_stands(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("a,b\n\n1,2\n\n\n3,4\n1\n5,6\n\n")
    read = read_tables([tmp_path / "m.csv"])
    assert read.line.tolist() == [3, 6, 8]
    assert [(remark.row, remark.why) for remark in read.refused] == [(7, "1 cells in a row of 2 columns")]


# ---------------------------------------------------------------- images


@pytest.mark.parametrize("ending", [".png", ".jpg", ".bmp", ".tiff", ".pgm", ".ppm", ".webp"])
@pytest.mark.parametrize("size", [(48, 64), (1, 1), (300, 7)])
def test_the_size_in_a_header_is_that_of_the_decoded_image(ending: str, size: tuple[int, int]) -> None:
    shape = size if ending == ".pgm" else (*size, 3)
    image = np.random.default_rng(0).integers(0, 256, shape, dtype=np.uint8)
    options = {".jpg": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], ".webp": [cv2.IMWRITE_WEBP_QUALITY, 50]}
    for chosen in ([], options.get(ending, [])):
        content = bytes(cv2.imencode(ending, image, chosen)[1])
        height, width = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE).shape
        assert image_size(content) == (width, height) == size[::-1]


def test_no_bytes_make_the_size_of_an_image_fail() -> None:
    """Every header cut anywhere, and with any one byte changed."""
    rng = np.random.default_rng(0)
    for ending in (".png", ".jpg", ".bmp", ".tiff", ".pgm", ".webp"):
        content = bytes(cv2.imencode(ending, np.zeros((20, 30), np.uint8))[1])
        for cut in range(min(len(content), 200)):
            image_size(content[:cut])
        for _ in range(300):
            spoilt = bytearray(content)
            spoilt[rng.integers(min(len(content), 700))] = rng.integers(256)
            size = image_size(bytes(spoilt))
            assert size is None or min(size) > 0


def test_a_cell_of_megabytes_makes_no_column_of_as_many_in_each_row(tmp_path: Path) -> None:
    long = "x" * 2_000_000
    (tmp_path / "m.csv").write_text("a,b\n" + "\n".join(f"{k},word" for k in range(99)) + f"\n99,{long}\n")
    words = read_tables([tmp_path / "m.csv"]).texts("b")
    assert words.nbytes < 100 * len(long) / 50
    assert set(words[:99]) == {"word"} and long.startswith(words[99]) and len(words[99]) > 4096
