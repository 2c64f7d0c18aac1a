"""Frames of a camera as programs send them, raw or compressed, made images and PNG files.

Encodings are those of ROS (``sensor_msgs/image_encodings.hpp``); a Bayer pattern is named there after its first two pixels, in
OpenCV after the second and third of its second row (``cv_bridge``).
"""

from __future__ import annotations

import cv2
import numpy as np

from aridcal.jobs.boards.grey_images import MOST_MEGAPIXELS
from aridcal.jobs.head1992.matching import NotMeasured
from aridcal.system.reading.images import image_size
from aridcal.system.reading.regular_files import MEGA

CHANNELS = {
    "mono8": 1, "8uc1": 1, "mono16": 1, "16uc1": 1, "rgb8": 3, "bgr8": 3, "8uc3": 3, "rgba8": 4, "bgra8": 4, "8uc4": 4,
    "bayer_rggb8": 1, "bayer_bggr8": 1, "bayer_gbrg8": 1, "bayer_grbg8": 1,
}  # fmt: skip
"""Numbers of a pixel, by the encoding in small letters."""

TO_BGR = {
    "rgb8": cv2.COLOR_RGB2BGR, "rgba8": cv2.COLOR_RGBA2BGR, "bgra8": cv2.COLOR_BGRA2BGR, "8uc4": cv2.COLOR_BGRA2BGR,
    "bayer_rggb8": cv2.COLOR_BayerBG2BGR, "bayer_bggr8": cv2.COLOR_BayerRG2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGR2BGR, "bayer_grbg8": cv2.COLOR_BayerGB2BGR,
}  # fmt: skip
"""How OpenCV turns it into colours in its own order; the others are grey or in that order already."""

THUMBNAIL_SIZE = (64, 48)
"""[px] of a thumbnail: noise of pixels is gone, a board that moves by a hundredth of the picture is seen."""


def raw_frame(encoding: str, height: int, width: int, step: int, bigendian: bool, data: np.ndarray) -> np.ndarray:
    """A raw frame as an image: uint8, grey (height, width) or colours in OpenCV's order (height, width, 3).

    Args:
        encoding: As ROS calls it.
        height: [px].
        width: [px].
        step: Bytes of a row.
        bigendian: How numbers of two bytes are written.
        data: The bytes, uint8.

    Raises:
        NotMeasured: the encoding is another one, or the bytes do not fit the size.
    """
    kind = encoding.lower()
    if kind not in CHANNELS:
        raise NotMeasured(f"images of encoding {encoding!r} are not read; publish mono8, bgr8 or rgb8")
    _check_size(width, height)
    depth = 2 if kind in ("mono16", "16uc1") else 1
    row = width * CHANNELS[kind] * depth
    if width < 1 or height < 1 or step < row or len(data) < step * (height - 1) + row:
        raise NotMeasured(f"an image says {width} x {height} pixels of {encoding}, and has {len(data)} bytes")
    # rows as they lie in the bytes; what a row ends in may be missing from the last, and may be said to be gigabytes
    rows = np.lib.stride_tricks.as_strided(np.ascontiguousarray(data), (height, row), (step, 1), writeable=False)
    if depth == 2:
        numbers = np.ascontiguousarray(rows).view(">u2" if bigendian else "<u2")
        return np.asarray(numbers >> 8, dtype=np.uint8)
    image = rows.reshape((height, width) if CHANNELS[kind] == 1 else (height, width, CHANNELS[kind]))
    image = np.ascontiguousarray(image)
    return np.asarray(cv2.cvtColor(image, TO_BGR[kind])) if kind in TO_BGR else image


def packed_frame(content: bytes) -> np.ndarray:
    """A frame that was sent as JPEG or PNG, as the sensor saw it; likewise.

    Raises:
        NotMeasured: it is neither, or damaged.
    """
    size = image_size(content)
    if size is None:
        raise NotMeasured("a compressed image is neither JPEG nor PNG, or damaged")
    _check_size(*size)
    try:
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    if image is None:
        raise NotMeasured("a compressed image cannot be decoded: it is damaged")
    image = np.asarray(image >> 8, dtype=np.uint8) if image.dtype == np.uint16 else np.asarray(image)
    return np.ascontiguousarray(image[..., :3]) if image.ndim == 3 and image.shape[2] == 4 else image


def png_file(image: np.ndarray) -> bytes:
    """An image as a PNG file."""
    return bytes(cv2.imencode(".png", image)[1])


def thumbnail(image: np.ndarray) -> np.ndarray:
    """Grey levels of an image made small, each the mean of what it stands for; shape (48, 64)."""
    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    return np.asarray(cv2.resize(grey, THUMBNAIL_SIZE, interpolation=cv2.INTER_AREA), dtype=float)


def _check_size(width: int, height: int) -> None:
    if width * height > MOST_MEGAPIXELS * MEGA:
        raise NotMeasured(f"an image has {width} x {height} pixels, at most {MOST_MEGAPIXELS:g} megapixels are decoded")
