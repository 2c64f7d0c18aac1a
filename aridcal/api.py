"""The Python face: plan poses, propose a campaign, calibrate, load.

Example:
    for pose in aridcal.guide("campaign.yaml", tolerance="0.2mm"):
        pose.record(my_robot(pose.joints))
    poses = aridcal.plan("campaign.yaml", 30)
    poses.save("poses.csv", "poses.script", "poses.html")
    campaign = aridcal.propose("robot.urdf", table)
    cal = aridcal.calibrate(campaign)
    poses = cal.predict(queries)
    cal.save("results")
    aridcal.compare("march", "april").causes
    aridcal.fleet("robots/*/campaign.yaml", "fleet").robots
    aridcal.history("fleet").alarms
    aridcal.study("scenario.yaml", "study").cases
    table = aridcal.merge("joints.csv", "tracker.csv", "robot.urdf", "tool0")
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import pandas as pd

from aridcal.calibration import Calibration
from aridcal.engine.robot.chain import Robot
from aridcal.files.campaign import Campaign, load_campaign, nominal_robot
from aridcal.files.measurement_settings import LENGTHS, with_unit
from aridcal.files.tables import AnyTable
from aridcal.jobs.calibrate.pipeline import identify
from aridcal.jobs.calibrate.saved_model import SavedModel
from aridcal.jobs.calibrate.saving import calibration
from aridcal.jobs.fleet.members import members
from aridcal.jobs.fleet.trials import load_study
from aridcal.jobs.plan.pose_design import Plan, PlanRequest, as_table, design
from aridcal.jobs.plan.prior_knowledge import beforehand
from aridcal.jobs.plan.row_exchange import Criterion
from aridcal.jobs.prepare.campaign_text import draft
from aridcal.jobs.prepare.guesses import leave_open
from aridcal.jobs.prepare.other_readings import refuse_misread
from aridcal.runs.calibration_changes import Changes, changes
from aridcal.runs.fleet_history import FleetHistory, over_time
from aridcal.runs.fleet_run import FleetRun, calibrated_fleet, fleet_run
from aridcal.runs.guided_poses import Guided, guided
from aridcal.runs.log_merge import merge
from aridcal.runs.plan_files import MOST_PLANNED, check_endings, check_outputs, write_plan
from aridcal.runs.proposal import print_proposal
from aridcal.runs.study_run import StudyRun, repeated, study_run
from aridcal.system.errors import AridcalError, CampaignError, shortened
from aridcal.system.progress import Progress, Screen, working

__all__ = [
    "AridcalError",
    "Calibration",
    "Campaign",
    "Guided",
    "PlannedPoses",
    "calibrate",
    "compare",
    "fleet",
    "guide",
    "history",
    "load",
    "merge",
    "plan",
    "propose",
    "study",
]


def propose(
    urdf: str | Path,
    measurements: AnyTable | Sequence[AnyTable],
    answers: Mapping[str, int] | None = None,
    *,
    packages: Mapping[str, str | Path] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> Campaign:
    """Propose a campaign by looking at a URDF and at measurements, and print what was found and what was guessed.

    Nothing is written, and nothing is guessed that changes a number: where the data leave such a choice, the error names it
    and its possible answers. ``print(campaign)`` shows the campaign as a file, every choice with its reason.

    Args:
        urdf: The nominal robot: a URDF, a xacro file, or the name of a robot in the cache of robot_descriptions.
        measurements: Measured poses as a DataFrame or the path of a file, or several: any text, .xlsx, .parquet.
        answers: Numbers of answers to questions that were asked before: ``{"units": 2}``.
        packages: Folders of packages of ROS that the URDF names and that are not found by themselves.
        arguments: Of a xacro file.

    Returns:
        The campaign, for :func:`calibrate`.

    Raises:
        AridcalError: what in the tables or the URDF needs mending first.
    """
    tables = [measurements] if isinstance(measurements, str | Path | pd.DataFrame) else list(measurements)
    places = {name: Path(place) for name, place in (packages or {}).items()}
    proposed = draft(Path(urdf), tables, Path.cwd() / "campaign.yaml", leave_open, answers, places, arguments)
    title = ", ".join(file.name for file in proposed.rows.origin.files)
    print_proposal(proposed, title, Screen(force_jupyter=False))
    return proposed.campaign


@dataclass(frozen=True, repr=False, eq=False)
class PlannedPoses:
    """Configurations to measure next.

    Attributes:
        design: The plan behind it, for arrays: readings in [rad] and [m], sigmas, notices.
        campaign: Whose measurements it plans.
        robot: The chain.
    """

    design: Plan
    campaign: Campaign
    robot: Robot

    @property
    def table(self) -> pd.DataFrame:
        """Joints in the campaign's columns and units, in the order of the visits, and what each row measures."""
        return as_table(self.design, self.robot, self.campaign.measurements)

    @property
    def sigma(self) -> pd.DataFrame:
        """Sigma of the target with the best n configurations, for some n: over three axes, and at worst, [mm]."""
        rows = [(s.n, 1e3 * s.rms, 1e3 * s.worst) for s in self.design.sigma]
        return pd.DataFrame(rows, columns=["n", "rms_mm", "worst_mm"])

    def save(self, *paths: str | Path, settle: float = 1.0) -> None:
        """Write the plan, in the form that the ending of each name asks for (see `aridcal design --help`): all files, or none.

        Args:
            paths: Of the files.
            settle: What programs wait at each configuration, [s].

        Raises:
            AridcalError: a file cannot hold a plan or be written, or its language has no such arm.
        """
        out = [Path(path) for path in paths]
        check_endings(out)
        check_outputs(self.campaign, self.robot, out)
        write_plan(self.design, self.campaign, self.robot, out, settle)

    def __repr__(self) -> str:
        return f"{len(self.design.readings)} configurations to measure\n{self.sigma.to_string(index=False)}"


