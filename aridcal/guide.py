"""Be led while measuring: each row is judged as it comes, and the next pose, and the end, are told.

The campaign's table is followed while any program appends to it; it may not be there yet. After each row stands whether it is
good beside all before it, how well the target is known by now, and which pose to measure next: inside the limits, clear of the
mounting plane, of `design: {keep_out: …}` and of the arm itself, on a straight way of the joints from the last one. It ends when
the target is within --tolerance in 95 % of the region with 95 % confidence, or when more rows gain nothing; then follow the full
search and its report.

Lines on standard input: `reject` asks for another pose, `stop` ends it; all others are rows, appended to the table. --json
prints one event a line (docs/guide.md). The page shows the same in large figures, to this computer only; over ssh, forward its
port.

Example:
    aridcal guide campaign.yaml --tolerance 0.2mm
    aridcal guide campaign.yaml --json < rows_of_my_driver
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

from rich.text import Text

from aridcal.command_line import CommandParser, command, command_parser
from aridcal.files.campaign import load_campaign, nominal_robot
from aridcal.files.measurement_settings import length_argument
from aridcal.jobs.fleet.keys import files_of
from aridcal.jobs.guide.events import Alarm, Event, Known, Next, RowRead
from aridcal.jobs.guide.session import Session, session
from aridcal.runs.guide_server import Board, GuideServer
from aridcal.runs.guided_campaign import Incoming, calibrated, followed
from aridcal.runs.local_pages import show
from aridcal.runs.result_folder import RESULT_FILES, RESULT_FOLDERS
from aridcal.system.errors import AridcalError
from aridcal.system.progress import Screen, console_progress
from aridcal.system.reading.user_names import path_argument
from aridcal.system.writing.separate_paths import check_apart
from aridcal.system.writing.whole_files import claimed

LAST_LOOK = 1.0
"""[s] after which an open page has seen the end: it asks three times in that."""


def parser() -> CommandParser:
    """The command's arguments."""
    arguments = command_parser("guide", __doc__)
    arguments.add_argument("campaign", type=path_argument, help="campaign.yaml; its table may not be there yet")
    arguments.add_argument(
        "--tolerance",
        type=length_argument,
        metavar="LENGTH",
        help="when it is enough: 0.2mm for instance (default: the campaign's `tolerance`, else when more rows gain nothing)",
    )
    arguments.add_argument(
        "-o",
        "--out",
        type=path_argument,
        metavar="DIR",
        help="folder of the report at the end (default: results/ beside the campaign)",
    )
    arguments.add_argument(
        "--json", action="store_true", help="print events as JSON, one a line, and no words, to stdout"
    )
    arguments.add_argument(
        "--page", action=argparse.BooleanOptionalAction, default=True, help="show a page in the browser (default: yes)"
    )
    return arguments


def _main(arguments: argparse.Namespace) -> None:
    campaign = load_campaign(arguments.campaign)
    tolerance = arguments.tolerance or (campaign.tolerance.position if campaign.tolerance else None)
    if arguments.tolerance is not None:
        campaign = campaign.with_tolerance(arguments.tolerance)
    out: Path = arguments.out or arguments.campaign.parent / "results"
    # Before half a day of measuring, not after it.
    check_apart((out / name for name in RESULT_FILES), (campaign.path, *(file for _, file in files_of(campaign))))
    with claimed(out, "folder", RESULT_FILES, RESULT_FOLDERS):
        _lead(arguments, session(campaign, nominal_robot(campaign), tolerance), out)


def _lead(arguments: argparse.Namespace, now: Session, out: Path) -> None:
    """Follow the table to the end, then make the report."""
    campaign = now.campaign
    incoming = Incoming()
    incoming.listen(sys.stdin)
    screen, aside = Screen(), Screen(stderr=True)
    (table,) = campaign.measurements.files
    board = Board(campaign.path.parent.resolve().name, now.tolerance, str(table), now.units, now.measured, now.subject)
    board.note([])
    if arguments.page:
        server = GuideServer(board, incoming)
        aside.say(f"{server.url}  (shows the same)")
        show(server.url)
    if not arguments.json:
        screen.say(f"follows {table}; `reject` or `stop` and Enter, or Ctrl-C")
    for events in followed(now, incoming):
        board.note(events)
        for event in events:
            if arguments.json:
                print(json.dumps(event.document(), allow_nan=False), flush=True)
            else:
                screen.print(in_words(event, now.measured), soft_wrap=True)
    report = _finish(now, out, aside)
    if arguments.page:
        board.note([], report)
        time.sleep(LAST_LOOK)


def in_words(event: Event, measured: str = "rows") -> Text:
    """An event as a line for the terminal; ``measured`` is what is counted."""
    match event:
        case RowRead(row, ok, reasons):
            return (
                Text(f"row {row}: good")
                if ok and not reasons
                else Text(f"row {row}: {'good' if ok else 'NOT USED'}, {'; '.join(reasons)}")
            )
        case Alarm(row, what, words, do):
            return Text(f"  {what.upper()}: {words}\n  do: {do}", style="bold")
        case Known():
            more = "" if event.more is None else f", about {event.more} more for the tolerance"
            turn = f", {1e3 * event.rotation:.3g} mrad" if event.rotation < float("inf") else ""
            return Text(f"  {event.rows} {measured}: within {1e3 * event.position:.3g} mm{turn}{more}")
        case Next():
            joints = ", ".join(f"{name} {value:g}" for name, value in {**event.joints}.items())
            measure = "".join(f", {name} {label}" for name, label in event.labels.items())
            return Text(f"  next: {joints}{measure}\n        {event.why}")
    lines = [f"stop, {event.why}: {event.words}", "check the result with these poses (`aridcal check`):"]
    lines += ["  " + ", ".join(f"{name} {value:g}" for name, value in pose.items()) for pose in event.check]
    return Text("\n".join(lines))


def _finish(now: Session, out: Path, aside: Screen) -> str:
    """The full search and its report; returns where that is, or why there is none."""
    if now.posterior is None:
        words = "no report: too few rows to calibrate from"
    else:
        with console_progress(aside) as progress:
            try:
                calibrated(now, out, progress)
                words = f"report: {out / 'report.html'}"
            except AridcalError as error:
                words = f"no report: {error}"
    aside.say(words)
    return words


main = command(parser, _main)

if __name__ == "__main__":
    sys.exit(main())
