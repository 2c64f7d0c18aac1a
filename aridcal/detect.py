"""Corners of printed boards and tags in images, as a table of pixels for a campaign of `kind: pixels`.

Beside the table, camera.yaml has the camera's own numbers as the images tell them, or as --intrinsics states them, and
refused.csv names the images that show nothing that can be measured. Joints come from --joints: a table with a row for each
image, whose column `image` has its name. Without options the board is the one that `aridcal print charuco` draws.

Example:
    aridcal detect images/ --joints joints.csv -o corners.csv
    aridcal detect images/ --board apriltag --dictionary DICT_APRILTAG_36h11 --joints joints.csv -o corners.csv
"""

from __future__ import annotations

import argparse
import re
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from rich.progress import track

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.files.instrument_settings import ArmCameraSettings
from aridcal.files.tables import Table, read_tables
from aridcal.jobs.boards.advice import ENOUGH_IMAGES, advice
from aridcal.jobs.boards.camera_file import CAMERA_FILE, camera_by_name, camera_text
from aridcal.jobs.boards.finders import MIRRORED, ImageMarks, find
from aridcal.jobs.boards.grey_images import grey_image, listed_images
from aridcal.jobs.boards.lens import FEWEST_VIEWS, Lens, LensUnknown, estimate, fit
from aridcal.jobs.boards.options import BOARDS, TAGS, Defaults, add_board_options, board_of, chosen, option_text
from aridcal.jobs.boards.patterns import AnyBoard, Cube
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.system.errors import AridcalError, MeasurementError, name_list, printable, shortened
from aridcal.system.progress import SHOWN_REMARKS, Screen
from aridcal.system.reading.regular_files import SETTINGS, read_file
from aridcal.system.reading.user_names import check_name, path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import in_plain_words
from aridcal.system.writing.whole_files import atomic_table, claimed_table

FILES_BESIDE_MARKS = CAMERA, REFUSED = CAMERA_FILE, "refused.csv"
"""Written beside the table."""

MARK_KINDS: Defaults = {**BOARDS, **TAGS}

MARK_COLUMNS = ("image", "camera", "marker", "u", "v", "shot")


@dataclass(frozen=True)
class BoardImages:
    """Images with the board in them, and images refused.

    Attributes:
        good: Marks in each image that shows the board, by the image's name.
        refused: Why each other image was not measured, by name.
        size: Width and height of the good images, [px].
        shot: Number of each image, by name.
    """

    good: dict[str, ImageMarks]
    refused: dict[str, str]
    size: tuple[int, int]
    shot: dict[str, int]

    def without(self, why: dict[str, str]) -> BoardImages:
        """These images with more of them refused, with the reasons ``why`` by name."""
        good = {name: found for name, found in self.good.items() if name not in why}
        return BoardImages(good, self.refused | why, self.size, self.shot)


def look(images: dict[str, Path], board: AnyBoard, console: Screen) -> BoardImages:
    """Find a board in images; those of another size than the first good one are refused: they are of another camera.

    Args:
        images: By name.
        board: What to look for.
        console: For the progress.

    Raises:
        AridcalError: it is in none of them. The message says why, and what is there instead.
    """
    good: dict[str, ImageMarks] = {}
    refused: dict[str, str] = {}
    size = (0, 0)
    for name, path in track(images.items(), "looking", total=len(images), console=console, transient=True):
        try:
            image = grey_image(path)
            own_size = (image.shape[1], image.shape[0])
            if good and own_size != size:
                raise NotMeasured(
                    f"the image has {own_size[0]} x {own_size[1]} pixels, the others {size[0]} x {size[1]}: one camera at a time"
                )
            good[name] = find(image, board)
            size = own_size
        except NotMeasured as refusal:
            refused[name] = str(refusal)
    if not good:
        raise AridcalError(_nothing(images, refused))
    return BoardImages(good, refused, size, {name: k + 1 for k, name in enumerate(images)})


