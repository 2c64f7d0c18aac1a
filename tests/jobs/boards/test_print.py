"""Bodies to print, and the command: true sizes, closed surfaces, what is written and what is refused."""

import io
import re

import numpy as np
import pandas as pd
import pytest
import trimesh

from aridcal.jobs.boards.bodies import BORE, MOUTH, cup, holder, seat_rise, stl
from aridcal.print import main
from aridcal.system.errors import CampaignError

SIZES = [(0.02, 0.05, 0.0055), (0.03, 0.05, 0.0055), (0.01, 0.08, 0.004), (0.025, 0.1, 0.01)]
CUPS = [(0.02, 4, 0.05, 0.0066), (0.0254, 4, 0.05, 0.0066), (0.012, 6, 0.0315, 0.0055), (0.012, 3, 0.05, 0.005)]


def read_back(body: trimesh.Trimesh) -> trimesh.Trimesh:
    """As a slicer reads it: in millimetres, corners merged."""
    return trimesh.load(io.BytesIO(stl(body)), file_type="stl")


def rests(body: trimesh.Trimesh, x: float, y: float, ball: float) -> float:
    """Second road: height of the centre of a ball lowered onto a body along z, from rays down onto its surface, [mm].

    At a distance r from the axis the ball's underside is sqrt(R² - r²) below its centre.
    """
    r = np.r_[np.linspace(0.02, 0.99, 30), np.linspace(0.69, 0.73, 41)] * ball / 2  # it should touch at 0.707
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False) + 0.01
    at = np.stack(np.meshgrid(r, angles, indexing="ij"), -1).reshape(-1, 2)
    places = np.column_stack(
        [x + at[:, 0] * np.cos(at[:, 1]), y + at[:, 0] * np.sin(at[:, 1]), np.full(len(at), 500.0)]
    )
    points, rays, _ = body.ray.intersects_location(places, np.tile([0.0, 0, -1], (len(at), 1)), multiple_hits=True)
    top = np.full(len(at), -np.inf)
    np.maximum.at(top, rays, points[:, 2])
    return float(np.max(top + np.sqrt((ball / 2) ** 2 - at[:, 0] ** 2)))


@pytest.mark.parametrize("size", SIZES)
def test_the_holder_is_closed_and_as_large_as_its_parts_make_it(size):
    body = read_back(holder(*size))
    ball, apart, bolt = (1e3 * s for s in size)
    assert body.is_watertight and body.is_winding_consistent and body.body_count == 1
    assert body.euler_number == 2 - 2 * 4  # four holes through it
    mouth, bore = MOUTH * ball / 2, BORE * ball / 2
    cone = np.pi / 3 * (mouth - bore) * (mouth**2 + mouth * bore + bore**2)
    block = (2 * apart + 48) * 40 * 16
    seats = 2 * (cone + np.pi * bore**2 * (16 - (mouth - bore)))
    assert np.isclose(body.volume, block - seats - 2 * np.pi * (bolt / 2) ** 2 * 16, rtol=1e-4)


@pytest.mark.parametrize("size", SIZES)
def test_a_ball_rests_in_both_seats_at_their_distance_and_height(size):
    body = read_back(holder(*size))
    ball, apart, _ = size
    expected = 16 + 1e3 * seat_rise(ball)
    for side in (-1, 1):
        x = side * 1e3 * apart / 2
        height = rests(body, x, 0, 1e3 * ball)
        assert np.isclose(height, expected, atol=0.01)
        # Nudged either way it stands higher: the seat's axis is there.
        assert all(
            rests(body, x + dx, dy, 1e3 * ball) > height + 0.02 for dx, dy in ((0.1, 0), (-0.1, 0), (0, 0.1), (0, -0.1))
        )


@pytest.mark.parametrize("size", CUPS)
def test_the_cup_is_closed_has_its_bolts_and_carries_the_ball_on_its_axis(size):
    body = read_back(cup(*size))
    ball, bolts, circle, bolt = size
    assert body.is_watertight and body.is_winding_consistent and body.volume > 0 and body.body_count == 1
    assert body.euler_number == 2 - 2 * bolts
    section = body.section(plane_origin=[0, 0, 3.0], plane_normal=[0, 0, 1])
    loops = section.discrete
    middles = np.array([loop[:, :2].min(axis=0) + np.ptp(loop[:, :2], axis=0) / 2 for loop in loops])
    bores = [m for m, loop in zip(middles, loops, strict=True) if np.isclose(np.ptp(loop[:, 0]), 1e3 * bolt, atol=0.05)]
    assert len(bores) == bolts and np.allclose(np.linalg.norm(bores, axis=1), 500 * circle, atol=0.05)
    assert np.isclose(rests(body, 0, 0, 1e3 * ball), 40 + 1e3 * seat_rise(ball), atol=0.01)


