"""A sheet of paper at true scale, as SVG in millimetres and as PDF, with rulers that tell whether the printer kept the scale.

All is polygons, discs and a line of text: such a page needs no library.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

# In a metre.
MM = 1e3

# PDF counts in points of 1/72 in.
MM_PER_POINT = 25.4 / 72

# Width of cut and fold lines, [mm]; grey, so that they are no mark.
LINE_WIDTH = 0.1

# Paper sizes that are tried, narrow side first, [mm].
PAPERS = {"A4": (210.0, 297.0), "A3": (297.0, 420.0), "A2": (420.0, 594.0), "A1": (594.0, 841.0), "A0": (841.0, 1189.0)}

# [mm] around what is printed: white, and room for the rulers beyond what printers can reach.
SHEET_MARGIN = 17.0

# [mm] from the paper's edge to a ruler; its length, or a tenth of it where the sheet is short; its marks.
RULER_AT, RULER, RULER_STEP, RULER_MARK = 8.5, 100.0, 10.0, 3.0

# Height of letters, and what of it is below their line, [mm]; [mm] at the paper's edge that printers leave white.
LETTERS, BELOW, UNREACHED = 3.0, 0.7, 4.5

# A quarter of a circle as a Bézier curve: its control points lie so many radii along the tangents.
BEZIER_QUARTER = 4 / 3 * (np.sqrt(2) - 1)


@dataclass(frozen=True)
class Sheet:
    """The drawing on a sheet, [mm] from its lower left corner, y up.

    Attributes:
        size: Width and height of the sheet.
        ink: Black areas, each of one or more loops of shape (K, 2): outlines turn left, the edges of holes right.
        discs: Black discs, x, y and radius, shape (D, 3).
        cuts: Lines to cut along, each of shape (K, 2).
        folds: Lines to fold along, shape (F, 2, 2), dashed.
        texts: Place of the left end of a line of letters, and the line.
    """

    size: tuple[float, float]
    ink: Sequence[Sequence[np.ndarray]]
    discs: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    cuts: Sequence[np.ndarray] = ()
    folds: np.ndarray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    texts: Sequence[tuple[float, float, str]] = ()


def on_paper(drawing: Sheet, title: str) -> Sheet:
    """Put a drawing in the middle of the smallest paper that holds it, with a title and two rulers.

    Args:
        drawing: Without a margin.
        title: Printed above it.

    Returns:
        The sheet; of the drawing's own size with a margin where no paper is large enough.
    """
    width, height = drawing.size
    needed = width + 2 * SHEET_MARGIN, height + 2 * SHEET_MARGIN
    papers = [size for narrow, wide in PAPERS.values() for size in ((narrow, wide), (wide, narrow))]
    size = next((paper for paper in papers if paper[0] >= needed[0] and paper[1] >= needed[1]), needed)
    shift = np.array([size[0] - width, size[1] - height]) / 2
    marks, texts = _rulers(size)
    texts.append((RULER_AT, size[1] - RULER_AT - LETTERS, title))
    return Sheet(
        size=size,
        ink=[*([loop + shift for loop in loops] for loops in drawing.ink), *([mark] for mark in marks)],
        discs=drawing.discs + np.r_[shift, 0.0] if len(drawing.discs) else drawing.discs,
        cuts=[line + shift for line in drawing.cuts],
        folds=drawing.folds + shift,
        texts=[*((x + shift[0], y + shift[1], text) for x, y, text in drawing.texts), *texts],
    )


def _rulers(size: tuple[float, float]) -> tuple[list[np.ndarray], list[tuple[float, float, str]]]:
    """One ruler along the lower edge and one along the left edge: printers may stretch the two directions apart."""
    marks, texts = [], []
    for axis in (0, 1):
        length = (
            RULER if size[axis] >= RULER + 4 * RULER_AT else RULER_STEP * np.floor((size[axis] - 4 * RULER_AT) / 10)
        )
        steps = round(length / RULER_STEP)
        bars = [np.array([2 * RULER_AT, RULER_AT, length, 2 * LINE_WIDTH])]  # x and y of its corner, width and height
        for k in range(steps + 1):
            high = RULER_MARK if k in (0, steps) else RULER_MARK / 2
            bars.append(np.array([2 * RULER_AT + k * RULER_STEP - LINE_WIDTH / 2, RULER_AT, LINE_WIDTH, high]))
        for x, y, width, high in bars:
            corners = np.array([[x, y], [x + width, y], [x + width, y + high], [x, y + high]])
            marks.append(corners[::-1, ::-1] if axis else corners)
        said = f"{length:g} mm" if axis else f"{length:g} mm from end to end, if printed at 100 %: measure both rulers"
        place = (2 * RULER_AT, UNREACHED + BELOW) if axis == 0 else (UNREACHED, 2 * RULER_AT + length + 2)
        texts.append((*place, said))
    return marks, texts


def svg(sheet: Sheet) -> str:
    """Draw a sheet as SVG in millimetres."""
    width, height = sheet.size
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width:g}mm" height="{height:g}mm" '
        f'viewBox="0 0 {width:g} {height:g}">',
        f'<rect width="{width:g}" height="{height:g}" fill="white"/>',
    ]
    pen = f'fill="none" stroke="#999" stroke-width="{LINE_WIDTH}"'
    lines += [f'<polyline points="{_svg_points(cut, height)}" {pen}/>' for cut in sheet.cuts]
    lines += [f'<polyline points="{_svg_points(fold, height)}" {pen} stroke-dasharray="2 1"/>' for fold in sheet.folds]
    lines += [f'<path d="{_svg_path(loops, height)}" fill="black"/>' for loops in sheet.ink]
    lines += [f'<circle cx="{x:.4f}" cy="{height - y:.4f}" r="{r:.4f}" fill="black"/>' for x, y, r in sheet.discs]
    letters = f'font-family="Helvetica, Arial, sans-serif" font-size="{LETTERS}" fill="#444"'
    lines += [f'<text x="{x:.4f}" y="{height - y:.4f}" {letters}>{text}</text>' for x, y, text in sheet.texts]
    return "\n".join([*lines, "</svg>"]) + "\n"


def _svg_points(corners: np.ndarray, height: float) -> str:
    """Corners, shape (K, 2), [mm], on a sheet of that height; SVG's y points down."""
    return " ".join(f"{x:.4f},{height - y:.4f}" for x, y in corners)


