"""Choose configurations to measure: those that make the target best known where it is to work.

With tables already measured, the new rows add to what these tell. A campaign whose tables are not there yet is planned from
nothing: the kind of measurement, its noise, and frames and instruments as hints. Joints stay inside their limits. The arm, as
lines from joint to joint and to the target and with the URDF's collision shapes, keeps out of itself and of the boxes of the
campaign's `design: {keep_out: [{min: [x, y, z], max: [x, y, z]}]}` (base frame, m). The ways between are not looked at.
The table has the joints in the campaign's columns and units, in an order that shortens the way, and what each row measures:
which point, anchor, plane, camera or target.

Optimal is `A`: the mean variance of the target's position over the region (default), `G`: the largest one in any direction,
or `D`: the uncertainty of the constants. The region is the whole range of the joints, or a table of joints or of places
of the target.

Example:
    aridcal design campaign.yaml -n 30 -o poses.csv
    aridcal design campaign.yaml -n 30 -o poses.csv --region cell.csv --optimal G
    aridcal design campaign.yaml -n 8 -o poses.csv --apart joint_2.joint_compliance,joint_2.joint_gain
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import get_args

from rich.console import Console
from rich.table import Table
from rich.text import Text

from aridcal.command_line import CommandParser, command_parser, run
from aridcal.errors import OutputError
from aridcal.inputs.campaign import load_campaign
from aridcal.planning.beforehand import beforehand
from aridcal.planning.design import Asked, Plan, as_table, design
from aridcal.planning.exchange import Criterion
from aridcal.reading.names import path_argument
from aridcal.result.predict import ENDINGS, write_table
from aridcal.robot.chain import load_robot
from aridcal.showing import told_on
from aridcal.writing.files import atomic_file, check_home, claimed

MOST = 500
"""Configurations of one plan: choosing more would take minutes, and chance does as well by then."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("design", __doc__)
    arguments.add_argument("campaign", type=path_argument, help="campaign.yaml")
    arguments.add_argument("-n", type=_count, required=True, help=f"how many configurations, 1 to {MOST}")
    arguments.add_argument(
        "-o", "--out", type=path_argument, required=True, help="where to write them, .csv or .parquet"
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
        "--optimal", choices=get_args(Criterion), default="A", help="what is made small (default: A)"
    )
    return arguments


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    arguments = parser().parse_args(argv)
    return run(lambda: _main(arguments))


def _count(text: str) -> int:
    if not text.isdecimal() or len(text) > len(str(MOST)) or not 1 <= int(text) <= MOST:
        raise argparse.ArgumentTypeError(f"should be a whole number from 1 to {MOST}")
    return int(text)


def _pair(text: str) -> tuple[str, ...]:
    names = tuple(name.strip() for name in text.split(","))
    if len(names) != 2 or not all(names) or names[0] == names[1]:
        raise argparse.ArgumentTypeError(
            "should be two effects with a comma between, joint_2.joint_gain,joint_3.joint_gain"
        )
    return names


def _main(arguments: argparse.Namespace) -> None:
    if arguments.out.suffix.lower() not in ENDINGS:
        raise OutputError(f"{arguments.out}: should be a .csv or .parquet file")
    check_home(arguments.out)
    with claimed(arguments.out, "file"):
        _design(arguments)


def _design(arguments: argparse.Namespace) -> None:
    campaign = load_campaign(arguments.campaign)
    tables = [path.resolve() for block in campaign.blocks for path in block.files]
    if arguments.out.resolve() in tables:
        raise OutputError(
            f"{arguments.out}: is a table of measurements of {arguments.campaign}; write the plan to another file"
        )
    robot = load_robot(campaign.robot.urdf, campaign.robot.tip, campaign.robot.base, campaign.limits.urdf)
    with atomic_file(arguments.out) as path, told_on(Console(stderr=True)) as progress:
        known = beforehand(campaign, robot, progress)
        asked = Asked(arguments.n, arguments.optimal, arguments.region, arguments.apart)
        plan = design(known, asked, progress)
        write_table(as_table(plan, robot, campaign.measurements), path)
    _report(plan, arguments.apart, arguments.out)


def _report(plan: Plan, apart: Sequence[str], out: Path) -> None:
    """Print what the plan will tell."""
    console = Console()
    console.print(_sigma_table(plan, apart))
    lines = [
        f"{plan.measured} rows so far; {plan.unknowns} unknowns of arm and frames can be identified with the planned ones",
        f"RMS of as many random configurations, mm: {_mm(plan.random)}",
        "observability " + ", ".join(f"O{k} {value:.3g}" for k, value in enumerate(plan.indices, start=1)),
        *(f"note: {notice}" for notice in plan.notices),
        f"{out}: {len(plan.readings)} configurations",
    ]
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)


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


if __name__ == "__main__":
    sys.exit(main())