def _nothing(images: dict[str, Path], refused: dict[str, str]) -> str:
    """The message where no image shows the board: the usual reason, and what some images show instead."""
    reasons = {name: re.sub(r"[\d.]+", "", why) for name, why in refused.items()}  # "by 2.3 px", "by 2.5 px" are one
    reason, times = Counter(reasons.values()).most_common(1)[0]
    alike = [name for name, own_reason in reasons.items() if own_reason == reason]
    readable = []
    for k in np.unique(np.linspace(0, times - 1, min(times, ENOUGH_IMAGES)).astype(int)):
        with suppress(NotMeasured):
            readable.append(grey_image(images[alike[k]]))
    hint = advice(readable) if refused[alike[0]] != MIRRORED else ""
    further = f" (and {times - 1} more like it)" if times > 1 else ""
    sentence = (
        f"nothing is found in {len(images)} images. {shortened(printable(alike[0]))}{further}: {refused[alike[0]]}"
    )
    return f"{sentence}. {hint[0].upper()}{hint[1:]}" if hint else sentence


def pixels_table(images: BoardImages, camera: str) -> pd.DataFrame:
    """All marks as rows: image, camera, marker, u, v, shot."""
    parts = [
        pd.DataFrame(
            {"image": name, "camera": camera, "marker": marks.names, "u": marks.pixels[:, 0], "v": marks.pixels[:, 1]}
        )
        for name, marks in images.good.items()
    ]
    table = pd.concat(parts, ignore_index=True)
    table["shot"] = table["image"].map(images.shot)
    return table


def joint_rows(path: Path) -> tuple[Table, dict[str, int]]:
    """Read the table of joints.

    Returns:
        The table, and the row of each image.

    Raises:
        MeasurementError: it has no column `image`, one of this command's columns, or an image twice.
    """
    table = read_tables([path])
    table.require(["image"], "It has the name of the image that belongs to each row.")
    reserved = [name for name in MARK_COLUMNS[1:] if name in table.names]
    if reserved:
        raise MeasurementError(
            f"{path}: the columns {name_list(reserved)} are written by this command: rename or delete them"
        )
    rows: dict[str, int] = {}
    for row, name in enumerate(table.texts("image")):
        key = Path(str(name)).name
        if key in rows:
            earlier = table.line[rows[key]]
            raise MeasurementError(
                f"{path}, line {table.line[row]}: image {key!r} stands in line {earlier} too; delete one"
            )
        rows[key] = row
    return table, rows


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("detect", __doc__)
    arguments.add_argument("images", type=path_argument, nargs="+", help="folders of images, or images")
    arguments.add_argument("-o", "--out", type=path_argument, required=True, help="table of corners to write, .csv")
    arguments.add_argument(
        "--board", choices=list(MARK_KINDS), default="charuco", help="what to look for (default: charuco)"
    )
    arguments.add_argument("--joints", type=path_argument, metavar="CSV", help="joints of each image, .csv or .parquet")
    arguments.add_argument("--camera", default="eye", help="the camera's name in the table (default: eye)")
    arguments.add_argument("--intrinsics", type=path_argument, metavar="YAML", help="a camera.yaml whose numbers hold")
    add_board_options(arguments)
    for_scripts(arguments)
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    out: Path = arguments.out
    check_name(arguments.camera, "--camera", AridcalError)
    options = chosen(arguments, arguments.board, MARK_KINDS)
    board = board_of(arguments.board, options)
    assert not isinstance(board, Cube)
    # The numbers of --intrinsics may be in the camera's file beside the table, and are what is written there again.
    check_apart([out, out.with_name(REFUSED)], [arguments.joints, arguments.intrinsics])
    with claimed_table(out, FILES_BESIDE_MARKS):
        camera = camera_by_name(arguments.intrinsics, arguments.camera) if arguments.intrinsics else None
        stated_text = read_file(arguments.intrinsics, AridcalError, SETTINGS) if camera else b""
        joints = joint_rows(arguments.joints) if arguments.joints else None
        images = listed_images(arguments.images)
        check_apart([out, *(out.with_name(name) for name in FILES_BESIDE_MARKS)], images.values())
        if joints is not None and not set(images) & set(joints[1]):
            first = next(iter(images))
            raise MeasurementError(
                f"{arguments.joints}: has no row for any of the images: its column `image` needs names as {first!r}"
            )
        _, console = screens(arguments)
        console.say(f"looking for {arguments.board} {option_text(options)}")
        looked = look(images, board, console)
        remarks = _write(looked, out, arguments.camera, camera, stated_text, joints)
    console.say(*remarks)


