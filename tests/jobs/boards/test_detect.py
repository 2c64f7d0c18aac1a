"""Printed boards in photographs with known truth: where their marks are, what is refused, and what the command writes."""

import os
import runpy
import shutil
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
import pytest
from photographs import INTRINSICS, SIZE, looking, photograph, pixels_of

from aridcal.detect import main
from aridcal.jobs.boards.camera_file import camera_by_name
from aridcal.jobs.boards.finders import ImageMarks, find
from aridcal.jobs.boards.lens import estimate
from aridcal.jobs.boards.options import ALL_BOARDS, board_of
from aridcal.jobs.boards.patterns import FACES, Cube, Tags, drawing, marks
from aridcal.jobs.boards.sheet import on_paper, svg
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.jobs.head1992.square import UNIT_CORNERS

cv2.setNumThreads(1)
BOARDS = {what: board_of(what, options) for what, options in ALL_BOARDS.items()}
PRINTED = {what: svg(on_paper(drawing(board), what)) for what, board in BOARDS.items()}
VIEWS = [
    looking(0, 0, 0.45),
    looking(0.01, 0.01, 0.47, 0.5, 0.3, 0.2),
    looking(0, 0.01, 0.5, -0.3, -0.4, 3.1),
]


@cache
def seen(what: str, view: int) -> np.ndarray:
    """A photograph of a sheet, as one of the views has it; not to be written into."""
    return photograph(PRINTED[what], VIEWS[view], seed=view)


def places_on_the_sheet(what: str) -> dict[str, np.ndarray]:
    """Places of marks on the flat sheet; those of a cube before it is folded."""
    board = BOARDS[what]
    if not isinstance(board, Cube):
        known = marks(board)
        return dict(zip(known.names, known.places, strict=True))
    middle = np.array([2.1, 1.7]) * board.side  # of a net of 4.2 x 3.4 sides, tabs of a fifth among them
    found = {}
    for k, (_, _, place) in enumerate(FACES):
        corners = board.side * (np.array(place) + [1.5, 1.7]) - middle + board.tag * UNIT_CORNERS
        found |= {f"tag{k}_{n + 1}": np.r_[corner, 0] for n, corner in enumerate(corners)}
    return found


def looked_for(what: str):
    board = BOARDS[what]
    return Tags(board.dictionary) if isinstance(board, Cube) else board


@pytest.mark.parametrize("what", BOARDS)
@pytest.mark.parametrize("view", [1, 2])
def test_marks_are_found_under_their_names_to_a_tenth_of_a_pixel(what, view):
    found = find(seen(what, view), looked_for(what))
    places = places_on_the_sheet(what)
    assert set(found.names) == set(places) and len(found.names) == len(places)
    off = np.linalg.norm(
        found.pixels - pixels_of(np.array([places[name] for name in found.names]), VIEWS[view]), axis=1
    )
    assert np.sqrt(np.mean(off**2)) < 0.1
    assert off.max() < (0.25 if what == "cube" else 0.1)


def drawn_camera(rng: np.random.Generator) -> tuple[np.ndarray, tuple[int, int]]:
    """Some webcam of 640 x 480 pixels, its lens a barrel or a cushion."""
    f = rng.uniform(560, 900)
    middle = np.array([319.5, 239.5]) + rng.uniform(-15, 15, 2)
    bend = rng.uniform(-0.3, 0.1), rng.uniform(-0.05, 0.1), *rng.uniform(-1e-3, 1e-3, 2), 0.0
    return np.array([f, f * rng.uniform(0.99, 1.01), *middle, *bend]), (640, 480)


def circles_seen(seed: int, views: int, **light: float) -> tuple[list[ImageMarks], list[np.ndarray], np.ndarray]:
    """Grids of circles as a drawn camera sees them, how far each circle is from where OpenCV projects it, and the camera."""
    rng = np.random.default_rng([7, seed])
    camera, size = drawn_camera(rng)
    found, off = [], []
    for k in range(views):
        away = camera[0] / 640 * rng.uniform(0.4, 0.5)
        T = looking(*rng.uniform(-0.02, 0.02, 2), away, *rng.uniform(-0.7, 0.7, 2), rng.uniform(-3, 3))
        with suppress(NotMeasured):  # a board that reaches out of the image
            found.append(
                find(photograph(PRINTED["circles"], T, camera, size, seed=100 * seed + k, **light), BOARDS["circles"])
            )
            off.append(found[-1].pixels - pixels_of(found[-1].places, T, camera))
    return found, off, camera