def plan(
    campaign: str | Path | Campaign,
    n: int,
    region: str | Path | None = None,
    apart: Sequence[str] = (),
    optimal: Criterion = "A",
) -> PlannedPoses:
    """Choose configurations to measure next, as `aridcal design` does. Nothing is written.

    Args:
        campaign: ``campaign.yaml``, or a campaign. If its tables are there, new rows add to them.
        n: Number of configurations.
        region: Table of joints, or of x y z of the target, where it is to be known; None: the campaign's own, else anywhere.
        apart: Two effects to be told apart, ``WHERE.KIND`` each.
        optimal: What is made small: ``A``, ``D`` or ``G``; two effects are told apart by the evidence expected instead.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    if not isinstance(n, int | np.integer) or not 1 <= n <= MOST_PLANNED:
        raise AridcalError(f"n: should be a whole number from 1 to {MOST_PLANNED}, not {shortened(repr(n))}")
    if optimal not in get_args(Criterion):
        raise AridcalError(
            f"optimal: should be one of {', '.join(get_args(Criterion))}, not {shortened(repr(optimal))}"
        )
    if apart and (isinstance(apart, str) or len(apart) != 2 or apart[0] == apart[1]):
        raise AridcalError("apart: should be two effects, ('joint_2.joint_gain', 'joint_3.joint_gain') for instance")
    job = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    robot = nominal_robot(job)
    with working() as progress:
        request = PlanRequest(int(n), optimal, None if region is None else Path(region), tuple(apart))
        planned = design(beforehand(job, robot, progress), request, progress)
    return PlannedPoses(planned, job, robot)


def calibrate(campaign: str | Path | Campaign, seed: int = 0) -> Calibration:
    """Identify what is wrong with the robot. Nothing is written; terminals and notebooks show the progress.

    Args:
        campaign: ``campaign.yaml``, or what :func:`propose` gave.
        seed: Of the split into train and test, where the table has none.

    Raises:
        AridcalError: whatever in the input needs mending.
    """
    job = campaign if isinstance(campaign, Campaign) else Path(campaign)
    with working() as progress:
        outcome = identify(job, seed, progress=progress, judge=refuse_misread)
    return Calibration(calibration(outcome), outcome)


def load(path: str | Path) -> Calibration:
    """Read a calibration that was saved.

    Args:
        path: A result folder, or the ``calibration.yaml`` in it.

    Raises:
        AridcalError: it is not there, or not a calibration of this format.
    """
    path = Path(path)
    saved = SavedModel.load(path)
    return Calibration(saved, folder=path if path.is_dir() else path.parent)


def compare(a: str | Path | Calibration, b: str | Path | Calibration) -> Changes:
    """What changed between two calibrations of one robot beyond the uncertainty of both, as `aridcal compare` tells it.

    Args:
        a: The first: a result folder, the ``calibration.yaml`` in it, or a calibration.
        b: The second.

    Raises:
        AridcalError: one is not there, or they are not of one arm.
    """
    first, second = (
        calibration_or_path.model if isinstance(calibration_or_path, Calibration) else calibration_or_path
        for calibration_or_path in (a, b)
    )
    return changes(first, second)


def guide(campaign: str | Path | Campaign, tolerance: str | None = None) -> Guided:
    """Be led while measuring, as `aridcal guide` does: poses one after another, each recorded and judged, until it is enough.

    .. code-block:: python

        guided = aridcal.guide("campaign.yaml", tolerance="0.2mm")
        for pose in guided:
            for alarm in pose.record(my_robot(pose.joints)):  # {"x": …, "y": …, "z": …}
                print(alarm.words, alarm.do)
        cal = aridcal.calibrate(guided.campaign)

    Each row is appended to the campaign's table: whoever begins again goes on where it ends.

    Args:
        campaign: Its table may not be there yet.
        tolerance: When it is enough, ``"0.2mm"``; None: the campaign's own, else when more rows gain nothing.

    Raises:
        AridcalError: the campaign or its table needs mending.
    """
    job = campaign if isinstance(campaign, Campaign) else load_campaign(Path(campaign))
    try:
        limit = None if tolerance is None else with_unit(tolerance, LENGTHS, "0.2mm")
    except ValueError as problem:
        raise CampaignError(f"tolerance: {problem}") from None
    return guided(job, limit)


def history(folder: str | Path, robot: str | None = None) -> FleetHistory:
    """A fleet's calibrations over time: errors, constants, and which of these drift or jump, as `aridcal history` tells it.

    Args:
        folder: What `aridcal fleet` wrote, or a folder above several of them.
        robot: Name of the robot to be shown; None: all.

    Raises:
        AridcalError: there are no runs, none of this robot, or DuckDB is not installed.
    """
    return over_time(folder, robot)


def fleet(
    campaigns: str | Path | Sequence[str | Path],
    out: str | Path,
    scheduler: str | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> FleetRun:
    """Calibrate many robots, as `aridcal fleet` does: into one folder, without those that are there already.

    Robots that fail raise nothing: they are in ``failed`` with their reasons, and cost no other.

    Args:
        campaigns: Patterns or paths of campaigns, one or several: ``robots/*/campaign.yaml``. A robot is called as its folder.
        out: Folder of all results.
        scheduler: Address of a Dask cluster, ``tcp://10.0.0.1:8786``; None: processes of this computer.
        progress: Told of each step, ``print`` for instance; None: terminals and notebooks show it.

    Raises:
        AridcalError: no campaign fits, the folder cannot be used, or Dask is not installed.
    """
    patterns = [campaigns] if isinstance(campaigns, str | Path) else list(campaigns)
    robots = members([str(pattern) for pattern in patterns], Path(out))
    with working() if progress is None else nullcontext(Progress(progress)) as steps:
        ran = calibrated_fleet(robots, Path(out), scheduler, steps)
    return fleet_run(ran, Path(out))


def study(
    path: str | Path,
    out: str | Path,
    scheduler: str | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> StudyRun:
    """Repeat a simulation, or a calibration from halves of its rows, as `aridcal study` does; runs that are there are kept.

    Args:
        path: Of a scenario or a campaign with a block ``study``.
        out: Folder of table and page.
        scheduler: Address of a Dask cluster; None: processes of this computer.
        progress: Told of each step, ``print`` for instance; None: terminals and notebooks show it.

    Raises:
        AridcalError: what is studied needs mending, the folder cannot be used, or Dask is not installed.
    """
    job = load_study(Path(path))
    with working() if progress is None else nullcontext(Progress(progress)) as steps:
        results = repeated(job, Path(out), scheduler, steps)
    return study_run(results, Path(out))
