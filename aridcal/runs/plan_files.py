"""A plan written: tables, programs, waypoints and pages, by the endings of their names."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.files.campaign import Campaign
from aridcal.files.counting import counting
from aridcal.jobs.fleet.keys import files_of
from aridcal.jobs.plan.joint_moves import PROGRAMS, WAYPOINTS, check_program, moves, program
from aridcal.jobs.plan.pose_design import Plan, as_table
from aridcal.pages.plan_page import plan_page
from aridcal.system.errors import OutputError
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import WRITTEN_ENDINGS, write_table
from aridcal.system.writing.whole_files import atomic_file

PLAN_PAGE_ENDING = ".html"
PLAN_ENDINGS = (*WRITTEN_ENDINGS, *PROGRAMS, PLAN_PAGE_ENDING)
"""Endings of what can be written."""

MOST_PLANNED = 500
"""Configurations of one plan: choosing more would take minutes, and chance does as well by then."""


def check_endings(out: Sequence[Path]) -> None:
    """Make sure that files of these names can hold a plan.

    Raises:
        OutputError: naming the file.
    """
    for path in out:
        if path.suffix.lower() not in PLAN_ENDINGS:
            raise OutputError(f"{path}: should be a file that ends in one of {', '.join(PLAN_ENDINGS)}")


def check_outputs(campaign: Campaign, robot: Robot, out: Sequence[Path]) -> None:
    """Make sure that a plan may be written to some files, and that programs in their languages can move the robot.

    Raises:
        OutputError: naming the file.
    """
    check_apart(out, [campaign.path, *(file for _, file in files_of(campaign))])
    places = [path.resolve() for path in out]
    for number, (path, place) in enumerate(zip(out, places, strict=True)):
        if place in places[:number]:
            raise OutputError(f"{path}: is named twice; delete one")
        if path.suffix.lower() in PROGRAMS:
            if robot.others and path.suffix.lower() != WAYPOINTS:
                limbs = ", ".join(limb.tip for limb in robot.limbs)
                raise OutputError(
                    f"{path}: a controller's program moves one arm, and this plan several limbs ({limbs}): write a table, or "
                    f"waypoints for MoveIt ({WAYPOINTS})"
                )
            check_program(path.suffix.lower(), path.stem, robot.kinds)


def write_plan(plan: Plan, campaign: Campaign, robot: Robot, out: Sequence[Path], settle: float) -> None:
    """Write a plan in the forms that the names of files ask for; all of them appear, or none.

    Args:
        plan: What to write.
        campaign: Whose measurements it plans.
        robot: The chain.
        out: The files.
        settle: What programs wait at each configuration, [s].
    """
    with ExitStack() as ends:
        built = [(path, ends.enter_context(atomic_file(path))) for path in out]
        for path, file in built:
            _write(plan, campaign, robot, path, file, settle)


def _write(plan: Plan, campaign: Campaign, robot: Robot, path: Path, file: Path, settle: float) -> None:
    """Write one file of a plan, called ``path``, to ``file``; see :func:`write_plan`."""
    ending = path.suffix.lower()
    if ending in WRITTEN_ENDINGS:
        write_table(as_table(plan, robot, campaign.measurements), file)
    elif ending == PLAN_PAGE_ENDING:
        file.write_text(plan_page(plan, robot, campaign.path.name), encoding="utf-8", errors="replace")
    else:
        # controllers go straight in joints; MoveIt may come by any way
        via = plan.via if ending == WAYPOINTS else np.where(plan.by_way[:, None], plan.via, np.nan)
        readings = plan.readings
        if ending != WAYPOINTS:  # MoveIt counts as the URDF does, a controller as its own joints in the tables
            conversion = counting(campaign.measurements, robot.readings, robot.kinds)
            readings, via = conversion.shown(readings), conversion.shown(via)
        motion = moves(
            campaign.path.name, robot.readings, robot.kinds, readings, via, plan.titles, settle, (plan.kept_out,)
        )
        file.write_text(program(motion, ending, path.stem), encoding="utf-8", errors="replace")
