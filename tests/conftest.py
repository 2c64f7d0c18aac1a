"""What several test files share."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import chromium
import pytest

# A shell starts what runs in its background with interrupts ignored, and children would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# As the Makefile has it, for those who call pytest themselves: two workers with two threads each take twice as long.
os.environ.setdefault("OMP_NUM_THREADS", "1")


LONGEST = (
    "fleet",
    "guide",
    "head_detections",
    "view",
    "trees",
    "merge",
    "recalibrate",
    "detect",
    "cells",
    "counting",
    "early_rows",
    "instrument_faults",
    "notebooks",
    "noise_of_kinds",
    "instrument_results",
    "diagnose",
    "bad_pictures",
    "bad_inputs",
    "joined",
    "other_readings",
    "face",
    "certificate_pages",
    "check",
    "shift",
    "tree_examples",
    "design",
    "head_effects",
    "descriptions",
    "head_fiducials",
    "noise_causes",
    "determinism",
    "design_limbs",
    "compensate",
    "places",
    "study",
    "identify",
    "attacks",
    "other_instruments",
    "narrow_maps",
    "limb_words",
    "regions",
    "properties",
)
"""Test files that take more than four seconds, the longest first: the last ones to end are then short."""


MEMORY, ROOM = Path("/dev/shm"), 4 << 30
"""A file system in memory, and how many bytes of it must be free: tests keep some hundred MB at a time."""


def pytest_configure() -> None:
    """Temporary folders are in memory where there is room: tests flush files to the disk many thousand times, 4 ms each."""
    if MEMORY.is_dir() and os.access(MEMORY, os.W_OK):
        found = os.statvfs(MEMORY)
        if found.f_bavail * found.f_frsize > ROOM and not found.f_flag & os.ST_NOEXEC:
            os.environ.setdefault("PYTEST_DEBUG_TEMPROOT", str(MEMORY))


def pytest_collection() -> None:
    """Some hundred thousand objects of the tests themselves stay to the end: no collection of garbage looks at them."""
    gc.disable()


def pytest_collection_finish() -> None:
    """Nor does any later one; what collecting left over is little, and to look for it takes a second."""
    gc.freeze()
    gc.set_threshold(700, 10, 100)  # whole collections ten times rarer: they take a hundredth of the suite's time
    gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest files begin first: one that begins last would be waited for by all but one of the processes."""
    order = {f"test_{name}.py": k for k, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.name, len(order)))


@pytest.fixture
def shared_data() -> Path:
    """Folder of the public data sets, which are kept beside the repository."""
    folder = Path(__file__).resolve().parents[2] / "shared" / "data"
    if not folder.is_dir():
        reason = f"the public data sets are not at {folder}"
        if os.environ.get("ARIDCAL_REQUIRE_SHARED") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture(scope="session")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[chromium.Browser]:
    """Headless Chromium, one for all tests of a process."""
    started = chromium.Browser(chromium.find(), tmp_path_factory.mktemp("chromium"))
    yield started
    started.close()