def test_a_bent_lens_moves_no_circle():
    """Without the lens's share of the shift the worst circle is 0.03 px off, and all together look like a longer focal length."""
    off = np.concatenate([circle for k in range(3) for circle in circles_seen(k, 2, blur=0.5, noise=0)[1]])
    assert len(off) > 4 * 44
    assert np.abs(off).max() < 0.01 and np.sqrt(np.mean(off**2)) < 0.003


def test_the_focal_length_from_circles_is_within_three_of_its_sigmas_for_every_camera():
    scores = []
    for k in range(5):
        circles, _, camera = circles_seen(k, 4)
        lens = estimate(circles, (640, 480))
        scores.append((lens.intrinsics[:2] - camera[:2]) / lens.std[:2])
    assert np.abs(scores).max() < 3
    # Neither too small nor too large: 5 independent draws, as fx and fy go together, scatter by a third of it.
    assert 0.4 < np.sqrt(np.mean(np.square(scores))) < 1.7


@pytest.mark.parametrize("what", BOARDS)
def test_blur_is_refused_or_does_no_harm(what):
    """In focus or not, by motion or not: whatever is measured is right to a quarter of a pixel, RMS."""
    sharp = photograph(PRINTED[what], VIEWS[1], blur=0, noise=0)
    places = places_on_the_sheet(what)
    refused = 0
    for sigma, motion in ((3, False), (3, True), (14, False)):
        image = cv2.blur(sharp, (round(3.5 * sigma) | 1, 1)) if motion else cv2.GaussianBlur(sharp, (0, 0), sigma)
        noise = 1.5 * np.random.default_rng(sigma).normal(size=image.shape)
        try:
            found = find(np.clip(image + noise, 0, 255).astype(np.uint8), looked_for(what))
        except NotMeasured:
            refused += 1
            continue
        off = found.pixels - pixels_of(np.array([places[name] for name in found.names]), VIEWS[1])
        assert np.sqrt(np.mean(np.sum(off**2, axis=1))) < 0.25, (sigma, motion)
    assert refused >= 1


@pytest.mark.parametrize("what", ["charuco", "cube"])
def test_what_is_mirrored_is_named_and_refused(what):
    image = seen(what, 1)
    for axis in (0, 1):
        with pytest.raises(NotMeasured, match="mirrored"):
            find(np.ascontiguousarray(np.flip(image, axis)), looked_for(what))
    assert len(find(np.ascontiguousarray(image[::-1, ::-1]), looked_for(what)).names) == 24  # turned, not mirrored


@pytest.mark.parametrize("what", BOARDS)
def test_nothing_is_found_where_nothing_is(what):
    rng = np.random.default_rng(0)
    other = "circles" if what != "circles" else "charuco"
    for image in (
        np.full((240, 320), 128, np.uint8),
        rng.integers(0, 255, (240, 320), np.uint8),
        seen(other, 1),
    ):
        with pytest.raises(NotMeasured):
            find(image, looked_for(what))


def test_a_board_of_another_size_is_refused_though_its_markers_are_known():
    image = seen("charuco", 1)
    for size in ("9x6", "5x7", "8x5"):
        board = board_of("charuco", {**ALL_BOARDS["charuco"], "size": tuple(map(int, size.split("x")))})
        with pytest.raises(NotMeasured, match=f"{size} squares"):
            find(image, board)


def test_a_tag_twice_in_an_image_is_refused():
    image = seen("cube", 0)
    with pytest.raises(NotMeasured, match="seen twice"):
        find(np.hstack([image, image]), looked_for("cube"))


