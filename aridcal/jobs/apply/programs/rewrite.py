"""Programs corrected: read as a project, corrected, proved, and written all or none."""

from __future__ import annotations

import datetime
import gc
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path

import numpy as np

from aridcal.engine.robot.chain import Robot
from aridcal.jobs.apply.programs.axes import Axes, axes_of
from aridcal.jobs.apply.programs.axis_zeros import cell_zeros, without_mirrored, witnesses, zeros_hint
from aridcal.jobs.apply.programs.cell import Cell
from aridcal.jobs.apply.programs.correct import NO_SUCH_POSTURE, correct, every_position
from aridcal.jobs.apply.programs.corrections import WRITTEN_DIGITS, Corrections, as_table
from aridcal.jobs.apply.programs.frames import read_frames
from aridcal.jobs.apply.programs.language import Language
from aridcal.jobs.apply.programs.languages import language_of
from aridcal.jobs.apply.programs.marks import (
    OUTPUT_HASH,
    SIDE_OF_FOLDER,
    SIDE_TABLE_ENDING,
    mark_of,
    output_hash,
    refuse_corrected,
)
from aridcal.jobs.apply.programs.proof import TextChange, corrected, edit_texts, expected_targets
from aridcal.jobs.apply.programs.read_project import LoadedProject, read_project
from aridcal.jobs.apply.programs.text import Numbers
from aridcal.jobs.calibrate.saved_model import SavedModel, calibration_file
from aridcal.system.errors import CampaignError, MeasurementError, OutputError, printable
from aridcal.system.progress import SILENT, Progress
from aridcal.system.reading.memory_release import give_back
from aridcal.system.reading.regular_files import CALIBRATION, read_file
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.table_writer import write_csv
from aridcal.system.writing.whole_files import atomic_file, atomic_folder, claimed

LONG_PROGRAM = 2_000
"""Work: targets from which what was made of the text is worth looking for: a target takes some kB, and the look 20 ms."""


@dataclass(frozen=True)
class Request:
    """What is to be corrected, and what is known of it.

    Attributes:
        calibration: Path of calibration.yaml, or of its result folder.
        programs: Files, or folders of them.
        out: A file for a single program, a folder for more.
        frames: A file of frames that only the controller has.
        at: What effects depend on while the program runs.
        start: Joints where the program begins, in its units.
        zeros: What the controller shows of each axis where the URDF's joint is at zero, numbers with commas between them, in the
            program's units; None: the campaign's.
        of: The link at the end of the limb that the programs move, of a robot of several; None: of the only one.
    """

    calibration: Path
    programs: tuple[Path, ...]
    out: Path
    frames: Path | None = None
    at: Mapping[str, float] = field(default_factory=dict)
    start: tuple[float, ...] | None = None
    zeros: str | None = None
    of: str | None = None


@dataclass(frozen=True)
class Outputs:
    """Where corrected programs go.

    Attributes:
        files: One for each program, in their order.
        side: The table that says what was done.
        folder: All of them are in it, by their names in the project; None where one file was named.
    """

    files: tuple[Path, ...]
    side: Path
    folder: Path | None


@dataclass(frozen=True)
class Answer:
    """What was done.

    Attributes:
        notes: What was taken for granted.
        corrections: One for each target, without its numbers.
        outputs: Where all was written.
        opened: The project.
        saved: The calibration.
    """

    notes: tuple[str, ...]
    corrections: Corrections
    outputs: Outputs
    opened: LoadedProject
    saved: SavedModel


