"""What a camera in a bag published: when, its frames, and its own numbers as its driver states them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from aridcal.jobs.boards.camera_frames import packed_frame, raw_frame
from aridcal.jobs.head1992.matching import NotMeasured

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO = "sensor_msgs/msg/CameraInfo"

PLUMB_BOB = ("plumb_bob", "rational_polynomial")
"""Models whose first five numbers are k1 k2 p1 p2 k3 of OpenCV; the second has three more, which must be 0 here."""

MODEL_NUMBERS = 5

RECTIFIED_WORD = "rect"
"""In a topic's name: a node has straightened its images, for which not K and D hold but P."""


@dataclass(frozen=True)
class CameraInfo:
    """A camera's own numbers, as its driver states them.

    Attributes:
        width: Of its images, [px].
        height: Likewise.
        model: Of the lens.
        D: Numbers of the lens model.
        K: Camera matrix row by row, shape (9,), [px].
        P: Projection matrix of straightened images, likewise, shape (12,).
    """

    width: int
    height: int
    model: str
    D: tuple[float, ...]
    K: tuple[float, ...]
    P: tuple[float, ...]


@dataclass(frozen=True)
class BagCamera:
    """A topic with images.

    Attributes:
        title: The bag and the topic, for messages.
        topic: Its name.
        time: Of each image, shape (N,), [s], by the clock of the headers, or of arrival.
        by_arrival: Whether it is that of arrival.
        infos: What its driver says, each once.
    """

    title: str
    topic: str
    time: np.ndarray
    by_arrival: bool
    infos: tuple[CameraInfo, ...]


def info_of(message: Any) -> CameraInfo:
    """A message's numbers; those of ROS 1 have capital names."""

    def numbers(name: str) -> tuple[float, ...]:
        found = getattr(message, name) if hasattr(message, name) else getattr(message, name.upper())
        return tuple(float(value) for value in found)

    return CameraInfo(
        int(message.width), int(message.height), str(message.distortion_model), numbers("d"), numbers("k"), numbers("p")
    )


def frame_of(kind: str, message: Any) -> np.ndarray:
    """The image in a message.

    Raises:
        NotMeasured: it cannot be read.
    """
    data = np.asarray(message.data, dtype=np.uint8)
    if kind == IMAGES[1]:
        return packed_frame(data.tobytes())
    return raw_frame(
        str(message.encoding),
        int(message.height),
        int(message.width),
        int(message.step),
        bool(message.is_bigendian),
        data,
    )


def same_camera(info_topic: str, image_topic: str) -> bool:
    """Whether a topic with CameraInfo is of a topic with images: ``/cam/camera_info`` of ``/cam/image_raw/compressed``."""
    home = info_topic.rsplit("/", 1)[0]
    return image_topic.startswith(f"{home}/")


def intrinsics(camera: BagCamera, size: tuple[int, int]) -> tuple[dict[str, Any] | None, str]:
    """The camera's numbers as a campaign has them, or why there are none.

    Args:
        camera: The topic.
        size: Width and height of its images, [px].

    Returns:
        fx fy cx cy width height distortion, None where nothing usable is stated; and what is to be said.
    """
    remedy = "the lens is found from the images themselves by `aridcal detect`, without --intrinsics"
    if not camera.infos:
        return None, f"{camera.title}: no CameraInfo belongs to it: {remedy}"
    if len(camera.infos) > 1:
        return None, f"{camera.title}: its CameraInfo changes ({len(camera.infos)} different ones): not used; {remedy}"
    info = camera.infos[0]
    straightened = RECTIFIED_WORD in camera.topic.lower().rsplit("image", 1)[-1]
    K = (info.P[0], info.P[5], info.P[2], info.P[6]) if straightened else (info.K[0], info.K[4], info.K[2], info.K[5])
    D = () if straightened else info.D
    if not (K[0] > 0 and K[1] > 0 and np.isfinite([*K, *D]).all()):
        return (
            None,
            f"{camera.title}: its CameraInfo states no focal length, the camera was never calibrated: {remedy}",
        )
    if (info.width, info.height) != size:
        return None, (
            f"{camera.title}: its CameraInfo is of {info.width} x {info.height} pixels, the images have {size[0]} x {size[1]}: "
            f"not used; {remedy}"
        )
    if any(D) and (info.model not in PLUMB_BOB or any(D[MODEL_NUMBERS:])):
        return None, (
            f"{camera.title}: its CameraInfo has the lens model {info.model!r}, whose numbers k1 k2 p1 p2 k3 alone cannot hold: "
            f"not used; {remedy}"
        )
    distortion = [*D[:MODEL_NUMBERS], *[0.0] * MODEL_NUMBERS][:MODEL_NUMBERS]
    found = dict(zip(("fx", "fy", "cx", "cy"), K, strict=True))
    remark = " of straightened images (P)" if straightened else ""
    return (
        {**found, "width": size[0], "height": size[1], "distortion": distortion},
        f"{camera.title}: intrinsics{remark} from its CameraInfo ({info.model or 'no lens model'})",
    )


def camera_file(numbers: dict[str, Any], title: str) -> str:
    """``camera.yaml`` of these numbers, for ``aridcal detect --intrinsics``, `init`, or by hand into ``head.yaml``."""
    shown = ", ".join(
        f"{name}: {numbers[name]!r}" for name in ("fx", "fy", "cx", "cy", "width", "height", "distortion")
    )
    return (
        f"# From the CameraInfo of {title}.\n"
        "# Under `instruments:` of a campaign; without `on` and `identify`, and without `eye`, the `camera` of head.yaml.\n"
        "format: 1\n"
        "cameras:\n"
        f"  eye: {{{shown}, on: tip, identify: [place]}}\n"
    )


Take = Callable[[int, np.ndarray | NotMeasured], None]
"""Is handed an image by its number, or why it cannot be read."""

Load = Callable[[frozenset[int], Take], None]
"""Goes through a topic's images and hands over those of some numbers."""
