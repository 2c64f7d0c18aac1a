"""What every instruction of a TP program does, after the operator's manual of HandlingTool (B-83284EN) and of the options.

Instructions are compared as :func:`aridcal.jobs.apply.programs.fanuc.listing.plain` writes them: capitals, no names in
brackets, a blank only between two words. What matches no row is unknown: all that it may have changed is unknown behind it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

INDEX = r"(?:[^\[\]]|\[[^\[\]]*\])*"
"""What stands in brackets: a number, or another register."""

VALUE = rf"(?:[-+]?[\d.]+|(?:L?R|AR)\[{INDEX}\])"

HARMLESS = (
    # registers, signals and timers
    rf"(?:L?R|L?SR|AR|PL)\[{INDEX}\]=.+",
    rf"(?:DO|RO|GO|AO|SO|UO|SDO|WO|WSO|F|LF|M)\[{INDEX}\]=.+",
    rf"(?:TIMER|RSR|SEMAPHORE)\[{INDEX}\]=.+",
    # waits that only wait, stops and messages
    r"WAIT\b(?:(?!TIMEOUT).)*",
    r"PAUSE",
    rf"UALM\[{INDEX}\]",
    r"MESSAGE\[.*\]",
    r"SKIP CONDITION\b.+",
    rf"DIAG_REC\[{INDEX}\]",
    # speeds, loads and guards
    r"OVERRIDE=.+",
    rf"(?:JOINT|LINEAR)_MAX_SPEED(?:\[{INDEX}\])?=.+",
    rf"PAYLOAD\[{INDEX}\]",
    r"COL (?:DETECT (?:ON|OFF)|GUARD (?:ADJUST|STICK)\b.*)",
    rf"TORQ_LIMIT {VALUE}%",
    r"TC_ONLINE(?:\(.*\)| ENABLE| DISABLE)",  # the condition on which the arm may move
    r"(?:UN)?LOCK [PV]REG",
    r"CLEAR_RESUME_PROG",
    # system variables that have nothing to do with places, and variables of KAREL programs
    rf"\$(?:WAITTMOUT|WAITRELEASE|RMT_MASTER|TIMER\[{INDEX}\].*|MCR\.\$\w*OVERRIDE|MCR_GRP\[{INDEX}\]\.\$\w*OVERRIDE)=.+",
    r"\$\[\w+\]\w.*?=.+",
    # processes along the way
    r"(?:ARC|WELD) (?:START|END)(?:\[.*\])?",
    r"WEAVE (?:SINE|SINE 2|CIRCLE|FIGURE 8|L|END)(?:\[.*\])?",
    r"STITCH (?:ON|OFF|START|END|ENABLE|DISABLE)(?:\[.*\])?",
    r"SPOT\[.*\]",
    r"PRESS_MOTN\[.*\]",
    r"SS\[.*\]|SE",
    rf"GUN\[{INDEX}\]=.+",
    r"PALLETIZING-\w+",
    r"VISION (?:RUN_FIND|GET_PASSFAIL|GET_NFOUND|GET_READING|SET_REFERENCE)\b.*",
    r"-{2,}",  # the end of a point's logic
)
"""Instructions that change nothing of frames, tools, points, position registers, and of the way through the program."""

CHANGES: tuple[tuple[str, str], ...] = (
    ("frame number", rf"UFRAME_NUM(?:\[(?P<groups>{INDEX})\])?=(?P<value>.+)"),
    ("tool number", rf"UTOOL_NUM(?:\[(?P<groups>{INDEX})\])?=(?P<value>.+)"),
    ("frame", rf"UFRAME\[(?P<index>{INDEX})\]=(?P<value>.+)"),
    ("tool", rf"UTOOL\[(?P<index>{INDEX})\]=(?P<value>.+)"),
    ("register", rf"PR\[(?P<index>{INDEX})\]=(?P<value>.+)"),
    ("local register", rf"LPR\[{INDEX}\]=.+"),
    ("point", rf"P\[{INDEX}\]=.+"),
    ("offset", r"OFFSET CONDITION (?P<value>.+)"),
    ("tool offset", r"TOOL_OFFSET CONDITION (?P<value>.+)"),
    ("no vision offset", r"VOFFSET CONDITION .+"),  # a move that uses it says so
)
"""Instructions that change one thing, by what they change."""

MODES: tuple[tuple[str, str, str], ...] = (
    ("a seam is followed", r"TRACK (?!END\b).+", r"TRACK END\b.*"),
    ("a touch offset is on", r"TOUCH OFFSET (?!END\b).+", r"TOUCH OFFSET END\b.*"),
    ("a touch search is on", r"SEARCH START\b.*", r"SEARCH END\b.*"),
    ("an offset of passes is on", r"MP OFFSET (?!END\b).+", r"MP OFFSET END\b.*"),
    ("soft float is on", rf"SOFTFLOAT\[{INDEX}\]", r"SOFTFLOAT END\b.*"),
)
"""While these are on, the arm does not go where the points are: what it is, what begins and what ends it."""

MOVE = re.compile(
    rf"(?P<how>[JLCAS]) ?(?P<places>(?:(?:L?PR|P|PAL_\w+)\[{INDEX}\] ?){{1,2}})"
    rf"(?P<speed>(?:{VALUE} ?(?:%|MM/SEC|CM/MIN|INCH/MIN|DEG/SEC|MSEC|SEC)|MAX_SPEED|WELD_SPEED)) ?"
    rf"(?P<end>FINE|(?:CNT|CR|CD) ?{VALUE})(?P<options>.*)"
)
"""A motion instruction."""

PLACE = re.compile(rf"(?P<kind>L?PR|P|PAL_\w+)\[(?P<index>{INDEX})\]")

SIGNAL = rf"(?:DO|RO|GO|AO|SDO|F|M)\[{INDEX}\]=(?:\([^()]*\)|ON\b|OFF\b|PULSE\b(?:,[\d.]+ ?SEC)?|{VALUE}|(?:DI|RI|F)\[{INDEX}\])"

TIME = r"(?:TB|TA|DB|TIME BEFORE|TIME AFTER) ?[-+]?[\d.]+ ?(?:SEC|MM)"


@dataclass(frozen=True)
class Option:
    """What may stand behind the speed of a motion instruction.

    Attributes:
        does: Empty: nothing to where the arm goes; else one of ``offset``, ``tool offset``, ``skip``, ``call``, ``left``.
        pattern: How it stands there.
        why: Of what is ``left``: the reason.
    """

    does: str
    pattern: str
    why: str = ""


OPTIONS = (
    Option("", rf"ACC ?{VALUE}"),
    Option("", r"PTH\b|WJNT\b|BREAK\b|CTV ?[-+]?[\d.]+"),
    Option("", rf"(?:EV|IND\.EV) ?{VALUE}%"),
    Option("", rf"(?:RT_LD|AP_LD|PSPD) ?{VALUE}(?:MM\b)?"),
    Option("", rf"{TIME},(?:{SIGNAL}|POINT_LOGIC|P-SPS)"),
    Option("", rf"(?:ARC START|ARC END|WELD START|WELD END|SPOT|PRESS_MOTN|SS)\[{INDEX}\]|SE\b"),
    Option("call", rf"{TIME},CALL (?P<name>\w+)(?:\([^()]*\))?"),
    Option("skip", rf"SKIP(?:JUMP)?,LBL\[(?P<label>{INDEX})\](?:,PR\[(?P<register>{INDEX})\]=[LJ]POS)?"),
    Option("offset", rf"OFFSET\b(?:,PR\[(?P<register>{INDEX})\])?(?!,)"),
    Option("tool offset", rf"TOOL_OFFSET\b(?:,PR\[(?P<register>{INDEX})\])?(?!,)"),
    Option("left", rf"VOFFSET\b(?:,VR\[{INDEX}\])?", "a camera shifts it (VOFFSET)"),
    Option("left", r"INC\b", "it is a step from where the arm is (INC)"),
    Option("left", r"RTCP\b", "the tool stands still and the part moves (RTCP)"),
    Option("left", rf"COORD\b(?:\[{INDEX}\])?", "its frame moves with another group (COORD)"),
    Option("left", r"MROT\b", "the axes take the shorter way, whatever CONFIG says (MROT)"),
)

HEADERS = (
    r"(?:ARC|SPOT) ?WELDING EQUIPMENT(?: NUMBER)?:[\d,*]+",
    r"(?:SPOT|HANDLING|ARC|DISPENSE|PROCESS):(?:TRUE|FALSE)",
    r"LINE_TRACK",
    r"LINE_TRACK_SCHEDULE_NUMBER:0",
    r"LINE_TRACK_BOUNDARY_NUMBER:\d+",
    r"CONTINUE_TRACK_AT_PROG_END:(?:TRUE|FALSE)",
    r"AUTO_SINGULARITY_HEADER",
    r"ENABLE_SINGULARITY_AVOIDANCE:(?:TRUE|FALSE)",
    r"PLTZ_MODE_HEADER",
    r"PLTZ_MODE_ENABLE:FALSE",
    r"MPAS(?:_\w+:0)?",
    r"(?:J4TURN|ORIENT):\w+",
)
"""What may stand in /APPL of a program whose points are where they say. A schedule of line tracking is not among it."""