def _write(
    images: BoardImages,
    out: Path,
    camera: str,
    known_lens: ArmCameraSettings | None,
    stated_text: bytes,
    joints: tuple[Table, dict[str, int]] | None,
) -> list[str]:
    """Check what was found against the camera, and write it; returns what there is to say."""
    remarks: list[str] = []
    lens = None
    if known_lens is None:
        images, lens, remark = _with_own_lens(images)
        remarks += [remark] if remark else []
    else:
        images = _with_known_lens(images, known_lens)
    if joints is None:
        remarks.append("joints are missing: give --joints, a table with the columns image and one for each joint")
    else:
        lacking = [name for name in images.good if name not in joints[1]]
        images = images.without(dict.fromkeys(lacking, "the table of joints has no row for this image"))
        unseen = sorted(set(joints[1]) - set(images.shot))
        remarks += [f"{len(unseen)} rows of the table of joints name no image: {name_list(unseen)}"] if unseen else []
    if not images.good:
        name, why = next(iter(images.refused.items()))
        raise AridcalError(f"no image is left. {shortened(printable(name))}: {why}")
    table = pixels_table(images, camera)
    if joints is not None:
        cells = joints[0].frame().drop(columns="image")
        rows = table["image"].map(joints[1]).to_numpy()
        table = pd.concat([table, cells.iloc[rows].reset_index(drop=True)], axis=1)
    refused = [(images.shot[name], name, why) for name, why in images.refused.items()]
    text = camera_text(camera, lens, images.size, len(images.good)) if lens else ""
    with atomic_table(out, FILES_BESIDE_MARKS) as folder:
        table.to_csv(folder / out.name, index=False, float_format="%.17g")
        in_plain_words(pd.DataFrame(refused, columns=["shot", "image", "why"])).to_csv(folder / REFUSED, index=False)
        if text or stated_text:  # beside the table, where `init` looks for it
            (folder / CAMERA).write_bytes(text.encode() or stated_text)
    lines = [f"refused: {shortened(printable(name))}: {why}" for _, name, why in refused[:SHOWN_REMARKS]]
    found = f"{out}: {len(table)} marks in {len(images.good)} images, {len(refused)} images refused"
    return [*lines, *remarks, *([f"{out.parent / CAMERA}:", text.rstrip()] if text else []), found]


def _with_own_lens(images: BoardImages) -> tuple[BoardImages, Lens | None, str]:
    """Estimate the camera's numbers; images that contradict the others are refused, once, and the rest estimated anew."""
    try:
        lens = estimate(list(images.good.values()), images.size)
        names = np.array(list(images.good))
        if lens.strange.any() and len(names) - lens.strange.sum() >= FEWEST_VIEWS:
            off = zip(names[lens.strange].tolist(), lens.misfit[lens.strange], strict=True)
            images = images.without({name: _strange(misfit) for name, misfit in off})
            lens = estimate(list(images.good.values()), images.size)
    except LensUnknown as problem:
        return images, None, f"the camera's numbers are not estimated: {problem}"
    return images, lens, ""


def _with_known_lens(images: BoardImages, camera: ArmCameraSettings) -> BoardImages:
    """Refuse images that do not show the board as this camera would."""
    if (camera.width, camera.height) != images.size:
        raise AridcalError(
            f"--intrinsics: the camera has {camera.width} x {camera.height} pixels, "
            f"the images {images.size[0]} x {images.size[1]}"
        )
    names, misfit = list(images.good), fit(list(images.good.values()), camera.intrinsics)
    lens = Lens(camera.intrinsics, np.zeros(len(camera.intrinsics)), misfit)
    return images.without({name: _strange(misfit[k]) for k, name in enumerate(names) if lens.strange[k]})


def _strange(misfit: float) -> str:
    return (
        f"the marks are {misfit:.2g} px off a plane board as the other images show it: is it bent, or partly covered?"
    )


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
