"""Shots of the measuring head (images and sonar ranges) to measured poses of the tip, with their uncertainty.

Example:
    aridcal measure head.yaml -o measurements.csv
"""

from __future__ import annotations

import argparse
import base64
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from markupsafe import Markup
from rich.progress import track
from scipy.spatial.transform import Rotation

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.files.quantities import STD
from aridcal.files.tables import Table
from aridcal.jobs.head1992.head_settings import POSE_COLUMNS, HeadSettings, range_columns
from aridcal.jobs.head1992.shots import THUMBNAIL, ShotResult, load, measure_shots
from aridcal.jobs.head1992.sonar import contradictions
from aridcal.pages.drawing.html import tag
from aridcal.system.errors import AridcalError, printable, shortened
from aridcal.system.progress import SHOWN_REMARKS, Screen
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import in_plain_words
from aridcal.system.writing.whole_files import atomic_table, claimed_table

FILES_BESIDE_POSES = REFUSED, SHEET = "refused.csv", "shots.html"
"""Written beside the table: the shots that were not measured, and a page with all images."""

REFUSED_COLUMNS = ("shot", "image", "why")
STYLE = """body { font: 14px system-ui, sans-serif; margin: 1.5rem; color: #222; background: #fff }
main { display: grid; grid-template-columns: repeat(auto-fill, minmax(256px, 1fr)); gap: 1rem }
figure { margin: 0 } figcaption { font-size: 12px; overflow-wrap: anywhere } .refused { color: #a11 }"""


def measured_table(table: Table, results: Sequence[ShotResult], head: HeadSettings) -> pd.DataFrame:
    """Write measured shots as rows of ``measurements.csv``: shot, the user's other columns, the pose, its ``std_*``.

    Args:
        table: ``shots.csv``.
        results: Of its rows, in their order.
        head: Which of the columns are ranges, which are left out.
    """
    good = [(row, m) for row, m in enumerate(results) if m.T_world_tip is not None]
    rows = [row for row, _ in good]
    T = np.array([m.T_world_tip for _, m in good])
    position, R = T[:, :3, 3], T[:, :3, :3]
    quaternion = Rotation.from_matrix(R).as_quat(canonical=True)
    std = np.array([m.std for _, m in good])
    measured = pd.DataFrame(np.column_stack([position, quaternion, std]), columns=[*POSE_COLUMNS, *STD])
    own = table.frame().iloc[rows].reset_index(drop=True)
    replaced = [name for name in ("shot", *measured.columns) if name in own.columns]
    own = own.drop(columns=["image", *range_columns(head), *replaced])
    own.insert(0, "shot", [m.shot.line for _, m in good])
    return pd.concat([own, measured], axis=1)


def refused_table(table: Table, results: Sequence[ShotResult]) -> pd.DataFrame:
    """Write the shots that were not measured, and rows of the table that could not be read, as rows of ``refused.csv``."""
    shots = [(m.shot.line, m.shot.image, m.why) for m in results if m.why]
    unread = [(remark.row or 0, "", remark.why) for remark in table.refused]
    return pd.DataFrame([*shots, *unread], columns=list(REFUSED_COLUMNS))


def contact_sheet(results: Sequence[ShotResult], title: str) -> Markup:
    """Show all images with what was found in them, as one page that needs nothing else.

    Args:
        results: Of all shots; those that were refused are shown in red, with the reason.
        title: Of the page.
    """
    figures = []
    for m in results:
        content = base64.b64encode(m.thumbnail).decode()
        source = f"data:image/jpeg;base64,{content}"
        image = Markup(f'<img alt="" width="{THUMBNAIL}" src="{source}">') if m.thumbnail else Markup("")
        caption = f"shot {m.shot.line}, {m.shot.image}: {_found(m) or m.why}"
        text = tag("figcaption", caption) if _found(m) else tag("figcaption", caption, class_="refused")
        figures.append(tag("figure", image, text))
    good = sum(m.std is not None for m in results)
    head = tag("head", Markup('<meta charset="utf-8">'), tag("title", title), tag("style", Markup(STYLE)))
    summary = tag("p", f"{good} of {len(results)} shots measured.")
    body = tag("body", tag("h1", title), summary, tag("main", figures))
    return Markup("<!doctype html>") + tag("html", head, body, lang="en")


def _found(m: ShotResult) -> str:
    """Say what a shot shows, and how exactly; nothing for one that was refused."""
    if m.std is None or m.fiducials is None:
        return ""
    um, mrad = 1e6 * np.max(m.std[:3]), 1e3 * np.max(m.std[3:])
    count = len(m.fiducials.pixels)
    return f"square {m.square}, {count} fiducials, std of the tip {um:.0f} µm, {mrad:.2f} mrad"


def sonar_remarks(results: Sequence[ShotResult], std: float) -> list[str]:
    """Say which sonars contradict the camera throughout.

    Args:
        results: Of all shots.
        std: Of a reading, [m].
    """
    residuals = np.array([m.range_residuals for m in results if m.range_residuals is not None])
    return [
        f"sonar {k + 1} differs from the camera by {1e3 * mean:+.2f} mm, on average over {len(residuals)} shots: "
        "the head is not as declared; a campaign of `kind: camera_sonar` identifies the cause"
        for k, mean in contradictions(residuals, std).items()
    ]


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("measure", __doc__)
    arguments.add_argument("head", type=path_argument, help="head.yaml: camera, sonars, squares and shots")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, help="table of measured poses to write, .csv"
    )
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    out: Path = arguments.out
    check_apart(_written(out), [arguments.head])
    with claimed_table(out, FILES_BESIDE_POSES):
        _measure(arguments.head, out, screens(arguments)[1])


def _written(out: Path) -> list[Path]:
    return [out, *(out.with_name(name) for name in FILES_BESIDE_POSES)]


def _measure(settings: Path, out: Path, console: Screen) -> None:
    head, squares, table, shots = load(settings)
    check_apart(_written(out), [head.squares, head.shots, *(head.shots.parent / shot.image for shot in shots)])
    work = measure_shots(shots, head, squares)
    results = list(track(work, "measuring", total=len(shots), console=console, transient=True))
    refused = refused_table(table, results)
    rows = len(results) + len(table.refused)
    lines = [
        f"line {line}, {shortened(printable(image))}: {why}" for line, image, why in refused.itertuples(index=False)
    ]
    if len(refused) == rows:
        first = lines[0] if lines else "it has no rows"
        raise AridcalError(f"{head.shots}: nothing could be measured. First: {first}")
    with atomic_table(out, FILES_BESIDE_POSES) as folder:
        measured_table(table, results, head).to_csv(folder / out.name, index=False, float_format="%.17g")
        in_plain_words(refused).to_csv(folder / REFUSED, index=False)
        (folder / SHEET).write_text(contact_sheet(results, f"Shots of {head.shots.name}"), encoding="utf-8")
    said = [f"refused: {line}" for line in lines[:SHOWN_REMARKS]]
    if head.sonars:
        said += sonar_remarks(results, head.sonars.std)
    said.append(f"{out}: {rows - len(refused)} shots measured, {len(refused)} refused")
    console.say(*said)


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
