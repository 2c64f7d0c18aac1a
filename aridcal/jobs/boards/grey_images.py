"""Images that a user names, one by one or by their folder, decoded to grey levels."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.system.errors import AridcalError, name_list
from aridcal.system.reading.images import image_size, read_image_file
from aridcal.system.reading.regular_files import IMAGE, MEGA
from aridcal.system.reading.user_names import check_name

IMAGE_ENDINGS = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".pgm", ".ppm", ".webp")
"""Endings of files that count as images of a folder."""

# Decoded, each takes a byte of memory, and three times that on the way.
MOST_MEGAPIXELS = 100.0


def listed_images(paths: Sequence[Path]) -> dict[str, Path]:
    """Images by the names that a table has for them: those of a folder, in the order in which people count, or files.

    Args:
        paths: Folders and files.

    Raises:
        AridcalError: a folder is not there or has no images, or two images have one name.
    """
    by_name: dict[str, Path] = {}
    for path in paths:
        if path.is_dir():
            files = sorted(
                (file for file in path.iterdir() if file.suffix.lower() in IMAGE_ENDINGS), key=_counting_order
            )
            if not files:
                raise AridcalError(f"{path}: no images in this folder; their names end in {name_list(IMAGE_ENDINGS)}")
        else:
            files = [path]
        for file in files:
            check_name(file.name, str(path), AridcalError)
            if file.name in by_name:
                raise AridcalError(f"{file} and {by_name[file.name]} have one name: rename one of them")
            by_name[file.name] = file
    return by_name


def _counting_order(file: Path) -> list[tuple[int, str]]:
    """Sort key of file names that puts shot_2 before shot_10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", file.name)]


def grey_image(path: Path) -> np.ndarray:
    """Read an image as grey levels, uint8, shape (height, width); its header decides whether it is decoded at all.

    Raises:
        NotMeasured: it cannot be read.
    """
    try:
        content = read_image_file(path.name, path.parent, IMAGE)
    except AridcalError as problem:
        raise NotMeasured(str(problem)) from None
    size = image_size(content)
    if size is None:
        raise NotMeasured(
            "the file is no image of a known kind, or damaged: save it as PNG, JPEG, TIFF, BMP, PGM or WebP"
        )
    if size[0] * size[1] > MOST_MEGAPIXELS * MEGA:
        raise NotMeasured(
            f"the image has {size[0]} x {size[1]} pixels, at most {MOST_MEGAPIXELS:g} megapixels are decoded"
        )
    try:
        # As the sensor saw it: a camera that was turned may say so in some images and not in others.
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
    except cv2.error:
        image = None
    if image is None:
        raise NotMeasured("the image cannot be decoded: is the file complete? Save it anew")
    return image
