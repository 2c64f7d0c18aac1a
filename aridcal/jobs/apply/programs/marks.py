"""A corrected program says so, for what is corrected twice is wrong twice."""

from __future__ import annotations

import csv
import hashlib
import re
from collections.abc import Collection
from pathlib import Path

from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.text import Number
from aridcal.system.errors import AridcalError

HASH_DIGITS = 16
"""Of a calibration's SHA-256 that a comment has."""

MARK = re.compile(rf"corrected by aridcal with calibration ([0-9a-f]{{{HASH_DIGITS}}}) on (\d{{4}}-\d\d-\d\d)")

SIDE_TABLE_ENDING = ".corrections.csv"
"""Ending of the table that stands beside a corrected program, behind its name."""

SIDE_OF_FOLDER = "corrections.csv"

OUTPUT_HASH = "output_sha256"
"""Column of that table: SHA-256 of the program beside it."""


def mark_of(language: Language, text: str, calibration: bytes, day: str) -> tuple[Number, str] | None:
    """Where a comment is put in that says that a program is corrected, and the comment; None where there is no harmless place.

    Args:
        language: Of the text.
        text: The program as it was.
        calibration: Content of calibration.yaml.
        day: As 2026-11-23.
    """
    if language.comment is None:
        return None
    digest = hashlib.sha256(calibration).hexdigest()[:HASH_DIGITS]
    place, comment = language.comment(
        text, f"corrected by aridcal with calibration {digest} on {day}: do not correct it again"
    )
    return Number(place, ""), comment


def output_hash(text: str) -> str:
    """SHA-256 of a program's bytes."""
    return hashlib.sha256(text.encode("latin-1")).hexdigest()


def refuse_corrected(path: Path, text: str) -> None:
    """Make sure that a program has not been corrected yet.

    Raises:
        AridcalError: it has, by its comment or by the table beside it.
    """
    mark = MARK.search(text)
    if mark is not None:
        raise AridcalError(
            f"{path}: was corrected on {mark.group(2)} with calibration {mark.group(1)}: correct the program as it was before"
        )
    tables = [
        path.with_name(f"{path.name}{SIDE_TABLE_ENDING}"),
        *(folder / SIDE_OF_FOLDER for folder in path.absolute().parents[:3]),
    ]
    if any(output_hash(text) in _hashes(table) for table in tables):
        raise AridcalError(
            f"{path}: was corrected already, as the table beside it says; correct the program as it was before"
        )


def _hashes(table: Path) -> Collection[str]:
    """Hashes of outputs in a table of corrections; none where there is no such table."""
    try:
        with table.open(encoding="utf-8", newline="") as lines:
            return frozenset(row.get(OUTPUT_HASH) or "" for row in csv.DictReader(lines)) - {""}
    except (OSError, ValueError, csv.Error):
        return frozenset()
