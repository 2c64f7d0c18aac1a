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

from aridcal.commands import atomic_folder, run
from aridcal.head.square import SIDE, STRIP_SQUARES, fiducial_corners, index_corners, paper_corners, strip_placements

MM_PER_POINT = 25.4 / 72
CUT_LINE = 0.1  # [mm], grey


def strip_polygons(indexes: Sequence[int]) -> tuple[np.ndarray, np.ndarray, tuple[float, float]]:
    """Lay squares out on a sheet, the first at its lower end.

    Args:
        indexes: Of the squares, from below upwards.

    Returns:
        The squares' outlines (S, 4, 2) and all that is black (M, 4, 2), [mm] from the sheet's lower left corner; width and
        height of the sheet, [mm].
    """
    up = strip_placements(len(indexes))[:, :2, 3] + SIDE / 2
    paper = np.array([paper_corners() + at for at in up])
    ink = np.concatenate(
        [np.concatenate([fiducial_corners(), index_corners(k)]) + at for k, at in zip(indexes, up, strict=True)]
    )
    return 1e3 * paper, 1e3 * ink, (1e3 * SIDE, 1e3 * SIDE * len(indexes))


def svg(indexes: Sequence[int]) -> str:
    """Draw squares as SVG in millimetres."""
    paper, ink, (width, height) = strip_polygons(indexes)

    def polygons(corners: np.ndarray, style: str) -> list[str]:
        flipped = corners * [1, -1] + [0, height]  # SVG's y points down
        points = (" ".join(f"{x:.4f},{y:.4f}" for x, y in polygon) for polygon in flipped)
        return [f'<polygon points="{p}" {style}/>' for p in points]

    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
        *polygons(paper, f'fill="none" stroke="#999" stroke-width="{CUT_LINE}"'),
        *polygons(ink, 'fill="black"'),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"


def pdf(indexes: Sequence[int]) -> bytes:
    """Draw squares as a PDF of one page: a page description needs no library when all is polygons."""
    paper, ink, size = (np.asarray(part) / MM_PER_POINT for part in strip_polygons(indexes))

    def paths(corners: np.ndarray, paint: str) -> list[str]:
        return [
            " ".join(f"{x:.4f} {y:.4f} {'l' if k else 'm'}" for k, (x, y) in enumerate(polygon)) + f" h {paint}"
            for polygon in corners
        ]

    content = "\n".join(
        [f"0.6 G {CUT_LINE / MM_PER_POINT:.4f} w", *paths(paper, "S"), "0 g", *paths(ink, "f")],
    ).encode()
    # A user unit of 1/72 in allows 200 in, the strip is 112 in long.
    objects = [
        b"<< /Type /Catalog /Pages 2 0 R >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {size[0]:.4f} {size[1]:.4f}] /Resources << >> /Contents 4 0 R >>".encode(),
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
    ]
    document, offsets = b"%PDF-1.4\n", []
    for number, body in enumerate(objects, 1):
        offsets.append(len(document))
        document += b"%d 0 obj\n%s\nendobj\n" % (number, body)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    trailer = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(document))
    return document + b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1) + table + trailer


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
    with atomic_folder(folder) as new:
        for name, indexes in (("square", range(1)), ("strip", range(STRIP_SQUARES))):
            (new / f"{name}.svg").write_text(svg(indexes), encoding="utf-8")
            (new / f"{name}.pdf").write_bytes(pdf(indexes))


if __name__ == "__main__":
    sys.exit(main())