def _svg_path(loops: Sequence[np.ndarray], height: float) -> str:
    return " ".join(f"M {_svg_points(loop, height)} Z" for loop in loops)


def pdf(sheet: Sheet) -> bytes:
    """Draw a sheet as a PDF of one page."""
    width, height = np.array(sheet.size) / MM_PER_POINT
    operators = [f"0.6 G {LINE_WIDTH / MM_PER_POINT:.4f} w"]
    operators += [f"{_pdf_path(cut)} S" for cut in sheet.cuts]
    dash, gap = 2 / MM_PER_POINT, 1 / MM_PER_POINT
    operators += [f"[{dash:.4f} {gap:.4f}] 0 d", *(f"{_pdf_path(fold)} S" for fold in sheet.folds), "0 g"]
    operators += [" ".join([*(f"{_pdf_path(loop)} h" for loop in loops), "f"]) for loops in sheet.ink]
    operators += [_pdf_disc(disc / MM_PER_POINT) for disc in sheet.discs]
    operators += ["0.3 g BT", f"/F1 {LETTERS / MM_PER_POINT:.4f} Tf"]
    for x, y, text in sheet.texts:
        operators.append(f"1 0 0 1 {x / MM_PER_POINT:.4f} {y / MM_PER_POINT:.4f} Tm ({_pdf_text(text)}) Tj")
    content = "\n".join([*operators, "ET"]).encode("latin-1")
    # A user unit of 1/72 in allows 200 in; a strip of 28 squares is 112 in long.
    page = f"/MediaBox [0 0 {width:.4f} {height:.4f}] /Resources << /Font << /F1 5 0 R >> >> /Contents 4 0 R".encode()
    return _pdf_document([
        b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
        b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
        b"<< /Type /Page /Parent 2 0 R %s >>" % page,
        b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
        b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
    ])  # fmt: skip


def _pdf_path(corners: np.ndarray) -> str:
    """A path through corners, shape (K, 2), [mm]: ``m`` moves, ``l`` draws a line."""
    verbs = ["m", *["l"] * (len(corners) - 1)]
    points = corners / MM_PER_POINT
    return " ".join(f"{x:.4f} {y:.4f} {verb}" for (x, y), verb in zip(points, verbs, strict=True))


def _pdf_disc(disc: np.ndarray) -> str:
    """A disc, x, y and radius in points, of four Bézier curves, which miss it by 0.03 % of the radius."""
    x, y, r = disc
    start, steps = np.array([r, 0]), []
    for _ in range(4):
        end = np.array([-start[1], start[0]])
        for dx, dy in (start + BEZIER_QUARTER * end, end + BEZIER_QUARTER * start, end):
            steps.append(f"{x + dx:.4f} {y + dy:.4f}")
        start = end
    curves = [f"{a} {b} {c} c" for a, b, c in zip(steps[::3], steps[1::3], steps[2::3], strict=True)]
    return " ".join([f"{x + r:.4f} {y:.4f} m", *curves, "h f"])


def _pdf_text(text: str) -> str:
    return text.replace("\\", "\\\\").replace("(", "\\(").replace(")", "\\)")


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
