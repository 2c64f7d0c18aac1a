"""Squares to print: true to scale, and the same as the simulator renders."""

import re

import numpy as np
from lxml import etree
from shapely.geometry import Polygon
from shapely.ops import unary_union

from aridcal.head.drawing import main, pdf, svg
from aridcal.head.square import fiducial_corners, index_corners


def black(text: str) -> list[Polygon]:
    root = etree.fromstring(text.encode())
    found = root.findall(".//{*}polygon[@fill='black']")
    return [Polygon([[float(c) for c in pair.split(",")] for pair in e.get("points").split()]) for e in found]


def test_svg_is_in_millimetres_and_carries_the_squares_own_polygons():
    root = etree.fromstring(svg([7]).encode())
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == ("101.6mm", "101.6mm", "0 0 101.6 101.6")
    expected = np.concatenate([fiducial_corners(), index_corners(7)]) * [1e3, -1e3] + 50.8
    assert np.allclose([p.exterior.coords[:4] for p in black(svg([7]))], expected, atol=1e-4)


def test_strip_is_2844_8_mm_long_with_its_first_square_below_and_every_index_on_it():
    text = svg(range(28))
    assert 'height="2844.8mm"' in text
    lowest = [p for p in black(text) if p.centroid.y > 2844.8 - 101.6]
    alone = [p for p in black(svg([0]))]
    assert len(lowest) == len(alone) and np.isclose(unary_union(lowest).area, unary_union(alone).area)


def test_pdf_has_the_same_polygons_in_points():
    page = pdf(range(28)).decode()
    box = [float(x) for x in re.search(r"MediaBox \[(.*?)\]", page)[1].split()]
    assert np.allclose(box, [0, 0, 4 * 72, 112 * 72])  # 4 x 112 in
    numbers = [re.findall(r"[\d.]+ [\d.]+ (?=[ml])", line) for line in page.splitlines() if line.endswith("h f")]
    points = np.array([[pair.split() for pair in line] for line in numbers], dtype=float) / 72 * 25.4
    drawn = np.array([p.exterior.coords[:4] for p in black(svg(range(28)))])
    assert np.allclose(points, drawn * [1, -1] + [0, 2844.8], atol=1e-3)


def test_pdf_is_read_by_its_own_cross_reference_table():
    document = pdf([0])
    start = int(re.search(rb"startxref\n(\d+)", document)[1])
    assert document[start:].startswith(b"xref")
    for number, offset in enumerate(re.findall(rb"(\d{10}) 00000 n", document), 1):
        assert document[int(offset) :].startswith(b"%d 0 obj" % number)
    length = int(re.search(rb"/Length (\d+)", document)[1])
    stream = document.index(b"stream\n") + 7
    assert document[stream + length :].startswith(b"\nendstream")


def test_command_writes_both_in_both_formats(tmp_path):
    assert main(["-o", str(tmp_path / "print")]) == 0
    names = sorted(p.name for p in (tmp_path / "print").iterdir())
    assert names == ["square.pdf", "square.svg", "strip.pdf", "strip.svg"]
