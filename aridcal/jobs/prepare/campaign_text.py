"""A proposal written as campaign.yaml, every choice with its reason."""

from __future__ import annotations

import itertools
import os
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pandas as pd
import yaml

from aridcal.engine.robot.described_robots import RobotDescription, robot_description
from aridcal.engine.robot.expand import plain_name, read_urdf
from aridcal.engine.robot.mjcf import as_urdf
from aridcal.engine.rows.dataset import Dataset
from aridcal.files.campaign import Campaign
from aridcal.files.read import load_measurements
from aridcal.files.tables import AnyTable, read_tables
from aridcal.files.yaml_file import parse_settings
from aridcal.jobs.prepare.alternative_reading import mended
from aridcal.jobs.prepare.camera_side import best_side
from aridcal.jobs.prepare.campaign_proposal import QUESTIONS, propose
from aridcal.jobs.prepare.guesses import Choose, Chooser, Guess, Proposal
from aridcal.jobs.prepare.table_formats import best_dialect, dialects_of, say_table
from aridcal.system.errors import MeasurementError
from aridcal.system.reading.dialect import Dialect
from aridcal.system.reading.regular_files import URDF

# Of a line with a comment.
COMMENT_WIDTH = 116
# So wide that YAML breaks no value.
LONGEST_YAML_LINE = 10_000
CAMPAIGN_HEAD = """\
# Proposed by `aridcal init`. What was guessed says so: read it once. All keys: docs/formats.md.
format: 1
"""


@dataclass(frozen=True)
class Draft:
    """A campaign that was proposed, tried once.

    Attributes:
        campaign: As it will be read; its text says of every choice why. DataFrames stay with it.
        proposal: What it rests on.
        rows: The measurements as it reads them.
    """

    campaign: Campaign
    proposal: Proposal
    rows: Dataset


def draft(
    urdf: Path,
    tables: Sequence[AnyTable],
    out: Path,
    choose: Choose,
    settled: Mapping[str, int] | None = None,
    packages: Mapping[str, Path] | None = None,
    arguments: Mapping[str, str] | None = None,
) -> Draft:
    """Propose a campaign and try it: what comes back can be identified as it stands.

    Args:
        urdf: The robot: a URDF, a xacro file, or a name that robot_descriptions knows.
        tables: Its measurements.
        out: Where the campaign will be.
        choose: Asked where the evidence does not decide.
        settled: Numbers of answers that were given beforehand, by the key of the question.
        packages: Folders of packages of ROS that the robot's file names.
        arguments: Of a xacro file.

    Raises:
        AridcalError: what in the files needs mending first; or what is to be answered.
    """
    asker = Chooser(choose, settled or {})
    asker.check(QUESTIONS)
    source = robot_description(urdf, packages or {}, arguments or {})
    content = as_urdf(read_urdf(source.path, URDF, source.packages, source.arguments), source.path)

    def proposed(dialect: Dialect, asker: Chooser) -> Proposal:
        table = read_tables(tables, None, dialect=dialect)
        try:
            return propose(
                content, plain_name(source.path), table, asker, dialect.dates.name if dialect.dates else None
            )
        except MeasurementError:
            read_tables(tables, dialect=dialect)  # what lacks may be in some of the files: then that is the fault
            raise

    dialects, maker = dialects_of(tables, asker)
    dialect, why = best_dialect(dialects, proposed, asker)
    proposal = proposed(dialect, asker)
    say_table(dialect, tables, maker, why, proposal)
    proposal.guesses = [
        replace(guess, value=_with_relative_paths(guess.value, out.parent)) for guess in proposal.guesses
    ]

    def tried(proposal: Proposal) -> tuple[Campaign, Dataset]:
        campaign = parse_settings(campaign_text(proposal, source, tables, out.parent), out, Campaign)
        if any(isinstance(table, pd.DataFrame) for table in tables):
            campaign = campaign.with_tables(tables)
        robot = proposal.robot
        return campaign, load_measurements(campaign, robot.readings, robot.limits, robot.kinds, robot=robot)

    proposal = best_side(proposal, tried)
    campaign, rows = tried(proposal)
    chosen = mended(proposal, campaign, rows, asker)
    if chosen is not proposal:
        proposal = chosen
        campaign, rows = tried(proposal)
    return Draft(campaign, proposal, rows)