@pytest.mark.parametrize(
    ("make", "sizes", "culprit"),
    [
        (holder, (0.06, 0.05, 0.005), "--ball"),
        (holder, (0.02, 0.016, 0.005), "--ball"),
        (holder, (0.02, 0.05, 0.03), "--bolt"),
        (holder, (0.02, 5.0, 0.005), "--apart"),
        (cup, (0.04, 4, 0.05, 0.0066), "--ball"),
        (cup, (0.02, 2, 0.05, 0.0066), "--bolts"),
        (cup, (0.012, 12, 0.03, 0.0066), "--bolts"),
    ],
)
def test_what_cannot_be_printed_is_refused_by_the_option_to_change(make, sizes, culprit):
    with pytest.raises(CampaignError, match=culprit):
        make(*sizes)


# -- the command


@pytest.mark.parametrize("what", ["charuco", "chessboard", "circles", "cube"])
@pytest.mark.parametrize("ending", [".svg", ".pdf"])
def test_a_board_comes_with_its_markers(what, ending, tmp_path):
    assert main([what, "-o", str(tmp_path / "new" / f"board{ending}")]) == 0
    assert {path.name for path in (tmp_path / "new").iterdir()} == {f"board{ending}", "markers.csv"}
    table = pd.read_csv(tmp_path / "new" / "markers.csv")
    assert list(table.columns) == ["marker", "x", "y", "z"]
    assert table["marker"].is_unique and np.abs(table[["x", "y", "z"]]).max().max() < 0.2
    middle = (table[["x", "y", "z"]].max() + table[["x", "y", "z"]].min()) / 2
    assert np.allclose(middle, 0, atol=1e-9)


def test_the_sizes_asked_for_are_those_printed_and_the_title_says_them(tmp_path):
    out = tmp_path / "b.svg"
    options = ["--size", "6x9", "--square", "1.5cm", "--marker", "11mm", "--dictionary", "DICT_4X4_50"]
    assert main(["charuco", *options, "-o", str(out)]) == 0
    table = pd.read_csv(tmp_path / "markers.csv")
    assert (
        len(table) == 5 * 8 and np.isclose(np.ptp(table["x"]), 4 * 0.015) and np.isclose(np.ptp(table["y"]), 7 * 0.015)
    )
    assert "aridcal print charuco --size 6x9 --square 15mm --marker 11mm --dictionary DICT_4X4_50" in out.read_text()


def test_a_marker_follows_its_square_here_and_where_it_is_looked_for(tmp_path):
    """The title says both, as `detect` is to be told them."""
    sizes = {}
    for square in ("35mm", "70mm"):
        out = tmp_path / f"{square}.svg"
        assert main(["charuco", "--size", "3x3", "--square", square, "-o", str(out), "--quiet"]) == 0
        sizes[square] = re.search(r"--square (\S+)mm --marker (\S+)mm", out.read_text()).groups()
    assert sizes == {"35mm": ("35", "26"), "70mm": ("70", "52")}
    assert main(["charuco", "--square", "30mm", "--marker", "20mm", "-o", str(tmp_path / "c.svg"), "--quiet"]) == 0
    assert "--marker 20mm" in (tmp_path / "c.svg").read_text()


@pytest.mark.parametrize("what", ["square", "strip"])
def test_squares_of_the_head_are_printed_alone(what, tmp_path):
    assert main([what, "-o", str(tmp_path / "s.pdf")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["s.pdf"]


def test_the_holder_says_the_length_for_the_campaign(tmp_path, capsys):
    assert main(["holder", "--apart", "60mm", "-o", str(tmp_path / "h.stl")]) == 0
    assert "lengths: [{between: [a0, a1], length: 0.06" in capsys.readouterr().out
    assert trimesh.load(tmp_path / "h.stl").is_watertight


@pytest.mark.parametrize(
    ("arguments", "culprit"),
    [
        (["charuco", "-o", "b.png"], ".svg or .pdf"),
        (["cup", "-o", "b.pdf"], ".stl"),
        (["charuco", "--ball", "20mm", "-o", "b.svg"], "--ball"),
        (["chessboard", "--size", "8x6", "-o", "b.svg"], "upside down"),
        (["chessboard", "--marker", "5mm", "-o", "b.svg"], "--marker"),
        (["circles", "--size", "4x10", "-o", "b.svg"], "odd number of rows"),
        (["charuco", "--marker", "40mm", "-o", "b.svg"], "smaller than `square`"),
        (["charuco", "--dictionary", "DICT_5X5_10", "-o", "b.svg"], "did you mean"),
        (["charuco", "--size", "30x30", "-o", "b.svg"], "too few"),
        (["charuco", "--size", "1x30", "-o", "b.svg"], "at least 3x3"),
        (["cube", "--marker", "45mm", "-o", "b.svg"], "white"),
        (["cube", "--dictionary", "DICT_APRILTAG_16h5", "--first", "27", "-o", "b.svg"], "--first"),
        (["square", "--first", "-1", "-o", "b.svg"], "--first"),
    ],
)
def test_slips_are_named_with_status_2_and_nothing_is_written(arguments, culprit, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 2
    assert culprit in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("option", [["--square", "35"], ["--square", "0mm"], ["--size", "7"], ["--square", "9999m"]])
def test_lengths_need_their_unit_and_sizes_two_numbers(option, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["charuco", *option, "-o", "b.svg"])
    assert stop.value.code == 2
    assert "write" in capsys.readouterr().err
