"""Calibrate a robot: from a campaign to the calibrated URDF, the whole model, a report and a 3D scene.

With --tolerance, or `tolerance:` in the campaign, it is said whether the target is within it in 95 % of the campaign's `region:`
(of the range that was measured, where it names none), with 95 % confidence: by the calibration's own uncertainty, and by what
held-out rows leave beyond it and beyond the instrument's declared noise. All files are written in either case.

Where rows are too few to judge the model by (verdict not_enough_data), the screen and the report begin with that: not for a
controller. No tolerance is kept then.

With --verify, a table of another day has a verdict of its own: agrees, remounted (target or instrument stand elsewhere: fit the
frames anew), or changed (the robot itself: measure it again).

Exit status: 0 done, 3 not within the tolerance, or not what another day's table says.

Example:
    aridcal identify identification/arid/campaign.yaml
    aridcal identify campaign.yaml --verify another_day.csv
    aridcal identify campaign.yaml --tolerance 0.2mm
    aridcal identify campaign.yaml --json | jq .error.final
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rich.console import Console
from rich.table import Table

from aridcal.command_line import (
    DONE,
    NOT_GOOD,
    CommandParser,
    command,
    command_parser,
    for_scripts,
    print_headline,
    screens,
    seed_argument,
)
from aridcal.files.campaign import load_campaign
from aridcal.files.measurement_settings import length_argument
from aridcal.jobs.calibrate.job_inputs import read_job
from aridcal.jobs.fleet.keys import files_of
from aridcal.jobs.head1992.observations import CACHE
from aridcal.runs.result_folder import RESULT_FILES, RESULT_FOLDERS, write_folder
from aridcal.system.errors import OutputError, shortened
from aridcal.system.progress import console_progress
from aridcal.system.reading.memory_release import frozen_garbage
from aridcal.system.reading.regular_files import RESULT, read_file
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import claimed

if TYPE_CHECKING:
    from aridcal.engine.trust.gains import NamedEffect
    from aridcal.jobs.calibrate.controllers import ControllerExports
    from aridcal.jobs.calibrate.outcome import Outcome, Verification

MOST_NOTICES = 8

SHOWN_STATISTICS = ("rms", "p95", "max")
"""Statistics of an error on the screen; of all channels but the first only two, so that the table keeps its width."""

STATISTIC_HEADINGS = {"rms": "RMS", "p95": "p95", "max": "max"}


def summary(outcome: Outcome, console: Console) -> None:
    """Print the figures that matter."""
    from aridcal.jobs.calibrate.folder import step_in_words
    from aridcal.jobs.calibrate.key_figures import every_held_out_row, over_time, verification_agreement
    from aridcal.jobs.calibrate.verdict import VERDICTS
    from aridcal.pages.drawing.words import (
        NOT_FOR_A_CONTROLLER,
        noise_unknown_in_words,
        scale_in_words,
        tolerance_in_words,
    )

    if not outcome.verdict.for_controller:
        console.print(NOT_FOR_A_CONTROLLER, markup=False, style="bold red")
    console.print(_error_table(outcome))
    if outcome.parts()["test_all"].any():
        console.print(every_held_out_row(outcome), markup=False)
    if over_time(outcome):
        console.print(over_time(outcome), markup=False)
    for effect in outcome.effects:
        moved = step_in_words(effect.effect, outcome.measurements)
        console.print(_effect_line(outcome, effect) + (f": {moved}" if moved else ""), markup=False)
    if outcome.diagnosis is not None and outcome.diagnosis.tested:
        console.print(f"{outcome.diagnosis.tested:,} candidates tested", markup=False)
    verified = verification_agreement(outcome)
    if outcome.verification is not None and verified is not None:
        for line in _verification_lines(outcome.verification):
            console.print(line, markup=False)
        console.print(verified[1], markup=False)
        console.print(f"verdict on {shortened(outcome.verification.file)}: {verified[0]}", markup=False)
    console.print(_noise_line(outcome), markup=False)
    for line in scale_in_words(outcome):
        console.print(line, markup=False)
    for _, sentence in (*tolerance_in_words(outcome, asked=True), *tolerance_in_words(outcome, asked=False)):
        console.print(sentence, markup=False)
    verdict = outcome.verdict
    if verdict.noise_unknown:
        console.print(f"verdict: {verdict.word}: {noise_unknown_in_words(outcome)}", markup=False)
        console.print("  declare `noise` in the campaign, or measure some configurations twice", markup=False)
    else:
        console.print(f"verdict: {verdict.word}: {VERDICTS[verdict.word].line}", markup=False)
        for reason in verdict.reasons:
            console.print(f"  {reason}", markup=False)
    for notice in outcome.notices[:MOST_NOTICES]:
        console.print(f"note: {notice}", markup=False)


def _error_table(outcome: Outcome) -> Table:
    """Errors of every stage on the rows that judge the calibration."""
    from aridcal.jobs.calibrate.key_figures import judged_channels, scored
    from aridcal.jobs.calibrate.outcome import errors

    mask, rows = scored(outcome)
    table = Table(title=f"error on {mask.sum()} {rows}, the instrument's noise included", title_justify="left")
    table.add_column("model", no_wrap=True)
    first, *others = (outcome.channels[k] for k in judged_channels(outcome))
    columns = [(first, key) for key in SHOWN_STATISTICS] + [
        (channel, key) for channel in others for key in SHOWN_STATISTICS[:2]
    ]
    several = len(outcome.measurements.blocks) > 1
    for channel, key in columns:
        whose = f"{channel.name} " if several else ""
        table.add_column(f"{whose}{STATISTIC_HEADINGS[key]}, {channel.shown}", justify="right")
    for stage in outcome.stages:
        figures = errors(stage.residual, mask, outcome.channels)
        table.add_row(stage.name, *(f"{figures[channel.key][key]:.3f}" for channel, key in columns))
    return table


def _effect_line(outcome: Outcome, effect: NamedEffect) -> str:
    """A line on an effect: others that would do as well in its place, and its gain on the held-out rows, if there are any."""
    from aridcal.jobs.calibrate.key_figures import or_as_well
    from aridcal.jobs.calibrate.outcome import rms_in_words

    source = "declared" if effect.declared else "found"
    gain = ""
    if len(effect.before):
        all_rows = np.ones(len(effect.before), dtype=bool)
        without, with_it = (rms_in_words(r, all_rows, outcome.measurements) for r in (effect.before, effect.after))
        gain = f": {without} without it, {with_it} with it"
    return f"{source}: {effect.effect.label} [{', '.join(effect.effect.motion)}]{or_as_well(effect)}{gain}"


def _noise_line(outcome: Outcome) -> str:
    """A line on the noise that is left, and its sources beyond the instrument."""
    from aridcal.pages.drawing.words import causes_in_words, noise_in_words

    causes = causes_in_words(outcome)
    return f"noise: {noise_in_words(outcome, outcome.scatter)}{'. ' if causes else ''}{causes}"


def _verification_lines(v: Verification) -> list[str]:
    """Lines on the errors on another day's data."""
    from aridcal.jobs.calibrate.outcome import rms_in_words

    sound = ~v.outlier
    figures = ", ".join(f"{name} {rms_in_words(r, sound, v.measurements)}" for name, r in v.residuals.items())
    gross = f" ({v.outlier.sum()} gross outliers excluded)" if v.outlier.any() else ""
    lines = [f"note: {v.left_out}"] if v.left_out else []
    lines.append(f"verification on {v.file}, {sound.sum()} rows{gross}: {figures}")
    if v.realigned is not None:
        lines.append(f"  with both frames refitted: {rms_in_words(v.realigned, sound, v.measurements)}")
    return lines


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("identify", __doc__)
    arguments.add_argument("campaign", type=path_argument, help="campaign.yaml")
    arguments.add_argument(
        "-o", "--out", type=path_argument, help="result folder (default: results/ beside the campaign)"
    )
    arguments.add_argument(
        "--verify", type=path_argument, metavar="CSV", help="measurements of another day, to check the result on"
    )
    arguments.add_argument(
        "--tolerance",
        type=length_argument,
        metavar="LENGTH",
        help="how far the target may be off in 95 %% of the campaign's region, 0.2mm for instance; exit status 3 if it cannot "
        "be said, with 95 %% confidence, that it is not",
    )
    arguments.add_argument(
        "--seed",
        type=seed_argument,
        default=0,
        help="seed of the random split into fitted and held-out rows, where the table has no column `split`",
    )
    for_scripts(arguments, headline=True)
    return arguments