def campaign_text(proposal: Proposal, source: RobotDescription, tables: Sequence[AnyTable], home: Path) -> str:
    """Write a proposal as ``campaign.yaml``, every choice with its reason above it.

    Args:
        proposal: What was found.
        source: The robot.
        tables: The measurements.
        home: Folder of the campaign; paths are relative to it.
    """
    parts: dict[str, list[Guess]] = {}
    for guess in proposal.guesses:
        section, _, _ = guess.key.rpartition(".")
        parts.setdefault(section, []).append(guess)
    columns = [guess for guess in parts["measurements.columns"] if guess.value is not None or not guess.sure]
    renamed = any(guess.value is not None for guess in columns)
    lines = [
        f"{CAMPAIGN_HEAD}robot:",
        *_source(source, home),
        *_mapping(parts["robot"], "  "),
        "measurements:",
        *_files(tables, home),
        *_mapping([*parts.get("", []), *parts["measurements"]], "  "),
        *(["  columns:"] if renamed else []),
        *_mapping(columns, "    "),
    ]
    if "frames" in parts:
        lines += ["frames:", *_mapping(parts["frames"], "  ")]
    if "instruments" in parts:
        lines += ["instruments:", *_mapping(parts["instruments"], "  ")]
    return "\n".join(lines) + "\n"


def _source(source: RobotDescription, home: Path) -> list[str]:
    """The lines that name the robot's description; what lies in a cache is not named by its way from the campaign."""
    shown = str if source.cached else lambda path: _relative(path, home)
    lines = [f"  urdf: {scalar(shown(source.path))}"]
    if source.packages:
        lines.append(f"  packages: {scalar({name: shown(place) for name, place in source.packages.items()})}")
    if source.arguments:
        lines.append(f"  arguments: {scalar(dict(source.arguments))}")
    return lines


def _files(tables: Sequence[AnyTable], home: Path) -> list[str]:
    """The line that names the tables; a DataFrame gets a name under which it may be saved."""
    names, lines = [], []
    for number, table in enumerate(tables):
        if isinstance(table, pd.DataFrame):
            names.append("measurements.csv" if len(tables) == 1 else f"measurements_{number + 1}.csv")
            lines.append(f"  # {names[-1]} is a DataFrame: `df.to_csv({names[-1]!r}, index=False)` saves it")
        else:
            names.append(_relative(Path(table), home))
    return [*lines, f"  file: {scalar(names[0] if len(names) == 1 else names)}"]


def _mapping(guesses: Sequence[Guess], indent: str) -> list[str]:
    """Lines of a mapping; guesses with one reason share its comment."""
    lines = []
    for (why, sure), group in itertools.groupby(guesses, key=lambda guess: (guess.why, guess.sure)):
        entries = list(group)
        # A default has no line of its own: then the comment says what it is about.
        about = "" if entries[0].value is not None else f"{entries[0].name}: "
        comment = f"{'' if sure else 'GUESSED: '}{about}{why}"
        lines += textwrap.wrap(comment, COMMENT_WIDTH, initial_indent=f"{indent}# ", subsequent_indent=f"{indent}#   ")
        values = [guess for guess in entries if guess.value is not None]
        lines += [f"{indent}{scalar(guess.name)}: {scalar(guess.value)}" for guess in values]
    return lines


def scalar(value: Any) -> str:
    """A value on one line of YAML, quoted where it must be."""
    text = yaml.safe_dump(value, default_flow_style=True, width=LONGEST_YAML_LINE, allow_unicode=True)
    return text.removesuffix("...\n").strip()


def _with_relative_paths(value: Any, home: Path) -> Any:
    """A value whose files are named as seen from the campaign."""
    if isinstance(value, dict):
        return {key: _with_relative_paths(entry, home) for key, entry in value.items()}
    return _relative(value, home) if isinstance(value, Path) else value


def _relative(path: Path, home: Path) -> str:
    return Path(os.path.relpath(path, home)).as_posix()