def correct_programs(request: Request, progress: Progress = SILENT) -> Answer:
    """Correct programs, prove the new texts, and write all of them, or none.

    Args:
        request: What is to be corrected.
        progress: Told what is being done.

    Raises:
        AridcalError: a file cannot be read or written, has no target, or was corrected before.
        Unproved: the new text does not say what was meant: a fault of ours.
    """
    beside = request.out.with_name(f"{request.out.name}{SIDE_TABLE_ENDING}")
    check_apart([request.out, beside], [*request.programs, request.calibration, request.frames])
    loaded = read_project(request.programs, request.out)
    for source in loaded.project.sources:
        if source.ours:
            refuse_corrected(source.path, source.text)
    request = replace(request, calibration=calibration_file(request.calibration))
    outputs = _outputs(request, loaded)
    content = read_file(request.calibration, CampaignError, CALIBRATION)
    saved = _of_limb(SavedModel.load(request.calibration), request.of)
    with ExitStack() as ends:
        if outputs.folder is not None:
            ends.enter_context(claimed(outputs.folder, "folder", [*map(str, loaded.names), SIDE_OF_FOLDER]))
        else:
            ends.enter_context(claimed(outputs.files[0], "file"))
            ends.enter_context(claimed(outputs.side, "file"))
        ends.enter_context(_uncollected())
        notes, corrections, texts = _corrected(request, saved, content, loaded, progress)
        _write(loaded, outputs, texts, corrections)
    return Answer(notes, corrections, outputs, loaded, saved)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Without Python's search for objects that hold each other: a long program has millions, and each search looks at all."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        gc.freeze()
        gc.unfreeze()  # what stays counts as old from here on, so that it is not looked through at once
        if was:
            gc.enable()


def _of_limb(saved: SavedModel, link: str | None) -> SavedModel:
    """The calibration of the arm that a program moves.

    Raises:
        CampaignError: the robot has several limbs, and none is named.
        RobotError: no limb ends at that link.
    """
    robot = saved.final.model.robot
    if link is not None:
        return saved.limb(link)
    if robot.others:
        ends = ", ".join(limb.tip for limb in robot.limbs)
        raise CampaignError(
            f"the calibration is of several limbs ({ends}), and a program moves one: name its end with --of LINK"
        )
    return saved


def _refuse_coupled(robot: Robot) -> None:
    """Refuse an arm whose axes nobody can tell from its readings.

    Raises:
        CampaignError: a joint of it follows several others.
    """
    for joint in robot.joints:
        if len(joint.drive.factors) > 1:
            raise CampaignError(
                f"robot.coupled: joint {joint.name!r} follows {' and '.join(joint.drive.factors)}: which of them a program's "
                "axes are, and where its controller stops them, is not known; give a table of poses to `aridcal compensate`"
            )


def _corrected(
    request: Request, saved: SavedModel, content: bytes, loaded: LoadedProject, progress: Progress
) -> tuple[tuple[str, ...], Corrections, tuple[str, ...]]:
    """What was taken for granted, what becomes of each target, and the proved new text of each file."""
    language, robot = loaded.language, saved.final.model.robot
    if robot.climbs:
        raise CampaignError(
            f"{request.calibration}: joints move the base {robot.base!r}, and a program says where its targets are in a "
            "base that stands still. Calibrate with `robot.base` at the arm's foot"
        )
    _refuse_coupled(robot)
    frames = read_frames(request.frames)
    where, numbers = ("--start", request.start) if request.start is not None else ("--frames: `start`", frames.start)
    axes = axes_of(robot.kinds, cell_zeros(saved, request.zeros, language))
    start = None if numbers is None else _readings(numbers, where, axes, language)
    cell = Cell(robot, frames, axes.zeros, start is not None)
    progress.at("reading the program")
    reading = language.read(loaded.project, cell)
    if not reading.targets:
        names = ", ".join(str(source.path) for source in loaded.project.sources if source.ours)
        raise MeasurementError(f"{names}: no target of {language.name} is in it; is it a program of this maker?")
    progress.at("correcting the program")
    count = len(reading.targets)
    targets = without_mirrored(reading.targets, cell, language.name)
    corrections = correct(saved, targets, request.at, start, lambda done: progress.share(done / count))
    hint = _zeros_hint(corrections, cell, language)
    progress.at("reading the new program")
    marks = _marks(language, loaded, corrections.files(), content)
    new = edit_texts(loaded.project, chain(corrections.changes(), marks))
    expected, notes, corrections = expected_targets(reading.targets), reading.notes, corrections.named(())
    del reading, targets, marks  # a long program has too many to keep them while the new text is read
    if count > LONG_PROGRAM:
        gc.collect()  # of what was made of the text some parts hold each other
        give_back()
    texts = corrected(language, loaded.project, cell, expected, new)
    named = corrections.named([target for part in expected for target in part.named()])
    return (*notes, *([hint] if hint else [])), named, texts


