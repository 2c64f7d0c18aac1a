"""What a calibration depends on, as one hash: the contents of all files that it reads, and the version of what reads them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel

from aridcal import __version__
from aridcal.files.campaign import Campaign
from aridcal.files.yaml_file import load_settings
from aridcal.jobs.head1992.head_settings import HeadSettings, load_shots
from aridcal.system.errors import AridcalError

ABSENT_FILE = b"absent"
"""Stands for the contents of a file that is not there: once it is, the key is another."""


@dataclass(frozen=True)
class Inputs:
    """Hashes of what a calibration reads, as hexadecimal numbers.

    Attributes:
        key: Of everything and the version: two calibrations of one key are the same.
        inputs: Of everything but the version.
        urdf: Of the URDF: robots of one make have the same.
    """

    key: str
    inputs: str
    urdf: str


def inputs_of(campaign: Campaign) -> Inputs:
    """Hash what a campaign reads: itself and every file that it names, the head's own files, and images; no meshes.

    Names and places of the files do not count beyond what the campaign writes, so that a folder may be moved as a whole.

    Args:
        campaign: As it was read.
    """
    whole = hashlib.sha256(_of_text(campaign.text))
    for place, path in files_of(campaign):
        whole.update(f"\n{place} ".encode())
        whole.update(_of_file(path))
    inputs = whole.hexdigest()
    return Inputs(key_of_version(inputs), inputs, _of_file(campaign.robot.urdf).hex())


def key_of_version(inputs: str) -> str:
    """The key of inputs, read by this version."""
    return hashlib.sha256(f"{inputs} {__version__}".encode()).hexdigest()


def inputs_of_text(path: Path) -> Inputs:
    """The same of a campaign that cannot be read: of its own contents alone."""
    inputs = _of_file(path).hex()
    return Inputs(key_of_version(inputs), inputs, "")


def files_of(campaign: Campaign) -> Iterator[tuple[str, Path]]:
    """Every file that a campaign reads beside itself, with the key that names it, always in the same order."""
    yield from _paths(campaign, "")
    if campaign.measurements.head is not None:
        yield from _files_of_head(campaign.measurements.head)


def _files_of_head(path: Path) -> Iterator[tuple[str, Path]]:
    """Files of a measuring head; those that cannot be found for want of another are left out, and the key changes with that."""
    try:
        head = load_settings(path, HeadSettings)
        yield from _paths(head, "head.")
        images = dict.fromkeys(map(str, load_shots(head.shots, head).texts("image")))
    except (AridcalError, OSError):  # said when the campaign is computed, where it can be said whose fault it is
        return
    for name in images:
        yield f"head.shots.{name}", head.shots.parent / name


def _paths(value: Any, place: str) -> Iterator[tuple[str, Path]]:
    """Every path in settings, with the keys that lead to it."""
    if isinstance(value, Path):
        yield place, value
    elif isinstance(value, BaseModel):
        for name in type(value).model_fields:
            yield from _paths(getattr(value, name), f"{place}.{name}")
    elif isinstance(value, Mapping):
        for name in sorted(value, key=str):
            yield from _paths(value[name], f"{place}.{name}")
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        for k, part in enumerate(value):
            yield from _paths(part, f"{place}[{k}]")


def _of_text(text: str) -> bytes:
    return hashlib.sha256(text.encode()).digest()


def _of_file(path: Path) -> bytes:
    """Hash of a file's contents; that of :data:`ABSENT_FILE` where it cannot be read or is no file."""
    try:
        if not path.is_file():  # of a pipe or a device nothing would ever come
            return hashlib.sha256(ABSENT_FILE).digest()
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").digest()
    except (OSError, ValueError):
        return hashlib.sha256(ABSENT_FILE).digest()
