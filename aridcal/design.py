"""Choose configurations to measure: those that make the target best known where it is to work.

With tables already measured, the new rows add to what these tell. A campaign whose tables are not there yet is planned from
nothing: the kind of measurement, its noise, and frames and instruments as hints. Joints keep 2 % of their ranges off their
limits. The arm, as lines from joint to joint and to the target and with the URDF's collision shapes, keeps out of itself and of
the boxes of the campaign's `design: {keep_out: [{min: [x, y, z], max: [x, y, z]}]}` (base frame, m); without that key it stays
above the plane z = 0 of its base, where that is what it is mounted on. The tracker or camera of
`design: {sight: {at: [x, y, z]}}` sees the target past them. The ways between are not looked at.

Of a robot of several limbs the joints of all are planned. Their shapes keep out of each other, and every target that rows may
see, on whichever link, is to be known. What images show of several limbs is not planned.

Configurations come in an order that shortens the way. Where backlash is among the effects that may be there, each joint comes to
them from both sides, by way of points that the programs have and that are not measured.

What is written is said by the ending of -o, which may stand more than once: .csv or .parquet, the joints in the campaign's
columns and units with what each row measures (which point, anchor, plane, camera or target) and, where it matters,
JOINT_direction; .script (URScript), .src (KRL), .mod (RAPID), joint moves with a stop at each; .yaml, waypoints for MoveIt;
.html, a page that shows what the plan covers.

Optimal is `A`: the mean variance of the target's position over the region (default), `G`: the largest one in any direction,
or `D`: the uncertainty of the constants. The region is a table of joints or of places of the target, else the `region` of the
campaign, else the whole range of the joints.

Example:
    aridcal design campaign.yaml -n 30 -o poses.csv
    aridcal design campaign.yaml -n 30 -o poses.csv -o poses.script -o poses.html
    aridcal design campaign.yaml -n 30 -o poses.csv --region cell.csv --optimal G
    aridcal design campaign.yaml -n 8 -o poses.csv --apart joint_2.joint_compliance,joint_2.joint_gain
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import get_args

from rich.table import Table
from rich.text import Text

from aridcal.command_line import CommandParser, command, command_parser, for_scripts, screens
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.jobs.plan.discrimination import duel_lines
from aridcal.jobs.plan.pose_design import Plan, PlanRequest, design
from aridcal.jobs.plan.prior_knowledge import beforehand
from aridcal.jobs.plan.row_exchange import Criterion
from aridcal.runs.plan_files import MOST_PLANNED, PLAN_ENDINGS, check_endings, check_outputs, write_plan
from aridcal.system.errors import OutputError
from aridcal.system.progress import Screen, console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.whole_files import claimed

LONGEST_WAIT = 3600.0
"""[s]: a program that waits longer hangs."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("design", __doc__)
    arguments.add_argument("campaign", type=path_argument, help="campaign.yaml")
    arguments.add_argument("-n", type=_count, required=True, help=f"how many configurations, 1 to {MOST_PLANNED}")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, action="append", metavar="FILE",
        help=f"where to write them: {', '.join(PLAN_ENDINGS)}; may be given more than once",
    )  # fmt: skip
    arguments.add_argument(
        "--settle", type=_seconds, default=1.0, metavar="SECONDS", help="what programs wait at each one (default: 1)"
    )
    arguments.add_argument(
        "--region",
        type=path_argument,
        metavar="FILE",
        help="where the target is to be known: rows of joints, or of x y z",
    )
    arguments.add_argument(
        "--apart", type=_pair, default=(), metavar="EFFECT,EFFECT", help="two effects to be told apart, WHERE.KIND each"
    )
    arguments.add_argument(
        "--optimal", choices=get_args(Criterion), help="what is made small (default: A); not with --apart"
    )
    for_scripts(arguments)
    return arguments


def _count(text: str) -> int:
    if not text.isdecimal() or len(text) > len(str(MOST_PLANNED)) or not 1 <= int(text) <= MOST_PLANNED:
        raise argparse.ArgumentTypeError(f"should be a whole number from 1 to {MOST_PLANNED}")
    return int(text)


def _seconds(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= LONGEST_WAIT:
        raise argparse.ArgumentTypeError(f"should be a number of seconds from 0 to {LONGEST_WAIT:g}")
    return value


def _pair(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise argparse.ArgumentTypeError(
            "should be two effects with a comma between, joint_2.joint_gain,joint_3.joint_gain"
        )
    return names


def _main(arguments: argparse.Namespace) -> None:
    out: list[Path] = arguments.out
    if arguments.apart and arguments.optimal:
        raise OutputError(
            "--apart has a criterion of its own, by which two effects are told apart; leave --optimal out"
        )
    check_endings(out)
    with ExitStack() as ends:
        for path in out:
            ends.enter_context(claimed(path, "file"))
        _design(arguments, out)


def _design(arguments: argparse.Namespace, out: list[Path]) -> None:
    campaign = load_campaign(arguments.campaign)
    robot = nominal_robot(campaign)
    check_outputs(campaign, robot, out)
    console, aside = screens(arguments)
    with console_progress(aside) as progress:
        setup = beforehand(campaign, robot, progress)
        request = PlanRequest(arguments.n, arguments.optimal or "A", arguments.region, arguments.apart)
        plan = design(setup, request, progress)
        write_plan(plan, campaign, robot, out, arguments.settle)
    _report(plan, arguments.apart, out, console)
    console.say(*campaign.measurements.table.remarks_on(*out))


def _report(plan: Plan, apart: Sequence[str], out: Sequence[Path], console: Screen) -> None:
    """Print what the plan will tell."""
    console.print(_sigma_table(plan, apart))
    lines = [
        f"{plan.measured} rows so far; {plan.unknowns} unknowns of arm, frames, effects can be identified with the planned ones",
        *([] if apart else [f"RMS of as many random configurations, mm: {_mm(plan.random)}"]),
        "observability " + ", ".join(f"O{k} {value:.3g}" for k, value in enumerate(plan.indices, start=1)),
        *(f"note: {notice}" for notice in plan.notices),
        plan.kept_out,
        *duel_lines(plan.duels),
        *_of_sides(plan),
        f"{', '.join(str(path) for path in out)}: {len(plan.readings)} configurations",
    ]
    console.say(*lines)


def _of_sides(plan: Plan) -> list[str]:
    """From which sides joints come, in words."""
    if not plan.directions:
        return []
    via = int(plan.by_way.sum())
    return [
        f"{', '.join(plan.directions)} come from both sides: {via} points on the way, in programs; a table has the "
        "side in JOINT_direction: copy these columns into the table of what is measured"
    ]


def _sigma_table(plan: Plan, apart: Sequence[str]) -> Table:
    """How well the target is known with more and more of the configurations."""
    of = f"what {' and '.join(apart)} do to the target" if apart else "the target over the region"
    table = Table(title=Text(f"sigma of {of}, predicted"), title_justify="left")
    for column in ("new configurations", "three axes, mm", "worst direction, mm"):
        table.add_column(column, justify="right")
    for sigma in plan.sigma:
        table.add_row(str(sigma.n), _mm(sigma.rms), _mm(sigma.worst))
    return table


def _mm(metres: float) -> str:
    return "not known" if metres != metres else f"{1e3 * metres:.4f}"


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