def test_half_a_charuco_board_is_enough_and_half_a_chessboard_is_not():
    half = {what: seen(what, 0)[:, : SIZE[0] // 2] for what in ("charuco", "chessboard")}
    found = find(np.ascontiguousarray(half["charuco"]), BOARDS["charuco"])
    assert 6 <= len(found.names) < 24
    with pytest.raises(NotMeasured, match="seen whole"):
        find(np.ascontiguousarray(half["chessboard"]), BOARDS["chessboard"])


# -- the command


def shots(folder: Path, what: str, n: int = 8, seed: int = 1) -> list[np.ndarray]:
    """Photographs shot_1.png, ... of a sheet held every way; where the camera stood."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    views = [
        looking(*rng.uniform(-0.02, 0.02, 2), rng.uniform(0.45, 0.6), *rng.uniform(-0.6, 0.6, 2), rng.uniform(-3, 3))
        for _ in range(n)
    ]
    for k, T in enumerate(views, start=1):
        cv2.imwrite(str(folder / f"shot_{k}.png"), photograph(PRINTED[what], T, seed=k))
    return views


@pytest.fixture(scope="module")
def taken(tmp_path_factory) -> Path:
    """Folders of photographs of every board."""
    home = tmp_path_factory.mktemp("taken")
    for what in BOARDS:
        shots(home / what, what, 12 if what == "charuco" else 1)
    return home


@pytest.fixture(scope="module")
def read(taken, tmp_path_factory) -> Path:
    """What the command writes of the ChArUco board."""
    home = tmp_path_factory.mktemp("read")
    assert main([str(taken / "charuco"), "-o", str(home / "c.csv")]) == 0
    return home


@pytest.fixture
def images(taken, tmp_path) -> Path:
    """Twelve photographs of a ChArUco board, to be spoilt."""
    return Path(shutil.copytree(taken / "charuco", tmp_path / "images"))


def joints(path: Path, names: list[str]) -> Path:
    rows = [
        {"image": name, "q1": 0.1 * k, "q2": -0.2 * k, "temperature": 20.5, "note": f"n{k}"}
        for k, name in enumerate(names)
    ]
    pd.DataFrame(rows).to_csv(path, index=False)
    return path


def test_images_and_joints_make_a_complete_table_of_pixels_with_its_camera(images, tmp_path, capsys):
    cv2.imwrite(str(images / "dark.png"), np.zeros((SIZE[1], SIZE[0]), np.uint8))
    (images / "broken.jpg").write_bytes(b"\xff\xd8 no more")
    (images / "notes.txt").write_text("no image")
    for k in range(7, 13):
        (images / f"shot_{k}.png").unlink()
    names = [f"shot_{k}.png" for k in range(1, 6)]
    out = tmp_path / "out" / "corners.csv"
    assert (
        main([str(images), "--joints", str(joints(tmp_path / "joints.csv", names)), "--camera", "cam", "-o", str(out)])
        == 0
    )
    table = pd.read_csv(out)
    assert list(table.columns) == ["image", "camera", "marker", "u", "v", "shot", "q1", "q2", "temperature", "note"]
    assert set(table["image"]) == set(names) and set(table["camera"]) == {"cam"}
    assert table.groupby("image")["shot"].nunique().max() == 1 and table["shot"].nunique() == 5
    assert np.allclose(table["q2"], -2 * table["q1"]) and table.groupby("image")["q1"].first()["shot_3.png"] == 0.2
    refused = pd.read_csv(tmp_path / "out" / "refused.csv").set_index("image")["why"]
    assert set(refused.index) == {"dark.png", "broken.jpg", "shot_6.png"}
    assert "no row" in refused["shot_6.png"] and "damaged" in refused["broken.jpg"]
    err = capsys.readouterr().err
    assert "5 images, 3 images refused" in err and "broken.jpg" in err


def test_the_camera_is_told_by_the_images_themselves_within_four_sigma(read):
    text = (read / "camera.yaml").read_text()
    camera = camera_by_name(read / "camera.yaml", "eye")
    assert (camera.width, camera.height, camera.on) == (*SIZE, "tip")
    focal, middle = (
        float(part.split()[0]) for part in text.replace("fx fy ", "|").replace("cx cy ", "|").split("|")[1:3]
    )
    assert 0 < focal < 1 and 0 < middle < 1
    assert np.all(np.abs(camera.intrinsics[:2] - INTRINSICS[:2]) < 4 * focal)
    assert np.all(np.abs(camera.intrinsics[2:4] - INTRINSICS[2:4]) < 4 * middle)
    assert abs(camera.intrinsics[4] - INTRINSICS[4]) < 0.02


def test_tags_alone_tell_the_camera_too(tmp_path):
    shots(tmp_path / "cube", "cube", 8)
    assert main([str(tmp_path / "cube"), "--board", "apriltag", "-o", str(tmp_path / "c.csv")]) == 0
    camera = camera_by_name(tmp_path / "camera.yaml", "eye")
    assert np.allclose(camera.intrinsics[:2] / INTRINSICS[:2], 1, atol=0.01)


def test_an_image_of_another_board_is_refused_when_the_camera_is_known(images, read, tmp_path):
    # The same board on paper that is 8 % too wide: no lens does that.
    image = cv2.imread(str(images / "shot_3.png"), 0)
    wide = cv2.warpAffine(image, np.array([[1.0, 0.12, -40], [0, 1, 0]]), SIZE, borderValue=140)
    cv2.imwrite(str(images / "shot_3.png"), wide)
    camera = tmp_path / "camera.yaml"
    shutil.copy(read / "camera.yaml", camera)
    some = [str(images / f"shot_{k}.png") for k in (1, 2, 3)]
    for given, options in (([str(images)], []), (some, ["--intrinsics", str(camera)])):
        out = tmp_path / f"again{len(options)}" / "c.csv"
        assert main([*given, *options, "-o", str(out)]) == 0
        refused = pd.read_csv(out.parent / "refused.csv")
        assert list(refused["image"]) == ["shot_3.png"] and "px off" in refused["why"][0]
        if options:  # what was stated goes along, for `init` to find
            assert (out.parent / "camera.yaml").read_bytes() == camera.read_bytes()
    assert main([some[0], "--intrinsics", str(camera), "-o", str(tmp_path / "c.csv")]) == 0
    assert camera_by_name(camera, "eye").width == SIZE[0]  # not lost where it is beside the table already


def test_without_joints_the_table_has_the_images_alone_and_says_so(images, tmp_path, capsys):
    assert main([str(images / "shot_1.png"), str(images / "shot_2.png"), "-o", str(tmp_path / "c.csv")]) == 0
    assert list(pd.read_csv(tmp_path / "c.csv").columns) == ["image", "camera", "marker", "u", "v", "shot"]
    err = capsys.readouterr().err
    assert "joints are missing" in err and "not estimated" in err  # of two images
    assert not (tmp_path / "camera.yaml").exists()


@pytest.mark.parametrize(
    ("images", "arguments", "hint"),
    [
        ("charuco", ["--dictionary", "DICT_4X4_50"], "--board charuco --size 7x5 --dictionary DICT_5X5_50"),
        ("cube", [], "--board apriltag --dictionary DICT_APRILTAG_36h11"),
        ("chessboard", ["--board", "chessboard", "--size", "9x6"], "--board chessboard --size 8x5"),
        ("circles", ["--board", "circles", "--size", "4x9"], "--board circles --size 4x11"),
    ],
)
def test_what_is_there_instead_is_named(images, arguments, hint, taken, tmp_path, capsys):
    image = cv2.imread(str(taken / images / "shot_1.png"), 0)
    cv2.imwrite(str(tmp_path / "half.png"), cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
    assert main([str(tmp_path / "half.png"), *arguments, "-o", str(tmp_path / "c.csv")]) == 2
    assert f"try `{hint}" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["half.png"]


def test_mirrored_images_are_no_other_board(images, tmp_path, capsys):
    some = [str(images / f"shot_{k}.png") for k in (1, 2)]
    for name in some:
        cv2.imwrite(name, cv2.imread(name, 0)[:, ::-1])
    assert main([*some, "-o", str(tmp_path / "c.csv")]) == 2
    err = capsys.readouterr().err
    assert "mirrored" in err and "try" not in err


def test_images_of_two_cameras_are_not_mixed(images, tmp_path):
    small = cv2.resize(cv2.imread(str(images / "shot_5.png"), 0), (800, 600))
    cv2.imwrite(str(images / "shot_5.png"), small)
    some = [str(images / f"shot_{k}.png") for k in (4, 5, 6)]
    assert main([*some, "-o", str(tmp_path / "c.csv")]) == 0
    refused = pd.read_csv(tmp_path / "refused.csv")
    assert list(refused["image"]) == ["shot_5.png"] and "800 x 600" in refused["why"][0]


def test_bad_use_is_named_with_status_2_and_leaves_an_earlier_table_alone(images, tmp_path, capsys):
    out = tmp_path / "out" / "c.csv"
    out.parent.mkdir()
    out.write_text("earlier")
    (tmp_path / "empty").mkdir()
    good = joints(tmp_path / "good.csv", ["shot_1.png"])
    pd.DataFrame({"image": ["shot_1.png"] * 2, "q1": [0, 1]}).to_csv(tmp_path / "twice.csv", index=False)
    pd.DataFrame({"image": ["shot_1.png"], "u": [0]}).to_csv(tmp_path / "own.csv", index=False)
    pd.DataFrame({"picture": ["shot_1.png"], "q1": [0]}).to_csv(tmp_path / "lacks.csv", index=False)
    pd.DataFrame({"image": ["other.png"], "q1": [0]}).to_csv(tmp_path / "others.csv", index=False)
    (tmp_path / "cam.yaml").write_text(
        "format: 1\ncameras: {left: {fx: 1, fy: 1, cx: 1, cy: 1, width: 3, height: 3}}\n"
    )
    cases = {
        "no images": [str(tmp_path / "empty")],
        "no such image": [str(tmp_path / "none.png")],
        "stands in line 2": [str(images), "--joints", str(tmp_path / "twice.csv")],
        "columns u": [str(images), "--joints", str(tmp_path / "own.csv")],
        "no column 'image'": [str(images), "--joints", str(tmp_path / "lacks.csv")],
        "no row for any": [str(images), "--joints", str(tmp_path / "others.csv")],
        "no such option": [str(images), "--joints", str(good), "--board", "apriltag", "--size", "7x5"],
        "no camera 'eye'": [str(images), "--intrinsics", str(tmp_path / "cam.yaml")],
        "3 x 3 pixels": [str(images / "shot_1.png"), "--intrinsics", str(tmp_path / "cam.yaml"), "--camera", "left"],
        "one name": [str(images), str(images / "shot_1.png")],
    }
    for said, arguments in cases.items():
        assert main([*arguments, "-o", str(out)]) == 2, said
        assert said in capsys.readouterr().err
    assert out.read_text() == "earlier" and [path.name for path in out.parent.iterdir()] == ["c.csv"]
    assert main([str(images), "-o", str(tmp_path / "c.txt")]) == 2


def test_the_driver_of_a_camera_folder_takes_the_corners_of_an_image_that_arrives(tmp_path, monkeypatch):
    """Against where OpenCV projects them; an image that shows nothing has none."""
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    driver = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "guide" / "camera_folder.py"))
    (tmp_path / "old.png").touch()
    known = set(tmp_path.iterdir())
    cv2.imwrite(str(tmp_path / "new.png"), seen("charuco", 1))
    image = driver["next_image"](tmp_path, known)
    assert image == tmp_path / "new.png"
    rows = driver["corners"](image, 3)
    places = places_on_the_sheet("charuco")
    assert {row["marker"] for row in rows} == set(places)
    pixels = pixels_of(np.array([places[row["marker"]] for row in rows]), VIEWS[1])
    assert np.abs(np.array([[row["u"], row["v"]] for row in rows]) - pixels).max() < 0.25
    assert {(row["camera"], row["shot"]) for row in rows} == {("eye", "3")}
    cv2.imwrite(str(tmp_path / "dark.png"), np.zeros((720, 960), dtype=np.uint8))
    assert driver["corners"](driver["next_image"](tmp_path, known), 4) == []