def _main(arguments: argparse.Namespace) -> int:
    out = arguments.out or arguments.campaign.parent / "results"
    with claimed(out, "folder", RESULT_FILES, RESULT_FOLDERS):
        return _identify(arguments, out)


def _identify(arguments: argparse.Namespace, out: Path) -> int:
    console, aside = screens(arguments)
    with console_progress(aside) as progress:
        campaign = load_campaign(arguments.campaign)
        if arguments.tolerance is not None:
            campaign = campaign.with_tolerance(arguments.tolerance)
        inputs = (campaign.path, arguments.verify, *(file for _, file in files_of(campaign)))
        check_apart((out / name for name in RESULT_FILES), inputs)
        job = read_job(campaign, arguments.seed, progress, out / CACHE, arguments.verify is not None)
        # Loaded only now, here and above: what fits, searches and draws takes longer to load than a slip in a table to be found.
        from aridcal.jobs.calibrate.hand_eye_files import FOLDER
        from aridcal.jobs.calibrate.pipeline import identify
        from aridcal.jobs.prepare.other_readings import refuse_misread

        with frozen_garbage():
            outcome = identify(job, verify=arguments.verify, progress=progress, judge=refuse_misread)
            written = write_folder(outcome, out, progress)
    summary(outcome, console)
    handover = written.handover
    console.print(
        f"exports for controllers, {handover.channel.name} RMS on {handover.rows}:\n  {handover.summary()}",
        soft_wrap=True,
        markup=False,
    )
    for camera in () if handover.hand_eye is None else handover.hand_eye.places:
        console.print(f"camera {camera.name} on {camera.parent}: {camera.in_words}", soft_wrap=True, markup=False)
    for notice in written.notices[:MOST_NOTICES]:
        console.print(f"note: {notice}", markup=False, soft_wrap=True)
    if len(written.notices) > MOST_NOTICES:
        console.print(f"note: and {len(written.notices) - MOST_NOTICES} more, in the pages themselves", markup=False)
    console.say(f"report: {out / 'report.html'}")
    if (out / "certificate.pdf").is_file():
        console.say(f"certificate: {out / 'certificate.pdf'}")
    if handover.hand_eye is not None:
        console.say(f"cameras, to paste: {out / FOLDER}")
    console.say(*_next(out, outcome, handover))
    print_headline(arguments, _headline(out, outcome))
    return DONE if _good(outcome) else NOT_GOOD


