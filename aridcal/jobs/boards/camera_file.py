"""``camera.yaml``: a camera's own numbers, written by `aridcal detect` and read again by it and by `aridcal init`."""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from aridcal.files.instrument_settings import ArmCameraSettings
from aridcal.files.yaml_file import Settings, load_settings
from aridcal.jobs.boards.lens import Lens
from aridcal.system.errors import AridcalError, nearest

CAMERA_FILE = "camera.yaml"


class CameraFile(Settings):
    """Cameras as a campaign's ``instruments`` has them."""

    cameras: dict[str, ArmCameraSettings] = Field(min_length=1)


def camera_text(name: str, lens: Lens, size: tuple[int, int], images: int) -> str:
    """An entry to paste into a campaign, and how well its numbers are known.

    Args:
        name: Of the camera.
        lens: Its numbers.
        size: Width and height of its images, [px].
        images: How many there were.
    """
    fx, fy, cx, cy = (f"{value:.3f}" for value in lens.intrinsics[:4])
    distortion = ", ".join(f"{value:.6g}" for value in lens.intrinsics[4:])
    focal, middle = max(lens.std[:2]), max(lens.std[2:4])
    return (
        f"# From {images} images, misfit {lens.rms:.3f} px; 1-sigma of fx fy {focal:.2g} px, of cx cy {middle:.2g} px.\n"
        "# Under `instruments:` of a campaign. `on: tip` moves with the arm, `on: world` looks at it.\n"
        "format: 1\n"
        "cameras:\n"
        f"  {name}: {{fx: {fx}, fy: {fy}, cx: {cx}, cy: {cy}, width: {size[0]}, height: {size[1]}, "
        f"distortion: [{distortion}], on: tip, identify: [place]}}\n"
    )


def camera_by_name(path: Path, name: str) -> ArmCameraSettings:
    """The camera of a name.

    Raises:
        AridcalError: the file cannot be read, or has no camera of that name.
    """
    cameras = load_settings(path, CameraFile).cameras
    if name not in cameras:
        raise AridcalError(f"{path}: no camera {name!r}{nearest(name, cameras)}; `--camera` names one of its cameras")
    return cameras[name]