def _zeros_hint(corrections: Corrections, cell: Cell, language: Language) -> str:
    """What the program says against the zeros of its controller; looked for only where postures or limits are contradicted."""
    contradicted = sum(why.endswith(NO_SUCH_POSTURE) for why in corrections.why)
    poses, joints = witnesses(corrections.targets, contradicted, cell)
    positions = [*every_position(cell.robot, poses), *([] for _ in joints)]
    return zeros_hint([*poses, *joints], positions, cell, language.name)


def _marks(
    language: Language, loaded: LoadedProject, files: Collection[int], calibration: bytes
) -> Iterator[TextChange]:
    """A comment in each file that changes."""
    day = datetime.date.today().isoformat()
    for file in files:
        mark = mark_of(language, loaded.project.sources[file].text, calibration, day)
        if mark is not None:
            place, comment = mark
            yield TextChange(file, Numbers([place]), comment)


def _readings(numbers: Sequence[float], where: str, axes: Axes, language: Language) -> np.ndarray:
    """Readings where the program begins, shape (columns,), [rad] or [m]."""
    order = [*axes.arm, *axes.external]
    if len(numbers) != len(order):
        raise CampaignError(f"{where} has {len(numbers)} numbers, the robot {len(order)} axes")
    readings = np.zeros(len(order))
    for value, (unit, k) in zip(numbers, axes.units(order, language.angle, language.length), strict=True):
        readings[k] = unit * (value - axes.zero(k))
    return readings


def _outputs(request: Request, loaded: LoadedProject) -> Outputs:
    """Where the programs of a project are to be written.

    Raises:
        OutputError: a file that is read would be replaced, or would be read as a program next time, or a file was named that
            is none of this language.
    """
    out, language = request.out, loaded.language
    single = len(loaded.names) == 1 and not out.is_dir() and not request.programs[0].is_dir()
    if single and language_of(out) is not language and out.suffix:
        name = loaded.project.sources[0].path.name
        raise OutputError(f"{out}: should end as {name} does: it is {language.name}, too; or be a folder")
    if not single and language_of(out) is not None:
        raise OutputError(f"{out}: should be a folder: {len(loaded.names)} programs are to be written")
    if single and out.suffix:
        outputs = Outputs((out,), out.with_name(f"{out.name}{SIDE_TABLE_ENDING}"), None)
    else:
        _check_outside(out, request.programs)
        outputs = Outputs(tuple(out / name for name in loaded.names), out / SIDE_OF_FOLDER, out)
    inputs = [*(source.path for source in loaded.project.sources), request.calibration, request.frames]
    check_apart([*outputs.files, outputs.side], inputs)
    return outputs


def _check_outside(out: Path, programs: Sequence[Path]) -> None:
    """Make sure that a folder of outputs is neither one of inputs nor inside of it: they would be read as inputs next time."""
    place = out.resolve()
    for path in programs:
        folder = path.resolve() if path.is_dir() else path.resolve().parent
        if place == folder or (path.is_dir() and folder in place.parents):
            raise OutputError(f"{out}: is where the programs are read from; give a folder outside of {folder}")


def _write(loaded: LoadedProject, outputs: Outputs, texts: Sequence[str], corrections: Corrections) -> None:
    """Write the programs and the table beside them, all or none."""
    sources = loaded.project.sources
    hashes = [output_hash(text) if text != source.text else "" for source, text in zip(sources, texts, strict=True)]
    table = as_table(corrections)
    if len(outputs.files) > 1:
        table = {
            "file": np.array([printable(sources[t.file].path.name) for t in corrections.targets], dtype=object)
        } | table
    table[OUTPUT_HASH] = np.array([hashes[target.file] for target in corrections.targets], dtype=object)
    with ExitStack() as ends:
        if outputs.folder is not None:
            built = ends.enter_context(atomic_folder(outputs.folder))
            places = [built / name for name in loaded.names]
            side = built / SIDE_OF_FOLDER
        else:
            places = [ends.enter_context(atomic_file(outputs.files[0]))]
            side = ends.enter_context(atomic_file(outputs.side))
        for place, text in zip(places, texts, strict=False):  # behind the programs are files that are only read
            place.parent.mkdir(parents=True, exist_ok=True)
            place.write_bytes(text.encode("latin-1"))
        write_csv(table, side, WRITTEN_DIGITS)