def _good(outcome: Outcome) -> bool:
    """False where another day disagrees, a tolerance is not kept, or nobody can say so as there are too few data."""
    from aridcal.jobs.calibrate.key_figures import verification_agreement  # as above

    day = verification_agreement(outcome)
    if day is not None and day[0] != "agrees":
        return False
    if outcome.campaign.tolerance is not None and not outcome.verdict.for_controller:
        return False
    return outcome.certainty is None or outcome.certainty.within


def _next(out: Path, outcome: Outcome, handover: ControllerExports) -> list[str]:
    """The way to the controller, if there is one."""
    from aridcal.pages.drawing.words import next_command  # as above

    following = next_command(outcome, handover, str(out))
    if not following:
        return []
    return [
        f"next: {following}",
        "      docs/apply/index.md has a page for each controller: what it takes, and how to undo it",
    ]


def _headline(out: Path, outcome: Outcome) -> dict[str, Any]:
    """What `--json` prints: keys of `result.json`, the error on the rows that judge, and where the pages are."""
    from aridcal.jobs.calibrate.key_figures import scored, verification_agreement  # as above

    document = json.loads(read_file(out / "result.json", OutputError, RESULT))
    scored_rows, rows = scored(outcome)
    part = next(name for name, mask in outcome.parts().items() if np.array_equal(mask, scored_rows))
    keys = ("verdict", "reasons", "effects", "workspace", "notices")
    day = verification_agreement(outcome)
    return {
        "format": document["format"],
        "rows": f"{scored_rows.sum()} {rows}",
        "error": {stage: parts[part] for stage, parts in document["error"].items()},
        **{key: document[key] for key in keys if key in document},
        **({} if day is None else {"another_day": day[0]}),
        **{page: str(out / page) for page in ("report.html", "certificate.pdf") if (out / page).is_file()},
    }


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
