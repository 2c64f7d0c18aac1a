"""Squares to print at true scale, SVG and PDF, from the same polygons that the simulator renders.

Example:
    python -m aridcal.head.drawing -o print
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from aridcal.command_line import run
from aridcal.head.square import SIDE, STRIP_SQUARES, fiducial_corners, index_corners, paper_corners, strip_placements
from aridcal.writing.files import atomic_folder

# In a metre.
MM = 1e3

# PDF counts in points of 1/72 in.
MM_PER_POINT = 25.4 / 72

# Width of the line around each square, [mm]; grey, so that it is no mark.
CUT_LINE = 0.1


def strip_polygons(indexes: Sequence[int]) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Lay squares out on a sheet, the first at its lower end.

    Args:
        indexes: Of the squares, from below upwards.

    Returns:
        The squares' outlines (S, 4, 2) and all that is black (M, 4, 2), [mm] from the sheet's lower left corner; width and
        height of the sheet, [mm].
    """
    middles = strip_placements(len(indexes))[:, :2, 3] + SIDE / 2
    paper, ink = [], []
    for index, middle in zip(indexes, middles, strict=True):
        printed = np.concatenate([fiducial_corners(), index_corners(index)])
        paper.append(paper_corners() + middle)
        ink.append(printed + middle)
    width, height = MM * SIDE, MM * SIDE * len(indexes)
    return MM * np.array(paper), MM * np.concatenate(ink), (width, height)


def svg(indexes: Sequence[int]) -> str:
    """Draw squares as SVG in millimetres.

    Args:
        indexes: Of the squares, from below upwards.
    """
    paper, ink, (width, height) = strip_polygons(indexes)
    cut_line = f'fill="none" stroke="#999" stroke-width="{CUT_LINE}"'
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
        *_svg_polygons(paper, height, cut_line),
        *_svg_polygons(ink, height, 'fill="black"'),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def _svg_polygons(corners: np.ndarray, height: float, style: str) -> list[str]:
    """Write polygons, shape (M, K, 2), [mm], on a sheet of that height; SVG's y points down."""
    flipped = corners * [1, -1] + [0, height]
    lines = []
    for polygon in flipped:
        points = " ".join(f"{x:.4f},{y:.4f}" for x, y in polygon)
        lines.append(f'<polygon points="{points}" {style}/>')
    return lines


def pdf(indexes: Sequence[int]) -> bytes:
    """Draw squares as a PDF of one page: a page description needs no library when all is polygons.

    Args:
        indexes: Of the squares, from below upwards.
    """
    paper, ink, (width, height) = (np.asarray(part) / MM_PER_POINT for part in strip_polygons(indexes))
    pen = f"0.6 G {CUT_LINE / MM_PER_POINT:.4f} w"
    operators = [pen, *_pdf_polygons(paper, "S"), "0 g", *_pdf_polygons(ink, "f")]
    content = "\n".join(operators).encode()
    # A user unit of 1/72 in allows 200 in, the strip is 112 in long.
    page = f"/MediaBox [0 0 {width:.4f} {height:.4f}] /Resources << >> /Contents 4 0 R".encode()
    return _pdf_document([
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        b"<< /Type /Page /Parent 2 0 R %s >>" % page,
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
    ])  # fmt: skip


def _pdf_polygons(corners: np.ndarray, paint: str) -> list[str]:
    """Write polygons, shape (M, K, 2), [pt], each closed and painted: ``m`` moves, ``l`` draws a line, ``h`` closes."""
    lines = []
    for polygon in corners:
        verbs = ["m", *["l"] * (len(polygon) - 1)]
        steps = [f"{x:.4f} {y:.4f} {verb}" for (x, y), verb in zip(polygon, verbs, strict=True)]
        lines.append(" ".join([*steps, "h", paint]))
    return lines


def _pdf_document(objects: Sequence[bytes]) -> bytes:
    """Join objects, the catalogue first, with the table that tells where in the file each begins (ISO 32000-1, 7.5).

    Args:
        objects: Bodies of the objects 1, 2, ...
    """
    document = b"%PDF-1.4\n"
    offsets = []
    for number, body in enumerate(objects, 1):
        offsets.append(len(document))
        document += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    entries = len(objects) + 1
    table = b"xref\n0 %d\n0000000000 65535 f \n" % entries
    table += b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    trailer = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (entries, len(document))
    return document + table + trailer


def main(argv: Sequence[str] | None = None) -> int:
    """Write one square and a strip of 28, each as SVG and PDF; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--out", type=Path, required=True, help="folder to write into")
    arguments = parser.parse_args(argv)
    return run(lambda: write(arguments.out))


def write(folder: Path) -> None:
    """Write ``square.svg``, ``square.pdf``, ``strip.svg`` and ``strip.pdf``.

    Raises:
        OutputError: The folder cannot be written.
    """
    drawings = {"square": range(1), "strip": range(STRIP_SQUARES)}
    with atomic_folder(folder) as new:
        for name, indexes in drawings.items():
            (new / f"{name}.svg").write_text(svg(indexes), encoding="utf-8")
            (new / f"{name}.pdf").write_bytes(pdf(indexes))


if __name__ == "__main__":
    sys.exit(main())
